// The rallies of a recorded match, to choose from.

import { h, percent, replaceChildren } from "./dom";
import { term } from "./glossary";
import { displayName } from "./names";
import type { MatchRally, MatchReply, RecordedMatch } from "./wire.gen";
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
  readonly element = h("section", { class: "panel browser", "aria-label": say("page.match_rallies") });
  private list = h("ol");
  private readonly report = h("a", { target: "_blank", rel: "noopener" }, say("page.report"));
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
    replaceChildren(this.element, this.picker, h("p", { class: "quiet" }, say("page.computing_style")));
  }

  /** A rally; of those that are not played yet, nothing but the number is told. */
  private row(rally: MatchRally, current: number, all: boolean): HTMLElement {
    const { number, winner, games, points, strokes, swing } = rally;
    const [begun, played] = [all || number <= current, all || number < current];
    const score = begun ? say("page.game_points", { game: games[0] + games[1] + 1, points: points.join("–") }) : "";
    return h(
      "li",
      {},
      h(
        "button",
        { onclick: () => this.open(number), "data-rally": number },
        h("b", { class: played && winner ? "b" : "a" }, played ? "AB"[winner]! : ""),
        h("span", {}, score || say("page.rally_number", { number: number + 1 })),
        h("span", { class: "quiet" }, played ? `${strokes} · ±${percent(swing)}` : ""),
      ),
    );
  }

  /**
   * @param match the match; null: as before.
   * @param current number of the rally on the court.
   * @param all whether all rallies are told; else those before the current one.
   * @param over whether nothing more is known of the match.
   */
  show(match: MatchReply | null, current: number, all: boolean, over = false): void {
    if (over && !match?.rallies.length) {
      replaceChildren(this.element, this.picker);
    }
    this.match = match?.rallies.length ? match : this.match;
    if (this.match) {
      this.list = h("ol", {}, ...this.match.rallies.map((rally) => this.row(rally, current, all)));
      const missing = matchOf(this.matches, current)?.missing ?? 0;
      replaceChildren(
        this.element,
        this.picker,
        h("h2", {}, term("rallies", say("term.rallies")), h("span", {}, say("page.swing"))),
        h("p", { class: "quiet" }, say("page.restaged")),
        missing > 0 && h("p", { class: "quiet" }, say(missing > 1 ? "page.missing" : "page.missing_one", { count: missing })),
        this.list,
        this.live && this.report,
      );
    }
    this.report.href = `report?rally=${current + 1}&language=${language}`;
    for (const button of this.list.querySelectorAll("button")) {
      if (button.dataset["rally"] === String(current)) {
        button.setAttribute("aria-current", "true");
        this.element.scrollTop = button.offsetTop - this.element.clientHeight / 2;
      }
    }
  }
}
