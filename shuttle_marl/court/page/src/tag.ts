// Tagging a video: the page around the reducer of tagging.ts. Keys enter shots, places and endings; the server keeps every input.

import { areaWords, decimal, type Key, say, words } from "./words";
import "./tag.css";
import type { Connection } from "./connection";
import { type Child, capitalised, h, percent, replaceChildren, s } from "./dom";
import { Film } from "./film";
import { keyOf } from "./keys";
import { languageMenu } from "./layout";
import { shown } from "./names";
import { KEYPAD } from "./recover";
import {
  CORNER_NAMES,
  CORNERS,
  courtLines,
  current,
  ENDINGS,
  type Ending,
  fell,
  type Hand,
  homography,
  type Input,
  line,
  mapped,
  Refused,
  type Rules,
  receivers,
  reduce,
  replay,
  rows,
  START,
  type State,
  striker,
} from "./tagging";
import { type HallFacts, type Hello, RULES, type Suggestion, type TagFacts, type TagRequest, type TagRow } from "./wire.gen";

const SHOT_KEYS = "sgcldsavpknbx"; // in the order of the vocabulary; s serves or smashes
const END_KEYS: Record<Ending, string> = { out: "o", net: "t", short: "r", foul: "f", let: "e", landed: "i", misjudged: "m" };
const FLIGHT = 0.6; // after a place, in which the shot is seen, before the next stroke [s]
const SOON = 3; // time in which play ends after a rally [s]
const SHOWN = 5; // suggestions
const CHUNK = 200; // rows of a request
const AGAIN = 3000; // time after which what was not saved is sent again [ms]

/** A request that saves, and what is saved with it. */
interface Change {
  request: Omit<TagRequest, "after">;
  inputs: number;
  strokes: number;
  begun: number;
}

/** Whether a suggestion is shown, with its usual ways. */
function likely({ probability }: Suggestion, rank: number): boolean {
  return rank < SHOWN && probability >= 0.01;
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
  private savingTimes: number[] = [];
  private suggested: Suggestion[] = [];
  private suggestedFor = "";
  private asked = false; // for the corners
  private sought = false; // the person has chosen the moment of the next stroke
  private ways: readonly number[] = []; // of playing the last shot
  private readonly film = new Film(
    () => (this.sought = true),
    (text) => (this.status.textContent = text),
  );
  private readonly marks = s("svg", { viewBox: "0 0 1 1", preserveAspectRatio: "none", "aria-hidden": "true" });
  private readonly score = h("p", { class: "score" });
  private readonly prompt = h("p", { class: "prompt", role: "status" });
  private readonly refusal = h("p", { class: "refusal", role: "alert" });
  private readonly keys = h("div", { class: "keys" });
  private readonly court = s("svg", { class: "mini", viewBox: "-3.3 -7 6.6 14", "aria-hidden": "true" });
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
    this.board = h(
      "div",
      { class: "board" },
      this.score,
      this.prompt,
      this.refusal,
      this.keys,
      h("div", { class: "done" }, this.court, this.list),
    );
    this.resume();
    document.title = say("tag.title", { video: file.video });
    document.body.classList.add("tagging");
    const picture = h(
      "div",
      { class: "picture", onpointerdown: (event) => this.clicked(event as PointerEvent) },
      this.film.video,
      this.marks,
    );
    document.body.append(
      h(
        "main",
        {},
        h("div", { class: "film" }, picture, this.film.bar, this.controls(), this.status),
        h("div", {}, this.setup, this.board),
      ),
    );
    this.film.video.addEventListener("error", () => this.refused(say("tag.cannot")));
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
    const known = this.suggestedFor === this.line() ? this.suggested : null;
    const suggested = known?.map(({ shot }) => this.hall.shots[shot]) ?? null;
    const ways = Object.fromEntries(known?.filter(likely).map(({ shot, ways }) => [this.hall.shots[shot], ways]) ?? []);
    const strokes = rallies.at(-1)?.strokes ?? [];
    const { inputs, unsaved, savingTimes } = this;
    return {
      ready: true,
      phase,
      games,
      question,
      last: strokes.at(-1) ?? null,
      strokes: strokes.length,
      suggested,
      ways,
      corners: this.state.corners.length,
      rally: rallies.length,
      inputs: inputs.length,
      unsaved: unsaved.length,
      saving_ms: savingTimes,
    };
  }

  private resume(): void {
    const known = this.file.inputs.map((text) => JSON.parse(text) as Input);
    this.inputs.push(...known);
    this.state = replay(known, this.hall);
    // The table may lack what the last input changed.
    const last = this.state.rallies.at(-2)?.strokes.length ?? 0;
    const all = this.table();
    const settled = Math.max(0, all.length - last - (this.state.rallies.at(-1)?.strokes.length ?? 0));
    this.sent = all.slice(0, Math.min(settled, this.file.rows)).map((row) => JSON.stringify(row));
    if (known.length) {
      this.save("rows");
      this.toLast();
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
      h(
        "label",
        {},
        label,
        h(
          "select",
          { name, required: !name.endsWith("hand") },
          ...options.map(([value, text]) => h("option", { value }, text)),
        ),
      );
    const hands: [string, string][] = [
      ["", say("tag.hand_unknown")],
      ["right", say("tag.hand_right")],
      ["left", say("tag.hand_left")],
    ];
    const ordered = [this.file.rules, ...Object.keys(RULES).filter((name) => name !== this.file.rules)];
    return h(
      "form",
      {
        onsubmit: (event) => {
          event.preventDefault();
          const of = (name: string) => String(new FormData(this.setup).get(name)).trim();
          const discipline = of("discipline") as "MS" | "WS";
          const players: [string, string] = [of("near"), of("far")];
          const hands = [of("near_hand") || null, of("far_hand") || null] as [Hand, Hand];
          const [server, rules] = [Number(of("server")) as 0 | 1, of("rules") as Rules];
          this.enter({ kind: "setup", match: of("match"), discipline, players, hands, server, rules });
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
        ["", say("tag.discipline_asked")],
        ["MS", say("disciplines.men")],
        ["WS", say("disciplines.women")],
      ]),
      select(
        "rules",
        say("tag.rules"),
        ordered.map((name) => [name, name]),
      ),
      h("button", { type: "submit" }, say("tag.begin")),
    );
  }

  private controls(): HTMLElement {
    const button = (text: string, label: string, act: () => void) =>
      h("button", { type: "button", "aria-label": label, title: label, onclick: act }, text);
    return h(
      "div",
      { class: "controls" },
      button(say("tag.play"), say("tag.play_about"), () => this.film.toggle()),
      button("−1", say("tag.back_about"), () => this.film.step(-1)),
      button("+1", say("tag.on_about"), () => this.film.step(1)),
      button("½×", say("tag.slower"), () => this.film.speed(0.5)),
      button("2×", say("tag.faster"), () => this.film.speed(2)),
      button(say("tag.skip"), say("tag.skip_about"), () => this.film.skip()),
      button(say("tag.last"), say("tag.last_about"), () => this.toLast()),
      button(say("tag.corners"), say("tag.corners_about"), () => {
        this.asked = true;
        this.show();
      }),
      button(say("tag.undo"), say("tag.undo_about"), () => this.undo()),
    );
  }

  private get marking(): boolean {
    const known = this.state.corners.length;
    return (this.asked || known > 0) && known < CORNERS.length;
  }

  private toLast(): void {
    this.film.jump(this.state.met ?? this.state.rallies.flatMap(({ strokes }) => strokes).at(-1)?.time ?? 0);
  }

  private pressed(event: KeyboardEvent): void {
    const target = event.target as HTMLElement;
    const slides = target.matches("[type=range]") && !/^(Arrow|Page|End)/.test(event.key);
    if (event.ctrlKey || event.metaKey || event.altKey || (!slides && /^(INPUT|SELECT)$/.test(target.tagName))) {
      return;
    }
    if ((event.key === "Enter" || event.key === " ") && target.closest("button")) {
      return;
    }
    const acts = this.acts();
    const key = keyOf(event);
    const act = acts[key] ?? acts[key.toLowerCase()];
    if (act) {
      event.preventDefault();
      act(event.shiftKey);
    }
  }

  /** What each key does; letters are shots, and endings after a stroke. */
  private acts(): Record<string, (shift: boolean) => void> {
    const acts: Record<string, (shift: boolean) => void> = {
      " ": () => this.film.toggle(),
      ",": () => this.film.step(-1),
      ".": () => this.film.step(1),
      "<": () => this.film.speed(0.5),
      ">": () => this.film.speed(2),
      ArrowLeft: () => this.film.seek(-1),
      ArrowRight: () => this.film.seek(1),
      PageDown: () => this.film.skip(),
      PageUp: () => this.film.back(),
      End: () => this.toLast(),
      Backspace: () => this.undo(),
      Enter: () => this.enter({ kind: "confirm" }),
      q: () => this.nextWay(),
    };
    this.shots().forEach((shot) => (acts[SHOT_KEYS[shot]!] = (shift) => this.shot(shot, shift)));
    ENDINGS.forEach((ending) => (acts[END_KEYS[ending]] = () => this.enter({ kind: "end", ending })));
    for (let cell = 1; cell <= 9; cell++) {
      acts[cell] = () => this.enter({ kind: "cell", cell, time: this.film.at });
    }
    return acts;
  }

  /** Shot types that may come next: serves, or the others. */
  private shots(): number[] {
    const serves = this.state.setup !== null && current(this.state).strokes.length === 0;
    return this.hall.shots.map((_, shot) => shot).filter((shot) => shot < 2 === serves);
  }

  /** Ways of playing a shot, the most probable first. */
  private waysOf(shot: number): readonly number[] {
    const known = this.suggestedFor === this.line() ? this.suggested.find((one) => one.shot === shot) : undefined;
    if (known && known.probability > 0) {
      return known.ways;
    }
    const above = Number(/^(clear|drop|smash|half-smash|net-kill)$/.test(this.hall.shots[shot]!));
    const all = this.hall.techniques.flatMap((_, technique) => [0, 1].map((height) => 2 * technique + height));
    return all.sort((a, b) => Number(a % 2 !== above) - Number(b % 2 !== above));
  }

  /** Enters a shot in its usual way, or in the next one. */
  private shot(shot: number, other: boolean): void {
    const known = this.suggestedFor === this.line() ? this.suggested.find((one) => one.shot === shot) : undefined;
    this.ways = this.waysOf(shot);
    const way = this.ways[Number(other)]!;
    this.enter({
      kind: "shot",
      shot,
      time: (this.sought ? null : this.state.met) ?? this.film.at,
      technique: Math.floor(way / 2),
      height: way % 2,
      probability: known?.probability ?? null,
      areas: known?.areas ?? null,
    });
  }

  private nextWay(): void {
    const last = this.state.setup && current(this.state).strokes.at(-1);
    const ways = this.ways.length ? this.ways : this.waysOf(last?.shot ?? 0);
    const way = ways[(ways.indexOf(last ? 2 * last.technique + last.height : 0) + 1) % ways.length]!;
    this.enter({ kind: "way", technique: Math.floor(way / 2), height: way % 2 });
  }

  private clicked(event: PointerEvent): void {
    const box = this.film.video.getBoundingClientRect();
    const [x, y] = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
    event.preventDefault();
    if (this.marking) {
      this.enter({ kind: "corner", x, y });
    } else if (this.state.phase === "place") {
      this.enter({ kind: "place", x, y, time: this.film.at });
      if (event.shiftKey) {
        this.fall();
      }
    } else if (this.state.setup) {
      this.film.toggle();
    }
  }

  /** Ends the rally at the last place, if that tells how. */
  private fall(): void {
    const ending = fell(this.state, this.hall);
    if (ending) {
      this.enter({ kind: "end", ending });
    } else if (this.state.phase === "shot") {
      this.refused(say("refusal.ending"));
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
    this.asked = input.kind === "setup";
    this.refused("");
    this.save(input);
    this.show();
    this.follow(input);
  }

  /** The film goes on after an input, and stops where something is asked. */
  private follow({ kind }: Input): void {
    const { phase, met } = this.state;
    this.sought = this.sought && kind === "way";
    if (phase === "ask" || phase === "over") {
      this.film.video.pause();
    } else if (phase === "place" && kind !== "way") {
      this.film.go();
    } else if (kind === "end" || (kind === "confirm" && !current(this.state).strokes.length)) {
      this.film.skip(SOON);
    } else if (kind === "cell" || kind === "place" || kind === "confirm") {
      this.film.go((met ?? Number.POSITIVE_INFINITY) + FLIGHT);
    }
  }

  private undo(): void {
    const last = this.inputs.pop();
    if (last) {
      if ("time" in last) {
        this.film.jump(last.time);
      }
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
        this.savingTimes.push(performance.now() - change.begun);
        this.status.textContent = say("tag.saved", { inputs: change.inputs, strokes: change.strokes, file: this.file.out });
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
    if (state.corners.length === CORNERS.length) {
      this.film.crop(state.corners);
    }
    this.film.show(
      state.rallies.flatMap(({ strokes, points }) =>
        strokes.length ? [{ from: strokes[0]!.time, to: strokes.at(-1)!.time, label: points.join(" : ") }] : [],
      ),
    );
    const { points, server, game } = current(state);
    const after = state.rallies.filter((rally) => rally.strokes.length).length;
    const [a, b] = state.setup!.players;
    replaceChildren(
      this.score,
      server === 0 && "• ",
      shown(a),
      ` ${points[0]} : ${points[1]} `,
      shown(b),
      server === 1 && " •",
      h("small", {}, say("tag.place", { game, rally: after, name: state.setup!.players[state.near] })),
    );
    this.prompt.textContent = this.marking
      ? say("tag.corner", { corner: say(`tag.${CORNER_NAMES[state.corners.length]!}`) })
      : this.asks();
    this.showKeys();
    this.showList();
    this.suggest();
  }

  private way(way: number): string {
    const height = say(`heights.${this.hall.heights[way % 2]}` as Key);
    return `${words(this.hall.techniques[Math.floor(way / 2)]!)} ${height}`;
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
    const key = (label: string, name: string, act: (shift: boolean) => void, kind = "", note: Child = null) => {
      const onclick = (event: Event) => act((event as MouseEvent).shiftKey);
      return h("button", { type: "button", class: kind, onclick }, h("kbd", {}, label), ` ${name}`, note);
    };
    const blocks: Child[] = [];
    if (phase === "shot") {
      const fresh = this.suggestedFor === this.line() ? this.suggested : [];
      // The likely ones in their order, beside all of them at fixed places.
      const suggested = fresh.filter(likely).map(({ shot, probability }) => {
        const [usual, other] = this.waysOf(shot).map((way) => this.way(way));
        const note = h("small", {}, ` ${percent(probability)}`, h("br"), `${usual}, Shift: ${other}`);
        return key(SHOT_KEYS[shot]!, words(this.hall.shots[shot]!), (shift) => this.shot(shot, shift), "likely", note);
      });
      const grid = this.shots().map((shot) =>
        key(SHOT_KEYS[shot]!, words(this.hall.shots[shot]!), (shift) => this.shot(shot, shift)),
      );
      blocks.push(h("div", { class: "both" }, h("div", { class: "letters" }, ...grid), h("div", {}, ...suggested)));
    }
    if (phase === "place") {
      const cells = KEYPAD.map((cell) => key(String(cell), "", () => this.enter({ kind: "cell", cell, time: this.film.at })));
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
        key("q", say("tag.way"), () => this.nextWay()),
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

  /** The last stroke on a small court, as the picture shows it. */
  private showCourt(): void {
    const last = current(this.state).strokes.findLast(({ area }) => area !== null);
    const parts = courtLines(this.hall.court).map((line) =>
      s("polyline", { points: line.map(([x, y]) => `${x},${-y}`).join(" ") }),
    );
    if (last) {
      const sign = last.seat === this.state.near ? 1 : -1;
      const [[x0, x1], [y0, y1]] = this.hall.areas[last.area!]!.box;
      const [left, top] = [Math.min(sign * x0, sign * x1), Math.min(-sign * y0, -sign * y1)];
      parts.unshift(s("rect", { x: left, y: top, width: x1 - x0, height: y1 - y0 }));
      if (last.place) {
        parts.push(s("circle", { cx: sign * last.place[0], cy: -sign * last.place[1], r: 0.25 }));
      }
    }
    this.court.replaceChildren(...parts);
  }

  private showList(): void {
    this.showCourt();
    const { players, hands } = this.state.setup!;
    const items = this.state.rallies.slice(-40).flatMap((rally) =>
      rally.strokes.map(({ seat, shot, area, time }, i) => {
        const ending = i === rally.strokes.length - 1 && rally.ending ? say("language.comma") + say(`tag.${rally.ending}`) : "";
        const name = words(this.hall.shots[shot]!);
        const to = (index: number) => areaWords(this.hall.areas[index]!.name, hands[1 - seat] ?? "right");
        const stroke = area === null ? name : say("stroke.to", { shot: name, area: to(area) });
        const text = say("tag.listed", { time: decimal(time, 1), name: players[seat], stroke, ending });
        const jump = () => this.film.jump(time);
        return h("li", { class: i ? "" : "first" }, h("button", { type: "button", onclick: jump }, text));
      }),
    );
    replaceChildren(this.list, ...items.reverse());
  }

  /** The corners, and the lines of the court through them. */
  private showMarks(): void {
    const { corners } = this.state;
    const dots = corners.map(([x, y]) => s("circle", { cx: x, cy: y, r: 0.008 }));
    const onPicture = corners.length === CORNERS.length ? homography(CORNERS, corners) : null;
    const lines = onPicture
      ? courtLines(this.hall.court).map((line) =>
          s("polyline", { points: line.map(([x, y]) => mapped(onPicture, x, y).join(",")).join(" ") }),
        )
      : [];
    this.marks.replaceChildren(...dots, ...lines);
  }
}
