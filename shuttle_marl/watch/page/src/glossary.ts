// Terms that the page explains, each in one sentence: on hover, focus and tap.

import { h } from "./dom";
import { type Key, say } from "./words";

export type Term = keyof typeof import("../../../reports/languages/en.json").glossary;

const tip = h("p", { class: "tip hidden", role: "tooltip", id: "tip" });
let owner: HTMLElement | null = null;

function show(button: HTMLElement, sentence: string): void {
  owner = button;
  tip.textContent = sentence;
  (button.closest("dialog, main") ?? document.body).append(tip);
  tip.classList.remove("hidden");
  const [at, size] = [button.getBoundingClientRect(), tip.getBoundingClientRect()];
  const below = at.bottom + 6 + size.height < innerHeight;
  tip.style.left = `${Math.max(6, Math.min(at.left, innerWidth - size.width - 6))}px`;
  tip.style.top = `${below ? at.bottom + 6 : Math.max(6, at.top - size.height - 6)}px`;
}

/** Hides the sentence that is shown; returns whether there was one. */
export function hideTip(): boolean {
  const was = owner !== null;
  owner = null;
  tip.classList.add("hidden");
  return was;
}

/** A term with its sentence. */
export function term(name: Term, label: string = say(`term.${name}` as Key)): HTMLElement {
  const sentence = say(`glossary.${name}`);
  const button: HTMLElement = h(
    "button",
    {
      class: "why",
      type: "button",
      "aria-label": `${label}: ${sentence}`,
      onclick: () => (owner === button ? hideTip() : show(button, sentence)),
      onpointerenter: (event) => (event as PointerEvent).pointerType === "mouse" && show(button, sentence),
      onpointerleave: (event) => (event as PointerEvent).pointerType === "mouse" && hideTip(),
      onblur: () => hideTip(),
    },
    label,
  );
  return button;
}

/** The word "hurried", with its sentence on hover: for places where a term could not be focused. */
export function hurriedTag(hurried: boolean): HTMLElement | null {
  return hurried ? h("span", { class: "tag", title: say("glossary.hurried") }, say("term.hurried")) : null;
}

document.addEventListener("scroll", () => hideTip(), { capture: true, passive: true });
