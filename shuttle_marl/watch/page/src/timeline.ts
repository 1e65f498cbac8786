// What is played: the plan of the match, the rally of it, and what a person chose or tried.

import { type Place, writeLink } from "./link";
import type { Wanted } from "./rallies";
import type { Person, Plan, Side } from "./wire.gen";

/** All that a course consists of, to return to it. */
type Mark = Pick<Course, "plan" | "number" | "tried" | "person" | "original">;

export class Course {
  number = 0;
  person: Person | null = null;
  /** The plan before strokes were tried, null while none was. */
  original: Plan | null = null;

  constructor(
    public plan: Plan | null,
    public tried: Record<string, number>,
  ) {}

  wanted(rally: number): Wanted {
    return { plan: this.plan, rally, person: this.person, tried: rally === this.number ? this.tried : {} };
  }

  mark(): () => void {
    const { plan, number, tried, person, original } = this;
    return () => Object.assign(this, { plan, number, tried, person, original } satisfies Mark);
  }

  /** Who plays the rally, null for what was recorded. */
  get sides(): [Side, Side] | null {
    return this.plan && sidesIn(this.plan, this.number);
  }

  /** Whether something was tried that was not played. */
  get isTried(): boolean {
    return this.original !== null || Object.keys(this.tried).length > 0;
  }

  newMatch(): void {
    this.plan = { seed: Math.floor(Math.random() * 2 ** 31), sides: this.sides! };
    this.original = null;
    if (this.person) {
      this.person = { ...this.person, rally: 0, stroke: 0 };
    }
  }

  /** A place that a link names; a person who plays has left. */
  visit({ plan, rally, tried }: Place): void {
    if (plan && this.plan) {
      this.plan = plan;
      this.original = this.person = null;
    }
    this.number = rally;
    this.tried = tried;
  }

  /** Another side from a rally on. */
  changeSide(seat: number, side: Side, from: number): void {
    const plan = this.plan!;
    if (from === 0) {
      const sides: [Side, Side] = [...plan.sides];
      sides[seat] = side;
      this.plan = { ...plan, sides, changes: [] };
    } else {
      const kept = (plan.changes ?? []).filter(
        (change) => change.rally < from || (change.rally === from && change.seat !== seat),
      );
      this.plan = { ...plan, changes: [...kept, { rally: from, seat, side }] };
    }
  }

  /** A stroke that a person chose. */
  choose(at: number, stroke: number): void {
    const plan = this.plan!;
    const chosen = { ...plan.chosen?.[this.number], [at]: stroke };
    this.plan = { ...plan, chosen: { ...plan.chosen, [this.number]: chosen } };
  }

  /** A stroke that is tried in place of what was played; whatever was chosen after it is void. */
  try(at: number, stroke: number): void {
    const { plan } = this;
    const earlier = (chosen: Record<string, number>) =>
      Object.fromEntries(Object.entries(chosen).filter(([k]) => Number(k) < at));
    if (plan) {
      this.original ??= plan;
      const before = Object.entries(plan.chosen ?? {}).filter(([rally]) => Number(rally) < this.number);
      const chosen = { ...earlier(plan.chosen?.[this.number] ?? {}), [at]: stroke };
      this.plan = { ...plan, chosen: { ...Object.fromEntries(before), [this.number]: chosen } };
    } else {
      this.tried = { ...earlier(this.tried), [at]: stroke };
    }
  }

  back(): void {
    this.plan = this.original ?? this.plan;
    this.original = null;
    this.tried = {};
  }

  /** Address of a stroke of the rally, -1 for its start. */
  link(stroke: number): string {
    return writeLink({ plan: this.plan, rally: this.number, stroke: stroke >= 0 ? stroke : null, tried: this.tried });
  }
}

/** Who plays a rally of a plan. */
function sidesIn(plan: Plan, rally: number): [Side, Side] {
  const sides: [Side, Side] = [...plan.sides];
  for (const change of plan.changes ?? []) {
    if (change.rally <= rally) {
      sides[change.seat] = change.side;
    }
  }
  return sides;
}
