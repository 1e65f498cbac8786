// The card of the first visit, beside a rally that runs: one thing to do, and others as lines.

import { rung } from "./decisions";
import { h } from "./dom";
import { icon } from "./icons";
import type { Mode } from "./layout";
import { displayName, shown } from "./names";
import { say } from "./words";

/** A mode, a game with a friend, or a duel with an opponent of the ladder, by its number. */
export type Choice = Mode | "friend" | number;

/**
 * The card; it goes once something is chosen.
 * @param names of those who play.
 * @param ladder opponents of duels.
 * @param points points that win a duel.
 */
export function startCard(
  names: [string, string],
  ladder: string[],
  points: number,
  choose: (choice: Choice) => void,
): HTMLElement {
  const pick = (choice: Choice) => {
    element.remove();
    choose(choice);
  };
  const opponents = ladder.map((policy, i) => h("option", { value: i }, `${i + 1} ${displayName(policy)}`));
  const opponent = h("select", { "aria-label": say("start.opponent") }, ...opponents);
  opponent.value = String(rung(ladder.length));
  const close = h(
    "button",
    { class: "close", "aria-label": say("report.close"), onclick: () => element.remove() },
    icon("close"),
  );
  const element = h(
    "section",
    { class: "start", "aria-label": say("start.welcome") },
    close,
    h("h2", {}, shown(displayName(names[0])), say("page.versus"), shown(displayName(names[1]))),
    h("p", {}, say("start.heading")),
    h("button", { class: "strong", onclick: () => pick("learn") }, say("start.learn")),
    h("span", {}, h("button", { onclick: () => pick(Number(opponent.value)) }, say("start.duel", { points })), opponent),
    h("button", { onclick: () => pick("friend") }, say("friend.title")),
  );
  return element;
}
