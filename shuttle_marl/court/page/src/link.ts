// Links: plan, rally and stroke in the fragment of the address.

import type { Plan, Side } from "./wire.gen";

export interface Place {
  plan: Plan | null;
  rally: number;
  stroke: number | null;
  tried: Record<string, number>;
  /** Token of a game with a friend; null: none. */
  game: string | null;
}

function sideOf(text: string | null): Side | null {
  const found = text?.match(/^(.{1,200}?)(?:\*([0-9.]{1,8}))?$/);
  const temperature = Number(found?.[2] ?? 1);
  return found && Number.isFinite(temperature) ? { policy: found[1]!, temperature } : null;
}

function sideText({ policy, temperature }: Side): string {
  return temperature === 1 ? policy : `${policy}*${temperature}`;
}

const MOST = 1e6; // rallies and strokes of a link

/** Parses a JSON object of a link; empty if it is truncated, or something else. */
function parsed<T extends object>(text: string | null): T {
  try {
    const found: unknown = JSON.parse(text ?? "{}");
    return (found && typeof found === "object" ? found : {}) as T;
  } catch {
    return {} as T;
  }
}

/** A number of a link, which counts from 1, as an index. */
function indexOf(text: string | null): number {
  return Math.min(Math.max(0, Math.floor(Number(text ?? 1)) - 1), MOST) || 0;
}

/** Parses a link; missing parts are null or 0. */
export function readLink(hash: string): Place {
  const found = new URLSearchParams(hash.replace(/^#/, ""));
  const [a, b, seed] = [sideOf(found.get("a")), sideOf(found.get("b")), Number(found.get("seed"))];
  const rally = indexOf(found.get("rally"));
  const stroke = found.has("stroke") ? indexOf(found.get("stroke")) : null;
  const tried = parsed<Record<string, number>>(found.get("tried"));
  if (!a || !b || !Number.isSafeInteger(seed) || seed < 0) {
    return { plan: null, rally, stroke, tried, game: found.get("game") };
  }
  return { plan: { seed, sides: [a, b], ...parsed<Partial<Plan>>(found.get("more")) }, rally, stroke, tried, game: null };
}

export function writeLink({ plan, rally, stroke, tried, game }: Place): string {
  if (game) {
    return `#game=${game}`;
  }
  const out = new URLSearchParams();
  if (plan) {
    out.set("seed", String(plan.seed));
    out.set("a", sideText(plan.sides[0]));
    out.set("b", sideText(plan.sides[1]));
    const more: Partial<Plan> = {};
    if (plan.changes?.length) {
      more.changes = plan.changes;
    }
    for (const kind of ["chosen", "waited"] as const) {
      if (Object.keys(plan[kind] ?? {}).length) {
        more[kind] = plan[kind]!;
      }
    }
    if (Object.keys(more).length) {
      out.set("more", JSON.stringify(more));
    }
  }
  out.set("rally", String(rally + 1));
  if (stroke !== null && stroke >= 0) {
    out.set("stroke", String(stroke + 1));
  }
  if (Object.keys(tried).length) {
    out.set("tried", JSON.stringify(tried));
  }
  return `#${out}`;
}
