// The page: what is shown, what plays, and who is asked for it.

import { Chances, Curve, LandingMap, MoveList, OptionTable, type Analysis, type Option } from "./analysis";
import { Board } from "./board";
import { cameraButtons, Chip, ScoreBug } from "./court_view";
import { h, percent, replaceChildren, words } from "./dom";
import { Layout, MODES, type Mode } from "./layout";
import { Learn } from "./learn";
import { readLink, writeLink, type Place } from "./link";
import type { Motion } from "./motion";
import { Player, SPEEDS } from "./player";
import { Recorder } from "./recorder";
import { SideCard, StylePanel, type Styles } from "./sides";
import { CAMERAS, Stage, type Camera } from "./stage";
import { save } from "./share";
import { endSentence, startSentence, strokeSentence } from "./told";
import type { Hello, Person, Plan, RallyFacts, Side, Turn } from "./wire";

/** A rally that is asked for: of a match by its plan, or of what was recorded. */
export interface Wanted {
  plan: Plan | null;
  rally: number;
  person: Person | null;
  tried: Record<string, number>;
}

export interface Shown {
  rally: RallyFacts;
  motion: Motion;
}

export interface Source {
  /** `before` has the frames before the branch of a motion that continues it. */
  rally(wanted: Wanted, before: Motion | null): Promise<Shown>;
  analysis(wanted: Wanted): Promise<Analysis>;
  options(wanted: Wanted): Promise<Option[]>;
  styles(wanted: Wanted): Promise<Styles>;
  model(athlete: string): Promise<ArrayBuffer>;
  /** A page that opens from disk with these rallies; null where the page itself is one. */
  share: ((wanted: Wanted[], title: string, hash: string) => Promise<Blob>) | null;
}

const EARLY = 0.45; // how long before they strike a person is waited for [s]

const STILL = matchMedia("(prefers-reduced-motion: reduce)");

const SETTLING = 45; // frames in which cameras and poses come to rest

export class App {
  readonly player = new Player();
  readonly stage: Stage | null;
  private plan: Plan | null;
  private number = 0;
  private tried: Record<string, number> = {};
  private person: Person | null = null;
  private analysis: Analysis | null = null;
  private mode: Mode = "watch";
  private shown: Shown | null = null;
  private original: Plan | null = null;
  private readonly modes: readonly Mode[];
  private readonly layout: Layout;
  private readonly bug = new ScoreBug();
  private readonly chip = new Chip();
  private readonly cameras = cameraButtons((camera) => this.setCamera(camera));
  private readonly curve = new Curve((time) => this.seek(time));
  private readonly moves = new MoveList((stroke) => this.seekStroke(stroke));
  private readonly options = new OptionTable((stroke) => void this.whatIf(stroke));
  private readonly chances = new Chances();
  private readonly landing: LandingMap;
  private readonly styles = new StylePanel();
  private readonly learn: Learn;
  private readonly board: Board;
  private readonly back = h("button", { class: "back hidden", onclick: () => void this.backToPlayed() }, "What if · back to what was played");
  private readonly sides: [SideCard, SideCard];
  private readonly recorder = new Recorder(save);
  private readonly cache = new Map<string, Promise<Shown>>();
  private readonly played: { number: number; rally: RallyFacts; analysis: Promise<Analysis> }[] = [];
  private aim: [number, number, number, number] | null = null;
  private hidden: number | null = null; // in Learn: number of strokes whose worth may be seen
  private request = 0;
  private pending = false; // whether the rally that was asked for last is still on its way
  private filming = false;
  private loopRally = false;
  private autoNext = true;
  private last = 0;
  private saidStroke = -2;
  private shownStroke = -2;
  private ended = false;
  private readonly frameTimes: number[] = [];
  private seen = "";
  private unsettled = 0;
  private styled = ""; // sides whose style is shown
  private answered: Turn | null = null;
  private chosenAt = 0;
  private turnTimes: number[] = [];

  constructor(
    private readonly hello: Hello,
    private readonly source: Source,
  ) {
    const place = readLink(location.hash);
    const recorded = hello.recorded !== null;
    this.modes = recorded || !source.share ? MODES.slice(0, 3) : MODES;
    this.plan = recorded ? null : (place.plan ?? hello.plan);
    this.tried = place.tried;
    this.stage = this.makeStage();
    this.landing = new LandingMap(hello.hall);
    const card = (seat: number) => new SideCard(seat, hello.policies, (side) => this.changeSide(seat, side), () => void this.takeOver(seat));
    this.sides = [card(0), card(1)];
    this.learn = new Learn({
      stopBefore: (stroke) => this.stopBefore(stroke),
      reveal: (upTo) => this.reveal(upTo),
      finish: () => void this.go(this.number + 1),
    });
    this.board = new Board(hello.hall, {
      hit: (stroke) => void this.hit(stroke),
      hints: () => source.options(this.wanted(this.number)),
      aim: (box) => (this.aim = box),
    });
    this.layout = new Layout(
      {
        canvas: this.stage?.canvas ?? null,
        overlays: [this.bug.element, this.cameras.element, this.chip.element, this.chip.speed, this.back, this.board.element],
        left: [...(recorded || !source.share ? [] : this.sides.map((side) => side.element)), recorded ? null : this.styles.element],
        right: [this.learn.element, this.moves.element, this.options.element, this.chances.element, this.landing.element],
        curve: this.curve.element,
      },
      this.modes,
      {
        mode: (mode) => this.setMode(mode),
        newMatch: () => this.newMatch(),
        copyLink: () => this.copyLink(),
        savePicture: () => this.savePicture(),
        savePage: (match) => void this.savePage(match),
        saveFilm: () => this.saveFilm(),
        rally: (step) => void this.go(this.number + step),
        stroke: (step) => this.stepStroke(step),
        toggle: () => this.toggle(),
        replay: () => this.player.replayLast(),
        speed: (speed) => (this.player.speed = speed),
        loop: (on) => (this.loopRally = on),
        autoNext: (on) => (this.autoNext = on),
        seek: (time) => this.seek(time),
        textMode: (on) => this.layout.showText(on),
      },
      source.share !== null,
      !recorded && source.share !== null,
    );
    this.layout.showMode(this.mode, this.modes);
    this.layout.showText(!this.stage);
    new ResizeObserver(() => this.resize()).observe(this.layout.court);
    this.resize();
    this.listen();
    const first = location.hash ? place.rally : (hello.recorded?.first ?? 0);
    void this.go(first, place.stroke, place.stroke === null);
    requestAnimationFrame((now) => this.frame(now));
  }

  private makeStage(): Stage | null {
    const asked = new URLSearchParams(location.search).get("quality");
    try {
      const stage = new Stage(this.hello.hall, (name) => this.source.model(name), asked === "full" || asked === "lite" ? asked : "auto", STILL.matches);
      stage.canvas.addEventListener("click", (event) => {
        const place = stage.floorAt(event.clientX, event.clientY);
        if (place && this.board.turn) {
          this.board.aimAt(...place);
        }
      });
      return stage;
    } catch {
      return null;
    }
  }

  private resize(): void {
    const { clientWidth, clientHeight } = this.layout.court;
    if (clientWidth && clientHeight) {
      this.stage?.resize(clientWidth, clientHeight);
    }
  }

  // What is shown.

  private wanted(rally: number): Wanted {
    return { plan: this.plan, rally, person: this.person, tried: rally === this.number ? this.tried : {} };
  }

  private load(wanted: Wanted, before: Motion | null = null): Promise<Shown> {
    const key = JSON.stringify(wanted);
    let found = this.cache.get(key);
    if (!found) {
      found = this.source.rally(wanted, before);
      this.cache.set(key, found);
      found.catch(() => this.cache.delete(key));
      while (this.cache.size > 10) {
        this.cache.delete(this.cache.keys().next().value!);
      }
    }
    return found;
  }

  /** Shows a rally, from its start or from a stroke of it. */
  async go(number: number, stroke: number | null = null, playing = this.player.playing): Promise<void> {
    const most = this.hello.recorded?.count ?? Infinity;
    if (number < 0 || number >= most) {
      return;
    }
    if (number !== this.number) {
      this.tried = {};
    }
    const shown = await this.fetch(this.wanted(number));
    if (shown) {
      this.number = number;
      const time = stroke === null ? 0 : (shown.rally.strokes[stroke]?.time ?? 0);
      this.show(shown, time, playing && stroke === null);
    }
  }

  /** A rally, or null if something else was asked for meanwhile, or it cannot be had; `undo` then takes back what it was for. */
  private async fetch(wanted: Wanted, before: Motion | null = null, undo: () => void = () => {}): Promise<Shown | null> {
    const request = ++this.request;
    this.pending = true;
    try {
      const shown = await this.load(wanted, before);
      await this.stage?.prepare(shown.rally);
      return request === this.request ? shown : null;
    } catch (error) {
      if (request === this.request) {
        undo();
        this.layout.say((error as Error).message, true);
      }
      return null;
    } finally {
      if (request === this.request) {
        this.pending = false;
      }
    }
  }

  private show(shown: Shown, time: number, playing: boolean): void {
    this.recorder.stop();
    this.layout.quiet();
    this.shown = shown;
    this.player.show(shown.rally, shown.motion, time);
    this.player.playing = playing;
    document.body.dataset["ready"] = "";
    this.player.stopAt = shown.rally.turn ? Math.max(0, this.player.duration - EARLY) : null;
    this.player.waiting = shown.rally.turn && !shown.rally.strokes.length && !STILL.matches ? this.player.duration - EARLY : null;
    this.ended = false;
    this.analysis = null;
    this.shownStroke = this.saidStroke = -2;
    this.hidden = this.mode === "learn" ? 0 : null;
    this.learn.end();
    this.board.show(null);
    this.showRally();
    void this.analyse(this.request);
    if (shown.rally.winner !== null && !shown.rally.after?.over && this.mode !== "learn") {
      this.load({ ...this.wanted(this.number + 1), tried: {} }).catch(() => {}); // staged while this one plays
    }
  }

  private async analyse(request: number): Promise<void> {
    const wanted = this.wanted(this.number);
    const { rally } = this.shown!;
    try {
      if (rally.strokes.length) {
        const asked = this.source.analysis(wanted);
        if (this.person && rally.winner !== null && !this.played.some((one) => one.number === rally.number)) {
          this.played.push({ number: rally.number, rally, analysis: asked });
        }
        const analysis = await asked;
        if (request === this.request) {
          this.analysis = analysis;
          this.showWorth();
          if (this.mode === "learn") {
            this.learn.begin(rally, analysis);
          }
        }
      }
      const sides = this.plan && JSON.stringify(sidesIn(this.plan, this.number));
      if (sides && sides !== this.styled) {
        const styles = await this.source.styles(wanted);
        if (request === this.request) {
          this.styled = sides;
          this.styles.show(styles);
        }
      }
    } catch (error) {
      if (request === this.request) {
        this.layout.say((error as Error).message, true);
      }
    }
  }

  private showRally(): void {
    const { rally } = this.shown!;
    this.layout.scrubber.max = String(this.player.duration);
    const where = this.hello.recorded ? ` · ${this.hello.recorded.title}` : this.plan ? ` · seed ${this.plan.seed}` : "";
    this.layout.what.textContent = `${rally.names[0]} (A) v ${rally.names[1]} (B)${where} · rally ${rally.number + 1}`;
    if (this.plan) {
      sidesIn(this.plan, this.number).forEach((side, seat) => this.sides[seat]!.show(side, this.person?.seat === seat));
    }
    replaceChildren(this.layout.told, h("li", {}, startSentence(rally)));
    this.layout.banner.classList.add("hidden");
    this.back.classList.toggle("hidden", this.original === null && !Object.keys(this.tried).length);
    this.showWorth();
    this.remember();
  }

  private showWorth(): void {
    const { rally } = this.shown!;
    const seen = this.hidden === null ? this.analysis : null;
    this.curve.show(rally, this.player.duration, seen);
    this.moves.show(rally, seen, this.hidden ?? (this.mode === "play" ? Math.max(this.player.stroke + 1, 0) : Infinity));
    this.shownStroke = -2;
  }

  // What the viewer does.

  setMode(mode: Mode): void {
    const before = this.mode;
    this.mode = mode;
    this.layout.showMode(mode, this.modes);
    this.autoNext = mode === "watch" || mode === "play";
    this.layout.showAutoNext(this.autoNext);
    if (mode === "play" && !this.person) {
      void this.takeOver(0);
      return;
    }
    if (before === "play" && this.person) {
      this.person = null;
    }
    void this.go(this.number, mode === "analyse" ? Math.max(this.player.stroke, 0) : null, mode === "watch");
  }

  toggle(): void {
    if (!this.player.playing && this.player.time >= this.player.duration) {
      this.player.seek(0);
    }
    const mine = this.board.turn && (this.player.waits || this.player.time >= this.player.duration - EARLY);
    this.player.playing = !this.player.playing && !mine;
  }

  seek(time: number): void {
    const limit = this.shown?.rally.turn ? this.player.duration - EARLY : Infinity;
    this.player.seek(Math.min(time, limit));
  }

  seekStroke(stroke: number): void {
    this.player.playing = false;
    this.seek(this.shown?.rally.strokes[stroke]?.time ?? 0);
    this.remember();
  }

  stepStroke(step: number): void {
    if (this.player.stepStroke(step)) {
      this.remember();
    } else {
      this.seek(step > 0 ? this.player.duration : 0);
    }
  }

  setCamera(camera: Camera): void {
    if (this.stage) {
      this.stage.camera = camera;
      this.cameras.show(camera);
    }
  }

  setSpeed(step: number): void {
    const at = SPEEDS.findIndex((speed) => speed >= this.player.speed);
    this.player.speed = SPEEDS[Math.min(Math.max(at + step, 0), SPEEDS.length - 1)]!;
    this.layout.speed.value = String(this.player.speed);
  }

  newMatch(): void {
    if (this.plan && this.source.share) {
      this.plan = { seed: Math.floor(Math.random() * 2 ** 31), sides: sidesIn(this.plan, this.number) };
      this.original = null;
      this.played.length = 0;
      if (this.person) {
        this.person = { ...this.person, rally: 0, stroke: 0 };
      }
      void this.go(0, null, true);
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
    this.layout.say(`${side.policy} plays from the next rally on`);
    this.remember();
    this.load(this.wanted(from)).catch((error: Error) => this.layout.say(error.message, true));
  }

  /** A person takes the place of a policy from the next stroke that can still be chosen, or hands it back. */
  async takeOver(seat: number): Promise<void> {
    if (!this.plan || !this.source.share || !this.shown) {
      return;
    }
    if (this.person?.seat === seat) {
      const open = this.shown.rally.winner === null;
      this.person = null;
      this.setModeQuietly("watch");
      await this.go(this.number, null, true);
      this.layout.say(open ? "The policy plays this rally from its start" : "The policy plays on");
      return;
    }
    const stroke = this.player.stroke;
    const { time } = this.player;
    const before = this.person;
    this.person = { seat, rally: this.number, stroke: stroke < 0 ? 0 : stroke + 2 };
    this.setModeQuietly("play");
    const shown = await this.fetch(this.wanted(this.number), null, () => (this.person = before));
    if (shown) {
      this.show(shown, Math.min(time, shown.motion.duration), true);
      this.layout.say(`You play side ${"AB"[seat]}: choose a stroke, then Enter`);
    }
  }

  private setModeQuietly(mode: Mode): void {
    this.mode = mode;
    this.autoNext = true;
    this.layout.showMode(mode, this.modes);
    this.layout.showAutoNext(true);
  }

  private async hit(stroke: number): Promise<void> {
    const { shown, plan } = this;
    if (!shown?.rally.turn || !plan) {
      return;
    }
    this.chosenAt = performance.now();
    const { number } = shown.rally.turn;
    const chosen = { ...plan.chosen?.[this.number], [number]: stroke };
    this.plan = { ...plan, chosen: { ...plan.chosen, [this.number]: chosen } };
    this.board.show(null);
    this.answered = shown.rally.turn;
    this.player.waiting = null;
    // What is left of the motion plays while the rest is staged.
    this.player.stopAt = Math.max(this.player.time, this.player.duration - 0.1);
    this.player.playing = true;
    const next = await this.fetch(this.wanted(this.number), shown.motion, () => {
      this.plan = plan; // they choose again
      this.answered = null;
    });
    if (next) {
      const { time } = this.player;
      const contact = next.rally.strokes[number]?.time ?? Infinity;
      this.stage?.blendFrom(shown.motion, time);
      this.show(next, Math.min(time, contact - 0.12), true);
    }
  }

  /** Plays another stroke where one was struck; the rally continues from there. */
  async whatIf(stroke: number): Promise<void> {
    const { shown, plan } = this;
    if (!shown || !this.source.share) {
      return;
    }
    const at = Math.max(this.player.stroke, 0);
    const { original, tried } = this;
    (document.activeElement as HTMLElement | null)?.blur(); // the next space plays or pauses
    if (plan) {
      this.original ??= plan;
      const earlier = Object.entries(plan.chosen?.[this.number] ?? {}).filter(([k]) => Number(k) < at);
      const before = Object.entries(plan.chosen ?? {}).filter(([rally]) => Number(rally) < this.number);
      this.plan = { ...plan, chosen: { ...Object.fromEntries(before), [this.number]: { ...Object.fromEntries(earlier), [at]: stroke } } };
    } else {
      const earlier = Object.entries(this.tried).filter(([k]) => Number(k) < at);
      this.tried = { ...Object.fromEntries(earlier), [at]: stroke };
    }
    const next = await this.fetch(this.wanted(this.number), null, () => {
      this.plan = plan;
      this.original = original;
      this.tried = tried;
    });
    if (next) {
      const contact = next.rally.strokes[at]!.time;
      const earliest = at ? next.rally.strokes[at - 1]!.time : 0;
      this.show(next, Math.max(earliest, contact - 0.5), true);
    }
  }

  private async backToPlayed(): Promise<void> {
    const stroke = Math.max(this.player.stroke, 0);
    this.plan = this.original ?? this.plan;
    this.original = null;
    this.tried = {};
    await this.go(this.number, stroke);
  }

  // Learn.

  private stopBefore(stroke: number): void {
    const { strokes } = this.shown!.rally;
    const target = strokes[stroke]!.time - 0.03;
    const from = stroke ? strokes[stroke - 1]!.time - 0.3 : 0;
    if (this.player.time < from || this.player.time > target) {
      this.player.seek(Math.max(0, from));
    }
    this.hidden = stroke;
    this.showWorth();
    this.player.stopAt = target;
    this.player.playing = true;
  }

  private reveal(upTo: number): void {
    this.hidden = upTo === Infinity ? null : upTo + 1;
    this.showWorth();
    if (upTo !== Infinity) {
      this.player.stopAt = this.shown!.rally.strokes[upTo]!.end_time;
      this.player.playing = true;
    }
  }

  // Links, pictures, pages.

  get link(): string {
    return writeLink({ plan: this.plan, rally: this.number, stroke: this.player.stroke >= 0 ? this.player.stroke : null, tried: this.tried } satisfies Place);
  }

  private remember(): void {
    history.replaceState(null, "", this.link);
  }

  private copyLink(): void {
    this.remember();
    navigator.clipboard?.writeText(location.href).catch(() => {});
    this.layout.say("The address names seed, rally and stroke; it is in the clipboard");
  }

  private savePicture(): void {
    this.draw();
    this.stage?.canvas.toBlob((picture) => picture && save(picture, `rally-${this.number + 1}.png`));
  }

  /** Plays the rally from its start, at the speed that is set, and saves the court as it is seen. */
  private saveFilm(): void {
    if (!this.stage) {
      return;
    }
    this.layout.showText(false);
    this.recorder.stop();
    this.player.seek(0);
    this.player.playing = true;
    this.recorder.start(this.stage.canvas, `rally-${this.number + 1}.webm`);
    this.layout.say("filming until the rally is over, or is paused");
  }

  private async savePage(match: boolean): Promise<void> {
    if (!this.source.share || !this.shown) {
      return;
    }
    this.layout.say("making the page …");
    const numbers = match && this.plan ? Array.from({ length: this.number + 1 }, (_, i) => i) : [this.number];
    const { names } = this.shown.rally;
    try {
      const page = await this.source.share(numbers.map((number) => this.wanted(number)), `${names[0]} v ${names[1]}`, this.link);
      save(page, match ? "match.html" : `rally-${this.number + 1}.html`);
      this.layout.say(`saved, ${(page.size / 1e6).toFixed(1)} MB; it opens from disk`);
    } catch (error) {
      this.layout.say((error as Error).message, true);
    }
  }

  // Time.

  private frame(now: number): void {
    const began = performance.now();
    const seconds = Math.min(0.1, (now - this.last) / 1000);
    this.last = now;
    const ended = this.player.advance(seconds);
    if (this.recorder.on && (ended || !this.player.playing)) {
      this.recorder.stop();
    }
    if (!this.filming) {
      this.draw();
    }
    if (ended) {
      this.atEnd();
    }
    if (this.chosenAt && this.player.playing && !this.board.turn) {
      this.turnTimes.push(performance.now() - this.chosenAt);
      this.chosenAt = 0;
    }
    this.frameTimes.push(performance.now() - began);
    if (this.frameTimes.length > 240) {
      this.frameTimes.shift();
    }
    requestAnimationFrame((next) => this.frame(next));
  }

  private atEnd(): void {
    const { rally } = this.shown!;
    this.player.playing = false;
    if (this.loopRally) {
      this.player.seek(0);
      this.player.playing = true;
    } else if (this.autoNext && !this.pending && rally.winner !== null && !rally.after?.over) {
      void this.go(this.number + 1, null, true);
    }
  }

  /** Draws the moment that is shown, and all that depends on it. */
  draw(): void {
    const { shown, player } = this;
    if (!shown) {
      return;
    }
    const { rally, motion } = shown;
    if (!document.body.classList.contains("text")) {
      this.drawCourt(rally, motion);
    }
    const over = rally.winner !== null && player.time >= (rally.strokes.at(-1)?.end_time ?? Infinity);
    this.bug.show(rally, over);
    this.chip.show(rally, player.stroke);
    this.curve.move(player.time);
    if (this.stage) {
      this.cameras.show(this.stage.camera);
    }
    const time = player.waits ? player.duration - EARLY : player.time;
    this.layout.scrubber.value = String(time);
    this.layout.clock.textContent = `${time.toFixed(2)} / ${player.duration.toFixed(1)} s`;
    this.layout.showPlaying(player.playing);
    if (player.stroke !== this.shownStroke) {
      this.showStroke(player.stroke);
    }
    if (over && !this.ended) {
      this.rallyEnded();
    }
    if (rally.turn && rally.turn !== this.answered && player.stroke === rally.turn.number - 1) {
      this.board.show(rally.turn);
    }
    const question = this.learn.current;
    if (question !== null && !player.playing && Math.abs(player.time - (rally.strokes[question]!.time - 0.03)) < 0.05) {
      this.learn.ask();
    }
  }

  /** Draws the court if anything on it moves. */
  private drawCourt(rally: RallyFacts, motion: Motion): void {
    const { stage, player } = this;
    if (!stage) {
      return;
    }
    stage.raised = this.board.turn ? 0.2 : 0;
    const { clientWidth, clientHeight } = this.layout.court;
    const seen = [this.request, motion.frames, player.time, stage.camera, stage.flipped, stage.raised, this.aim, clientWidth, clientHeight].join();
    if (seen !== this.seen) {
      this.seen = seen;
      this.unsettled = SETTLING;
    }
    if (this.unsettled > 0 || stage.camera === "free") {
      this.unsettled--;
      stage.draw(rally, motion, player.time, this.aim);
    }
  }

  private showStroke(stroke: number): void {
    const { rally } = this.shown!;
    this.shownStroke = stroke;
    if (this.mode === "play") {
      this.showWorth();
      this.shownStroke = stroke;
    }
    const at = Math.max(stroke, 0);
    const known = this.hidden === null ? this.mode !== "play" || rally.winner !== null : at < this.hidden;
    this.moves.mark(stroke);
    this.options.show(rally, at, known ? this.analysis?.strokes[at] : undefined);
    this.chances.show(rally, at);
    const landing = known ? (this.analysis?.landings[at]?.[rally.strokes[at]?.seat ?? 0] ?? null) : null;
    this.landing.show(rally, at, landing);
    for (let i = Math.max(this.saidStroke + 1, 0); i <= stroke; i++) {
      this.layout.tell(strokeSentence(rally, i));
    }
    this.saidStroke = Math.max(this.saidStroke, stroke);
  }

  private rallyEnded(): void {
    const { rally } = this.shown!;
    const after = rally.after!;
    this.ended = true;
    const won = after.over ? "wins the match" : after.game_won ? "wins the game" : "wins the rally";
    replaceChildren(
      this.layout.banner,
      h("b", { class: rally.winner ? "b" : "a" }, rally.names[rally.winner!]!),
      ` ${won}`,
      h("small", {}, `${after.points[0]} – ${after.points[1]}`),
    );
    this.layout.banner.classList.remove("hidden");
    this.layout.tell(endSentence(rally));
    if (after.game_won && this.person) {
      void this.showGame(rally);
    }
  }

  /** The costliest decisions of a person in the game that is over. */
  private async showGame(rally: RallyFacts): Promise<void> {
    const games = rally.games[0] + rally.games[1];
    const seat = this.person!.seat;
    const mine = this.played.filter((one) => one.rally.games[0] + one.rally.games[1] === games);
    const found = await Promise.all(mine.map(async (one) => ({ ...one, analysis: await one.analysis })));
    const strokes = found.flatMap(({ number, rally: { strokes }, analysis }) =>
      strokes.flatMap((stroke, i) => (stroke.seat === seat && stroke.person ? [{ number, i, stroke, value: analysis.strokes[i]! }] : [])),
    );
    const worst = strokes.filter(({ value }) => value.regret > 0).sort((a, b) => b.value.regret - a.value.regret).slice(0, 5);
    const rows = worst.map(({ number, i, stroke, value }) => {
      const better = value.options.find((option) => option.stroke === value.better);
      const go = () => {
        this.layout.summary.close();
        this.setMode("analyse");
        void this.go(number, i);
      };
      return h(
        "li",
        { style: "margin:6px 0" },
        h("button", { onclick: go }, `rally ${number + 1}, stroke ${i + 1}`),
        ` ${words(stroke.shot)} to ${words(stroke.area)} gave away ${percent(value.regret)}`,
        better ? `; better: ${words(better.shot)} to ${words(better.area)}` : "",
      );
    });
    const mean = strokes.length ? strokes.reduce((sum, { value }) => sum + value.regret, 0) / strokes.length : 0;
    replaceChildren(
      this.layout.summary.querySelector("div")!,
      h("p", {}, `${rally.after!.points[0]} – ${rally.after!.points[1]}. You chose ${strokes.length} strokes; each gave away ${(100 * mean).toFixed(1)} % of a rally on average. The costliest:`),
      h("ol", {}, ...rows),
    );
    this.layout.summary.showModal();
  }

  // Keys.

  private listen(): void {
    document.addEventListener("keydown", (event) => {
      const target = event.target as HTMLElement;
      const typing = /^(SELECT|TEXTAREA)$/.test(target.tagName) || (target as HTMLInputElement).type === "range";
      const dialog = document.querySelector("dialog[open]") !== null && event.key !== "h";
      if (event.ctrlKey || event.metaKey || event.altKey || typing || dialog || (event.key === " " && target.closest("button, summary"))) {
        return;
      }
      if (event.key === "Enter" && target.closest("button, summary") && !this.board.element.contains(target)) {
        return;
      }
      if (this.key(event.key)) {
        event.preventDefault();
      }
    });
    window.addEventListener("hashchange", () => {
      const place = readLink(location.hash);
      if (place.plan && !this.hello.recorded) {
        this.plan = place.plan;
        this.original = null;
        if (this.person) {
          this.person = null; // a link names a match that is watched
          this.setModeQuietly("watch");
        }
      }
      this.number = place.rally;
      this.tried = place.tried;
      void this.go(place.rally, place.stroke);
    });
  }

  key(key: string): boolean {
    if (this.board.key(key)) {
      return true;
    }
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
      r: () => this.player.replayLast(),
      f: () => this.stage && (this.stage.flipped = !this.stage.flipped),
      n: () => this.newMatch(),
      t: () => void this.takeOver(0),
      T: () => void this.takeOver(1),
      w: () => this.layout.showText(!document.body.classList.contains("text")),
      h: () => this.layout.toggleHelp(),
      "?": () => this.layout.toggleHelp(),
    };
    acts[key]?.();
    return key in acts;
  }

  /** Leaves nothing but the court, for a video. */
  film(): void {
    this.player.playing = false;
    this.filming = true;
    document.body.classList.add("film");
    this.resize();
    this.seek(0);
  }

  /** What is seen, for tests and scripts. */
  state(): Record<string, unknown> {
    const { shown, player, stage } = this;
    const rally = shown?.rally ?? null;
    return {
      ready: rally !== null,
      mode: this.mode,
      rally: this.number,
      names: rally?.names,
      points: rally?.points,
      games: rally?.games,
      after: rally?.after,
      server: rally?.server,
      winner: rally?.winner,
      strokes: rally?.strokes.map((stroke) => stroke.stroke),
      contacts: rally?.strokes.map((stroke) => stroke.time),
      strikers: rally?.strokes.map((stroke) => stroke.seat),
      stroke: player.stroke,
      time: player.time,
      duration: player.duration,
      playing: player.playing,
      speed: player.speed,
      turn: this.board.turn,
      selected: this.board.selected ?? null,
      person: this.person,
      asked: this.learn.current,
      camera: stage?.camera,
      lite: stage?.lite,
      target: stage?.targetArea ?? null,
      shuttle: shown ? shown.motion.shuttleAt(player.time, [0, 0, 0]) : null,
      hips: shown ? [0, 1].map((seat) => shown.motion.hipsAt(player.time, seat, [0, 0, 0])) : null,
      rackets: [stage?.sweetSpot(0) ?? null, stage?.sweetSpot(1) ?? null],
      analysis: this.analysis,
      plan: this.plan,
      link: this.link,
      figures: stage?.figures,
      script_ms: [...this.frameTimes],
      turn_ms: [...this.turnTimes],
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
