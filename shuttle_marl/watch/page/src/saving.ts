// Exports: link, picture, video, page.

import type { Layout } from "./layout";
import type { Player } from "./player";
import type { Source } from "./rallies";
import { Recorder } from "./recorder";
import { save } from "./share";
import type { Stage } from "./stage";
import type { Timeline } from "./timeline";

export class Saving {
  private readonly recorder = new Recorder(save);

  constructor(
    private readonly course: Timeline,
    private readonly player: Player,
    private readonly stage: Stage | null,
    private readonly source: Source,
    private readonly layout: Layout,
  ) {}

  get link(): string {
    return this.course.link(this.player.stroke);
  }

  /** Updates the address of the page. */
  updateAddress(): void {
    history.replaceState(null, "", this.link);
  }

  copyLink(): void {
    this.updateAddress();
    navigator.clipboard?.writeText(location.href).catch(() => {});
    this.layout.say("Link copied; it contains seed, rally and stroke");
  }

  /** Saves the current frame. */
  picture(): void {
    const name = `rally-${this.course.number + 1}.png`;
    this.stage?.canvas.toBlob((picture) => picture && save(picture, name));
  }

  /** Plays the rally from its start at the selected speed and records it. */
  film(): void {
    if (!this.stage) {
      return;
    }
    this.layout.showText(false);
    this.recorder.stop();
    this.player.seek(0);
    this.player.playing = true;
    this.recorder.start(this.stage.canvas, `rally-${this.course.number + 1}.webm`);
    this.layout.say("recording until the rally ends or is paused");
  }

  /** Stops a running recording. */
  endFilm(): void {
    this.recorder.stop();
  }

  /** Saves the rally, or the match up to it, as a page that opens from disk. */
  async page(match: boolean): Promise<void> {
    const { course, source, layout } = this;
    const names = this.player.rally?.names;
    if (!source.share || !names) {
      return;
    }
    layout.say("creating the page …");
    const numbers = match && course.plan ? Array.from({ length: course.number + 1 }, (_, i) => i) : [course.number];
    const name = match ? "match.html" : `rally-${course.number + 1}.html`;
    try {
      const wanted = numbers.map((number) => course.wanted(number));
      const progress = (done: number) => layout.say(`creating the page … rally ${done + 1} of ${numbers.length}`);
      const page = await source.share(wanted, `${names[0]} v ${names[1]}`, this.link, progress);
      save(page, name);
      layout.say(`saved (${(page.size / 1e6).toFixed(1)} MB); the page opens without a server`);
    } catch (error) {
      layout.say((error as Error).message, true);
    }
  }
}
