// Frame loop: advances the time and draws the court if something changed.

import type { Motion } from "./motion";
import { Player } from "./player";
import type { Flight } from "./shuttle";
import { Stage } from "./stage";
import type { HallFacts, RallyFacts, StrokeValue } from "./wire.gen";

const SETTLING = 45; // frames until cameras and poses settle
const RESTING = 300; // frame interval of waiting players in software rendering, which keeps input responsive [ms]
const LONGEST = 0.1; // maximum time step of a frame [s]
const FRAMES = 240; // number of frame durations that are stored

export interface FrameListener {
  /** Updates everything beside the court. */
  update(): void;
  /** The frame is drawn; `ended`: the rally reached its end. */
  drawn(ended: boolean): void;
}

export class Frames {
  readonly player = new Player();
  readonly stage: Stage | null;
  /** Durations of the last frames [ms]. */
  readonly durations: number[] = [];
  /** Target area of a person: x0, x1, y0, y1. */
  aim: [number, number, number, number] | null = null;
  /** Areas that a person may choose. */
  legal: [number, number, number, number][] = [];
  /** Flight of a stroke that is pointed at. */
  flight: Flight | null = null;
  /** The stroke whose positions and open side are shown; null: none are. */
  waiting: StrokeValue | null = null;
  private shown: { rally: RallyFacts; motion: Motion } | null = null;
  private last = 0; // time of the last frame [ms]
  private version = 0; // increases with each rally shown
  private seen = ""; // state that the last frame depends on
  private unsettled = 0; // frames to draw although nothing changed
  private drawnAt = 0;
  private drawnTime = 0;

  /** @param still whether cameras and waiting players stand still. */
  constructor(
    hall: HallFacts,
    model: (athlete: string) => Promise<ArrayBuffer>,
    quality: "auto" | "full" | "lite",
    private readonly still: boolean,
    nameOnShirt: (identifier: string) => string,
  ) {
    try {
      this.stage = new Stage(hall, model, quality, still, nameOnShirt);
    } catch {
      this.stage = null; // no WebGL: the rally is described as text
    }
  }

  show(rally: RallyFacts, motion: Motion, time: number): void {
    this.player.show(rally, motion, time, this.still);
    this.shown = { rally, motion };
    this.version++;
  }

  resize(width: number, height: number): void {
    this.stage?.resize(width, height);
    this.seen = "";
  }

  start(listener: FrameListener): void {
    requestAnimationFrame((now) => this.frame(now, listener));
  }

  private frame(now: number, listener: FrameListener): void {
    const began = performance.now();
    const seconds = Math.min(LONGEST, (now - this.last) / 1000);
    this.last = now;
    const ended = this.player.advance(seconds);
    this.draw(listener);
    listener.drawn(ended);
    this.durations.push(performance.now() - began);
    if (this.durations.length > FRAMES) {
      this.durations.shift();
    }
    this.start(listener);
  }

  draw(listener: FrameListener): void {
    if (this.shown) {
      listener.update();
      if (!document.body.classList.contains("text")) {
        this.drawCourt(this.shown.rally, this.shown.motion);
      }
    }
  }

  private drawCourt(rally: RallyFacts, motion: Motion): void {
    const { stage, player } = this;
    if (!stage) {
      return;
    }
    const now = performance.now();
    const resting = stage.lite && player.waits && now - this.drawnAt < RESTING;
    const seen = [
      this.version,
      resting ? this.drawnTime : player.time,
      stage.camera,
      stage.flipped,
      this.aim,
      this.legal.length,
      this.flight?.shot,
      this.waiting !== null,
      player.playing,
    ].join();
    if (seen !== this.seen) {
      this.seen = seen;
      this.unsettled = stage.lite ? 1 : SETTLING;
    }
    if (this.unsettled > 0 || stage.camera === "free") {
      this.unsettled--;
      [this.drawnAt, this.drawnTime] = [now, player.time];
      stage.draw(rally, motion, player.time, this.aim, this.legal, this.flight, this.waiting, !player.playing && !player.waits);
    }
  }
}
