// Motion of a rally as numbers, and what it is between two frames. Axes are those of the court: x along the net, y along the
// court, z up, metres; rotations are quaternions (x, y, z, w) since the rest pose.

import type { RallyFacts, Vec3 } from "./wire";

export const FLIP = 0.06; // time in which a shuttle turns its cork round after it was struck [s]

export class Motion {
  readonly fps: number;
  readonly frames: number;
  readonly bones: number;
  private readonly hips: Float32Array;
  private readonly shuttle: Float32Array;
  private readonly velocity: Float32Array;
  private readonly rotation: Int16Array;
  private readonly contacts: Set<number>;
  private readonly first: number;

  constructor(facts: RallyFacts, body: ArrayBuffer, bones: number) {
    this.fps = facts.fps;
    this.frames = facts.frames;
    this.bones = bones;
    const n = facts.frames;
    this.hips = new Float32Array(body, 0, n * 6);
    this.shuttle = new Float32Array(body, n * 24, n * 3);
    this.velocity = new Float32Array(body, n * 36, n * 3);
    this.rotation = new Int16Array(body, n * 48, n * 2 * bones * 4);
    this.contacts = new Set(facts.strokes.map((stroke) => stroke.frame));
    this.first = facts.strokes[0]?.frame ?? 0;
  }

  get duration(): number {
    return (this.frames - 1) / this.fps;
  }

  /** Frame before a time, and how far it is towards the next one. */
  private at(time: number): [number, number] {
    const exact = Math.min(Math.max(time * this.fps, 0), this.frames - 1);
    const frame = Math.min(Math.floor(exact), Math.max(this.frames - 2, 0));
    return [frame, exact - frame];
  }

  hipsAt(time: number, seat: number, out: Vec3): Vec3 {
    const [frame, share] = this.at(time);
    for (let k = 0; k < 3; k++) {
      const a = this.hips[frame * 6 + seat * 3 + k]!;
      const b = this.hips[Math.min(frame + 1, this.frames - 1) * 6 + seat * 3 + k]!;
      out[k] = a + share * (b - a);
    }
    return out;
  }

  /** Rotations of all bones of a player, four numbers each. */
  rotationsAt(time: number, seat: number, out: Float64Array): void {
    const [frame, share] = this.at(time);
    const size = this.bones * 4;
    const a = (frame * 2 + seat) * size;
    const b = (Math.min(frame + 1, this.frames - 1) * 2 + seat) * size;
    const q = this.rotation;
    for (let i = 0; i < size; i += 4) {
      const dot = q[a + i]! * q[b + i]! + q[a + i + 1]! * q[b + i + 1]! + q[a + i + 2]! * q[b + i + 2]! + q[a + i + 3]! * q[b + i + 3]!;
      const sign = dot < 0 ? -share : share;
      let sum = 0;
      for (let k = 0; k < 4; k++) {
        const value = (1 - share) * q[a + i + k]! + sign * q[b + i + k]!;
        out[i + k] = value;
        sum += value * value;
      }
      const scale = 1 / Math.sqrt(sum);
      for (let k = 0; k < 4; k++) {
        out[i + k]! *= scale;
      }
    }
  }

  /** Where the shuttle is: a cubic that leaves each frame with its velocity. */
  shuttleAt(time: number, out: Vec3): Vec3 {
    const [frame, u] = this.at(time);
    const next = Math.min(frame + 1, this.frames - 1);
    const dt = 1 / this.fps;
    const struck = this.contacts.has(next);
    for (let k = 0; k < 3; k++) {
      const p0 = this.shuttle[frame * 3 + k]!;
      const p1 = this.shuttle[next * 3 + k]!;
      const m0 = this.velocity[frame * 3 + k]! * dt;
      // The velocity of the frame of a contact is that with which the shuttle leaves.
      const m1 = struck ? 2 * (p1 - p0) - m0 : this.velocity[next * 3 + k]! * dt;
      const u2 = u * u;
      const u3 = u2 * u;
      out[k] = (2 * u3 - 3 * u2 + 1) * p0 + (u3 - 2 * u2 + u) * m0 + (3 * u2 - 2 * u3) * p1 + (u3 - u2) * m1;
    }
    return out;
  }

  /** Direction in which the cork points. */
  headingAt(time: number, out: Vec3): Vec3 {
    const frame = Math.min(Math.floor(time * this.fps + 1e-6), this.frames - 1);
    this.wayOf(frame, out);
    let contact = -1;
    for (const struck of this.contacts) {
      if (struck <= frame && struck > contact) {
        contact = struck;
      }
    }
    const since = time - contact / this.fps;
    if (contact >= 0 && since < FLIP) {
      const before = this.wayOf(Math.max(contact - 1, 0), [0, 0, 0]);
      mix(before, out, Math.max(0, since / FLIP));
    }
    return out;
  }

  private wayOf(frame: number, out: Vec3): Vec3 {
    out[0] = 0;
    out[1] = 0;
    out[2] = -1; // in the hand the cork points down
    for (let f = frame; f >= this.first; f--) {
      const v = this.velocity.subarray(f * 3, f * 3 + 3);
      const speed = Math.hypot(v[0]!, v[1]!, v[2]!);
      if (speed > 0.3) {
        for (let k = 0; k < 3; k++) {
          out[k] = v[k]! / speed;
        }
        break;
      }
    }
    return out;
  }
}

/** Turns direction `a` towards `b` by a share of the angle between them; the result is in `b`. */
function mix(a: Vec3, b: Vec3, share: number): void {
  const dot = Math.min(1, Math.max(-1, a[0] * b[0] + a[1] * b[1] + a[2] * b[2]));
  const angle = Math.acos(dot);
  let aside: Vec3 = [b[0] - dot * a[0], b[1] - dot * a[1], b[2] - dot * a[2]];
  let length = Math.hypot(...aside);
  if (length < 1e-6) {
    aside = Math.abs(a[2]) < 0.9 ? [a[1], -a[0], 0] : [0, a[2], -a[1]];
    length = Math.hypot(...aside);
  }
  for (let k = 0; k < 3; k++) {
    b[k] = Math.cos(share * angle) * a[k]! + (Math.sin(share * angle) * aside[k]!) / length;
  }
}
