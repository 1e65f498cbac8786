// Lossy compression of motions for pages with whole matches. Rotations are rotation vectors relative to the mean of their
// bone; every value is predicted from its neighbours in time, coarse intervals first, and the residual is quantized. The error
// is at most half a quantization step, and smaller near contacts.

import { BONES, type Frames, type Head, Motion } from "./motion";

const MAGIC = "CMOT";
// Length of the chain that each bone moves [m]; longer chains have finer steps.
const ARM = [1.3, 1.2, 0.95, 0.75];
const LEG = [0.95, 0.5, 0.2, 0.1];
const REACH = [1.7, 1.5, 1.45, 1.4, 0.3, 0.25, ...ARM, ...ARM, ...LEG, ...LEG, 0.65];
const TURN_STEP = 0.0064; // step of a rotation times the length of the chain [m]
const PLACE_STEP = 0.002; // step of a position [m]
const FAR = 4; // frames predicted from at least this distance have half the step, because others are predicted from them
const NEAR = 2; // frames before and after a contact with a third of the step

/** Distances of prediction, largest first; 0 is the first frame, which is not predicted. */
function distances(count: number): number[] {
  const out: number[] = [];
  for (let distance = 1; distance < count; distance *= 2) {
    out.unshift(distance);
  }
  return count ? [0, ...out] : [];
}

function predicted(values: Float64Array, i: number, distance: number): number {
  if (!distance) {
    return 0;
  }
  const before = values[i - distance]!;
  if (i + distance >= values.length) {
    return before;
  }
  const sum = before + values[i + distance]!;
  const [earlier, later] = [i - 3 * distance, i + 3 * distance];
  return earlier < 0 || later >= values.length ? sum / 2 : (9 * sum - values[earlier]! - values[later]!) / 16;
}

/** Quantizes columns or restores them; both directions predict from restored values. */
interface Steps {
  /** The restored value of an element of a column. */
  next(value: number, guess: number, step: number): number;
}

class Writer implements Steps {
  readonly bytes: number[] = [];

  next(value: number, guess: number, step: number): number {
    const steps = Math.round((value - guess) / step);
    let folded = steps < 0 ? -2 * steps - 1 : 2 * steps;
    while (folded > 127) {
      this.bytes.push((folded & 127) | 128);
      folded = Math.floor(folded / 128);
    }
    this.bytes.push(folded);
    return guess + steps * step;
  }
}

class Reader implements Steps {
  private at = 0;
  constructor(private readonly bytes: Uint8Array) {}

  next(_: number, guess: number, step: number): number {
    let [folded, factor, byte] = [0, 1, 0];
    do {
      if (this.at >= this.bytes.length) {
        throw new Error("truncated motion in this page");
      }
      byte = this.bytes[this.at++]!;
      folded += (byte & 127) * factor;
      factor *= 128;
    } while (byte > 127);
    return guess + (folded & 1 ? -(folded + 1) / 2 : folded / 2) * step;
  }
}

/** Codes all columns, one distance after the other; afterwards they hold the restored values. */
function run(steps: Steps, columns: Float64Array[], widths: number[], near: Uint8Array): void {
  const count = columns[0]?.length ?? 0;
  for (const distance of distances(count)) {
    const share = distance >= FAR || !distance ? 1 / 2 : 1;
    columns.forEach((column, k) => {
      for (let frame = distance; frame < count; frame += 2 * distance || count) {
        const width = widths[k]! * (near[frame] ? 1 / 3 : share);
        column[frame] = steps.next(column[frame]!, predicted(column, frame, distance), width);
      }
    });
  }
}

/** All columns of a motion, positions and rotations, with their quantization steps. */
function all(steps: Steps, parts: Parts, head: Head, coarse: number): void {
  const near = new Uint8Array(head.first + head.frames);
  head.strokes.forEach(({ frame }) => near.fill(1, Math.max(0, frame - NEAR), frame + NEAR + 1));
  const turns = Array.from({ length: parts.turns.length }, (_, k) => (coarse * TURN_STEP) / REACH[Math.floor(k / 3) % BONES]!);
  run(steps, parts.turns, turns, near);
  run(
    steps,
    parts.hips,
    parts.hips.map(() => PLACE_STEP),
    near,
  );
  run(
    steps,
    parts.loose,
    parts.loose.map(() => PLACE_STEP),
    new Uint8Array(0),
  );
}

interface Parts {
  turns: Float64Array[];
  hips: Float64Array[];
  loose: Float64Array[];
}

type Turn = [number, number, number, number];

function product([ax, ay, az, aw]: Turn, [bx, by, bz, bw]: Turn): Turn {
  return [
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}

const columns = (count: number, length: number) => Array.from({ length: count }, () => new Float64Array(length));

/** The mean rotation of a bone, `[2 * BONES]` for seat 0 and then seat 1. */
function means(local: Float32Array, frames: number): Turn[] {
  return Array.from({ length: 2 * BONES }, (_, bone) => {
    const sum: Turn = [0, 0, 0, 0];
    for (let frame = 0; frame < frames; frame++) {
      const q = local.subarray((frame * 2 * BONES + bone) * 4, (frame * 2 * BONES + bone) * 4 + 4);
      const sign = q[0]! * sum[0] + q[1]! * sum[1] + q[2]! * sum[2] + q[3]! * sum[3] < 0 ? -1 : 1;
      q.forEach((value, k) => (sum[k]! += sign * value));
    }
    const size = Math.hypot(...sum) || 1;
    return sum.map((value) => Math.round((1e5 * value) / size) / 1e5) as Turn;
  });
}

function split({ hips, local, loose }: Frames, frames: number, mean: Turn[], kept: number[]): Parts {
  const parts: Parts = { turns: columns(6 * BONES, frames), hips: columns(6, frames), loose: columns(3, kept.length) };
  for (let frame = 0; frame < frames; frame++) {
    mean.forEach(([x, y, z, w], bone) => {
      const at = (frame * 2 * BONES + bone) * 4;
      const q = product([-x, -y, -z, w], [local[at]!, local[at + 1]!, local[at + 2]!, local[at + 3]!]);
      const size = Math.hypot(q[0], q[1], q[2]);
      const scale = (q[3] < 0 ? -1 : 1) * (size > 1e-9 ? (2 * Math.atan2(size, Math.abs(q[3]))) / size : 2);
      for (let k = 0; k < 3; k++) {
        parts.turns[3 * bone + k]![frame] = scale * q[k]!;
      }
    });
    parts.hips.forEach((column, k) => (column[frame] = hips[6 * frame + k]!));
  }
  kept.forEach((frame, i) => parts.loose.forEach((column, k) => (column[i] = loose[3 * frame + k]!)));
  return parts;
}

function joined(parts: Parts, feet: Uint8Array, mean: Turn[], kept: number[]): Frames {
  const frames = feet.length;
  const out = {
    hips: new Float32Array(frames * 6),
    local: new Float32Array(frames * 2 * BONES * 4),
    feet,
    loose: new Float32Array(frames * 3),
  };
  for (let frame = 0; frame < frames; frame++) {
    mean.forEach((turn, bone) => {
      const [x, y, z] = [0, 1, 2].map((k) => parts.turns[3 * bone + k]![frame]!) as [number, number, number];
      const angle = Math.hypot(x, y, z);
      const scale = angle > 1e-9 ? Math.sin(angle / 2) / angle : 0.5;
      out.local.set(product(turn, [scale * x, scale * y, scale * z, Math.cos(angle / 2)]), (frame * 2 * BONES + bone) * 4);
    });
    parts.hips.forEach((column, k) => (out.hips[6 * frame + k] = column[frame]!));
  }
  kept.forEach((frame, i) => parts.loose.forEach((column, k) => (out.loose[3 * frame + k] = column[i]!)));
  return out;
}

/** Frames outside of flights. */
function outside({ strokes }: Head, frames: number): number[] {
  return Array.from({ length: frames }, (_, frame) => frame).filter(
    (frame) => !strokes.some((s) => s.frame <= frame && frame <= s.end_frame),
  );
}

/** Quantizes a motion with steps multiplied by `coarse`; the result is still to be compressed. */
export function condense(motion: Motion, coarse: number): Uint8Array<ArrayBuffer> {
  const { fps, frames, head, kept } = motion;
  const { players } = head;
  const strokes = head.strokes.map(({ frame, end_frame, start, velocity }) => ({ frame, end_frame, start, velocity }));
  const mean = means(kept.local, frames);
  const writer = new Writer();
  all(writer, split(kept, frames, mean, outside(head, frames)), head, coarse);
  const about = new TextEncoder().encode(
    `${MAGIC}${JSON.stringify({ fps, first: 0, frames, players, strokes, mean, coarse })}\n`,
  );
  const out = new Uint8Array(about.length + frames + writer.bytes.length);
  out.set(about);
  out.set(kept.feet, about.length);
  out.set(writer.bytes, about.length + frames);
  return out;
}

export function isCondensed(content: ArrayBuffer): boolean {
  return new TextDecoder().decode(content.slice(0, MAGIC.length)) === MAGIC;
}

/** Restores a quantized motion. */
export function expanded(content: ArrayBuffer): Motion {
  const bytes = new Uint8Array(content);
  const end = bytes.indexOf(10);
  const { mean, coarse, ...head }: Head & { mean: Turn[]; coarse: number } = JSON.parse(
    new TextDecoder().decode(bytes.subarray(MAGIC.length, end)),
  );
  const kept = outside(head, head.frames);
  const parts: Parts = {
    turns: columns(6 * BONES, head.frames),
    hips: columns(6, head.frames),
    loose: columns(3, kept.length),
  };
  const feet = bytes.slice(end + 1, end + 1 + head.frames);
  all(new Reader(bytes.subarray(end + 1 + head.frames)), parts, head, coarse);
  return new Motion(head, joined(parts, feet, mean, kept));
}
