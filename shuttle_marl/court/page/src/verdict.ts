// A stroke judged twice: what was chosen, and what became of it.

import { h, signed } from "./dom";
import type { Analysis, RallyFacts, StrokeValue } from "./wire.gen";
import { type Key, say } from "./words";

export const RIGHT = 0.005; // loss to the best choice up to which a choice is right, and gain from which it is good
const DEBATABLE = -0.02; // change from which a choice is no mistake only because many make it, or because the refits disagree
const NAMES: Record<string, string> = { "!!": "brilliant", "!": "strong", "?!": "doubtful", "?": "mistake", "??": "blunder" };
const ATTACKS = new Set(["smash", "half-smash", "drive", "push"]);

/** Probability that the striker wins the rally, from that of side A. */
function own(win: number, seat: number): number {
  return seat ? 1 - win : win;
}

/** The choice in words: beside what elite players choose there; where too few of them play it, what the model guesses. */
export function choiceWords({ change, mark, loss, win, chosen }: StrokeValue, seat: number): string {
  if (change === null) {
    return say("verdict.guess", { share: signed(own(chosen, seat) - own(win, seat)) });
  }
  const unmarked = loss <= RIGHT ? "right" : change > RIGHT ? "good" : "fair";
  const name = NAMES[mark] ?? (change <= DEBATABLE ? "debatable" : unmarked);
  return say(`verdict.${name}` as Key, { share: signed(change) });
}

/** Class of a choice: down only where its words are bad. */
export function choiceKind({ change, mark, loss }: StrokeValue): string {
  const good = change !== null && (loss <= RIGHT || change > RIGHT);
  return change !== null && (mark.includes("?") || (!mark && change <= DEBATABLE)) ? "down" : good ? "up" : "quiet";
}

/** What became of a stroke, as `named` strokes tell it, one more with the end of the rally; null: not known yet. */
export function result(rally: RallyFacts, { strokes }: Analysis, i: number, named: number): HTMLElement | null {
  const [stroke, next] = [rally.strokes[i]!, rally.strokes[i + 1]];
  const win = next ? strokes[i + 1]?.win : Number(rally.winner === 0); // undefined: struck after the analysis
  if (win === undefined || (next ? i + 1 >= named : rally.winner === null || named <= rally.strokes.length)) {
    return null;
  }
  const gain = own(win, stroke.seat) - own(strokes[i]!.chosen, stroke.seat);
  const answer = next?.shot === "net-kill" ? "killed" : ATTACKS.has(next?.shot ?? "") ? "attacked" : "returned";
  const kind = next ? answer : ["winner", "out", "net"].includes(stroke.end) ? stroke.end : "other";
  const change = Math.abs(gain) <= RIGHT ? "quiet" : gain > 0 ? "up" : "down";
  return h("span", { class: change }, say(`verdict.${kind}` as Key, { share: signed(gain) }));
}

/** Choice and result of a stroke, as so many strokes of the rally tell them. */
export function verdict(rally: RallyFacts, analysis: Analysis, i: number, named: number): HTMLElement {
  const value = analysis.strokes[i]!;
  return h(
    "span",
    { class: "judged" },
    h("span", { class: choiceKind(value) }, choiceWords(value, rally.strokes[i]!.seat)),
    result(rally, analysis, i, named),
  );
}
