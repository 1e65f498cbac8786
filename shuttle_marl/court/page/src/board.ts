// The board of a person who plays: legal strokes, targets, techniques.

import { h, percent, replaceChildren, sideColour } from "./dom";
import { term } from "./glossary";
import { KEYPAD, Pad } from "./recover";
import type { HallFacts, Option, OptionsReply, RallyFacts, Turn, TurnStroke } from "./wire.gen";
import { type Key, listed, say, words } from "./words";

const KEYS: Record<string, string> = {
  "short-serve": "s",
  "long-serve": "g",
  clear: "c",
  lift: "l",
  drop: "d",
  smash: "s",
  "half-smash": "a",
  drive: "v",
  push: "p",
  "net-kill": "k",
  "net-shot": "n",
  block: "b",
  "cross-court-net-shot": "x",
};

/** Places of the areas, by the hand of the receiver: an area is named by the side of the forehand. */
const GRID = { right: [6, 7, 8, 3, 4, 5, 0, 1, 2], left: [8, 7, 6, 5, 4, 3, 2, 1, 0] } as const;

const REACH = 0.8; // how far beside an area a click still aims at it [m]

type Box = [number, number, number, number];

export interface BoardHooks {
  /** Plays a stroke, or waits in a position, as the turn asks. */
  choose(choice: number): void;
  hints(): Promise<OptionsReply>;
  aim(box: Box | null): void;
  /** Paints the areas that may be chosen. */
  paint(boxes: Box[]): void;
}

export class Board {
  readonly element = h("section", { class: "panel board hidden", "aria-label": say("board.label") });
  turn: Turn | null = null;
  private shot = "";
  private area = "";
  private technique = "";
  /** Areas as the striker sees the other half: far ones above, their own left on the left. */
  private order: readonly number[] = GRID.right;
  private values = new Map<number, Option>();
  private readonly pad: Pad;
  /** Beside the pointer: the stroke that a click plays. */
  private readonly label = h("p", { class: "label hidden", "aria-hidden": "true" });

  constructor(
    private readonly hall: HallFacts,
    private readonly hooks: BoardHooks,
  ) {
    this.pad = new Pad(this.element, hall, {
      wait: (position) => hooks.choose(position),
      perfect: async () => (await hooks.hints()).positions,
      aim: (box) => hooks.aim(box),
      paint: (boxes) => hooks.paint(boxes),
    });
    document.body.append(this.label);
  }

  /** Offers the choices of a turn of a rally; null: none. */
  show(turn: Turn | null, rally: RallyFacts | null = null): void {
    if (turn === this.turn) {
      return;
    }
    this.turn = turn;
    this.values.clear();
    this.label.classList.add("hidden");
    if (turn?.positions.length) {
      this.pad.show(turn, rally!);
    } else if (turn) {
      this.order = GRID[rally!.players[1 - turn.seat]!.hand as keyof typeof GRID];
      this.shot = this.area = this.technique = "";
      this.draw();
      (this.element.querySelector(".shots button:not(:disabled)") as HTMLElement | null)?.focus({ preventScroll: true });
    } else {
      this.hooks.aim(null);
      this.hooks.paint([]);
      this.wait();
    }
  }

  /** Whether a person plays: then the board stays, so that nothing moves between two strokes. */
  set playing(on: boolean) {
    this.element.classList.toggle("hidden", !on);
    if (on && !this.element.hasChildNodes()) {
      this.wait();
    }
  }

  private wait(): void {
    const height = this.element.offsetHeight;
    this.element.style.minHeight = height ? `${height}px` : "";
    this.say(say(document.body.classList.contains("friend") ? "friend.waits" : "board.goes_on"));
  }

  /** Says how the rally ended, until the next stroke of the person. */
  say(text: string): void {
    replaceChildren(this.element, h("h2", {}, h("span", {}, say("board.label"))), h("p", { class: "quiet" }, text));
  }

  /** The selected position; null while none is chosen. */
  get position(): number | null {
    return this.turn?.positions.length ? this.pad.position : null;
  }

  get selected(): TurnStroke | undefined {
    return this.turn?.strokes.find((s) => s.shot === this.shot && s.area === this.area && s.technique === this.technique);
  }

  /** Sets parts of a stroke; once its shot is chosen, the others are the most probable legal ones if necessary. */
  private choose(parts: { shot?: string; area?: string; technique?: string }): void {
    const { strokes } = this.turn!;
    const fits = (test: (s: TurnStroke) => boolean) => strokes.filter(test);
    if (parts.area && !this.shot) {
      this.shot = this.usual(strokes.filter((s) => s.area === parts.area))!.shot;
    }
    this.shot = parts.shot ?? this.shot;
    let left = fits((s) => s.shot === this.shot);
    const area = parts.area ?? this.area;
    this.area = left.some((s) => s.area === area) ? area : this.usual(left)!.area;
    left = left.filter((s) => s.area === this.area);
    const technique = parts.technique ?? this.technique;
    this.technique = left.some((s) => s.technique === technique) ? technique : this.usual(left)!.technique;
    this.draw();
    this.hooks.aim(this.selected?.box ?? null);
  }

  /** The stroke that people play most. */
  private usual(strokes: TurnStroke[]): TurnStroke | undefined {
    return strokes.reduce<TurnStroke | undefined>((best, s) => (best && played(best) >= played(s) ? best : s), undefined);
  }

  /** The strokes of the chosen shot; all before one is chosen. */
  private get offered(): TurnStroke[] {
    return this.turn!.strokes.filter(({ shot }) => !this.shot || shot === this.shot);
  }

  /** Win probability of the best of several strokes; null until hints arrive. */
  private best(strokes: TurnStroke[]): string | null {
    const wins = strokes.flatMap((s) => this.values.get(s.stroke)?.win ?? []);
    return wins.length ? percent(Math.max(...wins)) : null;
  }

  private draw(): void {
    const { strokes, seat, height, hurried } = this.turn!;
    const focused = (document.activeElement as HTMLElement | null)?.dataset["key"];
    const serves = strokes[0]!.shot.endsWith("serve");
    const shots = this.hall.shots.filter((shot) => strokes.some((s) => s.shot === shot));
    const shotButtons = shots.map((shot) => {
      const best = this.best(strokes.filter((s) => s.shot === shot));
      return h(
        "button",
        { "aria-pressed": String(shot === this.shot), "data-key": `shot ${shot}`, onclick: () => this.choose({ shot }) },
        words(shot),
        h("small", {}, h("kbd", {}, KEYS[shot]!), best ? say("board.wins", { share: best }) : ""),
      );
    });
    const ofShot = this.offered;
    this.hooks.paint(Object.values(Object.fromEntries(ofShot.map(({ area, box }) => [area, box]))));
    const areaButtons = this.order.map((index, place) => {
      const area = this.hall.areas[index]!.name;
      const mine = ofShot.filter((s) => s.area === area);
      if (!mine.length) {
        return h("button", { disabled: true }); // keeps its place, and is not seen
      }
      const share = Math.max(...mine.map((s) => s.p_succ));
      const best = this.best(mine);
      const shot = this.shot ? null : words(this.usual(mine)!.shot);
      const facts = [shot, say("board.in", { share: percent(share) }), best && say("board.wins", { share: best }).trim()];
      return h(
        "button",
        {
          "aria-pressed": String(area === this.area),
          "data-key": `area ${area}`,
          "aria-label": listed([words(area), ...facts.filter((fact) => fact !== null)]),
          title: `${words(area)} (${KEYPAD[place]!})`,
          style: `background:${shade(share)}`,
          onclick: () => this.choose({ area }),
        },
        best ?? shot ?? percent(share),
      );
    });
    const there = (technique: string) => ofShot.some((s) => s.area === this.area && s.technique === technique);
    const techniques = this.hall.techniques
      .filter(there)
      .map((technique) =>
        h(
          "button",
          {
            "aria-pressed": String(technique === this.technique),
            "data-key": `technique ${technique}`,
            onclick: () => this.choose({ technique }),
          },
          words(technique),
        ),
      );
    const now = this.selected;
    const option = now ? this.values.get(now.stroke) : undefined;
    const chances = now
      ? [
          say("board.in", { share: percent(now.p_succ) }),
          say("board.back", { share: percent(now.p_ret) }),
          ...(option ? [say("board.wins", { share: percent(option.win) }).trim()] : []),
        ].join(" · ")
      : "";
    replaceChildren(
      this.element,
      h(
        "h2",
        {},
        term("your stroke", say(serves ? "term.your_serve" : "term.your_stroke")),
        h(
          "span",
          {},
          serves ? "" : say(`from_net.${height}` as Key),
          ...(hurried ? [say("language.comma"), term("hurried")] : []),
        ),
      ),
      h(
        "div",
        { class: "halves" },
        h("div", {}, h("div", { class: "shots" }, ...shotButtons)),
        h("div", { class: "targets", role: "group", "aria-label": say("board.target") }, ...areaButtons),
      ),
      h("div", { class: "row techniques", role: "group", "aria-label": say("board.technique") }, ...techniques),
      h(
        "div",
        { class: "row" },
        h("button", { "data-key": "hint", onclick: () => void this.askHints() }, say("board.hint"), h("kbd", {}, "i")),
        h("span", { role: "status" }, chances),
        h(
          "button",
          { class: "hit", "data-key": "hit", disabled: !now, onclick: () => this.hit() },
          say("board.hit"),
          h("kbd", {}, "Enter"),
        ),
      ),
    );
    this.element.style.setProperty("--mine", sideColour(seat));
    if (focused) {
      (this.element.querySelector(`[data-key="${CSS.escape(focused)}"]`) as HTMLElement | null)?.focus({ preventScroll: true });
    }
  }

  private async askHints(): Promise<void> {
    const { turn } = this;
    const { options } = await this.hooks.hints();
    if (turn === this.turn && turn) {
      this.values = new Map(options.map((option) => [option.stroke, option]));
      this.draw();
    }
  }

  hit(): void {
    const stroke = this.selected;
    if (stroke) {
      this.hooks.choose(stroke.stroke);
    }
  }

  /** The stroke of a point of the court: that which people play most to the nearest area. */
  private at(x: number, y: number): TurnStroke | undefined {
    const away = ({ box: [x0, x1, y0, y1] }: TurnStroke) =>
      Math.hypot(Math.max(x0 - x, 0, x - x1), Math.max(y0 - y, 0, y - y1));
    const least = Math.min(...this.offered.map(away));
    return least <= REACH ? this.usual(this.offered.filter((stroke) => away(stroke) === least)) : undefined;
  }

  /** Shows what a click plays at a point of the court; null: nothing. */
  point(place: [number, number] | null, left: number, top: number): void {
    if (this.turn?.positions.length && place) {
      this.pad.pointAt(...place, false);
    } else if (this.turn?.strokes.length) {
      const found = place ? this.at(...place) : undefined;
      this.label.classList.toggle("hidden", !found);
      this.hooks.aim((found ?? this.selected)?.box ?? null);
      if (found) {
        const name = say("stroke.to", { shot: words(found.shot), area: words(found.area) });
        this.label.textContent = `${name} · ${say("board.in", { share: percent(found.p_succ) })}`;
        this.label.style.left = `${Math.min(left + 14, innerWidth - this.label.offsetWidth - 6)}px`;
        this.label.style.top = `${top - 34}px`;
      }
    }
  }

  /** Plays the stroke that people play most at a point of the court, or waits there. */
  playAt(x: number, y: number): void {
    if (this.turn?.positions.length) {
      this.pad.pointAt(x, y, true);
    } else if (this.turn) {
      const found = this.at(x, y);
      if (found) {
        this.hooks.choose(found.stroke);
      }
    }
  }

  key(key: string): boolean {
    if (!this.turn) {
      return false;
    }
    if (this.turn.positions.length) {
      return this.pad.key(key);
    }
    const { strokes } = this.turn;
    if (key === "Enter") {
      const { shot } = this; // without one, Enter presses the button that has the focus
      this.hit();
      return shot !== "";
    }
    if (key === "i") {
      void this.askHints();
      return true;
    }
    if (key === "q" && this.shot) {
      const { techniques } = this.hall;
      const there = techniques.filter((t) =>
        strokes.some((s) => s.shot === this.shot && s.area === this.area && s.technique === t),
      );
      this.choose({ technique: there[(there.indexOf(this.technique) + 1) % there.length] ?? this.technique });
      return true;
    }
    const place = KEYPAD.indexOf(Number(key));
    if (/^[1-9]$/.test(key)) {
      const area = this.hall.areas[this.order[place]!]!.name;
      if (this.offered.some((s) => s.area === area)) {
        this.choose({ area });
      }
      return true;
    }
    const shot = this.hall.shots.find((name) => KEYS[name] === key && strokes.some((s) => s.shot === name));
    if (shot) {
      this.choose({ shot });
      return true;
    }
    return false;
  }
}

/** How often people play a stroke; where that is not known, how often it is in. */
function played({ support, p_succ }: TurnStroke): number {
  return support ?? p_succ;
}

/** Colour of a probability on the panel, from red to green; text on it keeps its contrast. */
function shade(p: number): string {
  const hue = Math.round(120 * p ** 3);
  return `light-dark(hsl(${hue} 60% 86%), hsl(${hue} 55% 22%))`;
}
