// Plays a rally by the clock: time, speed, steps.

import type { Motion } from "./motion";
import type { RallyFacts } from "./wire.gen";

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4] as const;
/** How long before they strike a person is waited for [s]. */
export const EARLY = 0.45;
const HASTE = 1.2; // of breathing while players wait; twice the highest speed of their time

export class Player {
  time = 0;
  speed = 1;
  playing = false;
  rally: RallyFacts | null = null;
  motion: Motion | null = null;
  /** Where the playback stops once, for example before a decision; null: nowhere. */
  stopAt: number | null = null;
  /** End of the time in which players wait for the serve of a person, who may take long; null: they do not. */
  waiting: number | null = null;
  private breath = 0; // phase of the waiting
  private until: { time: number; speed: number } | null = null;

  /** @param still whether players who wait do not move. */
  show(rally: RallyFacts, motion: Motion, time: number, still: boolean): void {
    this.rally = rally;
    this.motion = motion;
    this.time = Math.min(time, motion.duration);
    this.breath = 0;
    const turn = rally.turn ? Math.max(0, motion.duration - EARLY) : null;
    this.stopAt = turn;
    this.waiting = rally.strokes.length || still ? null : turn;
    this.until = null;
  }

  get duration(): number {
    return this.motion?.duration ?? 0;
  }

  /** Number of the stroke that was struck last, -1 before the serve. */
  get stroke(): number {
    return this.rally?.strokes.findLastIndex((stroke) => stroke.time <= this.time + 1e-6) ?? -1;
  }

  /** Whether players wait for a serve now. */
  get waits(): boolean {
    return this.waiting !== null && !this.playing;
  }

  /** Plays what is left of the motion. */
  finish(): void {
    this.waiting = null;
    this.stopAt = Math.max(this.time, this.duration - 0.1);
    this.playing = true;
  }

  seek(time: number): void {
    this.time = Math.min(Math.max(time, 0), this.duration);
    this.endReplay();
  }

  /** Lets time pass; returns whether the end was reached. */
  advance(seconds: number): boolean {
    if (this.waits) {
      // They breathe and shift their weight: their time goes to and fro.
      this.breath += (seconds * HASTE) / this.waiting!;
      this.time = (this.waiting! * (1 + Math.cos(this.breath))) / 2;
    }
    if (!this.playing || !this.motion) {
      return false;
    }
    let time = this.time + seconds * this.speed;
    if (this.stopAt !== null && this.time < this.stopAt && time >= this.stopAt) {
      time = this.stopAt;
      this.stopAt = null;
      this.playing = false;
    }
    if (this.until && time >= this.until.time) {
      this.endReplay();
    }
    this.time = Math.min(time, this.duration);
    return this.playing && this.time >= this.duration;
  }

  stepFrame(frames: number): void {
    this.playing = false;
    const fps = this.motion?.fps ?? 50;
    this.seek((Math.round(this.time * fps) + frames) / fps);
  }

  /** Goes to the contact of the next stroke, or the one before; false if there is none. */
  stepStroke(step: number): boolean {
    const strokes = this.rally?.strokes ?? [];
    const next = this.stroke + step;
    if (next < 0 || next >= strokes.length) {
      return false;
    }
    this.playing = false;
    this.seek(strokes[next]!.time);
    return true;
  }

  /** Shows the last stroke again, slowly, and then continues as before. */
  replayLast(): void {
    const stroke = this.rally?.strokes[Math.max(this.stroke, 0)];
    if (!stroke) {
      return;
    }
    const resume = { time: Math.max(this.time, stroke.end_time), speed: this.until?.speed ?? this.speed };
    this.time = Math.max(0, stroke.time - 0.7);
    this.speed = 0.25;
    this.playing = true;
    this.until = resume;
  }

  private endReplay(): void {
    if (this.until) {
      this.speed = this.until.speed;
      this.until = null;
    }
  }
}
