// Overlays of the court: score, shot, cameras.

import { type Child, capitalised, h, percent, replaceChildren, sideColour, signed } from "./dom";
import { hurriedTag } from "./glossary";
import { handTag, nameAt } from "./names";
import { breakWords } from "./narration";
import { positionWords } from "./recover";
import { CAMERAS, type Camera } from "./stage";
import type { HallFacts, RallyFacts, Stroke, StrokeValue } from "./wire.gen";
import { type Key, say, words } from "./words";

export class ScoreBug {
  readonly element = h("div", { class: "bug", role: "group", "aria-label": say("page.score") });
  private shown = "";

  /** @param begun whether the serve is struck; until then an interval or a change of ends is told. */
  show(rally: RallyFacts, begun: boolean, over: boolean): void {
    const before = begun ? "" : rally.before;
    const points = over && rally.after ? rally.after.points : rally.points;
    const key = JSON.stringify([rally.names, rally.players, points, rally.finished, rally.server, before, over]);
    if (key === this.shown) {
      return;
    }
    this.shown = key;
    const serving = over && rally.winner !== null ? rally.winner : rally.server;
    replaceChildren(
      this.element,
      ...[0, 1].map((seat) =>
        h(
          "div",
          { class: `row${seat === serving ? " serving" : ""}`, style: `--mine:${sideColour(seat)}` },
          h("i"),
          h("span", { class: "dot", title: say("page.serves") }),
          h("span", { class: "name" }, capitalised(nameAt(rally.names, seat)), handTag(rally.players[seat]!.hand)),
          h("span", { class: "sets" }, ...rally.finished.map((game) => h("span", {}, String(game[seat])))),
          h("span", { class: "points" }, String(points[seat])),
        ),
      ),
      before && h("p", { class: "before" }, capitalised(breakWords(before))),
    );
  }
}

function fact(name: string, value: Child | Child[], kind = "", style = ""): HTMLElement {
  return h("dl", { class: kind }, h("dt", {}, name), h("dd", { style }, ...[value].flat()));
}

/** The current stroke. */
export class Chip {
  readonly element = h("div", { class: "chip", "aria-hidden": "true" });
  readonly count = h("div", { class: "count", "aria-hidden": "true" });
  /** What the ring and the dots on the court say. */
  readonly waits = h("div", { class: "waits", "aria-hidden": "true" });
  private shown: unknown[] = [];

  constructor(private readonly hall: HallFacts) {}

  /** @param waiting values of the stroke whose positions and open side are shown; null: none are. */
  show(rally: RallyFacts, index: number, waiting: StrokeValue | null): void {
    const stroke = rally.strokes[index] ?? null;
    if (this.shown[0] === stroke && this.shown[1] === waiting && this.shown.length) {
      return;
    }
    this.shown = [stroke, waiting];
    this.element.classList.toggle("hidden", stroke === null);
    this.count.classList.toggle("hidden", stroke === null);
    this.showWaits(rally, stroke, waiting);
    if (!stroke) {
      return;
    }
    this.element.style.setProperty("--mine", sideColour(stroke.seat));
    const effort =
      stroke.effort === null ? null : fact(say("page.attacks"), `${stroke.effort} : ${stroke.opponent_effort}`, "minor");
    replaceChildren(
      this.element,
      h("div", { class: "shot" }, words(stroke.shot)),
      fact(say("page.target"), words(stroke.area)),
      fact(say("term.in"), percent(stroke.p_succ), "", "color:var(--green)"),
      fact(say("term.comes back"), percent(stroke.p_ret), "", "color:var(--gold)"),
      fact(say("page.technique"), words(stroke.technique), "technique"),
      fact(say("page.contact"), [say(`at_net.${stroke.height}` as Key), hurriedTag(stroke.hurried)], "minor"),
      effort,
    );
    this.count.textContent = say("page.stroke_of", { number: index + 1, count: rally.strokes.length });
  }

  private showWaits(rally: RallyFacts, stroke: Stroke | null, waiting: StrokeValue | null): void {
    const { open, places } = waiting ?? { open: null, places: null };
    const best = places?.reduce((a, b) => (b.perfect > a.perfect ? b : a));
    const loss = places?.find(({ position }) => position === stroke?.waited)?.loss ?? 0;
    const line = (mark: string, who: string, where: string) =>
      h("p", {}, h("i", { class: mark }), `${who}: `, h("b", {}, where));
    this.waits.classList.toggle("hidden", stroke?.waited == null && !best);
    replaceChildren(
      this.waits,
      stroke?.waited != null &&
        line(
          "ring",
          say("recover.waits", { name: capitalised(nameAt(rally.names, 1 - stroke.seat)) }),
          `${positionWords(this.hall, stroke.waited)}${loss >= 0.005 ? ` ${signed(-loss)}` : ""}`,
        ),
      open && line("open", say("recover.open"), `${words(open.area)} ${signed(open.gain)}`),
      best && line("spot", say("recover.best"), `${positionWords(this.hall, best.position)} ${percent(best.perfect)}`),
    );
    this.waits.style.setProperty("--mine", sideColour(1 - (stroke?.seat ?? 0)));
  }
}

export function cameraButtons(choose: (camera: Camera) => void): { element: HTMLElement; show(camera: Camera): void } {
  const buttons = CAMERAS.map((camera, i) =>
    h(
      "button",
      {
        onclick: () => choose(camera),
        "aria-pressed": "false",
        "aria-label": `${i + 1} ${say(`camera.${camera}`)}`,
        title: say("page.camera_number", { number: i + 1, name: say(`camera.${camera}`) }),
      },
      `${i + 1} ${say(`camera.${camera}`)}`,
    ),
  );
  const names = h(
    "select",
    { "aria-label": say("page.camera"), onchange: () => choose(names.value as Camera) },
    ...CAMERAS.map((camera) => h("option", { value: camera }, say(`camera.${camera}`))),
  );
  const element = h("div", { class: "cameras", role: "group", "aria-label": say("page.cameras") }, ...buttons, names);
  return {
    element,
    show: (camera) => {
      buttons.forEach((button, i) => button.setAttribute("aria-pressed", String(CAMERAS[i] === camera)));
      names.value = camera;
    },
  };
}
