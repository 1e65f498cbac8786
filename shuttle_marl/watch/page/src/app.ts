// The page: what is shown, what plays, and who is asked for it.

import { Chances, Curve, LandingMap, MoveList, OptionTable, type Analysis } from "./analysis";
import { cameraButtons, Chip, ScoreBug } from "./court_view";
import { h, replaceChildren } from "./dom";
import { icon } from "./icons";
import { readLink, writeLink } from "./link";
import { Motion } from "./motion";
import { Player, SPEEDS } from "./player";
import { SideCard, StylePanel, type Styles } from "./sides";
import { CAMERAS, Stage, type Camera } from "./stage";
import { endSentence, startSentence, strokeSentence } from "./told";
import type { Hello, Person, Plan, RallyFacts, Side } from "./wire";

export interface Source {
  rally(plan: Plan | null, rally: number, person: Person | null): Promise<{ rally: RallyFacts; motion: Motion }>;
  analysis(plan: Plan | null, rally: number, person: Person | null): Promise<Analysis>;
  styles(plan: Plan, rally: number): Promise<Styles>;
  model(athlete: string): Promise<ArrayBuffer>;
}

interface Shown {
  rally: RallyFacts;
  motion: Motion;
}

export class App {
  readonly player = new Player();
  readonly stage: Stage;
  plan: Plan | null;
  number = 0;
  analysis: Analysis | null = null;
  private readonly bug = new ScoreBug();
  private readonly chip = new Chip();
  private readonly cameras = cameraButtons((camera) => this.setCamera(camera));
  private readonly curve = new Curve((time) => this.seek(time));
  private readonly moves = new MoveList((stroke) => this.seekStroke(stroke));
  private readonly options = new OptionTable((stroke) => this.whatIf(stroke));
  private readonly chances = new Chances();
  private readonly landing: LandingMap;
  private readonly styles = new StylePanel();
  private readonly sides: [SideCard, SideCard];
  private readonly banner = h("div", { class: "banner hidden", role: "status" });
  private readonly notice = h("div", { class: "notice hidden", role: "alert" });
  private readonly told = h("ol", { class: "told", "aria-live": "polite", "aria-label": "The rally in words" });
  private readonly what = h("div", { class: "what" });
  private readonly playButton: HTMLButtonElement;
  private readonly speedSelect: HTMLSelectElement;
  private readonly scrubber: HTMLInputElement;
  private readonly clock = h("span", { class: "clock" });
  private readonly court = h("div", { class: "court" });
  private readonly cache = new Map<string, Promise<Shown>>();
  private shown: Shown | null = null;
  private request = 0;
  private loopRally = false;
  private autoNext = true;
  private last = 0;
  private saidStroke = -2;
  private shownStroke = -2;
  private frameTimes: number[] = [];
  person: Person | null = null;

  constructor(
    hello: Hello,
    private readonly source: Source,
    private readonly recorded: boolean,
  ) {
    const place = readLink(location.hash);
    this.plan = recorded ? null : (place.plan ?? hello.plan);
    const asked = new URLSearchParams(location.search).get("quality");
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.stage = new Stage(hello.hall, (name) => source.model(name), asked === "full" || asked === "lite" ? asked : "auto", still);
    this.landing = new LandingMap(hello.hall);
    const card = (seat: number) => new SideCard(seat, hello.policies, (side) => this.changeSide(seat, side), () => this.takeOver(seat));
    this.sides = [card(0), card(1)];
    this.playButton = h("button", { class: "play", onclick: () => this.toggle(), "aria-label": "Play" }, icon("play"));
    this.speedSelect = h(
      "select",
      { "aria-label": "Speed", onchange: () => (this.player.speed = Number(this.speedSelect.value)) },
      ...SPEEDS.map((speed) => h("option", { value: speed }, `${speed}×`)),
    );
    this.speedSelect.value = "1";
    this.scrubber = h("input", { type: "range", min: 0, max: 1, step: 0.02, value: 0, "aria-label": "Time in the rally", oninput: () => this.seek(Number(this.scrubber.value)) });
    this.build();
    this.listen();
    void this.go(place.rally, place.stroke);
    requestAnimationFrame((now) => this.frame(now));
  }

  private build(): void {
    const newMatch = h("button", { onclick: () => this.newMatch() }, "New match");
    const link = h("button", { onclick: () => this.copyLink() }, "Copy link");
    const help = h("button", { onclick: () => this.help.showModal(), "aria-label": "Keys" }, "? ", h("kbd", {}, "h"));
    const button = (name: string, label: string, act: () => void) => h("button", { onclick: act, "aria-label": label, title: label }, icon(name));
    const transport = h(
      "div",
      { class: "transport", role: "group", "aria-label": "Playback" },
      button("first", "Rally before", () => void this.go(this.number - 1)),
      button("back", "Stroke before", () => this.stepStroke(-1)),
      this.playButton,
      button("forward", "Next stroke", () => this.stepStroke(1)),
      button("last", "Next rally", () => void this.go(this.number + 1)),
      button("replay", "Last stroke again, slowly", () => this.replay()),
      this.speedSelect,
      this.toggleButton("loop rally", () => (this.loopRally = !this.loopRally)),
      this.toggleButton("auto-next", () => (this.autoNext = !this.autoNext), true),
      this.scrubber,
      this.clock,
    );
    this.curve.element.append(transport);
    this.court.append(this.stage.canvas, this.bug.element, this.cameras.element, this.chip.element, this.chip.speed, this.banner, this.notice);
    this.stage.canvas.setAttribute("aria-label", "The court");
    this.stage.canvas.setAttribute("role", "img");
    const keys = h("section", { class: "panel" }, h("h2", {}, "Keys"), h("div", { class: "keys" }, ...keyList().flatMap(([key, what]) => [h("span", {}, h("kbd", {}, key), ` ${what}`)])));
    const words = h("section", { class: "panel" }, h("h2", {}, "In words"), this.told);
    document.body.append(
      h("header", { class: "top" }, h("h1", {}, "shuttle_marl"), this.what, this.recorded ? null : newMatch, link, help),
      h(
        "main",
        { class: "page" },
        h("div", { class: "column agents" }, ...(this.recorded ? [] : this.sides.map((side) => side.element)), this.styles.element, keys),
        h("div", { class: "middle" }, this.court, this.curve.element),
        h("div", { class: "column" }, this.moves.element, this.options.element, this.chances.element, this.landing.element, words),
      ),
      this.help,
    );
    new ResizeObserver(() => this.resize()).observe(this.court);
    this.resize();
    this.cameras.show(this.stage.camera);
  }

  private readonly help = h(
    "dialog",
    { "aria-label": "Keys" },
    h("h2", {}, "Keys"),
    h("ul", {}, ...keyList().map(([key, what]) => h("li", {}, h("kbd", {}, key), ` ${what}`))),
    h("p", { style: "margin-top:12px" }, h("button", { onclick: () => this.help.close() }, "Close")),
  );

  private toggleButton(name: string, act: () => void, on = false): HTMLButtonElement {
    const button = h("button", {
      "aria-pressed": String(on),
      onclick: () => {
        act();
        button.setAttribute("aria-pressed", String(button.getAttribute("aria-pressed") !== "true"));
      },
    }, name);
    return button;
  }

  private resize(): void {
    const { clientWidth, clientHeight } = this.court;
    if (clientWidth && clientHeight) {
      this.stage.resize(clientWidth, clientHeight);
    }
  }

  // What is shown.

  private load(plan: Plan | null, number: number): Promise<Shown> {
    const key = JSON.stringify([plan, number, this.person]);
    let found = this.cache.get(key);
    if (!found) {
      found = this.source.rally(plan, number, this.person);
      this.cache.set(key, found);
      found.catch(() => this.cache.delete(key));
      while (this.cache.size > 12) {
        this.cache.delete(this.cache.keys().next().value!);
      }
    }
    return found;
  }

  /** Shows a rally, from its start or from a stroke of it. */
  async go(number: number, stroke: number | null = null, playing = this.player.playing || this.shown === null): Promise<void> {
    if (number < 0) {
      return;
    }
    const request = ++this.request;
    try {
      const shown = await this.load(this.plan, number);
      await this.stage.prepare(shown.rally);
      if (request !== this.request) {
        return;
      }
      this.notice.classList.add("hidden");
      this.number = number;
      this.shown = shown;
      this.player.show(shown.rally, shown.motion, stroke === null ? 0 : (shown.rally.strokes[stroke]?.time ?? 0));
      this.player.playing = playing && stroke === null;
      this.showRally();
      void this.analyse(request);
      if (!shown.rally.after?.over) {
        this.load(this.plan, number + 1).catch(() => {}); // staged while this one plays
      }
    } catch (error) {
      if (request === this.request) {
        this.say(String((error as Error).message));
      }
    }
  }

  private async analyse(request: number): Promise<void> {
    try {
      const analysis = await this.source.analysis(this.plan, this.number, this.person);
      if (request === this.request) {
        this.analysis = analysis;
        this.showAnalysis();
      }
      if (this.plan) {
        const styles = await this.source.styles(this.plan, this.number);
        if (request === this.request) {
          this.styles.show(styles);
        }
      }
    } catch (error) {
      if (request === this.request) {
        this.say(String((error as Error).message));
      }
    }
  }

  private showRally(): void {
    const { rally } = this.shown!;
    this.analysis = null;
    this.shownStroke = this.saidStroke = -2;
    this.scrubber.max = String(this.player.duration);
    const seed = this.plan ? ` · seed ${this.plan.seed}` : "";
    this.what.textContent = `${rally.names[0]} (A) v ${rally.names[1]} (B)${seed} · rally ${rally.number + 1}`;
    const sides = this.plan ? sidesIn(this.plan, this.number) : null;
    sides?.forEach((side, seat) => this.sides[seat]!.show(side, this.person?.seat === seat));
    replaceChildren(this.told, h("li", {}, startSentence(rally)));
    this.banner.classList.add("hidden");
    this.showAnalysis();
    this.remember();
  }

  private showAnalysis(): void {
    const { rally } = this.shown!;
    this.curve.show(rally, this.player.duration, this.analysis);
    this.moves.show(rally, this.analysis);
    this.shownStroke = -2;
  }

  private say(words: string): void {
    this.notice.textContent = words;
    this.notice.classList.remove("hidden");
  }

  // What the viewer does.

  toggle(): void {
    if (!this.player.playing && this.player.time >= this.player.duration) {
      this.player.seek(0);
    }
    this.player.playing = !this.player.playing;
  }

  seek(time: number): void {
    this.player.seek(time);
  }

  seekStroke(stroke: number): void {
    this.player.playing = false;
    this.seek(this.shown?.rally.strokes[stroke]?.time ?? 0);
    this.remember();
  }

  stepStroke(step: number): void {
    if (this.player.stepStroke(step)) {
      this.remember();
    } else if (step > 0) {
      this.seek(this.player.duration);
    } else {
      this.seek(0);
    }
  }

  replay(): void {
    this.player.replayLast();
  }

  setCamera(camera: Camera): void {
    this.stage.camera = camera;
    this.cameras.show(camera);
  }

  setSpeed(step: number): void {
    const at = SPEEDS.findIndex((speed) => speed >= this.player.speed);
    this.player.speed = SPEEDS[Math.min(Math.max(at + step, 0), SPEEDS.length - 1)]!;
    this.speedSelect.value = String(this.player.speed);
  }

  newMatch(): void {
    if (this.plan) {
      const sides = sidesIn(this.plan, this.number);
      this.plan = { seed: Math.floor(Math.random() * 2 ** 31), sides };
      this.person = null;
      this.player.playing = true;
      void this.go(0);
    }
  }

  /** Another agent, or another temperature, from the next rally on; before the first serve from this one on. */
  changeSide(seat: number, side: Side): void {
    if (!this.plan) {
      return;
    }
    const from = this.number === 0 && this.player.stroke < 0 ? 0 : this.number + 1;
    if (from === 0) {
      const sides: [Side, Side] = [...this.plan.sides];
      sides[seat] = side;
      this.plan = { ...this.plan, sides, changes: [] };
      void this.go(0);
      return;
    }
    const kept = (this.plan.changes ?? []).filter((change) => change.rally < from || (change.rally === from && change.seat !== seat));
    this.plan = { ...this.plan, changes: [...kept, { rally: from, seat, side }] };
    this.say(`${side.policy} plays from the next rally on`);
    this.remember();
    this.load(this.plan, from).catch((error: Error) => this.say(error.message));
  }

  takeOver(_seat: number): void {}

  whatIf(_stroke: number): void {}

  get link(): string {
    return writeLink(this.plan, this.number, this.player.stroke >= 0 ? this.player.stroke : null);
  }

  private remember(): void {
    history.replaceState(null, "", this.link);
  }

  private copyLink(): void {
    this.remember();
    void navigator.clipboard?.writeText(location.href);
    this.say("The link names seed, rally and stroke; it is in the clipboard");
  }

  // Time.

  private frame(now: number): void {
    const began = performance.now();
    const seconds = Math.min(0.1, (now - this.last) / 1000);
    this.last = now;
    const ended = this.player.advance(seconds);
    this.draw();
    if (ended) {
      this.atEnd();
    }
    this.frameTimes.push(performance.now() - began);
    if (this.frameTimes.length > 240) {
      this.frameTimes.shift();
    }
    requestAnimationFrame((next) => this.frame(next));
  }

  private atEnd(): void {
    if (this.loopRally) {
      this.player.seek(0);
    } else if (this.autoNext && !this.shown?.rally.after?.over) {
      this.player.playing = true;
      const next = this.number + 1;
      this.player.playing = false;
      void this.go(next, null, true);
    } else {
      this.player.playing = false;
    }
  }

  /** Draws the moment that is shown, and all that depends on it. */
  draw(): void {
    const { shown, player } = this;
    if (!shown) {
      return;
    }
    const { rally, motion } = shown;
    this.stage.draw(rally, motion, player.time, null);
    const over = rally.winner !== null && player.time >= (rally.strokes.at(-1)?.end_time ?? Infinity);
    this.bug.show(rally, over);
    this.chip.show(rally, player.stroke);
    this.curve.move(player.time);
    this.cameras.show(this.stage.camera);
    this.scrubber.value = String(player.time);
    this.clock.textContent = `${player.time.toFixed(2)} / ${player.duration.toFixed(1)} s`;
    const name = player.playing ? "Pause" : "Play";
    if (this.playButton.getAttribute("aria-label") !== name) {
      this.playButton.setAttribute("aria-label", name);
      replaceChildren(this.playButton, icon(name.toLowerCase()));
    }
    this.showBanner(over);
    if (player.stroke !== this.shownStroke) {
      this.shownStroke = player.stroke;
      this.showStroke(player.stroke);
    }
  }

  private showStroke(stroke: number): void {
    const { rally } = this.shown!;
    const at = Math.max(stroke, 0);
    const value = this.analysis?.strokes[at];
    this.moves.mark(stroke);
    this.options.show(rally, at, value);
    this.chances.show(rally, at);
    const landing = this.analysis?.landings[at]?.[rally.strokes[at]?.seat ?? 0] ?? null;
    this.landing.show(rally, at, landing);
    for (let i = Math.max(this.saidStroke + 1, 0); i <= stroke; i++) {
      this.told.append(h("li", {}, strokeSentence(rally, i)));
    }
    this.saidStroke = Math.max(this.saidStroke, stroke);
    this.told.scrollTop = this.told.scrollHeight;
  }

  private showBanner(over: boolean): void {
    const { rally } = this.shown!;
    if (over === !this.banner.classList.contains("hidden")) {
      return;
    }
    this.banner.classList.toggle("hidden", !over);
    if (over && rally.after) {
      const { after } = rally;
      const won = after.over ? "wins the match" : after.game_won ? "wins the game" : "wins the rally";
      replaceChildren(
        this.banner,
        h("b", { class: rally.winner ? "b" : "a" }, rally.names[rally.winner!]!),
        ` ${won}`,
        h("small", {}, `${after.points[0]} – ${after.points[1]}`),
      );
      this.told.append(h("li", {}, endSentence(rally)));
    }
  }

  // Keys.

  private listen(): void {
    document.addEventListener("keydown", (event) => {
      const target = event.target as HTMLElement;
      if (event.ctrlKey || event.metaKey || event.altKey || /^(SELECT|TEXTAREA)$/.test(target.tagName) || (target as HTMLInputElement).type === "range") {
        return;
      }
      if (event.key === " " && target.tagName === "BUTTON") {
        return;
      }
      if (this.key(event.key)) {
        event.preventDefault();
      }
    });
    window.addEventListener("hashchange", () => {
      const place = readLink(location.hash);
      if (place.plan && !this.recorded) {
        this.plan = place.plan;
      }
      void this.go(place.rally, place.stroke);
    });
  }

  key(key: string): boolean {
    const camera = CAMERAS[Number(key) - 1];
    if (camera) {
      this.setCamera(camera);
      return true;
    }
    const acts: Record<string, () => void> = {
      " ": () => this.toggle(),
      ArrowLeft: () => this.stepStroke(-1),
      ArrowRight: () => this.stepStroke(1),
      ArrowUp: () => void this.go(this.number - 1),
      ArrowDown: () => void this.go(this.number + 1),
      ",": () => this.player.stepFrame(-1),
      ".": () => this.player.stepFrame(1),
      "<": () => this.setSpeed(-1),
      ">": () => this.setSpeed(1),
      r: () => this.replay(),
      f: () => (this.stage.flipped = !this.stage.flipped),
      n: () => this.newMatch(),
      h: () => (this.help.open ? this.help.close() : this.help.showModal()),
      "?": () => this.help.showModal(),
    };
    acts[key]?.();
    return key in acts;
  }

  /** What is seen, for tests and scripts. */
  state(): Record<string, unknown> {
    const { shown, player, stage } = this;
    const rally = shown?.rally ?? null;
    const frame = Math.round(player.time * player.duration);
    return {
      ready: rally !== null,
      rally: this.number,
      names: rally?.names,
      points: rally?.points,
      games: rally?.games,
      server: rally?.server,
      winner: rally?.winner,
      strokes: rally?.strokes.map((stroke) => stroke.stroke),
      contacts: rally?.strokes.map((stroke) => stroke.time),
      strikers: rally?.strokes.map((stroke) => stroke.seat),
      stroke: player.stroke,
      frame,
      time: player.time,
      duration: player.duration,
      playing: player.playing,
      speed: player.speed,
      camera: stage.camera,
      lite: stage.lite,
      target: stage.targetArea,
      shuttle: shown ? shown.motion.shuttleAt(player.time, [0, 0, 0]) : null,
      rackets: [stage.sweetSpot(0), stage.sweetSpot(1)],
      analysis: this.analysis,
      plan: this.plan,
      link: this.link,
      figures: stage.figures,
      script_ms: [...this.frameTimes],
    };
  }
}

/** Who plays a rally of a plan. */
export function sidesIn(plan: Plan, rally: number): [Side, Side] {
  const sides: [Side, Side] = [...plan.sides];
  for (const change of plan.changes ?? []) {
    if (change.rally <= rally) {
      sides[change.seat] = change.side;
    }
  }
  return sides;
}

function keyList(): [string, string][] {
  return [
    ["space", "play, pause"],
    ["← →", "stroke"],
    ["↑ ↓", "rally"],
    [", .", "frame"],
    ["< >", "speed"],
    ["1 – 6", "camera"],
    ["f", "other end"],
    ["r", "slow replay"],
    ["n", "new match"],
    ["h", "keys"],
  ];
}
