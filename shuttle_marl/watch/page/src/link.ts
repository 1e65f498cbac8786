// Links: plan, rally and stroke in the fragment of the address.

import type { Plan, Side } from "./wire.gen";

export interface Place {
  plan: Plan | null;
  rally: number;
  stroke: number | null;
  tried: Record<string, number>;
}

function sideOf(text: string | null): Side | null {
  const found = text?.match(/^(.{1,200}?)(?:\*([0-9.]{1,8}))?$/);
  return found ? { policy: found[1]!, temperature: found[2] === undefined ? 1 : Number(found[2]) } : null;
}

function sideText({ policy, temperature }: Side): string {
  return temperature === 1 ? policy : `${policy}*${temperature}`;
}

/** Parses a JSON object of a link; empty if it is truncated. */
function parsed<T extends object>(text: string | null): T {
  try {
    return JSON.parse(text ?? "{}") as T;
  } catch {
    return {} as T;
  }
}

/** Parses a link; missing parts are null or 0. */
export function readLink(hash: string): Place {
  const found = new URLSearchParams(hash.replace(/^#/, ""));
  const [a, b, seed] = [sideOf(found.get("a")), sideOf(found.get("b")), Number(found.get("seed"))];
  const rally = Math.max(0, Math.floor(Number(found.get("rally") ?? 1)) - 1) || 0;
  const stroke = found.has("stroke") ? Math.max(0, Math.floor(Number(found.get("stroke"))) - 1) || 0 : null;
  const tried = parsed<Record<string, number>>(found.get("tried"));
  if (!a || !b || !Number.isSafeInteger(seed) || seed < 0) {
    return { plan: null, rally, stroke, tried };
  }
  return { plan: { seed, sides: [a, b], ...parsed<Partial<Plan>>(found.get("more")) }, rally, stroke, tried };
}

export function writeLink({ plan, rally, stroke, tried }: Place): string {
  const out = new URLSearchParams();
  if (plan) {
    out.set("seed", String(plan.seed));
    out.set("a", sideText(plan.sides[0]));
    out.set("b", sideText(plan.sides[1]));
    const more: Partial<Plan> = {};
    if (plan.changes?.length) {
      more.changes = plan.changes;
    }
    if (plan.chosen && Object.keys(plan.chosen).length) {
      more.chosen = plan.chosen;
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
