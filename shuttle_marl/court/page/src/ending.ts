// The end of a rally: its best stroke once more, and the next rally.

import { still } from "./dom";
import type { Frames } from "./frame";
import type { Rallies, Shown } from "./rallies";
import type { Screen } from "./screen";
import type { Camera } from "./stage";
import type { Timeline } from "./timeline";
import type { RallyFacts } from "./wire.gen";
import { say } from "./words";

const LONG = 20; // strokes of a rally whose end is replayed

export class Ending {
  /** Whether the rally is repeated. */
  loop = false;
  autoNext = true;
  private replayed: Camera | null = null; // the camera before a slow replay

  /** @param next shows the next rally. */
  constructor(
    private readonly course: Timeline,
    private readonly frames: Frames,
    private readonly rallies: Rallies,
    private readonly screen: Screen,
    private readonly next: () => Promise<void>,
  ) {}

  /** The playback has reached the end of the rally. */
  reached(shown: Shown): void {
    const { player } = this.frames;
    const { after, winner } = shown.rally;
    player.playing = false;
    if (this.loop) {
      player.seek(0);
      player.playing = true;
    } else if (this.replaysBest(shown.rally)) {
      return;
    } else if (
      this.autoNext &&
      !this.rallies.pending &&
      winner !== null &&
      !after?.over &&
      !(this.course.person && after?.game_won)
    ) {
      void this.goOn();
    }
  }

  /** Ends a slow replay from the side. */
  restoreCamera(): void {
    if (this.replayed && this.frames.stage) {
      this.frames.stage.camera = this.replayed;
    }
    this.replayed = null;
  }

  private async goOn(): Promise<void> {
    const { player, stage } = this.frames;
    const { motion, time } = player;
    await this.next();
    stage?.blendFrom(motion!, time);
  }

  /** Replays the best stroke of a remarkable rally from the side, once, before the next rally; returns whether it does. */
  private replaysBest(rally: RallyFacts): boolean {
    const { course, screen } = this;
    const { player, stage } = this.frames;
    if (this.replayed) {
      this.restoreCamera();
      return false;
    }
    const duel = course.person !== null && !!course.plan?.points;
    const shown = (mark: string, i: number) => (duel ? mark.startsWith("!") && rally.strokes[i]!.person : mark === "!!");
    const best = screen.analysis?.strokes.findLastIndex(({ mark }, i) => shown(mark, i)) ?? -1;
    const last = rally.strokes.length - 1;
    const wanted = duel || screen.mode === "watch";
    if (!stage || still() || !this.autoNext || !wanted || (best < 0 && last + 1 < LONG)) {
      return false;
    }
    this.replayed = stage.camera;
    stage.camera = "side";
    player.replay(best < 0 ? last : best, true);
    screen.layout.say(say("page.slow"));
    return true;
  }
}
