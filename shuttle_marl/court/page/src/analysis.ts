// Panels that show the values of strokes.

import { capitalised, h, percent, replaceChildren, s, sideColour, signed } from "./dom";
import { hurriedTag, term } from "./glossary";
import { nameAt } from "./names";
import type { Analysis, RallyFacts, Stroke } from "./wire.gen";
import { decimal, type Key, listed, say, words } from "./words";

/** Probability that seat 0 wins the rally, over time. */
export function winSteps(rally: RallyFacts, analysis: Analysis): { time: number; win: number }[] {
  const steps: { time: number; win: number }[] = [];
  analysis.strokes.forEach((value, i) => {
    const stroke = rally.strokes[i]!;
    steps.push({ time: i === 0 ? 0 : stroke.time - 1e-3, win: value.win });
    steps.push({ time: stroke.time, win: value.chosen });
  });
  const last = rally.strokes.at(-1);
  if (last && analysis.win_after !== null) {
    steps.push({ time: last.end_time, win: analysis.win_after });
  }
  return steps;
}

/** Probability that seat 0 wins the rally at a time; null before the values are known. */
export function winAt(rally: RallyFacts, analysis: Analysis | null, time: number): number | null {
  const steps = analysis ? winSteps(rally, analysis) : [];
  return (steps.findLast((step) => step.time <= time + 1e-6) ?? steps[0])?.win ?? null;
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
  readonly element = h("section", { class: "panel bottom", "aria-label": say("page.timeline") });
  private readonly drawing = s("svg", { class: "curve", viewBox: "0 0 1000 96", preserveAspectRatio: "none", role: "img" });
  private readonly cursor = s("line", {
    y1: 0,
    y2: 96,
    stroke: "var(--text)",
    "stroke-width": 2,
    "vector-effect": "non-scaling-stroke",
  });
  private readonly names = h("div", { "aria-hidden": "true" });
  private duration = 1;
  private labelled: Stroke[] = [];

  /** @param back button that leaves a "what if". */
  constructor(seek: (time: number) => void, back: HTMLElement) {
    this.element.append(
      h("h2", {}, term("win probability", say("term.win_probability")), back),
      h("div", { class: "timeline" }, this.drawing, this.names),
    );
    new ResizeObserver(() => this.label()).observe(this.drawing);
    this.drawing.addEventListener("click", (event) => {
      const box = this.drawing.getBoundingClientRect();
      seek((((event as MouseEvent).clientX - box.left) / box.width) * this.duration);
    });
  }

  /** @param named number of strokes whose names are shown. */
  show(rally: RallyFacts, duration: number, analysis: Analysis | null, named: number): void {
    this.duration = duration;
    const x = (time: number) => (1000 * time) / duration;
    const y = (win: number) => 92 - 88 * win;
    const parts: SVGElement[] = [
      s("line", {
        x1: 0,
        x2: 1000,
        y1: y(0.5),
        y2: y(0.5),
        stroke: "var(--off)",
        "stroke-dasharray": "6 6",
        "vector-effect": "non-scaling-stroke",
      }),
    ];
    this.labelled = rally.strokes.slice(0, named);
    this.label();
    for (const stroke of rally.strokes) {
      const colour = sideColour(stroke.seat);
      parts.push(
        s("line", {
          x1: x(stroke.time),
          x2: x(stroke.time),
          y1: 2,
          y2: 94,
          stroke: colour,
          "stroke-opacity": 0.55,
          "vector-effect": "non-scaling-stroke",
        }),
      );
    }
    const steps = analysis ? winSteps(rally, analysis) : [];
    if (steps.length) {
      let path = `M0 ${y(steps[0]!.win)}`;
      for (const step of steps) {
        path += `H${x(step.time)}V${y(step.win)}`;
      }
      path += "H1000";
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
    this.drawing.replaceChildren(...parts, this.cursor);
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

  move(time: number): void {
    const x = String((1000 * time) / this.duration);
    this.cursor.setAttribute("x1", x);
    this.cursor.setAttribute("x2", x);
  }
}

export class MoveList {
  readonly element = h("section", { class: "panel moves", "aria-label": say("page.strokes") });
  private rows: HTMLButtonElement[] = [];
  private current = -2;
  private moved = false;

  constructor(private readonly seek: (stroke: number) => void) {}

  show(rally: RallyFacts, analysis: Analysis | null, upTo = Infinity): void {
    this.current = -2;
    this.rows = rally.strokes.slice(0, upTo).map((stroke, i) => {
      const value = analysis?.strokes[i];
      const delta = value?.change ?? null;
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
        ),
        delta === null ? "" : h("span", { class: delta >= 0 ? "up" : "down" }, signed(delta)),
      );
    });
    const count = rally.strokes.length;
    const heading = h(
      "h2",
      {},
      h("span", {}, say(count === 1 ? "page.rally_stroke" : "page.rally_strokes", { number: rally.number + 1, count })),
      term("change"),
    );
    const ended = rally.winner === null || upTo < rally.strokes.length ? null : endLine(rally);
    replaceChildren(this.element, heading, h("ol", {}, ...this.rows.map((row) => h("li", {}, row))), ended);
  }

  mark(stroke: number): void {
    if (stroke === this.current) {
      return;
    }
    this.rows[this.current]?.removeAttribute("aria-current");
    this.current = stroke;
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
    h("b", { class: seat ? "b" : "a" }, capitalised(nameAt(rally.names, seat))),
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

/** A probability in percent with one decimal, so that close strokes differ. */
function points(p: number): string {
  return `${decimal(100 * p, 1)} %`;
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
        value.change === null ? h("span", {}, say("page.rare")) : term("change", signed(value.change)),
      ),
      h("table", { class: "options" }, h("thead", {}, head), h("tbody", {}, ...rows)),
      h("p", { class: "quiet" }, `${strong ? say("page.strongly") : ""}${sure(value.support)}${realised(analysis!.factor)}`),
    );
  }
}
