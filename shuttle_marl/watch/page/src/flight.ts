// The flight of a shuttle from its launch, integrated as staging/flight.py does; see docs/motion_format.md.

import type { Vec3 } from "./wire";

const TERMINAL = 6.8; // [m/s]
const GRAVITY = 9.81; // [m/s²]
const TIME = TERMINAL / GRAVITY;
const LENGTH = TERMINAL * TIME;
const STEPS = 16;

type State = [number, number, number, number]; // along, rise, and their speeds, scaled

function slope([, , along, up]: State): State {
  const speed = Math.hypot(along, up);
  return [along, up, -along * speed, -up * speed - 1];
}

function moved(s: State, by: State, h: number): State {
  return [s[0] + h * by[0], s[1] + h * by[1], s[2] + h * by[2], s[3] + h * by[3]];
}

export class Flight {
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
      (2 * u ** 3 - 3 * u ** 2 + 1) * a[i]! + (u ** 3 - 2 * u ** 2 + u) * h * a[i + 2]! + (3 * u ** 2 - 2 * u ** 3) * b[i]! + (u ** 3 - u ** 2) * h * b[i + 2]!;
    const [along, rise] = [LENGTH * place(0), LENGTH * place(1)];
    position[0] = this.start[0] + this.heading[0] * along;
    position[1] = this.start[1] + this.heading[1] * along;
    position[2] = this.start[2] + rise;
    if (velocity) {
      const speed = (i: 0 | 1) =>
        TERMINAL * ((6 * u * (1 - u) * (b[i]! - a[i]!)) / h + (1 - 4 * u + 3 * u ** 2) * a[i + 2]! + (3 * u ** 2 - 2 * u) * b[i + 2]!);
      const v = speed(0);
      velocity[0] = this.heading[0] * v;
      velocity[1] = this.heading[1] * v;
      velocity[2] = speed(1);
    }
  }
}
