// Motion of a rally: unpacking (docs/motion_format.md) and interpolation between frames. Axes are those of the
// court: x along the net, y along the court, z up, metres. Rotations are quaternions (x, y, z, w) relative to the parent bone.

import { FLIGHT, type Vec3 } from "./wire.gen";

export const BONES = 23;
const SCALE = ((1 << 14) - 1) * Math.SQRT2;
const HIPS_STEP = 2.5e-4;
const SHUTTLE_STEP = 5e-4;
const FLIP = 0.06; // time in which the shuttle flips after a contact [s]

// The flight of a shuttle from its launch, integrated as staging/flight.py does.
const { terminal: TERMINAL, gravity: GRAVITY, steps: STEPS } = FLIGHT;
const TIME = TERMINAL / GRAVITY;
const LENGTH = TERMINAL * TIME;

type State = [number, number, number, number]; // along, rise, and their speeds, scaled

function slope([, , along, up]: State): State {
  const speed = Math.hypot(along, up);
  return [along, up, -along * speed, -up * speed - 1];
}

function moved(s: State, by: State, h: number): State {
  return [s[0] + h * by[0], s[1] + h * by[1], s[2] + h * by[2], s[3] + h * by[3]];
}

class Flight {
  private readonly nodes: number[] = [0];
  private readonly states: State[];
  private readonly heading: [number, number];

  constructor(
    private readonly start: Vec3,
    velocity: Vec3,
    seconds: number,
  ) {
    const along = Math.hypot(velocity[0], velocity[1]);
    this.heading = [velocity[0] / Math.max(along, 1e-9), velocity[1] / Math.max(along, 1e-9)];
    const t = seconds / TIME;
    let s: State = [0, 0, along / TERMINAL, velocity[2] / TERMINAL];
    this.states = [s];
    const stretch = Math.log1p(Math.max(Math.hypot(s[2], s[3]) * t, 1e-3));
    for (let i = 1; i <= STEPS; i++) {
      const node = (t * Math.expm1((stretch * i) / STEPS)) / Math.max(Math.expm1(stretch), 1e-12);
      const h = node - this.nodes[i - 1]!;
      const k1 = slope(s);
      const k2 = slope(moved(s, k1, h / 2));
      const k3 = slope(moved(s, k2, h / 2));
      const k4 = slope(moved(s, k3, h));
      s = s.map((value, j) => value + (h / 6) * (k1[j]! + k4[j]! + 2 * (k2[j]! + k3[j]!))) as State;
      this.nodes.push(node);
      this.states.push(s);
    }
  }

  /** Position and velocity at a time since the launch [s]. */
  at(time: number, position: Vec3, velocity?: Vec3): void {
    const t = time / TIME;
    let k = 0;
    while (k < STEPS - 1 && this.nodes[k + 1]! <= t) {
      k++;
    }
    const h = this.nodes[k + 1]! - this.nodes[k]!;
    const u = Math.min(1, Math.max(0, (t - this.nodes[k]!) / h));
    const [a, b] = [this.states[k]!, this.states[k + 1]!];
    const place = (i: 0 | 1) =>
      (2 * u ** 3 - 3 * u ** 2 + 1) * a[i]! +
      (u ** 3 - 2 * u ** 2 + u) * h * a[i + 2]! +
      (3 * u ** 2 - 2 * u ** 3) * b[i]! +
      (u ** 3 - u ** 2) * h * b[i + 2]!;
    const [along, rise] = [LENGTH * place(0), LENGTH * place(1)];
    position[0] = this.start[0] + this.heading[0] * along;
    position[1] = this.start[1] + this.heading[1] * along;
    position[2] = this.start[2] + rise;
    if (velocity) {
      const speed = (i: 0 | 1) =>
        TERMINAL *
        ((6 * u * (1 - u) * (b[i]! - a[i]!)) / h + (1 - 4 * u + 3 * u ** 2) * a[i + 2]! + (3 * u ** 2 - 2 * u) * b[i + 2]!);
      const v = speed(0);
      velocity[0] = this.heading[0] * v;
      velocity[1] = this.heading[1] * v;
      velocity[2] = speed(1);
    }
  }
}

interface Launch {
  frame: number;
  end_frame: number;
  start: Vec3;
  velocity: Vec3;
}

export interface Head {
  fps: number;
  first: number;
  frames: number;
  players: [{ athlete: string; hand: string }, { athlete: string; hand: string }];
  strokes: Launch[];
}

/** Data of all frames. */
export interface Frames {
  hips: Float32Array; // [frames, 2, 3]
  local: Float32Array; // [frames, 2, BONES, 4]
  feet: Uint8Array; // [frames]
  loose: Float32Array; // [frames, 3], outside flights
}

async function inflated(content: Uint8Array<ArrayBuffer>): Promise<Uint8Array> {
  const stream = new Blob([content]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Sequential reader of a packed motion. */
class Reader {
  private offset = 0;
  constructor(private readonly data: Uint8Array) {}

  bytes(count: number): Uint8Array {
    this.offset += count;
    if (this.offset > this.data.length) {
      throw new Error("truncated packed motion");
    }
    return this.data.subarray(this.offset - count, this.offset);
  }

  /** Decodes three integer columns from second differences into every `stride`-th element of `out`. */
  columns(rows: number, scale: number, out: Float32Array, start: number, stride: number): void {
    for (let k = 0; k < 3; k++) {
      const low = this.bytes(rows);
      const high = this.bytes(rows);
      let change = 0;
      let value = 0;
      for (let i = 0; i < rows; i++) {
        const zigzag = low[i]! | (high[i]! << 8);
        change = (change + ((zigzag >> 1) ^ -(zigzag & 1))) | 0;
        value = ((value + change) << 16) >> 16;
        out[start + i * stride + k] = value * scale;
      }
    }
  }
}

export class Motion {
  readonly fps: number;
  readonly frames: number;
  private readonly flights: Flight[];

  /** @param kept data of all frames, including those before the first frame of the header. */
  constructor(
    readonly head: Head,
    readonly kept: Frames,
  ) {
    this.fps = head.fps;
    this.frames = head.first + head.frames;
    this.flights = head.strokes.map((s) => new Flight(s.start, s.velocity, (s.end_frame - s.frame) / head.fps));
  }

  /**
   * Unpacks a motion.
   * @param before has the frames before the first one that is packed, where that is not frame 0.
   */
  static async unpack(content: ArrayBuffer, before: Motion | null = null): Promise<Motion> {
    const magic = new Uint8Array(content, 0, 5);
    if (String.fromCharCode(...magic.subarray(0, 4)) !== "SMOT" || magic[4] !== 2) {
      throw new Error("not a packed motion of version 2");
    }
    const data = await inflated(new Uint8Array(content, 5));
    const size = new DataView(data.buffer, data.byteOffset).getUint32(0, true);
    const head: Head = JSON.parse(new TextDecoder().decode(data.subarray(4, 4 + size)));
    const { first, frames: count, strokes } = head;
    if (first && (!before || before.frames < first)) {
      throw new Error("the frames before this packed motion are missing");
    }
    const total = first + count;
    const out = {
      hips: new Float32Array(total * 6),
      local: new Float32Array(total * 2 * BONES * 4),
      feet: new Uint8Array(total),
      loose: new Float32Array(total * 3),
    };
    if (before) {
      for (const name of ["hips", "local", "feet", "loose"] as const) {
        const per = out[name].length / total;
        out[name].set(before.kept[name].subarray(0, first * per));
      }
    }
    const reader = new Reader(data.subarray(4 + size));
    for (let seat = 0; seat < 2; seat++) {
      reader.columns(count, HIPS_STEP, out.hips, first * 6 + seat * 3, 6);
      readBones(reader, count, out.local, first, seat);
    }
    out.feet.set(reader.bytes(count), first);
    const free: number[] = [];
    for (let frame = first; frame < total; frame++) {
      if (!strokes.some((s) => s.frame <= frame && frame <= s.end_frame)) {
        free.push(frame);
      }
    }
    const places = new Float32Array(free.length * 3);
    reader.columns(free.length, SHUTTLE_STEP, places, 0, 3);
    free.forEach((frame, i) => out.loose.set(places.subarray(3 * i, 3 * i + 3), 3 * frame));
    return new Motion(head, out);
  }

  get duration(): number {
    return (this.frames - 1) / this.fps;
  }

  /** Whether the left and the right foot of a player stand. */
  plantedAt(frame: number, seat: number): [boolean, boolean] {
    const bits = this.kept.feet[frame]! >> (2 * seat);
    return [(bits & 1) === 1, (bits & 2) === 2];
  }

  /** Frame before a time, and the fraction of the interval to the next one. */
  private at(time: number): [number, number] {
    const exact = Math.min(Math.max(time * this.fps, 0), this.frames - 1);
    const frame = Math.min(Math.floor(exact + 1e-6), Math.max(this.frames - 2, 0));
    return [frame, Math.max(0, exact - frame)];
  }

  hipsAt(time: number, seat: number, out: Vec3): Vec3 {
    const [frame, share] = this.at(time);
    const { hips } = this.kept;
    const a = frame * 6 + seat * 3;
    const b = Math.min(frame + 1, this.frames - 1) * 6 + seat * 3;
    for (let k = 0; k < 3; k++) {
      out[k] = hips[a + k]! + share * (hips[b + k]! - hips[a + k]!);
    }
    return out;
  }

  /** Rotations of all bones of a player relative to their parents, as quaternions. */
  rotationsAt(time: number, seat: number, out: Float64Array): void {
    const [frame, share] = this.at(time);
    const size = BONES * 4;
    const a = (frame * 2 + seat) * size;
    const b = (Math.min(frame + 1, this.frames - 1) * 2 + seat) * size;
    const q = this.kept.local;
    for (let i = 0; i < size; i += 4) {
      let dot = 0;
      for (let k = 0; k < 4; k++) {
        dot += q[a + i + k]! * q[b + i + k]!;
      }
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

  /** Index of the flight at a time; -1 outside of flights. */
  private flightAt(time: number): number {
    const exact = time * this.fps;
    return this.head.strokes.findLastIndex((s) => s.frame <= exact + 1e-6 && exact <= s.end_frame + 1e-6);
  }

  /** Position of the shuttle. */
  shuttleAt(time: number, out: Vec3, velocity?: Vec3): Vec3 {
    const flight = this.flightAt(time);
    if (flight >= 0) {
      this.flights[flight]!.at(time - this.head.strokes[flight]!.frame / this.fps, out, velocity);
      return out;
    }
    const [frame, share] = this.at(time);
    const [a, b] = [this.placeOf(frame), this.placeOf(Math.min(frame + 1, this.frames - 1))];
    for (let k = 0; k < 3; k++) {
      out[k] = a[k]! + share * (b[k]! - a[k]!);
      if (velocity) {
        velocity[k] = (b[k]! - a[k]!) * this.fps;
      }
    }
    return out;
  }

  private placeOf(frame: number): Vec3 {
    if (this.flightAt(frame / this.fps) >= 0) {
      return this.shuttleAt(frame / this.fps, [0, 0, 0]);
    }
    const { loose } = this.kept;
    return [loose[3 * frame]!, loose[3 * frame + 1]!, loose[3 * frame + 2]!];
  }

  /** Direction of the cork: the direction of flight, except shortly after a contact. */
  headingAt(time: number, out: Vec3): Vec3 {
    const flight = this.head.strokes.findLastIndex((s) => s.frame <= time * this.fps + 1e-6);
    if (flight < 0) {
      out[0] = out[1] = 0;
      out[2] = -1; // in the hand the cork points down
      return out;
    }
    const stroke = this.head.strokes[flight]!;
    const since = time - stroke.frame / this.fps;
    const end = (stroke.end_frame - stroke.frame) / this.fps;
    this.wayOf(flight, Math.min(since, end), out);
    if (since < FLIP) {
      const before: Vec3 = flight ? this.wayOf(flight - 1, Infinity, [0, 0, 0]) : [0, 0, -1];
      mix(before, out, since / FLIP);
    } else if (since > end) {
      // A shuttle at rest lies on its side.
      const share = Math.min(1, (since - end) / 0.2);
      mix([...out], Object.assign(out, flat(out)), share);
    }
    return out;
  }

  private wayOf(flight: number, since: number, out: Vec3): Vec3 {
    const { frame, end_frame } = this.head.strokes[flight]!;
    this.flights[flight]!.at(Math.min(since, (end_frame - frame) / this.fps), [0, 0, 0], out);
    return unit(out);
  }
}

function readBones(reader: Reader, count: number, local: Float32Array, first: number, seat: number): void {
  const changes = reader.bytes(BONES * count);
  const size = BONES * 4;
  const rest = new Float32Array(count * 3);
  for (let bone = 0; bone < BONES; bone++) {
    reader.columns(count, 1 / SCALE, rest, 0, 3);
    let largest = 0;
    for (let i = 0; i < count; i++) {
      largest = (largest + changes[bone * count + i]!) & 255;
      const at = ((first + i) * 2 + seat) * size + bone * 4;
      let [sum, k] = [0, 0];
      for (let c = 0; c < 4; c++) {
        if (c !== (largest & 3)) {
          const value = rest[3 * i + k++]!;
          local[at + c] = value;
          sum += value * value;
        }
      }
      local[at + (largest & 3)] = Math.sqrt(Math.max(0, 1 - sum));
    }
  }
}

function unit(v: Vec3): Vec3 {
  const length = Math.hypot(...v) || 1;
  for (let k = 0; k < 3; k++) {
    v[k]! /= length;
  }
  return v;
}

function flat(v: Vec3): Vec3 {
  return unit([v[0] + 1e-6, v[1], 0]);
}

/** Turns direction `a` towards `b` by a fraction of the angle between them; the result is in `b`. */
function mix(a: Vec3, b: Vec3, share: number): void {
  const dot = Math.min(1, Math.max(-1, a[0] * b[0] + a[1] * b[1] + a[2] * b[2]));
  const angle = Math.acos(dot);
  let aside: Vec3 = [b[0] - dot * a[0], b[1] - dot * a[1], b[2] - dot * a[2]];
  if (Math.hypot(...aside) < 1e-6) {
    aside = Math.abs(a[2]) < 0.9 ? [a[1], -a[0], 0] : [0, a[2], -a[1]];
  }
  unit(aside);
  for (let k = 0; k < 3; k++) {
    b[k] = Math.cos(share * angle) * a[k]! + Math.sin(share * angle) * aside[k]!;
  }
}
