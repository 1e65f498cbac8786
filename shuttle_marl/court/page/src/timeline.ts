// Position in the match: plan, rally, and strokes that a person chose or tried.

import type { FriendGame } from "./friend";
import { type Place, writeLink } from "./link";
import type { Wanted } from "./rallies";
import type { Person, Plan, Side, Turn } from "./wire.gen";

/** Snapshot for undo. */
type Mark = Pick<Timeline, "plan" | "number" | "tried" | "person" | "original" | "practice">;

/** What is tried instead. */
export type Tried = { stroke: number; position?: never } | { position: number; stroke?: never };

/** The match to which practice returns; `over`: whether its rally was over. */
type Practice = { plan: Plan; person: Person; over: boolean };

export class Timeline {
  number = 0;
  person: Person | null = null;
  /** The plan before strokes were tried; null if none was. */
  original: Plan | null = null;
  /** While a person plays a rally again from one of their strokes; null: they do not. */
  practice: Practice | null = null;
  /** Games with a friend; null: this page has no server. */
  friend: FriendGame | null = null;

  constructor(
    public plan: Plan | null,
    public tried: Record<string, number>,
  ) {}

  wanted(rally: number): Wanted {
    const { plan, person, tried } = this;
    return { plan, rally, person, tried: rally === this.number ? tried : {}, friend: this.friend?.wanted ?? null };
  }

  mark(): () => void {
    const { plan, number, tried, person, original, practice } = this;
    return () => Object.assign(this, { plan, number, tried, person, original, practice } satisfies Mark);
  }

  /** Players of the rally; null for recorded rallies. */
  get sides(): [Side, Side] | null {
    return this.plan && sidesIn(this.plan, this.number);
  }

  /** Whether the rally has tried strokes. */
  get isTried(): boolean {
    return this.original !== null || this.practice !== null || Object.keys(this.tried).length > 0;
  }

  /** Opens a match; leaves a game with a friend. */
  open(plan: Plan): void {
    this.friend?.leave();
    this.plan = plan;
    this.original = this.practice = null;
  }

  newMatch(): void {
    this.open({ seed: Math.floor(Math.random() * 2 ** 31), sides: this.sides! });
    if (this.person) {
      this.person = playing(this.person.seat);
    }
  }

  /** A match of the same players after this one, at 0–0, that a person plays. */
  playFromStart(): void {
    this.open({ seed: (this.plan!.seed + 1) % 2 ** 31, sides: this.sides! });
    this.person = playing(0);
  }

  /** Opens the position of a link; ends the play of a person. */
  visit({ plan, rally, tried }: Place): void {
    this.friend?.leave();
    if (plan && this.plan) {
      this.plan = plan;
      this.original = this.person = this.practice = null;
    }
    this.number = rally;
    this.tried = tried;
  }

  /** Changes a player from a rally on. */
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

  /** Adds what a person chose in a turn: a stroke, or a position. */
  choose(turn: Turn, choice: number): void {
    const plan = this.plan!;
    const kind = turn.positions.length ? "waited" : "chosen";
    const choices = { ...plan[kind]?.[this.number], [turn.number]: choice };
    this.plan = { ...plan, [kind]: { ...plan[kind], [this.number]: choices } };
  }

  /** Replaces a played stroke, or where its receiver waits, and keeps the other one; drops what was chosen after it. */
  try(at: number, tried: Tried): void {
    const { plan, number } = this;
    const before = <T>(choices: Record<string, T>, end: number): Record<string, T> =>
      Object.fromEntries(Object.entries(choices).filter(([k]) => Number(k) < end));
    const one = (choice: number | undefined) => (choice === undefined ? {} : { [at]: choice });
    if (plan) {
      this.original ??= plan;
      const { chosen = {}, waited = {} } = plan;
      this.plan = {
        ...plan,
        chosen: { ...before(chosen, number), [number]: { ...before(chosen[number] ?? {}, at + 1), ...one(tried.stroke) } },
        waited: { ...before(waited, number), [number]: { ...before(waited[number] ?? {}, at + 1), ...one(tried.position) } },
      };
    } else {
      this.tried = { ...before(this.tried, at), [at]: tried.stroke ?? -1 - tried.position! };
    }
  }

  /** Plays the rally again from a stroke of the person, for practice. */
  retry(at: number, over: boolean): void {
    const { number, plan, person } = this;
    this.practice ??= { plan: plan!, person: person!, over };
    this.try(at, { stroke: -1 });
    this.original = null;
    delete this.plan!.chosen![number]![at];
    this.person = { ...person!, practice: true };
  }

  back(): void {
    if (this.practice) {
      ({ plan: this.plan, person: this.person } = this.practice);
      this.practice = this.original = null;
    }
    this.plan = this.original ?? this.plan;
    this.original = null;
    this.tried = {};
  }

  /** Link to a stroke of the rally; -1: its start. */
  link(stroke: number): string {
    const { plan, number: rally, tried } = this;
    const game = this.friend?.wanted?.seat.token ?? null;
    return writeLink({ plan, rally, stroke: stroke >= 0 ? stroke : null, tried, game });
  }
}

/** A person who plays from a stroke of a rally on. */
export function playing(seat: number, rally = 0, stroke = 0, friend = false): Person {
  return { seat, rally, stroke, practice: false, friend };
}

/** Players of a rally of a plan. */
function sidesIn(plan: Plan, rally: number): [Side, Side] {
  const sides: [Side, Side] = [...plan.sides];
  for (const change of plan.changes ?? []) {
    if (change.rally <= rally) {
      sides[change.seat] = change.side;
    }
  }
  return sides;
}
