// The end of a rally: the next one follows.

import type { Frames } from "./frame";
import type { Rallies, Shown } from "./rallies";
import type { Timeline } from "./timeline";

export class Ending {
  autoNext = true;

  /** @param next shows the next rally. */
  constructor(
    private readonly course: Timeline,
    private readonly frames: Frames,
    private readonly rallies: Rallies,
    private readonly next: () => Promise<void>,
  ) {}

  /** The playback has reached the end of the rally. */
  reached(shown: Shown): void {
    const { player } = this.frames;
    const { after, winner } = shown.rally;
    player.playing = false;
    if (this.autoNext && !this.rallies.pending && winner !== null && !after?.over && !(this.course.person && after?.game_won)) {
      void this.goOn();
    }
  }

  private async goOn(): Promise<void> {
    const { player, stage } = this.frames;
    const { motion, time } = player;
    await this.next();
    stage?.blendFrom(motion!, time);
  }
}
