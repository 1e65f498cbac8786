// Selection of both players, and bars of their playing styles.

import { h, percent, replaceChildren, sideColour } from "./dom";
import { term } from "./glossary";
import { displayName, grouped, handTag } from "./names";
import type { Side, Styles } from "./wire.gen";
import { decimal, type Key, say, words } from "./words";

export class SideCard {
  readonly element: HTMLElement;
  private readonly select: HTMLSelectElement;
  private readonly slider: HTMLInputElement;
  private readonly output = h("output");
  private readonly take: HTMLButtonElement;
  private readonly identifier = h("code", {});
  private readonly strength = h("span");
  private readonly half = h("b");
  private readonly meter = h("span", { class: "meter" });

  constructor(seat: number, policies: string[], change: (side: Side) => void, takeOver: () => void) {
    const name = "AB"[seat]!;
    this.select = h(
      "select",
      { "aria-label": say("page.player_of", { side: name }) },
      ...grouped(policies).map(([group, members]) =>
        h("optgroup", { label: group }, ...members.map((policy) => h("option", { value: policy }, displayName(policy)))),
      ),
    );
    this.slider = h("input", {
      type: "range",
      min: 0,
      max: 2,
      step: 0.1,
      value: 1,
      "aria-label": say("page.variety_of", { side: name }),
    });
    const changed = () => {
      this.output.textContent = label(Number(this.slider.value));
      change({ policy: this.select.value, temperature: Number(this.slider.value) });
    };
    this.select.addEventListener("change", changed);
    this.slider.addEventListener("change", changed);
    this.slider.addEventListener("input", () => (this.output.textContent = label(Number(this.slider.value))));
    this.take = h(
      "button",
      { class: "take", onclick: takeOver, "aria-pressed": "false" },
      h("span", {}, say("page.take_over")),
      h("kbd", {}, seat ? "T" : "t"),
    );
    this.element = h(
      "section",
      { class: "panel side", style: `--mine:${sideColour(seat)}`, "aria-label": say("page.side", { side: name }) },
      h("h2", {}, h("span", {}, say("page.side", { side: name })), this.half),
      this.select,
      h("p", { class: "identifier" }, this.identifier, this.strength),
      this.meter,
      h("div", { class: "variety" }, term("variety"), this.slider, this.output),
      this.take,
    );
  }

  /** @param near whether the player is at the near end. */
  show(side: Side, near: boolean, person: boolean, hand: string): void {
    replaceChildren(this.half, say(near ? "page.near" : "page.far"), handTag(hand));
    if (![...this.select.options].some((option) => option.value === side.policy)) {
      this.select.append(h("option", { value: side.policy }, displayName(side.policy)));
    }
    this.select.value = side.policy;
    this.identifier.textContent = side.policy;
    this.slider.value = String(side.temperature);
    this.output.textContent = label(side.temperature);
    if (person) {
      this.identifier.textContent = say("page.replaces", { policy: side.policy });
    }
    this.take.setAttribute("aria-pressed", String(person));
    this.take.firstElementChild!.textContent = say(person ? "page.hand_back" : "page.take_over");
  }

  /** Shows the share of rallies that the player wins against the average pro; null: it is being computed. */
  showStrength(share: number | null): void {
    const known = share !== null && term("strength", say("term.strength", { share: percent(share) }));
    replaceChildren(this.strength, known || say("page.computing_style"));
    replaceChildren(this.meter, h("i", { style: `width:${100 * (share ?? 0)}%;background:var(--mine)` }));
  }
}

function label(temperature: number): string {
  return temperature === 0 ? say("page.none") : decimal(temperature, 1);
}

function bar(
  name: string,
  values: [number, number],
  reference: number | null,
  most: number,
  text: (value: number) => string,
): HTMLElement {
  const width = (value: number) => `${Math.min(100, (100 * value) / most)}%`;
  const tick = (edge: string) => (reference === null ? null : h("u", { style: `${edge}:${width(reference)}` }));
  return h(
    "div",
    { class: "bar" },
    h("span", { class: "name" }, name),
    h("span", { class: "a" }, text(values[0])),
    h("span", { class: "left" }, h("i", { style: `width:${width(values[0])}` }), tick("right")),
    h("span", { class: "right" }, h("i", { style: `width:${width(values[1])}` }), tick("left")),
    h("span", { class: "b" }, text(values[1])),
  );
}

export class StylePanel {
  readonly element = h("section", { class: "panel styles", "aria-label": say("page.styles") });

  constructor() {
    this.show(null);
  }

  show(styles: Styles | null): void {
    if (!styles) {
      replaceChildren(this.element, h("h2", {}, say("term.style")), h("p", { class: "quiet" }, say("page.computing_style")));
      return;
    }
    const most = Math.max(...styles.shots.flatMap(({ values, reference }) => [...values, reference ?? 0]));
    replaceChildren(
      this.element,
      h("h2", {}, term("style", say("term.style")), h("span", {}, "A | B")),
      h(
        "div",
        { class: "bars" },
        ...styles.figures.map(({ name, values, reference }) =>
          bar(say(`style.${name}` as Key), values, reference, Math.max(...values, reference ?? 0, 1e-9), percent),
        ),
      ),
      h(
        "h3",
        { style: "margin-top:10px" },
        term("shot mix", say("term.mix")),
        h("span", { style: "color:var(--gold)" }, say("page.average")),
      ),
      h(
        "div",
        { class: "bars" },
        ...styles.shots.map(({ name, values, reference }) => bar(words(name), values, reference, most, percent)),
      ),
    );
  }
}
