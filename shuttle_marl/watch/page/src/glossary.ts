// Terms that the page explains, each in one sentence: on hover, focus and tap.

import { h } from "./dom";

const SENTENCES = {
  in: "P(success): probability that the stroke passes the net and lands in, given the state of the rally.",
  "comes back": "P(returned): probability that the opponent returns the stroke if it is good.",
  variety:
    "Temperature of the policy: 1 plays as trained, 0 always plays the most probable stroke, above 1 plays more at random.",
  strength: "Exact share of rallies that this player wins against the average pro.",
  "win probability": "Probability that side A wins the rally if both players continue as they play. Click to seek.",
  change:
    "Probability of winning the rally with this stroke, minus that with what elite players choose here, if both play strongly afterwards. Empty: too few real strokes.",
  "as they play": "Exact probability that the striker wins the rally with this stroke if both players continue as they play.",
  "strong play":
    "Probability that the striker wins the rally with this stroke if both play like strong people afterwards, as far as real matches confirm it.",
  "perfect play":
    "Exact probability that the striker wins the rally with this stroke if both players play perfectly afterwards.",
  share: "Probability with which the average pro chooses this stroke here; both contacts with the shuttle are counted.",
  "pros win": "Exact probability that the striker wins the rally with this stroke if both go on like the average pro.",
  real: "Number of real strokes behind the probabilities of this stroke.",
  chosen: "Probability with which the player chooses this stroke.",
  loss: "Probability of winning the rally that the stroke loses to the best one if both players play strongly afterwards.",
  "target areas": "Where the player aims with any stroke in this state [%]; the line is the flight of the stroke played.",
  style: "Exact statistics of both players against each other; the ticks are two average pros against each other.",
  "shot mix": "Share of each shot among all strokes of a player; the ticks are average pros.",
  "better stroke":
    "The best of the answers if both play strongly afterwards. Real players played each of them at least 20 times.",
  "your stroke": "Choose shot, target and technique, then hit. Only strokes that the game allows here are listed.",
  target: "Percentages are the probability that the stroke is in; after a hint, the probability of winning the rally.",
  hurried: "Late or stretched: the hardest quarter of such situations.",
  words: "Every stroke as a sentence, for reading and for screen readers.",
  accuracy: "Share of the judged strokes without ?!, ? and ??. Elite players in real matches have 94 %.",
  rallies:
    "Rallies of this match: winner, score before, number of strokes, and the largest change of the probability of winning by one stroke.",
  match: "Probability that side A wins the match, before each rally. Click a rally to open it.",
} as const;

export type Term = keyof typeof SENTENCES;

const tip = h("p", { class: "tip hidden", role: "tooltip", id: "tip" });
let owner: HTMLElement | null = null;

function show(button: HTMLElement, sentence: string): void {
  owner = button;
  tip.textContent = sentence;
  (button.closest("dialog") ?? document.body).append(tip);
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
export function term(name: Term, label: string = name): HTMLElement {
  const sentence = SENTENCES[name];
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
  return hurried ? h("span", { class: "tag", title: SENTENCES.hurried }, "hurried") : null;
}

document.addEventListener("scroll", () => hideTip(), { capture: true, passive: true });
