// Panels that show the values of strokes.

import { capitalised, h, percent, replaceChildren, s, sideColour } from "./dom";
import { hurriedTag, term } from "./glossary";
import { nameAt, shown } from "./names";
import { choiceWords, verdict } from "./verdict";
import type { Analysis, RallyFacts, Stroke } from "./wire.gen";
import { decimal, type Key, listed, points, say, words } from "./words";

/** Probability that seat 0 wins the rally, over the time of so many strokes, and to its end if there are not as many. */
function winSteps(rally: RallyFacts, analysis: Analysis, named: number): { time: number; win: number }[] {
  const steps = analysis.strokes.slice(0, named).flatMap(({ win, chosen }, i) => {
    const { time } = rally.strokes[i]!;
    return [
      { time: i === 0 ? 0 : time - 1e-3, win },
      { time, win: chosen },
    ];
  });
  const last = rally.strokes.at(-1);
  const over = last && analysis.win_after !== null && named > rally.strokes.length;
  return over ? [...steps, { time: last.end_time, win: analysis.win_after! }] : steps;
}

/** Share of the judged strokes of a seat in some rallies that have no `?!`, `?` or `??`, as words. */
export function accuracy(rallies: { rally: RallyFacts; analysis: Analysis }[], seat: number): string {
  const values = rallies.flatMap(({ rally, analysis }) => analysis.strokes.filter((_, i) => rally.strokes[i]!.seat === seat));
  const judged = values.filter(({ change }) => change !== null);
  const sound = judged.filter(({ mark }) => !mark.includes("?"));
  return judged.length ? say("page.accuracy", { share: percent(sound.length / judged.length) }) : say("page.no_accuracy");
}

/** About the width of a small label, with a gap behind it [px]. */
function textWidth(label: string): number {
  return [...label].reduce((sum, letter) => sum + (letter > "\u2e80" ? 11 : 6.2), 10);
}

export class Curve {
  readonly element = h("div", { class: "timeline" });
  readonly slider: HTMLInputElement;
  private readonly drawing = s("svg", { class: "curve", viewBox: "0 0 1000 96", preserveAspectRatio: "none", role: "img" });
  private readonly ahead = s("rect", { y: 0, height: 96, width: 1000, class: "ahead" });
  private readonly names = h("div", { "aria-hidden": "true" });
  private duration = 1;
  private labelled: Stroke[] = [];

  constructor(seek: (time: number) => void) {
    this.slider = h("input", {
      type: "range",
      min: 0,
      max: 1,
      step: 0.02,
      value: 0,
      "aria-label": say("page.position"),
      oninput: () => seek(Number(this.slider.value)),
    });
    this.element.append(this.drawing, this.names, this.slider);
    new ResizeObserver(() => this.label()).observe(this.drawing);
  }

  /** @param named number of strokes that are told; more than there are: the end of the rally as well. */
  show(rally: RallyFacts, duration: number, analysis: Analysis | null, named: number): void {
    this.duration = duration;
    this.slider.max = String(duration);
    const x = (time: number) => (1000 * time) / duration;
    const y = (win: number) => 92 - 88 * win;
    const line = (x1: number, x2: number, y1: number, y2: number, colour: string, more: Record<string, string | number>) =>
      s("line", { x1, x2, y1, y2, stroke: colour, "vector-effect": "non-scaling-stroke", ...more });
    const parts = [line(0, 1000, y(0.5), y(0.5), "var(--off)", { "stroke-dasharray": "6 6" })];
    this.labelled = rally.strokes.slice(0, named);
    this.label();
    for (const { time, seat } of this.labelled) {
      parts.push(line(x(time), x(time), 2, 94, sideColour(seat), { "stroke-opacity": 0.55 }));
    }
    const steps = analysis ? winSteps(rally, analysis, named) : [];
    if (steps.length) {
      const path = `M0 ${y(steps[0]!.win)}${steps.map(({ time, win }) => `H${x(time)}V${y(win)}`).join("")}H1000`;
      parts.push(s("path", { d: `${path}V92H0Z`, fill: "var(--a)", "fill-opacity": 0.2 }));
      parts.push(
        s("path", { d: path, fill: "none", stroke: "var(--a)", "stroke-width": 2, "vector-effect": "non-scaling-stroke" }),
      );
    }
    this.drawing.setAttribute(
      "aria-label",
      steps.length
        ? say("page.curve", { from: percent(steps[0]!.win), to: percent(steps.at(-1)!.win) })
        : say("page.strokes_timeline"),
    );
    this.drawing.replaceChildren(...parts, this.ahead);
  }

  /** Names the strokes whose names have room. */
  private label(): void {
    const { duration, labelled } = this;
    const width = this.drawing.clientWidth || 600;
    this.names.replaceChildren();
    let free = 0; // left edge of the free space for the next label
    labelled.forEach(({ shot, time }, i) => {
      const [name, left] = [`${i + 1} ${words(shot)}`, time / duration];
      const right = left + textWidth(name) / width;
      if (left >= free && right < (labelled[i + 1]?.time ?? duration) / duration) {
        free = right;
        this.names.append(h("span", { style: `left:${100 * left}%` }, name));
      }
    });
  }

  /** Moves to a time; what is ahead is dim. */
  move(time: number): void {
    this.slider.value = String(time);
    this.ahead.setAttribute("x", String((1000 * time) / this.duration));
  }
}

export class MoveList {
  readonly element = h("section", { class: "panel moves", "aria-label": say("page.strokes") });
  private rows: HTMLButtonElement[] = [];
  private current = -2;
  private moved = false;

  constructor(private readonly seek: (stroke: number) => void) {}

  /** @param named number of strokes that are told; more than there are: the end of the rally as well. */
  show(rally: RallyFacts, analysis: Analysis | null, named: number): void {
    this.current = -2;
    this.rows = rally.strokes.slice(0, named).map((stroke, i) => {
      const value = analysis?.strokes[i];
      const bad = value?.mark.includes("?") ? " bad" : "";
      return h(
        "button",
        { onclick: () => this.seek(i) },
        h("span", { class: "quiet" }, String(i + 1)),
        h("span", { class: "dot", style: `background:${sideColour(stroke.seat)}` }),
        h(
          "span",
          { class: "what" },
          h("b", {}, words(stroke.shot)),
          value?.mark ? h("span", { class: `mark${bad}` }, value.mark) : null,
          h("span", { class: "tag" }, words(stroke.area)),
          h("span", { class: "tag" }, words(stroke.technique)),
          hurriedTag(stroke.hurried),
          stroke.person
            ? h("span", { class: "tag" }, say(rally.names[stroke.seat] === "you" ? "page.yours" : "page.tried"))
            : null,
          value ? verdict(rally, analysis!, i, named) : null,
        ),
      );
    });
    const count = rally.strokes.length;
    const over = rally.winner !== null && named > count;
    const key = !over ? "page.rally_number" : count === 1 ? "page.rally_stroke" : "page.rally_strokes";
    const heading = h(
      "h2",
      {},
      h("span", {}, say(key, { number: rally.number + 1, count })),
      term("change", say("verdict.term")),
    );
    const ended = over ? endLine(rally) : null;
    replaceChildren(this.element, heading, h("ol", {}, ...this.rows.map((row) => h("li", {}, row))), ended);
  }

  mark(stroke: number): void {
    if (stroke === this.current) {
      return;
    }
    this.rows[this.current]?.removeAttribute("aria-current");
    this.current = stroke;
    this.rows.forEach((row, i) => row.classList.toggle("ahead", i > stroke));
    this.rows[stroke]?.setAttribute("aria-current", "true");
    this.moved = true;
  }

  /** Scrolls to the current stroke. Call it before other changes of a frame: it measures the layout. */
  keepInView(): void {
    const row = this.moved ? this.rows[this.current] : undefined;
    this.moved = false;
    if (row) {
      const [top, bottom] = [row.offsetTop - 40, row.offsetTop + row.offsetHeight + 10];
      if (top < this.element.scrollTop || bottom > this.element.scrollTop + this.element.clientHeight) {
        this.element.scrollTop = top - 40;
      }
    }
  }
}

function endLine(rally: RallyFacts): HTMLElement {
  const seat = rally.winner!;
  return h(
    "p",
    { class: "end" },
    h("b", { class: seat ? "b" : "a" }, shown(capitalised(nameAt(rally.names, seat)))),
    say(rally.names[seat] === "you" ? "page.win_rally" : "page.wins_rally", {
      reason: say(`reason.${rally.reason}` as Key),
      points: rally.after!.points.join(" – "),
    }),
  );
}

const RELIABLE = 20; // real strokes from which a probability is fairly reliable
const SOME = 100; // … reliable

/** How reliable probabilities are with so many real strokes behind them; null: unknown. */
function sure(support: number | null): string {
  const known = support === null ? "unknown" : support < RELIABLE ? "low" : support < SOME ? "fair" : "good";
  return say(`page.support_${known}`, { count: decimal(support ?? 0, 0) });
}

function realised(factor: Analysis["factor"]): string {
  const [share, low, high] = (factor ?? []).map((part) => `${Math.round(100 * part)}%`) as [string, string, string];
  return factor ? say("page.realised", { share, low, high }) : "";
}

export class OptionTable {
  readonly element = h("section", { class: "panel", "aria-label": say("page.legal") });

  /** @param tryOut plays a stroke instead; null: this page has no server that could. */
  constructor(private readonly tryOut: ((stroke: number) => void) | null) {}

  /**
   * @param analysis values of the rally; null: none are shown.
   * @param strong whether the values assume strong play of both, as marks and the questions of Learn do.
   */
  show(rally: RallyFacts, index: number, analysis: Analysis | null, strong: boolean): void {
    const stroke = rally.strokes[index];
    const value = analysis?.strokes[index];
    this.element.classList.toggle("hidden", !stroke || !value);
    if (!stroke || !value) {
      this.element.replaceChildren();
      return;
    }
    const most = Math.max(...value.options.map((option) => option.probability), 0.01);
    const rows = value.options.map((option) => {
      const chosen = option.stroke === stroke.stroke;
      const name = `${words(option.shot)} → ${words(option.area)}`;
      const { tryOut } = this;
      const button = h(
        tryOut ? "button" : "div",
        tryOut
          ? {
              class: "try",
              onclick: () => tryOut(option.stroke),
              title: say("page.what_if", { stroke: listed([name, words(option.technique)]) }),
            }
          : { class: "try", title: listed([name, words(option.technique)]) },
        h("i", { style: `width:${(100 * option.probability) / most}%` }),
        h("span", {}, name, option.technique === "forehand" ? "" : ` · ${words(option.technique)}`),
      );
      return h(
        "tr",
        { class: `${chosen ? "chosen " : ""}${option.stroke === value.better ? "best" : ""}` },
        h("td", {}, button),
        h("td", {}, percent(option.probability)),
        h("td", {}, points(strong ? option.best : option.win)),
        h("td", {}, percent(option.p_succ)),
        h("td", {}, percent(option.p_ret)),
      );
    });
    const head = h(
      "tr",
      {},
      h("th", { scope: "col" }, say(this.tryOut ? "page.click" : "page.stroke")),
      h("th", { scope: "col" }, term("chosen")),
      h("th", { scope: "col" }, strong ? term("strong play", say("term.wins_strong")) : term("as they play", say("term.wins"))),
      h("th", { scope: "col" }, term("in")),
      h("th", { scope: "col" }, term("comes back", say("term.back"))),
    );
    replaceChildren(
      this.element,
      h(
        "h2",
        {},
        h("span", {}, say("page.at_stroke", { name: nameAt(rally.names, stroke.seat), number: index + 1 })),
        term("change", choiceWords(value, stroke.seat)),
      ),
      h("table", { class: "options" }, h("thead", {}, head), h("tbody", {}, ...rows)),
      h("p", { class: "quiet" }, `${strong ? say("page.strongly") : ""}${sure(value.support)}${realised(analysis!.factor)}`),
    );
  }
}
