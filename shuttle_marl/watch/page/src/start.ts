// The card of the first visit: three ways to begin, each one click.

import { h } from "./dom";
import type { Mode } from "./layout";

const CHOICES: [Mode, string, string][] = [
  ["watch", "Watch a rally", "Two players in 3D, with the chance of every stroke."],
  ["learn", "Find the better shot", "The rally stops before a mistake. What would you play?"],
  ["play", "Play one", "Choose shots and targets against an opponent."],
];

export type Choice = Mode | "daily" | "duel";

/** Opens the card; closing it watches the rally. */
export function openStartCard(choose: (choice: Choice) => void): void {
  const pick = (choice: Choice) => {
    element.close();
    choose(choice);
  };
  const element: HTMLDialogElement = h(
    "dialog",
    { class: "start", "aria-label": "Welcome" },
    h("h2", {}, "Badminton, learned from real matches"),
    h("p", { class: "quiet" }, "Every stroke on this court has a known chance of success, and the game is solved exactly."),
    h(
      "div",
      { class: "choices" },
      ...CHOICES.map(([mode, name, about]) =>
        h("button", { onclick: () => pick(mode) }, h("b", {}, name), h("span", { class: "quiet" }, about)),
      ),
    ),
    h(
      "div",
      { class: "row" },
      h("button", { onclick: () => pick("daily") }, "Rally of the day: five puzzles"),
      h("button", { onclick: () => pick("duel") }, "Duel with a strong player, to 3 points"),
    ),
  );
  element.addEventListener("close", () => element.remove());
  document.body.append(element);
  element.showModal();
}
