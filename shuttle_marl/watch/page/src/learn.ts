// Quiz: stops before the costliest decisions of a rally and asks for a better stroke.

import { h, percent, replaceChildren, words } from "./dom";
import type { Analysis, Option, RallyFacts, StrokeValue } from "./wire.gen";

const QUESTIONS = 3;
const WORTH_ASKING = 0.03; // minimum regret of a question
const ANSWERS = 4;

/** Numbers of the costliest decisions of a rally, in order of time. */
export function questions(analysis: Analysis): number[] {
  const found = analysis.strokes
    .map((value, i) => ({ i, regret: value.regret }))
    .filter(({ regret }) => regret >= WORTH_ASKING);
  found.sort((a, b) => b.regret - a.regret);
  return found
    .slice(0, QUESTIONS)
    .map(({ i }) => i)
    .sort((a, b) => a - b);
}

/** Answers of a question: the best stroke, the one played, and others, ordered by area to hide which is which. */
export function answers(value: StrokeValue, played: number): Option[] {
  const pick = (stroke: number) => value.options.find((option) => option.stroke === stroke);
  const first = [pick(value.better), pick(played)].filter((option) => option !== undefined);
  const others = value.options.filter((option) => !first.includes(option));
  const chosen = [...first, ...others].slice(0, ANSWERS);
  return chosen.sort((a, b) => a.stroke - b.stroke);
}

function name(option: Option): string {
  return `${words(option.shot)} to ${words(option.area)}, ${words(option.technique)}`;
}

export interface LearnHooks {
  stopBefore(stroke: number): void;
  reveal(upTo: number): void;
  finish(): void;
}

export class Learn {
  readonly element = h("section", { class: "panel hidden", "aria-label": "Find the better stroke", "aria-live": "polite" });
  private rally: RallyFacts | null = null;
  private analysis: Analysis | null = null;
  private left: number[] = [];
  private right = 0;
  private asked = 0;
  current: number | null = null;

  constructor(private readonly hooks: LearnHooks) {}

  begin(rally: RallyFacts, analysis: Analysis): void {
    this.rally = rally;
    this.analysis = analysis;
    this.left = questions(analysis);
    this.right = this.asked = 0;
    this.element.classList.remove("hidden");
    this.next();
  }

  end(): void {
    this.current = null;
    this.element.classList.add("hidden");
  }

  private next(): void {
    const question = this.left.shift();
    if (question === undefined) {
      this.tellAccuracy();
      return;
    }
    this.current = question;
    const stroke = this.rally!.strokes[question]!;
    replaceChildren(
      this.element,
      h(
        "h2",
        {},
        h("span", {}, "Find the better stroke"),
        h("span", {}, `${this.asked + 1} of ${this.asked + this.left.length + 1}`),
      ),
      h(
        "p",
        {},
        h("b", { class: stroke.seat ? "b" : "a" }, this.rally!.names[stroke.seat]!),
        ` is about to play stroke ${question + 1}, from ${stroke.height} the net.`,
      ),
    );
    this.hooks.stopBefore(question);
  }

  /** Shows the question when the playback reaches the decision. */
  ask(): void {
    const question = this.current;
    if (question === null || this.element.querySelector(".quiz")) {
      return;
    }
    const played = this.rally!.strokes[question]!;
    const value = this.analysis!.strokes[question]!;
    const options = answers(value, played.stroke);
    const buttons = options.map((option) =>
      h(
        "button",
        { onclick: () => this.answer(option, value, buttons, options) },
        h("span", {}, name(option)),
        h("span", { class: "quiet" }),
      ),
    );
    this.element.append(
      h("p", { style: "margin:8px 0" }, "Which stroke is best if both play perfectly afterwards?"),
      h("div", { class: "quiz" }, ...buttons),
    );
    buttons[0]?.focus();
  }

  private answer(given: Option, value: StrokeValue, buttons: HTMLButtonElement[], options: Option[]): void {
    const question = this.current!;
    const played = this.rally!.strokes[question]!;
    const right = given.stroke === value.better;
    this.asked++;
    this.right += right ? 1 : 0;
    buttons.forEach((button, i) => {
      const option = options[i]!;
      button.disabled = true;
      button.classList.toggle("right", option.stroke === value.better);
      button.classList.toggle("wrong", option === given && !right);
      const wasPlayed = option.stroke === played.stroke ? " · played" : "";
      button.lastElementChild!.textContent = `wins ${percent(option.best)} with perfect play${wasPlayed}`;
    });
    this.hooks.reveal(question);
    const best = value.options.find((option) => option.stroke === value.better)!;
    const verdict = right ? "Correct." : `Better: ${name(best)}. The regret of your stroke is ${percent(given.regret)}.`;
    const next = h("button", { onclick: () => this.next() }, this.left.length ? "Next" : "Show accuracy");
    this.element.append(
      h(
        "p",
        { style: "margin:8px 0" },
        `${verdict} The regret of the stroke played is ${percent(value.regret)}. ${value.sure}`,
      ),
      next,
    );
    next.focus();
  }

  private tellAccuracy(): void {
    this.current = null;
    const accuracy = this.analysis!.accuracy.map((share, seat) =>
      h(
        "p",
        {},
        h("b", { class: seat ? "b" : "a" }, this.rally!.names[seat]!),
        share === null ? ": no strokes" : `: accuracy ${percent(share)}`,
      ),
    );
    const score = this.asked ? `${this.right} of ${this.asked} correct.` : "No decision of this rally has a large regret.";
    const done = h("button", { onclick: () => this.hooks.finish() }, "Next rally");
    replaceChildren(
      this.element,
      h("h2", {}, "Find the better stroke"),
      h("p", {}, score),
      ...accuracy,
      h("p", { class: "quiet" }, "Accuracy: 100 % is perfect play, 0 % the worst stroke at every decision."),
      done,
    );
    this.hooks.reveal(Infinity);
    done.focus();
  }
}
