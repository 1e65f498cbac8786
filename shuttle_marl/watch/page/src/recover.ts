// Where players wait: the positions on the court, and the pad on which a person chooses theirs.

import { h, percent, replaceChildren, sideColour } from "./dom";
import { hurriedTag, term } from "./glossary";
import { facing } from "./hall";
import { displayName } from "./names";
import type { HallFacts, RallyFacts, Turn } from "./wire.gen";
import { type Key, listed, say, words } from "./words";

/** Positions as the player who waits sees them, the net above, by their hand; a position is named by the side of the forehand. */
const GRID = { right: [2, 1, 0, 5, 4, 3, 8, 7, 6], left: [0, 1, 2, 3, 4, 5, 6, 7, 8] } as const;
const KEYPAD = [7, 8, 9, 4, 5, 6, 1, 2, 3];

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
function boxOf(hall: HallFacts, rally: RallyFacts, seat: number, position: number): [number, number, number, number] {
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

export interface PadHooks {
  wait(position: number): void;
  perfect(): Promise<number[]>;
  aim(box: [number, number, number, number] | null): void;
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

  /** Offers the feasible positions; the one that people choose most often is selected. */
  show(turn: Turn, rally: RallyFacts): void {
    this.turn = turn;
    this.rally = rally;
    this.perfect = [];
    this.select(turn.positions.indexOf(Math.max(...turn.positions)));
    (this.element.querySelector("[aria-pressed=true]") as HTMLElement | null)?.focus({ preventScroll: true });
  }

  private select(position: number): void {
    if (this.turn?.positions[position]) {
      this.position = position;
      this.draw();
      this.hooks.aim(boxOf(this.hall, this.rally!, this.turn.seat, position));
    }
  }

  private get order(): readonly number[] {
    return GRID[this.rally!.players[this.turn!.seat]!.hand as keyof typeof GRID];
  }

  private draw(): void {
    const { seat, height, hurried, positions } = this.turn!;
    const focused = (document.activeElement as HTMLElement | null)?.dataset["key"];
    const shares = this.perfect.length ? this.perfect : positions;
    const buttons = this.order.map((position, place) => {
      const name = positionWords(this.hall, position);
      return h(
        "button",
        {
          disabled: !positions[position],
          "aria-pressed": String(position === this.position),
          "data-key": `position ${position}`,
          onclick: () => this.select(position),
        },
        positions[position] ? name : h("span", { "aria-label": `${name}: ${say("recover.infeasible")}` }, "–"),
        positions[position] ? h("small", {}, h("kbd", {}, String(KEYPAD[place])), ` ${percent(shares[position]!)}`) : null,
      );
    });
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
      h("div", { class: "targets recover", role: "group", "aria-label": say("recover.about") }, ...buttons),
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

  /** Selects the position that contains a point of the court. */
  aimAt(x: number, y: number): void {
    const { rally, turn } = this;
    const found = this.hall.positions.findIndex((_, position) => {
      const [x0, x1, y0, y1] = boxOf(this.hall, rally!, turn!.seat, position);
      return x0 <= x && x <= x1 && y0 <= y && y <= y1;
    });
    this.select(found);
  }

  key(key: string): boolean {
    if (key === "Enter") {
      this.hooks.wait(this.position);
    } else if (key === "i") {
      void this.ask();
    } else if (/^[1-9]$/.test(key)) {
      this.select(this.order[KEYPAD.indexOf(Number(key))]!);
    } else {
      return false;
    }
    return true;
  }
}
