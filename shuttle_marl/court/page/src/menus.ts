// Menus and dialogs of the page.

import { type Child, h } from "./dom";
import { say } from "./words";

/** Closes an open `<details>` menu on Escape and on a click outside. */
export function menu(name: Child, ...items: Child[]): HTMLDetailsElement {
  const summary = h("summary", { class: "button" }, name);
  const element = h("details", { class: "menu" }, summary, h("div", {}, ...items));
  document.addEventListener("pointerdown", (event) => {
    if (!element.contains(event.target as Node)) {
      element.open = false;
    }
  });
  element.addEventListener("keydown", (event) => {
    if (event.key === "Escape" && element.open) {
      element.open = false;
      summary.focus();
      event.stopPropagation();
    }
  });
  element.addEventListener("click", (event) => {
    if ((event.target as HTMLElement).closest("div button")) {
      element.open = false;
    }
  });
  return element;
}

export function dialog(name: string, content: HTMLElement, ...buttons: HTMLElement[]): HTMLDialogElement {
  const close = h("button", { onclick: () => element.close() }, say("report.close"));
  const element: HTMLDialogElement = h(
    "dialog",
    { "aria-label": name },
    h("h2", {}, name),
    content,
    h("div", { class: "row" }, ...buttons, close),
  );
  return element;
}

/** Asks for a confirmation; calls `act` after a yes. */
export function confirmed(question: string, consequence: string, yes: string, act: () => void): void {
  const element = dialog(
    question,
    h("p", {}, consequence),
    h(
      "button",
      {
        autofocus: true,
        onclick: () => {
          element.close();
          act();
        },
      },
      yes,
    ),
  );
  element.addEventListener("close", () => element.remove());
  document.body.append(element);
  element.showModal();
}
