// Tagging a video: the page around the reducer of tagging.ts. Keys enter shots, places and endings; the server keeps every input.

import { areaWords, decimal, type Key, say, words } from "./words";
import "./tag.css";
import type { Connection } from "./connection";
import { type Child, capitalised, h, percent, replaceChildren, s } from "./dom";
import { languageMenu } from "./layout";
import {
  current,
  ENDINGS,
  type Ending,
  type Hand,
  homography,
  type Input,
  line,
  mapped,
  Refused,
  receivers,
  reduce,
  replay,
  rows,
  START,
  type State,
  striker,
} from "./tagging";
import type { HallFacts, Hello, Suggestion, TagFacts, TagRequest, TagRow } from "./wire.gen";

const SHOT_KEYS = "sgcldsavpknbx"; // in the order of the vocabulary; s serves or smashes
const END_KEYS: Record<Ending, string> = { out: "o", net: "t", short: "r", foul: "f", let: "e", landed: "i", misjudged: "m" };
const STEP = 1 / 30; // a step by frame [s]
const SHOWN = 5; // suggestions
const CHUNK = 200; // rows of a request
const AGAIN = 3000; // time after which what was not saved is sent again [ms]
const CORNER_NAMES = ["near left", "near right", "far right", "far left"] as const;

/** A request that saves, and what is saved with it. */
interface Change {
  request: Omit<TagRequest, "after">;
  inputs: number;
  strokes: number;
  begun: number;
}

function trim(field: HTMLInputElement): void {
  field.value = field.value.trim();
}

export class Tagging {
  private state: State = START;
  private readonly inputs: Input[] = [];
  private readonly hall: HallFacts;
  private sent: string[] = [];
  private readonly unsaved: Change[] = [];
  private saving = false;
  private again = 0;
  private after: string;
  private saved = 0;
  private savingTimes: number[] = [];
  private suggested: Suggestion[] = [];
  private suggestedFor = "";
  private marking = false;
  private readonly video = h("video", { src: "video", preload: "auto", playsinline: true, "aria-label": say("tag.video") });
  private readonly marks = s("svg", { viewBox: "0 0 1 1", preserveAspectRatio: "none", "aria-hidden": "true" });
  private readonly time = h("output", {});
  private readonly score = h("p", { class: "score" });
  private readonly prompt = h("p", { class: "prompt", role: "status" });
  private readonly refusal = h("p", { class: "refusal", role: "alert" });
  private readonly keys = h("div", { class: "keys" });
  private readonly list = h("ol", { class: "strokes", "aria-label": say("tag.strokes") });
  private readonly status = h("p", { class: "status", role: "status" });
  private readonly setup: HTMLFormElement;
  private readonly board: HTMLElement;

  constructor(
    hello: Hello,
    private readonly file: TagFacts,
    private readonly server: Connection,
  ) {
    this.hall = hello.hall;
    this.after = file.after;
    this.setup = this.form();
    this.board = h("div", { class: "board" }, this.score, this.prompt, this.refusal, this.keys, this.list);
    this.resume();
    document.title = say("tag.title", { video: file.video });
    document.body.classList.add("tagging");
    const picture = h(
      "div",
      { class: "picture", onpointerdown: (event) => this.clicked(event as PointerEvent) },
      this.video,
      this.marks,
    );
    document.body.append(
      h("main", {}, h("div", { class: "film" }, picture, this.controls(), this.status), h("div", {}, this.setup, this.board)),
    );
    this.video.addEventListener("timeupdate", () => this.showTime());
    this.video.addEventListener("error", () => this.refused(say("tag.cannot")));
    document.addEventListener("keydown", (event) => this.pressed(event));
    document.addEventListener("click", ({ target, detail }) => {
      const button = (target as HTMLElement).closest("button");
      if (detail > 0) {
        button?.blur(); // else space and Enter would press it again
      }
    });
    this.show();
  }

  /** State for tests and scripts. */
  get facts(): Record<string, unknown> {
    const { phase, rallies, games, question } = this.state;
    const suggested = this.suggestedFor === this.line() ? this.suggested.map(({ shot }) => this.hall.shots[shot]) : null;
    const strokes = rallies.at(-1)?.strokes ?? [];
    const { inputs, saved, savingTimes } = this;
    return {
      ready: true,
      phase,
      games,
      question,
      last: strokes.at(-1) ?? null,
      strokes: strokes.length,
      suggested,
      rally: rallies.length,
      inputs: inputs.length,
      saved,
      saving_ms: savingTimes,
    };
  }

  private resume(): void {
    const known = this.file.inputs.map((text) => JSON.parse(text) as Input);
    this.inputs.push(...known);
    this.saved = known.length;
    this.state = replay(known, this.hall);
    // The table may lack what the last input changed.
    const last = this.state.rallies.at(-2)?.strokes.length ?? 0;
    const all = this.table();
    const settled = Math.max(0, all.length - last - (this.state.rallies.at(-1)?.strokes.length ?? 0));
    this.sent = all.slice(0, Math.min(settled, this.file.rows)).map((row) => JSON.stringify(row));
    if (known.length) {
      this.save("rows");
      this.video.currentTime = this.state.rallies.flatMap(({ strokes }) => strokes).at(-1)?.time ?? 0;
    }
  }

  private form(): HTMLFormElement {
    const allowed = { required: true, maxlength: this.file.longest_name, pattern: this.file.name };
    const field = (name: string, label: string, value = "") =>
      h(
        "label",
        {},
        label,
        h("input", { name, value, ...allowed, onchange: (event) => trim(event.target as HTMLInputElement) }),
      );
    const select = (name: string, label: string, options: [string, string][]) =>
      h("label", {}, label, h("select", { name }, ...options.map(([value, text]) => h("option", { value }, text))));
    const hands: [string, string][] = [
      ["", say("tag.hand_unknown")],
      ["right", say("tag.hand_right")],
      ["left", say("tag.hand_left")],
    ];
    return h(
      "form",
      {
        onsubmit: (event) => {
          event.preventDefault();
          const of = (name: string) => String(new FormData(this.setup).get(name)).trim();
          const discipline = of("discipline") as "MS" | "WS";
          const players: [string, string] = [of("near"), of("far")];
          const hands = [of("near_hand") || null, of("far_hand") || null] as [Hand, Hand];
          this.enter({ kind: "setup", match: of("match"), discipline, players, hands, server: Number(of("server")) as 0 | 1 });
        },
      },
      h("h1", {}, say("tag.heading")),
      h("label", {}, say("page.language"), languageMenu()),
      field("match", say("tag.match"), this.file.video.replace(/\.\w+$/, "")),
      field("near", say("tag.near")),
      select("near_hand", say("tag.near_hand"), hands),
      field("far", say("tag.far")),
      select("far_hand", say("tag.far_hand"), hands),
      select("server", say("tag.server"), [
        ["0", say("tag.near_player")],
        ["1", say("tag.far_player")],
      ]),
      select("discipline", say("tag.discipline"), [
        ["MS", say("disciplines.men")],
        ["WS", say("disciplines.women")],
      ]),
      h("button", { type: "submit" }, say("tag.begin")),
    );
  }

  private controls(): HTMLElement {
    const button = (text: string, label: string, act: () => void) =>
      h("button", { type: "button", "aria-label": label, title: label, onclick: act }, text);
    return h(
      "div",
      { class: "controls" },
      button(say("tag.play"), say("tag.play_about"), () => this.toggle()),
      button("−1", say("tag.back_about"), () => this.seek(-STEP)),
      button("+1", say("tag.on_about"), () => this.seek(STEP)),
      button("½×", say("tag.slower"), () => this.speed(0.5)),
      button("2×", say("tag.faster"), () => this.speed(2)),
      button(say("tag.corners"), say("tag.corners_about"), () => {
        this.marking = this.state.corners.length < 4;
        this.show();
      }),
      button(say("tag.undo"), say("tag.undo_about"), () => this.undo()),
      this.time,
    );
  }

  private toggle(): void {
    void (this.video.paused ? this.video.play() : this.video.pause());
  }

  private seek(by: number): void {
    this.video.pause();
    this.video.currentTime = Math.max(0, this.video.currentTime + by);
  }

  private speed(by: number): void {
    this.video.playbackRate = Math.min(Math.max(this.video.playbackRate * by, 0.125), 4);
    this.showTime();
  }

  private showTime(): void {
    this.time.textContent = say("tag.time", {
      time: decimal(this.video.currentTime, 2),
      speed: this.video.playbackRate,
    });
  }

  private pressed(event: KeyboardEvent): void {
    const target = event.target as HTMLElement;
    if (event.ctrlKey || event.metaKey || event.altKey || /^(INPUT|SELECT)$/.test(target.tagName)) {
      return;
    }
    if ((event.key === "Enter" || event.key === " ") && target.closest("button")) {
      return;
    }
    const act = this.acts()[event.key];
    if (act) {
      event.preventDefault();
      act();
    }
  }

  /** What each key does; letters are shots, and endings after a stroke. */
  private acts(): Record<string, () => void> {
    const acts: Record<string, () => void> = {
      " ": () => this.toggle(),
      ",": () => this.seek(-STEP),
      ".": () => this.seek(STEP),
      "<": () => this.speed(0.5),
      ">": () => this.speed(2),
      ArrowLeft: () => this.seek(-1),
      ArrowRight: () => this.seek(1),
      Backspace: () => this.undo(),
      Enter: () => this.enter({ kind: "confirm" }),
      q: () => this.enter({ kind: "technique" }),
      "-": () => this.enter({ kind: "height" }),
    };
    this.shots().forEach((shot) => (acts[SHOT_KEYS[shot]!] = () => this.shot(shot)));
    ENDINGS.forEach((ending) => (acts[END_KEYS[ending]] = () => this.enter({ kind: "end", ending })));
    for (let cell = 1; cell <= 9; cell++) {
      acts[cell] = () => this.enter({ kind: "cell", cell });
    }
    return acts;
  }

  /** Shot types that may come next: serves, or the others. */
  private shots(): number[] {
    const serves = this.state.setup !== null && current(this.state).strokes.length === 0;
    return this.hall.shots.map((_, shot) => shot).filter((shot) => shot < 2 === serves);
  }

  private shot(shot: number): void {
    const known = this.suggestedFor === this.line() ? this.suggested.find((one) => one.shot === shot) : undefined;
    const above = /^(clear|drop|smash|half-smash|net-kill)$/.test(this.hall.shots[shot]!);
    const usual = known && known.probability > 0 ? known : { technique: 0, height: above ? 1 : 0 };
    this.enter({
      kind: "shot",
      shot,
      time: Math.round(1000 * this.video.currentTime) / 1000,
      technique: usual.technique,
      height: usual.height,
      probability: known?.probability ?? null,
    });
  }

  private clicked(event: PointerEvent): void {
    const box = this.video.getBoundingClientRect();
    const [x, y] = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
    event.preventDefault();
    if (this.marking) {
      this.marking = this.state.corners.length < CORNER_NAMES.length - 1;
      this.enter({ kind: "corner", x, y });
      this.marking = this.state.corners.length < 4;
      this.show();
    } else if (this.state.phase === "place") {
      this.enter({ kind: "place", x, y });
    } else if (this.state.setup) {
      this.toggle();
    }
  }

  private enter(input: Input): void {
    try {
      this.state = reduce(this.state, input, this.hall);
    } catch (error) {
      if (!(error instanceof Refused)) {
        throw error;
      }
      this.refused(error.message);
      return;
    }
    this.inputs.push(input);
    this.refused("");
    this.save(input);
    this.show();
  }

  private undo(): void {
    if (this.inputs.pop()) {
      this.state = replay(this.inputs, this.hall);
      this.refused("");
      this.save("undo");
      this.show();
    }
  }

  private refused(text: string): void {
    this.refusal.textContent = capitalised(text);
  }

  private table(): TagRow[] {
    return this.state.setup ? rows(this.state) : [];
  }

  /** Sends an input, or an undo, and the rows that differ from those of the server, after what is not saved yet. */
  private save(act: Input | "undo" | "rows"): void {
    const inputs = this.inputs.length;
    const begun = performance.now();
    const table = this.table();
    const texts = table.map((row) => JSON.stringify(row));
    const differs = texts.findIndex((text, i) => text !== this.sent[i]);
    const first = differs < 0 ? texts.length : differs;
    this.sent = texts;
    const input = act === "undo" || act === "rows" ? null : JSON.stringify(act);
    for (let from = first; from === first || from < table.length; from += CHUNK) {
      const only_rows = act === "rows" || from > first;
      const at = only_rows ? inputs : act === "undo" ? inputs + 1 : inputs - 1;
      const request = { at, input: only_rows ? null : input, only_rows, first: from, rows: table.slice(from, from + CHUNK) };
      this.unsaved.push({ request, inputs, strokes: table.length, begun });
    }
    void this.send();
  }

  /** Sends what is not saved, one after another; what fails stays and is sent again. */
  private async send(): Promise<void> {
    if (this.saving) {
      return;
    }
    this.saving = true;
    clearTimeout(this.again);
    try {
      for (let change = this.unsaved[0]; change; change = this.unsaved[0]) {
        const { facts } = await this.server.ask("tag", { ...change.request, after: this.after });
        this.after = facts.after;
        this.unsaved.shift();
        this.saved = change.inputs;
        this.savingTimes.push(performance.now() - change.begun);
        this.status.textContent = say("tag.saved", {
          inputs: change.inputs,
          strokes: change.strokes,
          file: this.file.out,
        });
      }
    } catch (error) {
      this.status.textContent = say("tag.not_saved", { reason: (error as Error).message, inputs: this.unsaved.length });
      this.again = setTimeout(() => void this.send(), AGAIN);
    } finally {
      this.saving = false;
    }
  }

  private line(): string {
    return this.state.phase === "shot" ? JSON.stringify(line(current(this.state))) : "";
  }

  private suggest(): void {
    const text = this.line();
    if (!text || text === this.suggestedFor) {
      return;
    }
    void this.server.ask("suggest", { line: JSON.parse(text), receivers: receivers(this.state) }).then(
      ({ facts }) => {
        if (text === this.line()) {
          [this.suggested, this.suggestedFor] = [facts.shots, text];
          this.showKeys();
        }
      },
      () => {}, // shots can be entered without suggestions
    );
  }

  private show(): void {
    const { state } = this;
    const begun = state.setup !== null;
    this.setup.hidden = begun;
    this.board.hidden = !begun;
    this.showMarks();
    if (!begun) {
      return;
    }
    const { points, server, game } = current(state);
    const after = state.rallies.filter((rally) => rally.strokes.length).length;
    const [a, b] = state.setup!.players;
    replaceChildren(
      this.score,
      `${server === 0 ? "• " : ""}${a} ${points[0]} : ${points[1]} ${b}${server === 1 ? " •" : ""}`,
      h("small", {}, say("tag.place", { game, rally: after, name: state.setup!.players[state.near] })),
    );
    this.prompt.textContent = this.marking
      ? say("tag.corner", { corner: say(`tag.${CORNER_NAMES[state.corners.length]!}`) })
      : this.asks();
    this.showKeys();
    this.showList();
    this.suggest();
  }

  private asks(): string {
    const { phase, question, setup } = this.state;
    const rally = current(this.state);
    const last = rally.strokes.at(-1);
    if (phase === "ask") {
      return say("tag.keeps", { question });
    }
    if (phase === "place" && last) {
      return say("tag.where", {
        name: setup!.players[last.seat],
        technique: words(this.hall.techniques[last.technique]!),
        height: say(`heights.${this.hall.heights[last.height]}` as Key),
      });
    }
    const name = setup!.players[striker(rally)];
    return phase === "over" ? say("tag.over") : say(last ? "tag.plays" : "tag.serves", { name });
  }

  private showKeys(): void {
    const { phase } = this.state;
    const key = (label: string, name: string, act: () => void, kind = "", note: Child = null) =>
      h("button", { type: "button", class: kind, onclick: act }, h("kbd", {}, label), ` ${name}`, note);
    const blocks: Child[] = [];
    if (phase === "shot") {
      const fresh = this.suggestedFor === this.line() ? this.suggested : [];
      const probability = new Map(fresh.map((one, rank) => [one.shot, { p: one.probability, rank }]));
      const order = this.shots().sort((a, b) => (probability.get(a)?.rank ?? a) - (probability.get(b)?.rank ?? b));
      blocks.push(
        ...order.map((shot, i) => {
          const found = i < SHOWN ? probability.get(shot) : undefined;
          const likely = found !== undefined && found.p >= 0.01;
          const note = likely ? h("small", {}, ` ${percent(found.p)}`) : null;
          return key(SHOT_KEYS[shot]!, words(this.hall.shots[shot]!), () => this.shot(shot), likely ? "likely" : "", note);
        }),
      );
    }
    if (phase === "place") {
      const cells = [7, 8, 9, 4, 5, 6, 1, 2, 3].map((cell) => key(String(cell), "", () => this.enter({ kind: "cell", cell })));
      blocks.push(h("div", { class: "cells", role: "group", "aria-label": say("tag.half") }, ...cells));
    }
    if (phase === "place" || (phase === "shot" && current(this.state).strokes.length)) {
      const some = phase === "shot" ? ENDINGS : ENDINGS.slice(1, 5);
      blocks.push(
        h("hr", {}),
        ...some.map((ending) => key(END_KEYS[ending], say(`tag.${ending}`), () => this.enter({ kind: "end", ending }), "end")),
      );
      blocks.push(
        h("hr", {}),
        key("q", say("tag.technique"), () => this.enter({ kind: "technique" })),
        key("-", say("tag.height"), () => this.enter({ kind: "height" })),
      );
    }
    if (phase === "ask") {
      blocks.push(
        key("Enter", say("tag.keep"), () => this.enter({ kind: "confirm" })),
        key("Backspace", say("tag.remove"), () => this.undo()),
      );
    }
    replaceChildren(this.keys, ...blocks);
  }

  private showList(): void {
    const { players, hands } = this.state.setup!;
    const items = this.state.rallies.slice(-40).flatMap((rally) =>
      rally.strokes.map(({ seat, shot, area, time }, i) => {
        const ending = i === rally.strokes.length - 1 && rally.ending ? say("language.comma") + say(`tag.${rally.ending}`) : "";
        const name = words(this.hall.shots[shot]!);
        const to = (index: number) => areaWords(this.hall.areas[index]!.name, hands[1 - seat] ?? "right");
        const stroke = area === null ? name : say("stroke.to", { shot: name, area: to(area) });
        const text = say("tag.listed", { time: decimal(time, 1), name: players[seat], stroke, ending });
        const jump = () => {
          this.video.pause();
          this.video.currentTime = time;
        };
        return h("li", { class: i ? "" : "first" }, h("button", { type: "button", onclick: jump }, text));
      }),
    );
    replaceChildren(this.list, ...items.reverse());
  }

  /** The corners, and the lines of the court through them. */
  private showMarks(): void {
    const { corners } = this.state;
    const dots = corners.map(([x, y]) => s("circle", { cx: x, cy: y, r: 0.008 }));
    const outline: SVGElement[] = [];
    if (corners.length === 4) {
      const back = homography(
        [
          [-1, -1],
          [1, -1],
          [1, 1],
          [-1, 1],
        ],
        corners,
      );
      const path = (
        [
          [-1, -1],
          [1, -1],
          [1, 1],
          [-1, 1],
          [-1, -1],
          [-1, 0],
          [1, 0],
        ] as const
      )
        .map(([x, y]) => mapped(back, x, y).join(","))
        .join(" ");
      outline.push(s("polyline", { points: path }));
    }
    this.marks.replaceChildren(...dots, ...outline);
  }
}
