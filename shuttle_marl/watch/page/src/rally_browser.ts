// The rallies of a recorded match, to choose from.

import { h, percent, replaceChildren } from "./dom";
import { term } from "./glossary";
import type { MatchReply } from "./wire.gen";

export class RallyBrowser {
  readonly element = h("section", { class: "panel browser hidden", "aria-label": "Rallies of the match" });
  private list = h("ol");
  private readonly report = h("a", { target: "_blank", rel: "noopener" }, "Match report");
  private match: MatchReply | null = null;

  /** @param live whether the page has a server, which makes match reports. */
  constructor(
    private readonly open: (rally: number) => void,
    private readonly live: boolean,
  ) {}

  /**
   * @param match the match; null: as before.
   * @param current number of the rally on the court.
   */
  show(match: MatchReply | null, current: number): void {
    if (match && match !== this.match) {
      this.match = match;
      this.element.classList.toggle("hidden", !match.rallies.length);
      const rows = match.rallies.map((rally) =>
        h(
          "li",
          {},
          h(
            "button",
            { onclick: () => this.open(rally.number), "data-rally": rally.number },
            h("b", { class: rally.winner ? "b" : "a" }, rally.winner ? "B" : "A"),
            h("span", {}, `game ${rally.games[0] + rally.games[1] + 1} · ${rally.points.join("–")}`),
            h("span", { class: "quiet" }, `${rally.strokes} · ±${percent(rally.swing)}`),
          ),
        ),
      );
      this.list = h("ol", {}, ...rows);
      replaceChildren(
        this.element,
        h("h2", {}, term("rallies", "Rallies"), h("span", {}, "strokes · swing")),
        this.list,
        this.live && this.report,
      );
    }
    this.report.href = `report?rally=${current + 1}`;
    for (const button of this.list.querySelectorAll("button")) {
      const here = button.dataset["rally"] === String(current);
      button.removeAttribute("aria-current");
      if (here) {
        button.setAttribute("aria-current", "true");
        this.element.scrollTop = button.offsetTop - this.element.clientHeight / 2;
      }
    }
  }
}
