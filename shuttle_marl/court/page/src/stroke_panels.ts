// Panels about one stroke: its probabilities, and the court from above.

import { h, percent, replaceChildren, s } from "./dom";
import { term } from "./glossary";
import { facing } from "./hall";
import type { HallFacts, RallyFacts } from "./wire.gen";
import { say, words } from "./words";

/** P(success) and P(returned) of the current stroke. */
export class Chances {
  readonly element = h("section", { class: "panel pair", "aria-label": say("page.chances") });

  show(rally: RallyFacts, index: number): void {
    const stroke = rally.strokes[Math.max(index, 0)];
    this.element.classList.toggle("hidden", !stroke);
    if (!stroke) {
      return;
    }
    const part = (name: "in" | "comes back", p: number, colour: string) =>
      h(
        "div",
        {},
        h("h3", {}, term(name)),
        h("b", { style: `color:${colour}` }, percent(p)),
        h("div", { class: "meter" }, h("i", { style: `width:${100 * p}%;background:${colour}` })),
      );
    replaceChildren(this.element, part("in", stroke.p_succ, "var(--green)"), part("comes back", stroke.p_ret, "var(--gold)"));
  }
}

/** The court from above: target areas of the policy and path of the shuttle. The near end is on the left. */
export class LandingMap {
  readonly element = h("section", { class: "panel", "aria-label": say("page.areas") });
  private readonly drawing = s("svg", { class: "map", viewBox: "-7 -3.35 14 6.7", role: "img" });

  constructor(private readonly hall: HallFacts) {
    this.element.append(h("h2", {}, term("target areas", say("term.aim"))), this.drawing);
  }

  show(rally: RallyFacts, index: number, landing: number[] | null): void {
    const { court } = this.hall;
    const [hl, hw, fw] = [court.length / 2, court.half_width, court.width / 2];
    const parts: SVGElement[] = [s("rect", { x: -7, y: -3.35, width: 14, height: 6.7, rx: 0.2, fill: "#0f6d51" })];
    const stroke = rally.strokes[index];
    const most = Math.max(...(landing ?? [1]));
    if (stroke && landing) {
      this.hall.areas.forEach(({ box: [[x0, x1], [y0, y1]] }, area) => {
        const sign = facing(rally, stroke.seat);
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
          fill: stroke.seat ? "#fb7185" : "#38bdf8",
          stroke: "#06101f",
          "stroke-width": 0.05,
        }),
      );
      parts.push(s("circle", { cx: to[1], cy: to[0], r: 0.16, fill: "#ffffff", stroke: "#06101f", "stroke-width": 0.05 }));
    }
    this.drawing.setAttribute(
      "aria-label",
      stroke ? say("stroke.to", { shot: words(stroke.shot), area: words(stroke.area) }) : say("page.from_above"),
    );
    this.drawing.replaceChildren(...parts);
  }
}
