// Opening explorer: serve, reply and third stroke, how often they are chosen and what they are worth.

import { h, percent, replaceChildren, sideColour } from "./dom";
import { term } from "./glossary";
import type { OpeningReply, OpeningStroke } from "./wire.gen";
import { decimal, say, words } from "./words";

const LONGEST = 3; // strokes of a line
const SHOWN = 12; // strokes of a list
const RELIABLE = 20; // real strokes behind a stroke that is marked as the best
const USUAL = 0.5; // least probability that such a stroke is possible
const NAMES = [say("page.serve"), say("page.reply"), say("page.third")];

export interface OpeningHooks {
  /** Strokes after a line of catalogue indices. */
  load(line: number[]): Promise<OpeningReply>;
  /** Draws the target of a stroke; null: of none. */
  point(stroke: OpeningStroke | null): void;
  /** Plays a match whose first rally begins with a line; null: this page cannot. */
  play: ((line: number[], seed: number) => void) | null;
  failed(error: Error): void;
}

export class Openings {
  readonly element: HTMLDetailsElement;
  private readonly content = h("div", { "aria-live": "polite" });
  private line: OpeningStroke[] = [];
  private request = 0;

  constructor(private readonly hooks: OpeningHooks) {
    this.element = h(
      "details",
      { class: "panel openings", ontoggle: () => this.element.open && !this.request && void this.open([]) },
      h("summary", {}, h("h2", {}, h("span", {}, say("page.openings")), h("span", {}, say("page.openings_about")))),
      this.content,
    );
  }

  private async open(line: OpeningStroke[], focus = false): Promise<void> {
    const request = ++this.request;
    try {
      const reply = await this.hooks.load(line.map(({ stroke }) => stroke));
      if (request === this.request) {
        this.line = line;
        this.show(reply);
        if (focus) {
          this.content.querySelector<HTMLElement>("tbody button, .play")?.focus({ preventScroll: true });
        }
      }
    } catch (error) {
      this.hooks.failed(error as Error);
    }
  }

  private show({ strokes, seed }: OpeningReply): void {
    const { line, hooks } = this;
    const { play } = hooks;
    const steps = [
      h("button", { onclick: () => void this.open([], true) }, NAMES[0]!),
      ...line.map((stroke, i) =>
        h(
          "button",
          { onclick: () => void this.open(line.slice(0, i + 1), true) },
          `${words(stroke.shot)} → ${words(stroke.area)}`,
        ),
      ),
    ];
    steps.at(-1)!.setAttribute("aria-current", "step");
    const indices = line.map(({ stroke }) => stroke);
    replaceChildren(
      this.content,
      h("nav", { class: "line", "aria-label": say("page.line") }, ...steps),
      line.length < LONGEST ? this.table(strokes) : null,
      play && line.length
        ? seed === null
          ? h("p", { class: "quiet" }, say("page.too_rare"))
          : h("button", { class: "play", onclick: () => play(indices, seed) }, say("page.play_line"))
        : null,
    );
  }

  private table(strokes: OpeningStroke[]): HTMLElement {
    const { line } = this;
    const reliable = strokes.filter(({ support, available }) => (support ?? 0) >= RELIABLE && available >= USUAL);
    const best = reliable.reduce<OpeningStroke | null>((top, one) => (top && top.best >= one.best ? top : one), null);
    const usual = strokes.slice(0, SHOWN);
    const listed = best && !usual.includes(best) ? [...usual.slice(0, -1), best] : usual;
    const most = Math.max(...listed.map(({ share }) => share), 0.01);
    const rows = listed.map((stroke) => {
      const point = () => this.hooks.point(stroke);
      const technique = stroke.technique === "forehand" ? "" : say(stroke.technique === "backhand" ? "page.bh" : "page.ath");
      const button = h(
        "button",
        { class: "try", onclick: () => void this.open([...line, stroke], true), onpointerenter: point, onfocus: point },
        h("i", { style: `width:${(100 * stroke.share) / most}%` }),
        h("span", {}, `${words(stroke.shot)} → ${words(stroke.area)}${technique}`),
        stroke.available < USUAL ? h("small", {}, say("page.possible", { share: percent(stroke.available) })) : null,
      );
      return h(
        "tr",
        { class: stroke === best ? "best" : "" },
        h("td", {}, button),
        h("td", {}, percent(stroke.share)),
        h("td", {}, percent(stroke.win)),
        h("td", {}, percent(stroke.best)),
        h("td", {}, stroke.support === null ? "?" : decimal(stroke.support, 0)),
      );
    });
    const head = h(
      "tr",
      {},
      h("th", { scope: "col", style: `color:${sideColour(line.length % 2)}` }, NAMES[line.length]!),
      h("th", { scope: "col" }, term("share")),
      h("th", { scope: "col" }, term("pros win", say("term.wins"))),
      h("th", { scope: "col" }, term("perfect play", say("term.wins_strong"))),
      h("th", { scope: "col" }, term("real")),
    );
    const leave = () => this.hooks.point(null);
    return h(
      "table",
      { class: "options", onpointerleave: leave, onfocusout: leave },
      h("thead", {}, head),
      h("tbody", {}, ...rows),
    );
  }
}
