// Decisions of a person: what the last one was worth, the score of both sides, and the rating that the browser keeps.

import { capitalised, h, keep, kept, replaceChildren, signed } from "./dom";
import { does } from "./names";
import { reason } from "./narration";
import { choiceKind, choiceWords, RIGHT, result } from "./verdict";
import type { Analysis, RallyFacts, RatingReply } from "./wire.gen";
import { say, words } from "./words";

const RATING = "shuttle_marl.rating";
const RUNG = "shuttle_marl.rung";

/** Before the first match, as in shuttle_marl.reports.rating. */
const NEW: RatingReply = { points: 1500, deviation: 350, volatility: 0.06, interval: [814, 2186] };

interface Decision {
  seat: number;
  quality: number | null; // null: not judged
}

export function rating(): RatingReply {
  const whole = ({ points, deviation, volatility }: RatingReply) => [points, deviation, volatility].every(Number.isFinite);
  return kept(RATING, NEW, whole);
}

export function keepRating(found: RatingReply): void {
  keep(RATING, found);
}

/** Number of the opponent of the next duel. */
export function rung(count: number): number {
  return Math.min(
    kept<number>(RUNG, 0, (found) => Number.isInteger(found) && found >= 0),
    count - 1,
  );
}

export function keepRung(number: number): void {
  keep(RUNG, number);
}

/** Mean quality from 0 to 100; null: nothing was judged. */
function score(decisions: Decision[]): number | null {
  const known = decisions.flatMap(({ quality }) => quality ?? []);
  return known.length ? Math.round((100 * known.reduce((sum, one) => sum + one, 0)) / known.length) : null;
}

export class Decisions {
  readonly element = h("div", { class: "verdict hidden" });
  private readonly told = h("p", { role: "status" });
  private readonly line = h("p", {});
  private readonly again: HTMLButtonElement;
  played = 0; // strokes of the person, so that no verdict comes after the next one
  private judged: [RallyFacts, Analysis, number] | null = null; // the stroke of the verdict
  private readonly rallies = new Map<number, Decision[]>();
  private readonly rated = new Set<number>();

  /** @param retry plays the last stroke of the person that is shown again, for practice. */
  constructor(retry: () => void) {
    this.again = h("button", { onclick: retry }, say("decide.retry"), h("kbd", {}, "u"));
    this.element.append(this.told, h("div", {}, this.line, this.again));
    this.reset();
  }

  /** Whether a person plays: then the verdict stays, so that nothing moves between two strokes. */
  set playing(on: boolean) {
    this.element.classList.toggle("hidden", !on);
  }

  /** Starts another match. */
  reset(): void {
    this.rallies.clear();
    this.rated.clear();
    this.again.classList.add("hidden");
    this.judged = null;
    replaceChildren(this.told, h("span", { class: "quiet" }, say("board.point")));
    this.line.textContent = "";
  }

  /** Counts the decisions of both sides in a rally, from the first stroke of the person, or the one before it, on. */
  count(rally: RallyFacts, analysis: Analysis): void {
    const found = analysis.strokes.map(({ quality }, i) => ({ seat: rally.strokes[i]!.seat, quality }));
    const first = rally.strokes.findIndex((stroke) => stroke.person);
    if (found.length >= (this.rallies.get(rally.number)?.length ?? 0)) {
      this.rallies.set(rally.number, first < 0 ? [] : found.slice(Math.max(0, first - 1)));
    }
  }

  /**
   * Shows what the last stroke of the person in a rally is worth.
   * @param practice whether the rally is played again; then it does not count.
   * @param named number of strokes of the rally that are told; more than it has: its end as well.
   */
  show(rally: RallyFacts, analysis: Analysis, seat: number, practice: boolean, named: number): void {
    const last = rally.strokes.findLastIndex((stroke) => stroke.person && stroke.seat === seat);
    const value = analysis.strokes[last];
    if (!value) {
      return;
    }
    this.again.classList.remove("hidden");
    const better = value.options.find((option) => option.stroke === value.better);
    const stroke = better && say("stroke.to", { shot: words(better.shot), area: words(better.area) });
    const { change, loss } = value;
    const choice = capitalised(choiceWords(value, seat));
    const worse = change !== null && loss > RIGHT && stroke;
    const told = worse ? say("decide.worse", { choice, stroke, share: signed(change + loss) }) : choice;
    replaceChildren(this.told, h("span", { class: choiceKind(value) }, told));
    const [mine, theirs] = this.scores(seat).map((score) => score ?? "–") as [string, string];
    this.line.textContent = practice ? say("decide.practice") : say("decide.score", { mine, theirs });
    this.judged = [rally, analysis, last];
    this.became(rally, named);
  }

  /** Says what became of the stroke of the verdict, once so many strokes of its rally tell it. */
  became(rally: RallyFacts, named: number): void {
    if (this.judged?.[0].number !== rally.number) {
      return;
    }
    const [{ names, strokes, winner }, , i] = this.judged;
    const ended = winner !== null && named > strokes.length && i < strokes.length - 1; // by the opponent
    const found = ended ? h("span", {}, `${does(names, winner, "win")} · ${reason(rally)}`) : result(...this.judged, named);
    if (found && found.textContent !== this.told.lastChild?.textContent) {
      replaceChildren(this.told, this.told.firstChild, found);
    }
  }

  /** Takes the last verdict away: the person has played another stroke. */
  clear(): void {
    this.played++;
    this.judged = null;
    replaceChildren(this.told, h("span", { class: "quiet" }, say("page.computing")));
  }

  /** Scores of the person and of the opponent; null: nothing was judged. */
  scores(seat: number): [number | null, number | null] {
    const all = [...this.rallies.values()].flat();
    return [score(all.filter((one) => one.seat === seat)), score(all.filter((one) => one.seat !== seat))];
  }

  /** Qualities of the person's judged decisions since the last rating. */
  unrated(seat: number): number[] {
    const found = [...this.rallies].filter(([number]) => !this.rated.has(number));
    for (const [number] of found) {
      this.rated.add(number);
    }
    return found.flatMap(([, decisions]) => decisions.flatMap((one) => (one.seat === seat ? (one.quality ?? []) : [])));
  }
}
