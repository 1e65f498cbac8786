// Playback of a rally: time, speed, steps.

import type { Motion } from "./motion";
import type { RallyFacts } from "./wire.gen";

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4] as const;
const EARLY = 0.45; // time before the contact of a person at which the playback waits for their choice [s]
const HASTE = 1.2; // rate of breathing of waiting players; twice the maximum speed of playback

export class Player {
  time = 0;
  speed = 1;
  playing = false;
  rally: RallyFacts | null = null;
  motion: Motion | null = null;
  /** Duration of the rally [s]. */
  duration = 0;
  /** Time at which the playback stops once, for example before a decision; null: none. */
  stopAt: number | null = null;
  /** End of the interval in which players wait for the serve of a person; null: none. */
  waiting: number | null = null;
  private breath = 0; // phase of breathing
  private until: { time: number; speed: number } | null = null;

  /** @param still whether waiting players stand still. */
  show(rally: RallyFacts, motion: Motion, time: number, still: boolean): void {
    this.rally = rally;
    this.motion = motion;
    this.duration = motion.duration;
    this.time = Math.min(time, motion.duration);
    this.breath = 0;
    const turn = rally.turn ? this.choice : null;
    this.stopAt = turn;
    this.waiting = rally.strokes.length || still ? null : turn;
    this.until = null;
  }

  /** Time at which a person chooses the next stroke: after the last one, however fast the shuttle is. */
  get choice(): number {
    return Math.max(this.rally?.strokes.at(-1)?.time ?? 0, this.duration - EARLY);
  }

  /** Number of the last stroke; -1 before the serve. */
  get stroke(): number {
    return this.rally?.strokes.findLastIndex((stroke) => stroke.time <= this.time + 1e-6) ?? -1;
  }

  /** Whether players wait for a serve now. */
  get waits(): boolean {
    return this.waiting !== null && !this.playing;
  }

  /** Plays the rest of the motion. */
  finish(): void {
    this.waiting = null;
    this.stopAt = Math.max(this.time, this.duration - 0.1);
    this.playing = true;
  }

  seek(time: number): void {
    this.time = Math.min(Math.max(time, 0), this.duration);
    this.endReplay();
  }

  /** Advances the time; returns whether the end was reached. */
  advance(seconds: number): boolean {
    if (this.waits) {
      // Breathing and weight shifts: the time of their motion oscillates.
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
    this.endReplay();
    this.time = Math.min(Math.max((Math.round(this.time * fps) + frames) / fps, 0), this.duration);
  }

  /** Seeks the contact of the next or previous stroke; false if there is none. */
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

  /** Replays the last stroke in slow motion, then continues. */
  replay(): void {
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
