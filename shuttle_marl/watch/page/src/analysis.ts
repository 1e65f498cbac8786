// Panels that show the values of strokes.

import { h, percent, replaceChildren, s, signed, words } from "./dom";
import { COLOURS } from "./stage";
import type { Analysis, HallFacts, RallyFacts, StrokeValue } from "./wire.gen";

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

/** Change of seat 0's probability of winning from a stroke to the next decision. */
export function change(analysis: Analysis, i: number): number | null {
  const now = analysis.strokes[i]?.win ?? null;
  const next = analysis.strokes[i + 1]?.win ?? (i === analysis.strokes.length - 1 ? analysis.win_after : null);
  return now === null || next === null ? null : next - now;
}

export class Curve {
  readonly element = h("div", { class: "panel bottom" });
  private readonly drawing = s("svg", { class: "curve", viewBox: "0 0 1000 96", preserveAspectRatio: "none", role: "img" });
  private readonly cursor = s("line", {
    y1: 0,
    y2: 96,
    stroke: "#ffffff",
    "stroke-width": 2,
    "vector-effect": "non-scaling-stroke",
  });
  private readonly names = h("div", { "aria-hidden": "true" });
  private duration = 1;

  constructor(seek: (time: number) => void) {
    this.element.append(
      h("h2", {}, h("span", {}, "Win probability (A) · click to seek")),
      h("div", { class: "timeline" }, this.drawing, this.names),
    );
    this.drawing.addEventListener("click", (event) => {
      const box = this.drawing.getBoundingClientRect();
      seek((((event as MouseEvent).clientX - box.left) / box.width) * this.duration);
    });
  }

  show(rally: RallyFacts, duration: number, analysis: Analysis | null): void {
    this.duration = duration;
    const x = (time: number) => (1000 * time) / duration;
    const y = (win: number) => 92 - 88 * win;
    const parts: SVGElement[] = [
      s("line", {
        x1: 0,
        x2: 1000,
        y1: y(0.5),
        y2: y(0.5),
        stroke: "#2b3c5c",
        "stroke-dasharray": "6 6",
        "vector-effect": "non-scaling-stroke",
      }),
    ];
    this.names.replaceChildren();
    let free = 0; // left edge of the free space for the next label
    for (const [i, stroke] of rally.strokes.entries()) {
      const name = `${i + 1} ${words(stroke.shot)}`;
      const end = (rally.strokes[i + 1]?.time ?? duration) / duration;
      const width = 0.012 * (name.length + 1);
      if (stroke.time / duration >= free && stroke.time / duration + width < end + 0.01) {
        free = stroke.time / duration + width;
        this.names.append(h("span", { style: `left:${(100 * stroke.time) / duration}%` }, name));
      }
      const colour = COLOURS[stroke.seat]!;
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
      parts.push(s("path", { d: `${path}V92H0Z`, fill: COLOURS[0], "fill-opacity": 0.2 }));
      parts.push(
        s("path", { d: path, fill: "none", stroke: COLOURS[0], "stroke-width": 2, "vector-effect": "non-scaling-stroke" }),
      );
    }
    this.drawing.setAttribute(
      "aria-label",
      steps.length
        ? `Probability that A wins the rally, from ${percent(steps[0]!.win)} to ${percent(steps.at(-1)!.win)}`
        : "Timeline of the strokes",
    );
    this.drawing.replaceChildren(...parts, this.cursor);
  }

  move(time: number): void {
    const x = String((1000 * time) / this.duration);
    this.cursor.setAttribute("x1", x);
    this.cursor.setAttribute("x2", x);
  }
}

export class MoveList {
  readonly element = h("section", { class: "panel moves", "aria-label": "Strokes of the rally" });
  private rows: HTMLButtonElement[] = [];
  private current = -2;
  private moved = false;

  constructor(private readonly seek: (stroke: number) => void) {}

  show(rally: RallyFacts, analysis: Analysis | null, upTo = Infinity): void {
    this.current = -2;
    this.rows = rally.strokes.slice(0, upTo).map((stroke, i) => {
      const value = analysis?.strokes[i];
      const delta = analysis ? change(analysis, i) : null;
      const bad = value?.mark.includes("?") ? " bad" : "";
      return h(
        "button",
        { onclick: () => this.seek(i) },
        h("span", { class: "quiet" }, String(i + 1)),
        h("span", { class: "dot", style: `background:${COLOURS[stroke.seat]}` }),
        h(
          "span",
          { class: "what" },
          h("b", {}, words(stroke.shot)),
          value?.mark ? h("span", { class: `mark${bad}` }, value.mark) : null,
          h("span", { class: "tag" }, words(stroke.area)),
          h("span", { class: "tag" }, words(stroke.technique)),
          stroke.person ? h("span", { class: "tag" }, "yours") : null,
        ),
        delta === null ? "" : h("span", { class: delta >= 0 ? "up" : "down" }, signed(delta)),
      );
    });
    const heading = h(
      "h2",
      {},
      h("span", {}, `Rally ${rally.number + 1} · ${rally.strokes.length} stroke${rally.strokes.length === 1 ? "" : "s"}`),
      h("span", {}, "change (A)"),
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
    h("b", { class: seat ? "b" : "a" }, rally.names[seat]!),
    ` wins the rally (${rally.reason}), ${rally.after?.points.join(" – ")}`,
  );
}

export class OptionTable {
  readonly element = h("section", { class: "panel", "aria-label": "Legal strokes" });

  constructor(private readonly tryOut: (stroke: number) => void) {}

  show(rally: RallyFacts, index: number, value: StrokeValue | undefined): void {
    const stroke = rally.strokes[index];
    this.element.classList.toggle("hidden", !stroke || !value);
    if (!stroke || !value) {
      this.element.replaceChildren();
      return;
    }
    const most = Math.max(...value.options.map((option) => option.probability), 0.01);
    const rows = value.options.map((option) => {
      const chosen = option.stroke === stroke.stroke;
      const name = `${words(option.shot)} → ${words(option.area)}`;
      const button = h(
        "button",
        { onclick: () => this.tryOut(option.stroke), title: `What if: ${name}, ${words(option.technique)}` },
        h("i", { style: `width:${(100 * option.probability) / most}%` }),
        h("span", {}, name, option.technique === "forehand" ? "" : option.technique === "backhand" ? " · bh" : " · ath"),
      );
      return h(
        "tr",
        { class: `${chosen ? "chosen " : ""}${option.stroke === value.better ? "best" : ""}` },
        h("td", {}, button),
        h("td", {}, percent(option.probability)),
        h("td", {}, option.win.toFixed(3)),
        h("td", {}, option.p_succ.toFixed(2)),
        h("td", {}, option.p_ret.toFixed(2)),
      );
    });
    const head = h(
      "tr",
      {},
      ...["stroke · click: what if", "policy", "wins", "succ.", "ret."].map((name) => h("th", { scope: "col" }, name)),
    );
    replaceChildren(
      this.element,
      h(
        "h2",
        {},
        h("span", {}, `${rally.names[stroke.seat]} at stroke ${index + 1}`),
        h("span", {}, value.regret > 5e-4 ? `regret ${value.regret.toFixed(3)}` : "best"),
      ),
      h("table", { class: "options" }, h("thead", {}, head), h("tbody", {}, ...rows)),
      h("p", { class: "quiet" }, value.sure),
    );
  }
}

/** P(success) and P(returned) of the current stroke. */
export class Chances {
  readonly element = h("section", { class: "panel pair", "aria-label": "Probabilities of the stroke" });

  show(rally: RallyFacts, index: number): void {
    const stroke = rally.strokes[Math.max(index, 0)];
    if (!stroke) {
      return;
    }
    const part = (name: string, p: number, colour: string) =>
      h(
        "div",
        {},
        h("h3", {}, name),
        h("b", { style: `color:${colour}` }, p.toFixed(2)),
        h("div", { class: "meter" }, h("i", { style: `width:${100 * p}%;background:${colour}` })),
      );
    replaceChildren(
      this.element,
      part("P(success)", stroke.p_succ, "var(--green)"),
      part("P(returned)", stroke.p_ret, "var(--gold)"),
    );
  }
}

/** The court from above: target areas of the policy and path of the shuttle. Seat 0 is on the left. */
export class LandingMap {
  readonly element = h("section", { class: "panel", "aria-label": "Target areas of the striker's policy" });
  private readonly drawing = s("svg", { class: "map", viewBox: "-7 -3.35 14 6.7", role: "img" });

  constructor(private readonly hall: HallFacts) {
    this.element.append(h("h2", {}, h("span", {}, "Target areas"), h("span", {}, "policy")), this.drawing);
  }

  show(rally: RallyFacts, index: number, landing: number[] | null): void {
    const { court } = this.hall;
    const [hl, hw, fw] = [court.length / 2, court.half_width, court.width / 2];
    const parts: SVGElement[] = [s("rect", { x: -7, y: -3.35, width: 14, height: 6.7, rx: 0.2, fill: "#0f6d51" })];
    const stroke = rally.strokes[index];
    const most = Math.max(...(landing ?? [1]));
    if (stroke && landing) {
      this.hall.areas.forEach(({ box: [[x0, x1], [y0, y1]] }, area) => {
        const sign = stroke.seat ? -1 : 1;
        const share = landing[area]!;
        const [left, top] = [Math.min(sign * y0, sign * y1), Math.min(sign * x0, sign * x1)];
        parts.push(
          s("rect", {
            x: left,
            y: top,
            width: y1 - y0,
            height: x1 - x0,
            fill: "#fbbf24",
            "fill-opacity": (0.85 * share) / most,
          }),
        );
        if (share >= 0.05) {
          parts.push(
            s(
              "text",
              {
                x: left + (y1 - y0) / 2,
                y: top + (x1 - x0) / 2 + 0.16,
                "font-size": 0.5,
                fill: "#06101f",
                "text-anchor": "middle",
                "font-weight": 700,
              },
              String(Math.round(100 * share)),
            ),
          );
        }
      });
    }
    const line = (x1: number, y1: number, x2: number, y2: number) =>
      s("line", { x1, y1, x2, y2, stroke: "#f4f7f4", "stroke-width": 0.05 });
    for (const side of [-1, 1]) {
      parts.push(line(-hl, side * fw, hl, side * fw), line(-hl, side * hw, hl, side * hw), line(side * hl, -fw, side * hl, fw));
      parts.push(
        line(side * court.short_service, -fw, side * court.short_service, fw),
        line(side * court.short_service, 0, side * hl, 0),
      );
    }
    parts.push(s("line", { x1: 0, y1: -fw, x2: 0, y2: fw, stroke: "#ffffff", "stroke-width": 0.09 }));
    if (stroke) {
      const [from, to] = [stroke.contact, stroke.end_point];
      parts.push(
        s("line", {
          x1: from[1],
          y1: from[0],
          x2: to[1],
          y2: to[0],
          stroke: "#ffffff",
          "stroke-width": 0.06,
          "stroke-dasharray": "0.2 0.15",
        }),
      );
      parts.push(
        s("circle", {
          cx: from[1],
          cy: from[0],
          r: 0.19,
          fill: COLOURS[stroke.seat]!,
          stroke: "#06101f",
          "stroke-width": 0.05,
        }),
      );
      parts.push(s("circle", { cx: to[1], cy: to[0], r: 0.16, fill: "#ffffff", stroke: "#06101f", "stroke-width": 0.05 }));
    }
    this.drawing.setAttribute("aria-label", stroke ? `${words(stroke.shot)} to ${words(stroke.area)}` : "The court from above");
    this.drawing.replaceChildren(...parts);
  }
}
