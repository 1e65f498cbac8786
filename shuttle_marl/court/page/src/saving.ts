// Exports: link, picture, video, page.

import { cardSize, drawCard } from "./card";
import type { Frames } from "./frame";
import type { Layout } from "./layout";
import type { Player } from "./player";
import type { Source } from "./rallies";
import { Recorder } from "./recorder";
import type { Screen } from "./screen";
import { save } from "./share";
import type { Timeline } from "./timeline";
import { decimal, say } from "./words";

export class Saving {
  private readonly recorder = new Recorder(save);
  private readonly card = document.createElement("canvas");

  constructor(
    private readonly course: Timeline,
    private readonly player: Player,
    private readonly frames: Frames,
    private readonly source: Source,
    private readonly screen: Screen,
  ) {}

  private get layout(): Layout {
    return this.screen.layout;
  }

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
    this.layout.say(say("page.link_copied"));
  }

  /** Draws the current moment into the card. */
  private drawCard(): void {
    const { stage } = this.frames;
    const { moment } = this.screen;
    if (stage && moment) {
      drawCard(this.card, stage.canvas, moment);
    }
  }

  private prepare(size: [number, number]): void {
    [this.card.width, this.card.height] = size;
    this.frames.fix(size);
  }

  /** Saves the current moment, in full high definition on any machine. */
  picture(draw: () => void): void {
    this.layout.showText(false);
    this.prepare(cardSize());
    draw();
    this.drawCard();
    this.frames.fix(null);
    const name = `rally-${this.course.number + 1}.png`;
    this.card.toBlob((picture) => picture && save(picture, name));
  }

  /** Plays the rally from its start at the selected speed and records it. */
  film(draw: () => void): void {
    if (!this.frames.stage) {
      return;
    }
    this.layout.showText(false);
    this.recorder.stop();
    this.player.seek(0);
    this.player.playing = true;
    this.prepare(cardSize());
    draw();
    this.drawCard(); // the first frame of the film is not empty
    this.recorder.start(this.card, `rally-${this.course.number + 1}.webm`);
    this.layout.say(say("page.recording"));
  }

  /** Fills the window with the card, for a video. */
  fillWindow(): void {
    this.card.className = "card";
    this.layout.court.append(this.card);
    this.prepare([innerWidth, innerHeight]);
  }

  /** Adds the frame that was drawn to the film. */
  drawn(): void {
    if (this.recorder.isRunning || this.card.isConnected) {
      this.drawCard();
    }
  }

  /** Stops a running recording. */
  endFilm(): void {
    if (this.recorder.isRunning) {
      this.recorder.stop();
      this.frames.fix(null);
    }
  }

  /** Saves the rally, or the match up to it, as a page that opens from disk. */
  async page(match: boolean): Promise<void> {
    const { course, source, layout } = this;
    const names = this.player.rally?.names;
    if (!source.share || !names) {
      return;
    }
    layout.say(say("page.creating"));
    const numbers = match && course.plan ? Array.from({ length: course.number + 1 }, (_, i) => i) : [course.number];
    const name = match ? "match.html" : `rally-${course.number + 1}.html`;
    try {
      const wanted = numbers.map((number) => course.wanted(number));
      const progress = (done: number) => layout.say(say("page.creating_rally", { number: done + 1, count: numbers.length }));
      const page = await source.share(wanted, names.join(say("page.versus")), this.link, progress);
      save(page, name);
      layout.say(say("page.saved", { size: decimal(page.size / 1e6, 1) }));
    } catch (error) {
      layout.say((error as Error).message, true);
    }
  }
}
