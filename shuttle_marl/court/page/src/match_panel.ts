// The match at a glance: probability of winning it, its costliest strokes, accuracy and marks of both sides.

import { h, percent, replaceChildren, s, signed } from "./dom";
import { term } from "./glossary";
import { nameAt } from "./names";
import type { MatchReply, Moment } from "./wire.gen";
import { decimal, say, words } from "./words";

const MARKS = ["!!", "!", "?!", "?", "??"] as const;
const [WIDE, TALL] = [1000, 90];

export class MatchPanel {
  readonly element = h("section", { class: "panel match hidden", "aria-label": say("page.match") });
  private match: MatchReply | null = null;

  /** @param open shows a rally, from a stroke or from its start. */
  constructor(private readonly open: (rally: number, stroke: number | null) => void) {}

  /** @param current number of the rally on the court. */
  show(match: MatchReply | null, names: readonly [string, string], current: number): void {
    this.match = match;
    this.element.classList.toggle("hidden", !match?.rallies.length);
    if (!match?.rallies.length) {
      return;
    }
    const sides = [0, 1].map((seat) => {
      const accuracy = match.accuracy[seat as 0 | 1];
      const marks = match.marks[seat as 0 | 1].map((count, i) => `${MARKS[i]} ${count}`).join("  ");
      return h(
        "p",
        {},
        h("b", { class: seat ? "b" : "a" }, nameAt(names, seat)),
        accuracy === null ? "" : h("span", {}, ": ", term("accuracy"), ` ${percent(accuracy)}`),
        h("span", { class: "quiet" }, ` · ${marks}`),
      );
    });
    replaceChildren(
      this.element,
      h("h2", {}, term("match", say("term.match")), h("span", {}, say("page.rallies", { count: match.rallies.length }))),
      this.curve(match, current),
      ...sides,
      h("h3", { style: "margin-top:8px" }, term("loss", say("term.costliest"))),
      h("ol", { class: "moments" }, ...match.moments.map((moment) => h("li", {}, this.moment(moment)))),
    );
  }

  private moment(moment: Moment): HTMLElement {
    const cost =
      moment.cost === null
        ? say("page.of_rally", { points: signed(moment.change) })
        : say("page.of_match", { points: `−${decimal(100 * moment.cost, 1)} %` });
    return h(
      "button",
      { onclick: () => this.open(moment.rally, moment.stroke) },
      h("span", { class: "dot", style: `background:${moment.seat ? "var(--b)" : "var(--a)"}` }),
      h(
        "span",
        {},
        say("page.moment", { rally: moment.rally + 1, stroke: moment.stroke + 1, shot: words(moment.shot) }),
        h("span", { class: "mark bad" }, moment.mark),
      ),
      h("span", { class: "quiet" }, cost),
    );
  }

  private curve(match: MatchReply, current: number): SVGElement {
    const { rallies } = match;
    const first = rallies[0]!.number;
    const x = (i: number) => (WIDE * i) / rallies.length;
    const y = (win: number) => TALL - 4 - (TALL - 8) * win;
    const line = (x1: number, x2: number, y1: number, y2: number, colour: string, width: number) =>
      s("line", { x1, x2, y1, y2, stroke: colour, "stroke-width": width, "vector-effect": "non-scaling-stroke" });
    const path = [...rallies.map(({ win }, i) => `${x(i)} ${y(win)}`), `${WIDE} ${y(match.win_after ?? 0.5)}`].join("L");
    const games = rallies.flatMap((rally, i) =>
      i && rally.games.join() !== rallies[i - 1]!.games.join() ? [line(x(i), x(i), 0, TALL, "var(--off)", 1)] : [],
    );
    const here = x(current - first + 0.5);
    const drawing = s(
      "svg",
      {
        class: "curve",
        viewBox: `0 0 ${WIDE} ${TALL}`,
        preserveAspectRatio: "none",
        role: "img",
        "aria-label": say("page.match_curve", { count: rallies.length, share: percent(match.win_after ?? 0.5) }),
      },
      line(0, WIDE, y(0.5), y(0.5), "var(--off)", 1),
      ...games,
      s("path", { d: `M${path}L${WIDE} ${TALL}L0 ${TALL}Z`, fill: "var(--a)", "fill-opacity": 0.2 }),
      s("path", { d: `M${path}`, fill: "none", stroke: "var(--a)", "stroke-width": 2, "vector-effect": "non-scaling-stroke" }),
      line(here, here, 0, TALL, "var(--text)", 2),
    );
    drawing.addEventListener("click", (event) => {
      const box = drawing.getBoundingClientRect();
      const at = Math.floor((((event as MouseEvent).clientX - box.left) / box.width) * rallies.length);
      this.open(rallies[Math.min(Math.max(at, 0), rallies.length - 1)]!.number, null);
    });
    return drawing;
  }

  /** For tests and scripts. */
  get shown(): MatchReply | null {
    return this.match;
  }
}
