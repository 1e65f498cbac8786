// What the picture of a camera holds: both players and the shuttle, at every moment of a rally. The camera stands still; its lens
// zooms and shifts. A picture is a rectangle of the plane at a distance of one: left, right, bottom, top.

import type * as THREE from "three";

export type Picture = [number, number, number, number];

const RATE = 25; // moments a second at which the rally is looked at
const AROUND = 7; // moments before and after, which the picture holds as well: so it moves slowly
const MARGIN = 0.02; // free space around, of height and width
const BELOW = 0.65; // part of the free height that lies below: floor instead of hall
const LEAST = 0.33; // height of the closest picture

/** The picture of a shape that is as wide as `aspect` and contains another. */
function fitted([left, right, bottom, top]: Picture, aspect: number): Picture {
  const high = Math.max((1 + 2 * MARGIN) * Math.max(top - bottom, (right - left) / aspect), LEAST);
  const middle = bottom - BELOW * (high - (top - bottom)) + high / 2;
  return around((left + right) / 2, middle, high, aspect);
}

/** The picture of a height around a point. */
export function around(x: number, y: number, high: number, aspect: number): Picture {
  return [x - (high * aspect) / 2, x + (high * aspect) / 2, y - high / 2, y + high / 2];
}

export class Framing {
  private readonly moments: Picture[];

  /**
   * @param seen points in the axes of the scene that the picture holds at a time.
   * @param view from the axes of the scene to those of the camera.
   */
  constructor(duration: number, seen: (time: number) => THREE.Vector3[], view: THREE.Matrix4) {
    const count = Math.ceil(duration * RATE) + 1;
    const held = Array.from({ length: count }, (_, i) => smallest(seen(Math.min(i / RATE, duration)), view));
    const near = (all: Picture[], i: number, reach: number) => all.slice(Math.max(0, i - reach), i + reach + 1);
    const widest = held.map((_, i) => near(held, i, AROUND + 1).reduce(joint));
    this.moments = widest.map((_, i) => {
      const some = near(widest, i, AROUND);
      return [0, 1, 2, 3].map((k) => some.reduce((sum, one) => sum + one[k]!, 0) / some.length) as Picture;
    });
  }

  /** The picture at a time. */
  at(time: number, aspect: number): Picture {
    const place = Math.min(Math.max(0, time * RATE), this.moments.length - 1);
    const [before, after] = [this.moments[Math.floor(place)]!, this.moments[Math.ceil(place)]!];
    return fitted(mixed(before, after, place % 1), aspect);
  }

  /** A picture that contains those of all times, on a grid. */
  whole(aspect: number): Picture {
    const all = this.moments.map((one) => fitted(one, aspect)).reduce(joint);
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

/** The smallest picture that holds points. */
function smallest(points: THREE.Vector3[], view: THREE.Matrix4): Picture {
  return points
    .map((point): Picture => {
      const { x, y, z } = point.clone().applyMatrix4(view);
      return [x / -z, x / -z, y / -z, y / -z];
    })
    .reduce(joint);
}
