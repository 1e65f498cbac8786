// Where players wait: the positions on the court, and the pad on which a person chooses theirs.

import { type Child, h, percent, replaceChildren, sideColour, signed } from "./dom";
import { hurriedTag, term } from "./glossary";
import { facing } from "./hall";
import { displayName, nameAt } from "./names";
import type { Analysis, HallFacts, Place, RallyFacts, Turn } from "./wire.gen";
import { type Key, listed, points, say, words } from "./words";

/** Positions as the player who waits sees them, the net above, by their hand; a position is named by the side of the forehand. */
const GRID = { right: [2, 1, 0, 5, 4, 3, 8, 7, 6], left: [0, 1, 2, 3, 4, 5, 6, 7, 8] } as const;
/** Keys of nine places, as they lie on a keypad. */
export const KEYPAD = [7, 8, 9, 4, 5, 6, 1, 2, 3];

/** Signs of x and y between the frame of a player, mirrored for a left-hander, and that of the court. */
function signs(rally: RallyFacts, seat: number): [number, number] {
  const sign = facing(rally, seat);
  return [rally.players[seat]!.hand === "left" ? -sign : sign, sign];
}

/** Place on the court where a player stands who waits in a position. */
export function placeOf(hall: HallFacts, rally: RallyFacts, seat: number, position: number): [number, number] {
  const [sx, sy] = signs(rally, seat);
  const [x, y] = hall.positions[position]!.place;
  return [sx * x, sy * y];
}

/** Extent of a position on the court: x0, x1, y0, y1. */
export function boxOf(hall: HallFacts, rally: RallyFacts, seat: number, position: number): [number, number, number, number] {
  const [sx, sy] = signs(rally, seat);
  const [[x0, x1], [y0, y1]] = hall.positions[position]!.box;
  const [xs, ys] = [
    [sx * x0, sx * x1],
    [sy * y0, sy * y1],
  ];
  return [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
}

/** A position in a few words. */
export function positionWords(hall: HallFacts, position: number): string {
  return words(hall.areas[position]!.name);
}

/** Feasible position that contains a point of the court; undefined: none. */
export function positionAt(hall: HallFacts, rally: RallyFacts, seat: number, feasible: number[], x: number, y: number) {
  return feasible.find((position) => {
    const [x0, x1, y0, y1] = boxOf(hall, rally, seat, position);
    return x0 <= x && x <= x1 && y0 <= y && y <= y1;
  });
}

/** Buttons of the nine positions as the player who waits sees them. */
export function positionGrid(
  hall: HallFacts,
  rally: RallyFacts,
  seat: number,
  feasible: number[],
  cell: (position: number, key: number) => { props: Record<string, string | ((event: Event) => void)>; small: Child },
): HTMLElement {
  const order = GRID[rally.players[seat]!.hand as keyof typeof GRID];
  const buttons = order.map((position, place) => {
    const name = positionWords(hall, position);
    if (!feasible.includes(position)) {
      return h("button", { disabled: true }, h("span", { "aria-label": `${name}: ${say("recover.infeasible")}` }, "–"));
    }
    const { props, small } = cell(position, KEYPAD[place]!);
    return h("button", { "data-position": position, ...props }, name, h("small", {}, small));
  });
  return h("div", { class: "targets recover", role: "group", "aria-label": say("recover.about") }, ...buttons);
}

export interface PadHooks {
  wait(position: number): void;
  perfect(): Promise<number[]>;
  aim(box: [number, number, number, number] | null): void;
  paint(boxes: [number, number, number, number][]): void;
}

/** The choice of a position, while the opponent strikes. */
export class Pad {
  position = 0;
  private turn: Turn | null = null;
  private rally: RallyFacts | null = null;
  private perfect: number[] = [];

  constructor(
    private readonly element: HTMLElement,
    private readonly hall: HallFacts,
    private readonly hooks: PadHooks,
  ) {}

  /** Offers the feasible positions; the one that people choose most often is selected, and a key or a click waits in another. */
  show(turn: Turn, rally: RallyFacts): void {
    this.turn = turn;
    this.rally = rally;
    this.perfect = [];
    this.select(turn.positions.indexOf(Math.max(...turn.positions)));
    this.hooks.paint(this.feasible.map((position) => boxOf(this.hall, rally, turn.seat, position)));
    (this.element.querySelector("[aria-pressed=true]") as HTMLElement | null)?.focus({ preventScroll: true });
  }

  private select(position: number): void {
    if (this.turn?.positions[position]) {
      this.position = position;
      this.draw();
      this.hooks.aim(boxOf(this.hall, this.rally!, this.turn.seat, position));
    }
  }

  private get feasible(): number[] {
    return this.turn!.positions.flatMap((share, position) => (share ? position : []));
  }

  private draw(): void {
    const { seat, height, hurried, positions } = this.turn!;
    const focused = (document.activeElement as HTMLElement | null)?.dataset["key"];
    const shares = this.perfect.length ? this.perfect : positions;
    const grid = positionGrid(this.hall, this.rally!, seat, this.feasible, (position, key) => ({
      props: {
        "aria-pressed": String(position === this.position),
        "data-key": `position ${position}`,
        onclick: () => this.hooks.wait(position),
        // By a key only: drawn anew under the pointer, the button would get no click.
        onfocus: ({ target }) =>
          position !== this.position && (target as Element).matches(":focus-visible") && this.select(position),
        onpointerenter: () => this.hooks.aim(boxOf(this.hall, this.rally!, seat, position)),
      },
      small: h("span", {}, h("kbd", {}, String(key)), ` ${percent(shares[position]!)}`),
    }));
    replaceChildren(
      this.element,
      h(
        "h2",
        {},
        term("recover", say("recover.label")),
        h(
          "span",
          {},
          listed([displayName(this.rally!.names[1 - seat]!), say(`from_net.${height}` as Key)]),
          hurried && say("language.comma"),
          hurriedTag(hurried),
        ),
      ),
      grid,
      h(
        "div",
        { class: "row" },
        h("button", { "data-key": "hint", onclick: () => void this.ask() }, say("board.hint"), h("kbd", {}, "i")),
        h("span", { role: "status" }, say(this.perfect.length ? "recover.perfect" : "recover.people")),
        h(
          "button",
          { class: "hit", "data-key": "hit", onclick: () => this.hooks.wait(this.position) },
          say("recover.wait"),
          h("kbd", {}, "Enter"),
        ),
      ),
    );
    this.element.style.setProperty("--mine", sideColour(seat));
    if (focused) {
      (this.element.querySelector(`[data-key="${CSS.escape(focused)}"]`) as HTMLElement | null)?.focus({ preventScroll: true });
    }
  }

  private async ask(): Promise<void> {
    const { turn } = this;
    const perfect = await this.hooks.perfect();
    if (turn === this.turn && this.element.querySelector(".recover")) {
      this.perfect = perfect;
      this.draw();
    }
  }

  /** Points at the position that contains a point of the court; `wait`: waits there. */
  pointAt(x: number, y: number, wait: boolean): void {
    const position = positionAt(this.hall, this.rally!, this.turn!.seat, this.feasible, x, y);
    if (position !== undefined && wait) {
      this.hooks.wait(position);
    } else if (position !== undefined && position !== this.position) {
      this.select(position);
    }
  }

  key(key: string): boolean {
    if (key === "Enter") {
      this.hooks.wait(this.position);
    } else if (key === "i") {
      void this.ask();
    } else if (/^[1-9]$/.test(key)) {
      const order = GRID[this.rally!.players[this.turn!.seat]!.hand as keyof typeof GRID];
      const position = order[KEYPAD.indexOf(Number(key))]!;
      if (this.turn!.positions[position]) {
        this.hooks.wait(position);
      }
    } else {
      return false;
    }
    return true;
  }
}

/** Where the receiver of a stroke could wait, and what each position costs. */
export class PlacePanel {
  readonly element = h("section", { class: "panel detail", "aria-label": say("recover.panel") });

  /** @param tryOut plays on with the receiver at another position; null: this page cannot. */
  constructor(
    private readonly hall: HallFacts,
    private readonly tryOut: ((position: number) => void) | null,
  ) {}

  show(rally: RallyFacts, index: number, analysis: Analysis | null): void {
    const stroke = rally.strokes[index];
    const { places, open } = analysis?.strokes[index] ?? {};
    this.element.classList.toggle("hidden", !stroke || !places);
    if (!stroke || !places) {
      this.element.replaceChildren();
      return;
    }
    const row = ({ position, people, perfect, loss, win }: Place) => {
      const [name, here, { tryOut }] = [positionWords(this.hall, position), position === stroke.waited, this];
      const able = tryOut && !here && stroke.waited !== null; // positions of the rally so far must be known
      return h(
        "tr",
        { class: `${here ? "chosen " : ""}${perfect >= 0.5 ? "best" : ""}` },
        h(
          "td",
          {},
          h(
            able ? "button" : "div",
            able
              ? { class: "try", onclick: () => tryOut(position), title: say("page.what_if", { stroke: name }) }
              : { class: "try" },
            h("i", { style: `width:${100 * perfect}%` }),
            h("span", {}, name),
          ),
        ),
        ...[percent(people), percent(perfect), points(loss), points(win)].map((text) => h("td", {}, text)),
      );
    };
    const heads = [this.tryOut ? "page.click" : "recover.position", "recover.of_people", "recover.of_perfect"] as const;
    replaceChildren(
      this.element,
      h("h2", {}, term("places", say("recover.panel_of", { name: nameAt(rally.names, 1 - stroke.seat) }))),
      h(
        "table",
        { class: "options" },
        h(
          "thead",
          {},
          h(
            "tr",
            {},
            ...heads.map((key) => h("th", { scope: "col" }, say(key))),
            h("th", { scope: "col" }, say("recover.loses")),
            h("th", { scope: "col" }, say("recover.striker")),
          ),
        ),
        h("tbody", {}, ...places.map(row)),
      ),
      open &&
        h("p", {}, say("recover.open", { stroke: `${words(open.shot)} → ${words(open.area)}`, share: signed(open.gain) })),
    );
  }
}
