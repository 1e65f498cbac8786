// What the picture of a camera holds: both players and the shuttle, at every moment of a rally. The camera stands still; its lens
// zooms and shifts. A picture is a rectangle of the plane at a distance of one: left, right, bottom, top.

import type * as THREE from "three";
import { at } from "./hall";
import type { Motion } from "./motion";
import type { Vec3 } from "./wire.gen";

export type Picture = [number, number, number, number];

const RATE = 20; // moments a second at which the rally is looked at
const AROUND = 12; // moments before and after, which the picture holds as well: so it moves slowly
const REACH = 1.0; // of arms and legs from the hips, to the sides [m]
const STRIDE = 0.9; // of a foot from the hips, to the camera [m]
const ABOVE = 1.25; // of a hand above the hips [m]
const MARGIN = 0.04; // free space around, of the height
const LEAST = 0.33; // height of the closest picture

/** The picture of a shape that is as wide as `aspect` and contains another, with some of its height free at the top. */
function fitted([left, right, bottom, top]: Picture, aspect: number, free: number): Picture {
  const content = (top - bottom) * (1 + 2 * MARGIN);
  const high = Math.max(content / (1 - free), ((right - left) * (1 + MARGIN)) / aspect, LEAST);
  const [x, y] = [(left + right) / 2, (bottom + top + free * high) / 2];
  return [x - (high * aspect) / 2, x + (high * aspect) / 2, y - high / 2, y + high / 2];
}

export class Framing {
  private readonly moments: Picture[];

  /**
   * @param view from the axes of the scene to those of the camera.
   * @param floor points of the floor that are held as well.
   */
  constructor(motion: Motion, view: THREE.Matrix4, floor: [number, number][]) {
    const count = Math.ceil(motion.duration * RATE) + 1;
    const seen = Array.from({ length: count }, (_, i) => held(motion, Math.min(i / RATE, motion.duration), view, floor));
    const near = (all: Picture[], i: number, reach: number) => all.slice(Math.max(0, i - reach), i + reach + 1);
    const widest = seen.map((_, i) => near(seen, i, AROUND + 1).reduce(joint));
    this.moments = widest.map((_, i) => {
      const some = near(widest, i, AROUND);
      return [0, 1, 2, 3].map((k) => some.reduce((sum, one) => sum + one[k]!, 0) / some.length) as Picture;
    });
  }

  /** The picture at a time. */
  at(time: number, aspect: number, free: number): Picture {
    const place = Math.min(Math.max(0, time * RATE), this.moments.length - 1);
    const [before, after] = [this.moments[Math.floor(place)]!, this.moments[Math.ceil(place)]!];
    return fitted(mixed(before, after, place % 1), aspect, free);
  }

  /** A picture that contains those of all times, on a grid. */
  whole(aspect: number, free: number): Picture {
    const all = this.moments.map((one) => fitted(one, aspect, free)).reduce(joint);
    const step = 0.1;
    return all.map((edge, k) => step * (k % 2 ? Math.ceil(edge / step) : Math.floor(edge / step))) as Picture;
  }
}

export function mixed(a: Picture, b: Picture, share: number): Picture {
  return a.map((edge, k) => edge + share * (b[k]! - edge)) as Picture;
}

function joint(a: Picture, b: Picture): Picture {
  return [Math.min(a[0], b[0]), Math.max(a[1], b[1]), Math.min(a[2], b[2]), Math.max(a[3], b[3])];
}

/** The smallest picture that holds both players and the shuttle at a time. */
function held(motion: Motion, time: number, view: THREE.Matrix4, floor: [number, number][]): Picture {
  const point: Vec3 = [0, 0, 0];
  const out: Picture = [Infinity, -Infinity, Infinity, -Infinity];
  const hold = ({ x, y, z }: THREE.Vector3, aside: number, closer: number) => {
    for (const side of [-aside, aside]) {
      const u = (x + side) / -(z + closer);
      [out[0], out[1]] = [Math.min(out[0], u), Math.max(out[1], u)];
    }
    const v = y / -(z + closer);
    [out[2], out[3]] = [Math.min(out[2], v), Math.max(out[3], v)];
  };
  for (const seat of [0, 1]) {
    const [x, y, z] = motion.hipsAt(time, seat, point);
    hold(at(x, y, 0).applyMatrix4(view), REACH, STRIDE);
    hold(at(x, y, z + ABOVE).applyMatrix4(view), REACH, 0);
  }
  floor.forEach(([x, y]) => hold(at(x, y, 0).applyMatrix4(view), 0, 0));
  hold(at(...motion.shuttleAt(time, point)).applyMatrix4(view), 0, 0);
  return out;
}
