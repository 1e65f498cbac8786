// Quiz: stops before the costliest decisions of a rally and asks for a better stroke.

import { accuracy } from "./analysis";
import { capitalised, h, percent, replaceChildren, signed } from "./dom";
import { term } from "./glossary";
import { nameAt } from "./names";
import { positionAt, positionGrid, positionWords } from "./recover";
import type { Tried } from "./timeline";
import type { Analysis, HallFacts, Option, Place, RallyFacts, StrokeValue } from "./wire.gen";
import { decimal, type Key, say, words } from "./words";

const QUESTIONS = 3;
const RALLIES = 20; // rallies without a question that are skipped

interface Question {
  stroke: number;
  /** What the stroke or the position played loses. */
  loss: number;
}

interface StrokeQuestion extends Question {
  best: Option;
  /** Wrong answers, the stroke played first. */
  wrong: Option[];
}

/** Where the receiver waits: the positions from which they choose. */
interface PlaceQuestion extends Question {
  places: Place[];
}

type Asked = StrokeQuestion | PlaceQuestion;

const GOOD = 0.005; // loss up to which a position is a right answer, as in shuttle_marl.reports.rating

const isPlace = (question: Asked): question is PlaceQuestion => "places" in question;

function strokeQuestion({ question, options }: StrokeValue, stroke: number): Asked[] {
  if (!question) {
    return [];
  }
  const pick = (wanted: number) => options.find((option) => option.stroke === wanted)!;
  const [best, wrong] = [pick(question.right), question.wrong.map(pick)];
  return [{ stroke, loss: best.best - wrong[0]!.best, best, wrong }];
}

function placeQuestion({ wait, places }: StrokeValue, stroke: number, waited: number | null): Asked[] {
  return wait && places ? [{ stroke, loss: places.find(({ position }) => position === waited)!.loss, places }] : [];
}

/** Decisions to ask for, in order of time: the costliest. */
function questions(rally: RallyFacts, analysis: Analysis): Asked[] {
  return analysis.strokes
    .flatMap((value, i) => [...strokeQuestion(value, i), ...placeQuestion(value, i, rally.strokes[i]!.waited)])
    .sort((a, b) => b.loss - a.loss)
    .slice(0, QUESTIONS)
    .sort((a, b) => a.stroke - b.stroke);
}

/** Answers of a question in an order that does not tell which is which. */
function answers({ best, wrong }: StrokeQuestion): Option[] {
  const mixed = ({ stroke }: Option) => Math.imul(stroke + 1 + 64 * wrong[0]!.stroke, 0x9e3779b1) >>> 0;
  return [best, ...wrong].sort((a, b) => mixed(a) - mixed(b));
}

function name(option: Option): string {
  return say("stroke.with_area", { shot: words(option.shot), area: words(option.area), technique: words(option.technique) });
}

export interface LearnHooks {
  stopBefore(stroke: number): void;
  reveal(upTo: number): void;
  nextRally(): void;
  /** Whether the page has no rally after this one. */
  isLast(): boolean;
  /** Draws the target and the flight of a stroke; null: of none. */
  point(option: Option | null): void;
  /** Plays the rally on from a stroke. */
  playFrom(stroke: number): Promise<void>;
  /** Plays another stroke, or waits elsewhere, instead; null: this page cannot. */
  playInstead: ((stroke: number, other: Tried) => void) | null;
  /** Marks a position of the court; null: none. */
  mark(position: number | null): void;
  /** Shows the rally as it was played. */
  back(): Promise<void>;
}

export class Learn {
  readonly element = h("section", { class: "panel learn hidden", "aria-label": say("learn.title"), "aria-live": "polite" });
  private rally: RallyFacts | null = null;
  private analysis: Analysis | null = null;
  private question: Asked | null = null;
  private options: Option[] = [];
  private left: Asked[] = [];
  private right = 0;
  private asked = 0;
  private skipped = 0;
  private answered = false;

  constructor(
    private readonly hall: HallFacts,
    private readonly hooks: LearnHooks,
  ) {}

  /** Stroke of the question; null: none is asked. */
  get current(): number | null {
    return this.question?.stroke ?? null;
  }

  /** Whether a rally is that of the quiz, as played or with another stroke. */
  covers(rally: RallyFacts): boolean {
    return this.rally?.number === rally.number && this.answered;
  }

  /** Starts the quiz of a rally unless it runs already; without a question, the next rally is tried. */
  begin(rally: RallyFacts, analysis: Analysis): void {
    if (this.rally) {
      return;
    }
    this.left = questions(rally, analysis);
    this.element.classList.remove("hidden");
    if (!this.left.length && this.skipped < RALLIES && !rally.after?.over && !this.hooks.isLast()) {
      this.skipped++;
      replaceChildren(this.element, h("h2", {}, h("span", {}, say("learn.title"))), h("p", {}, say("learn.looking")));
      this.hooks.nextRally();
      return;
    }
    [this.rally, this.analysis] = [rally, analysis];
    this.right = this.asked = this.skipped = 0;
    void this.next();
  }

  end(): void {
    this.rally = this.question = null;
    this.left = [];
    this.answered = false;
    this.clear();
    this.element.classList.add("hidden");
    replaceChildren(this.element); // else the next quiz shows the last question until the court is ready
  }

  private clear(): void {
    this.hooks.point(null);
    this.hooks.mark(null);
  }

  private async next(): Promise<void> {
    const { left } = this; // each quiz has a list of its own
    this.clear();
    await this.hooks.back();
    if (this.left !== left) {
      return; // the viewer left this quiz meanwhile
    }
    this.answered = false;
    const question = left.shift();
    if (!question) {
      this.tellAccuracy();
      return;
    }
    this.question = question;
    const stroke = this.rally!.strokes[question.stroke]!;
    replaceChildren(
      this.element,
      h(
        "h2",
        {},
        term("better stroke", say("learn.title")),
        h("span", {}, say("learn.of", { number: this.asked + 1, count: this.asked + left.length + 1 })),
      ),
      h(
        "p",
        {},
        h("b", { class: stroke.seat ? "b" : "a" }, capitalised(nameAt(this.rally!.names, stroke.seat))),
        say("learn.plays", { number: question.stroke + 1, from: say(`from_net.${stroke.height}` as Key) }),
        ...(stroke.hurried ? [say("language.comma"), term("hurried")] : []),
        say("learn.stop"),
      ),
    );
    this.hooks.stopBefore(question.stroke);
  }

  /** Shows the question when the playback reaches the decision. */
  ask(): void {
    if (!this.question || this.element.querySelector(".quiz")) {
      return;
    }
    const { question } = this;
    if (isPlace(question)) {
      this.askPlace(question);
    } else {
      this.askStroke(question);
    }
    (this.element.querySelector(".quiz button:not(:disabled)") as HTMLElement | null)?.focus({ preventScroll: true });
    this.clear(); // nothing is pointed at before the viewer does
  }

  private askPlace({ stroke, places }: PlaceQuestion): void {
    const rally = this.rally!;
    const seat = 1 - rally.strokes[stroke]!.seat;
    const feasible = places.map(({ position }) => position);
    const grid = positionGrid(this.hall, rally, seat, feasible, (position) => {
      const mark = () => this.hooks.mark(position);
      return { props: { onclick: () => this.answerPlace(position), onpointerenter: mark, onfocus: mark }, small: "" };
    });
    grid.classList.add("quiz");
    this.element.append(h("p", {}, say("learn.where")), grid);
  }

  private askStroke(question: StrokeQuestion): void {
    this.options = answers(question);
    const buttons = this.options.map((option) => {
      const point = () => this.hooks.point(option);
      return h(
        "button",
        { onclick: () => this.answer(option), onpointerenter: point, onfocus: point },
        h("span", {}, name(option)),
        h("span", { class: "quiet" }),
      );
    });
    this.element.append(h("p", {}, say("learn.question")), h("div", { class: "quiz" }, ...buttons));
  }

  /** Answers with the target at a point of the court; of several such answers, the first gets the focus. */
  answerAt(x: number, y: number): void {
    const { question, rally } = this;
    if (!question || this.answered || !this.element.querySelector(".quiz")) {
      return;
    }
    if (isPlace(question)) {
      const seat = 1 - rally!.strokes[question.stroke]!.seat;
      const feasible = question.places.map(({ position }) => position);
      const position = positionAt(this.hall, rally!, seat, feasible, x, y);
      if (position !== undefined) {
        this.answerPlace(position);
      }
      return;
    }
    const inside = ({ box: [x0, x1, y0, y1] }: Option) => x0 <= x && x <= x1 && y0 <= y && y <= y1;
    const found = this.options.filter(inside);
    if (found.length === 1) {
      this.answer(found[0]!);
    } else if (found.length) {
      this.buttons[this.options.indexOf(found[0]!)]?.focus({ preventScroll: true });
    }
  }

  private get buttons(): HTMLButtonElement[] {
    return [...this.element.querySelectorAll<HTMLButtonElement>(".quiz button")];
  }

  private answer(given: Option): void {
    const question = this.question as StrokeQuestion;
    const { best, wrong } = question;
    const played = wrong[0]!;
    const right = given === best;
    this.buttons.forEach((button, i) => {
      const option = this.options[i]!;
      button.disabled = true;
      button.classList.toggle("right", option === best);
      button.classList.toggle("wrong", option === given && !right);
      button.lastElementChild!.textContent = `${percent(option.best)}${option === played ? say("learn.played") : ""}`;
    });
    this.hooks.point(best);
    const lost = (option: Option) => percent(best.best - option.best);
    const verdict = right ? say("learn.correct") : say("learn.better", { stroke: name(best), share: lost(given) });
    const support = Math.round(Math.min(...this.options.map((option) => option.support!)));
    const told = say("learn.verdict", { verdict, share: lost(played), count: decimal(support, 0) });
    this.tell(question.stroke, right, told, { stroke: best.stroke });
  }

  private answerPlace(given: number): void {
    const question = this.question as PlaceQuestion;
    const waited = this.rally!.strokes[question.stroke]!.waited;
    const of = (position: number | null) => question.places.find((place) => place.position === position)!;
    const right = of(given).loss <= GOOD;
    for (const button of this.buttons) {
      const place = of(Number(button.dataset["position"]));
      button.disabled = true;
      if (place) {
        button.classList.toggle("right", place.loss <= GOOD);
        button.classList.toggle("wrong", place.position === given && !right);
        const share = say("recover.share_of_perfect", { share: percent(place.perfect) });
        replaceChildren(button.lastElementChild!, h("span", {}, signed(-place.loss)), " · ", h("span", {}, share));
      }
    }
    const best = question.places.reduce((a, b) => (b.perfect > a.perfect ? b : a));
    this.hooks.mark(best.position);
    const lost = (place: Place) => percent(place.loss);
    const better = say("learn.wait_better", { place: positionWords(this.hall, best.position), share: lost(of(given)) });
    const told = say("learn.wait_verdict", {
      verdict: right ? say("learn.correct") : better,
      place: positionWords(this.hall, waited!),
      share: lost(of(waited)),
    });
    this.tell(question.stroke, right, told, { position: best.position });
  }

  /** Counts an answer, and says what was right. */
  private tell(stroke: number, right: boolean, told: string, better: Tried): void {
    this.asked++;
    this.right += right ? 1 : 0;
    this.answered = true;
    this.hooks.reveal(stroke);
    const { playInstead, playFrom } = this.hooks;
    const name = say(this.left.length ? "learn.next_question" : "learn.show_accuracy");
    const next = h("button", { onclick: () => void this.next() }, name);
    this.element.append(
      h("p", {}, told),
      h(
        "div",
        { class: "row" },
        next,
        playInstead ? h("button", { onclick: () => playInstead(stroke, better) }, say("learn.play_better")) : null,
        h("button", { onclick: () => void playFrom(stroke) }, say("learn.play_played")),
      ),
    );
    next.focus({ preventScroll: true });
  }

  private tellAccuracy(): void {
    this.question = null;
    const [rally, analysis] = [this.rally!, this.analysis!];
    const shares = [0, 1].map((seat) =>
      h(
        "p",
        {},
        h("b", { class: seat ? "b" : "a" }, capitalised(nameAt(rally.names, seat))),
        `: ${accuracy([{ rally, analysis }], seat)}`,
      ),
    );
    const score = this.asked ? say("learn.score", { right: this.right, count: this.asked }) : say("learn.none");
    const done = h("button", { onclick: () => this.hooks.nextRally() }, say("learn.next_rally"));
    replaceChildren(
      this.element,
      h("h2", {}, term("accuracy", say("term.accuracy_title"))),
      h("p", {}, score),
      ...shares,
      h("p", { class: "quiet" }, say("learn.accuracy_about")),
      h("div", { class: "row" }, done),
    );
    this.hooks.reveal(Infinity);
    done.focus({ preventScroll: true });
  }
}
