// The card of the first visit: three ways to begin, each one click.

import { h } from "./dom";
import type { Mode } from "./layout";
import { say } from "./words";

const CHOICES = ["watch", "learn", "play"] as const;

export type Choice = Mode | "daily" | "duel";

/** Opens the card; closing it watches the rally. */
export function openStartCard(choose: (choice: Choice) => void): void {
  const pick = (choice: Choice) => {
    element.close();
    choose(choice);
  };
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
      h("button", { onclick: () => pick("duel") }, say("start.duel")),
    ),
  );
  element.addEventListener("close", () => element.remove());
  document.body.append(element);
  element.showModal();
}
