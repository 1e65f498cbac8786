// Overlays of the court: the score, and the current stroke.

import { capitalised, h, percent, replaceChildren, sideColour } from "./dom";
import { does, handTag, nameAt, shown } from "./names";
import { breakWords, reason } from "./narration";
import { CAMERAS, type Camera } from "./stage";
import type { RallyFacts } from "./wire.gen";
import { say, words } from "./words";

export class ScoreBug {
  readonly element = h("div", { class: "bug", role: "group", "aria-label": say("page.score") });
  private seen = "";

  /** @param begun whether the serve is struck; until then an interval or a change of ends is told. */
  show(rally: RallyFacts, begun: boolean, over: boolean): void {
    const before = begun ? "" : rally.before;
    const points = over && rally.after ? rally.after.points : rally.points;
    const key = JSON.stringify([rally.names, rally.players, points, rally.finished, rally.server, before, over]);
    if (key === this.seen) {
      return;
    }
    this.seen = key;
    const serving = over && rally.winner !== null ? rally.winner : rally.server;
    replaceChildren(
      this.element,
      ...[0, 1].map((seat) =>
        h(
          "div",
          { class: `row${seat === serving ? " serving" : ""}`, style: `--mine:${sideColour(seat)}` },
          h("i"),
          h("span", { class: "dot", title: say("page.serves") }),
          h("span", { class: "name" }, shown(capitalised(nameAt(rally.names, seat))), handTag(rally.players[seat]!.hand)),
          h("span", { class: "sets" }, ...rally.finished.map((game) => h("span", {}, String(game[seat])))),
          h("span", { class: "points" }, String(points[seat])),
        ),
      ),
      before && h("p", { class: "before" }, capitalised(breakWords(before))),
    );
  }
}

/** The current stroke: its shot, its target, and how it ended the rally. */
export class Chip {
  readonly element = h("div", { class: "chip", "aria-hidden": "true" });
  private seen: unknown[] = [];

  /**
   * @param over whether the rally has ended on the court.
   * @param hint what the viewer may do after the match.
   */
  show(rally: RallyFacts, index: number, over: boolean, hint: string): void {
    const stroke = rally.strokes[index] ?? null;
    const now = [rally, stroke, over];
    if (now.every((part, i) => part === this.seen[i])) {
      return;
    }
    this.seen = now;
    this.element.classList.toggle("hidden", stroke === null);
    if (!stroke) {
      return;
    }
    this.element.style.setProperty("--mine", sideColour(stroke.seat));
    const faulty = over && stroke.end !== "winner";
    const chance = faulty
      ? say("board.in", { share: percent(stroke.p_succ) })
      : say("board.back", { share: percent(stroke.p_ret) });
    replaceChildren(
      this.element,
      h("b", { class: "shot" }, words(stroke.shot)),
      h("span", {}, say("stroke.place", { area: words(stroke.area) })),
      h("span", { class: "quiet" }, chance),
      over ? this.ending(rally, hint) : null,
    );
  }

  private ending(rally: RallyFacts, hint: string): HTMLElement {
    const after = rally.after!;
    const won = say(after.over ? "won.match" : after.game_won ? "won.game" : "won.rally");
    return h(
      "p",
      { class: "banner" },
      h("b", { class: rally.winner ? "b" : "a" }, does(rally.names, rally.winner!, "win")),
      `${won} · ${reason(rally)}${after.over ? hint : ""}`,
    );
  }
}

/** The menu of cameras. */
export function cameraMenu(choose: (camera: Camera) => void): HTMLSelectElement {
  const names = h(
    "select",
    { class: "cameras", "aria-label": say("page.camera"), onchange: () => choose(names.value as Camera) },
    ...CAMERAS.map((camera) => h("option", { value: camera }, say(`camera.${camera}`))),
  );
  return names;
}
