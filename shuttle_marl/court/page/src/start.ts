// The card of the first visit: ways to begin, each one click.

import { rung } from "./decisions";
import { h } from "./dom";
import { languageMenu, type Mode } from "./layout";
import { opponentName } from "./names";
import { say } from "./words";

const CHOICES = ["watch", "learn", "play"] as const;

/** A mode, the puzzles of the day, a game with a friend, or a duel with an opponent of the ladder, by its number. */
export type Choice = Mode | "daily" | "friend" | number;

/**
 * Opens the card; closing it watches the rally.
 * @param ladder opponents of duels.
 * @param points points that win a duel.
 */
export function openStartCard(ladder: string[], points: number, choose: (choice: Choice) => void): void {
  const pick = (choice: Choice) => {
    element.close();
    choose(choice);
  };
  const names = ladder.map((policy, i) => h("option", { value: i }, `${i + 1} ${opponentName(policy)}`));
  const opponent = h("select", { "aria-label": say("start.opponent") }, ...names);
  opponent.value = String(rung(ladder.length));
  const element: HTMLDialogElement = h(
    "dialog",
    { class: "start", "aria-label": say("start.welcome") },
    h("h2", {}, say("start.heading")),
    h("p", { class: "quiet" }, say("start.about")),
    h(
      "div",
      { class: "choices" },
      ...CHOICES.map((mode) =>
        h(
          "button",
          { onclick: () => pick(mode) },
          h("b", {}, say(`start.${mode}`)),
          h("span", { class: "quiet" }, say(`start.${mode}_about`)),
        ),
      ),
    ),
    h(
      "div",
      { class: "row" },
      h("button", { onclick: () => pick("daily") }, say("start.daily")),
      h("span", {}, opponent, h("button", { onclick: () => pick(Number(opponent.value)) }, say("start.duel", { points }))),
      h("button", { onclick: () => pick("friend") }, say("friend.title")),
      languageMenu(),
    ),
  );
  element.addEventListener("close", () => element.remove());
  document.body.append(element);
  element.showModal();
}
