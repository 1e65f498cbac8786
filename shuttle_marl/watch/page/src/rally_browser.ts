// The rallies of a recorded match, to choose from.

import { h, percent, replaceChildren } from "./dom";
import { term } from "./glossary";
import { displayName } from "./names";
import type { MatchReply, RecordedMatch } from "./wire.gen";
import { language, say } from "./words";

/** The match of a rally. */
export function matchOf(matches: RecordedMatch[], rally: number): RecordedMatch | undefined {
  return matches.findLast(({ first }) => first <= rally);
}

/** Date, event and players of a match. */
function matchName({ title, names, date }: RecordedMatch): string {
  return `${date ? `${date} · ` : ""}${title} · ${names.map(displayName).join(say("page.versus"))}`;
}

export class RallyBrowser {
  readonly element = h("section", { class: "panel browser hidden", "aria-label": say("page.match_rallies") });
  private list = h("ol");
  private readonly files = new Map([
    ["report", h("a", { target: "_blank", rel: "noopener" }, say("page.report"))],
    ["strokes.csv", h("a", { download: "" }, say("page.as_csv"))],
    ["strokes.parquet", h("a", { download: "" }, say("page.as_parquet"))],
  ]);
  private match: MatchReply | null = null;
  private readonly picker: HTMLElement | null;

  /** @param live whether the page has a server, which makes match reports. */
  constructor(
    private readonly open: (rally: number) => void,
    private readonly live: boolean,
    private readonly matches: RecordedMatch[],
  ) {
    const picker = h("input", {
      type: "search",
      list: "matches",
      placeholder: say("page.find", { count: matches.length }),
      "aria-label": say("page.find_match"),
      onchange: () => {
        const found = matches.find((one) => matchName(one) === picker.value);
        if (found) {
          picker.value = "";
          this.open(found.first);
        }
      },
    });
    const newest = [...matches].sort((a, b) => (b.date ?? "").localeCompare(a.date ?? ""));
    const names = h("datalist", { id: "matches" }, ...newest.map((one) => h("option", { value: matchName(one) })));
    this.picker = matches.length > 1 ? h("div", { class: "picker" }, picker, names) : null;
  }

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
            h(
              "span",
              {},
              say("page.game_points", { game: rally.games[0] + rally.games[1] + 1, points: rally.points.join("–") }),
            ),
            h("span", { class: "quiet" }, `${rally.strokes} · ±${percent(rally.swing)}`),
          ),
        ),
      );
      this.list = h("ol", {}, ...rows);
      const missing = matchOf(this.matches, current)?.missing ?? 0;
      replaceChildren(
        this.element,
        this.picker,
        h("h2", {}, term("rallies", say("term.rallies")), h("span", {}, say("page.swing"))),
        missing > 0 && h("p", { class: "quiet" }, say(missing > 1 ? "page.missing" : "page.missing_one", { count: missing })),
        this.list,
        this.live && h("p", { class: "files" }, ...this.files.values()),
      );
    }
    for (const [name, link] of this.files) {
      link.href = `${name}?rally=${current + 1}${name === "report" ? `&language=${language}` : ""}`;
    }
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
