// View of a rally at a given time: the court, its overlays, and the panels.

import { Curve, MoveList, OptionTable } from "./analysis";
import { Board } from "./board";
import { Chip, cameraMenu, ScoreBug } from "./court_view";
import { Decisions } from "./decisions";
import { capitalised, h } from "./dom";
import type { Frames } from "./frame";
import { facing } from "./hall";
import { type Hooks, Layout, MODES, type Mode } from "./layout";
import { Learn } from "./learn";
import { MatchPanel } from "./match_panel";
import { displayName, shown } from "./names";
import { endSentence, startSentence, strokeSentence } from "./narration";
import type { Player } from "./player";
import { RallyBrowser } from "./rally_browser";
import { boxOf, PlacePanel } from "./recover";
import { SideCard, StylePanel } from "./sides";
import { Sound } from "./sound";
import type { Camera, Stage } from "./stage";
import type { Analysis, HallFacts, Hello, Option, OptionsReply, RallyFacts, Side, Styles, Turn } from "./wire.gen";
import { decimal, say } from "./words";

export interface Acts extends Hooks {
  seek(time: number): void;
  camera(camera: Camera): void;
  seekStroke(stroke: number): void;
  /** Shows a rally, from a stroke or from its start. */
  open(rally: number, stroke: number | null): void;
  whatIf(stroke: number): void;
  /** Plays the current stroke against a receiver who waits in another position. */
  waitThere(position: number): void;
  /** Shows the rally as it was played, if a stroke was tried. */
  backToPlayed(): Promise<void>;
  /** Plays the rally from shortly before a stroke. */
  playFrom(stroke: number): void;
  changeSide(seat: number, side: Side): void;
  takeOver(seat: number): void;
  choose(choice: number): void;
  hints(): Promise<OptionsReply>;
  /** Shows the rally of the next question. */
  nextQuestion(): void;
  /** Whether the page has no rally after this one. */
  isLast(): boolean;
  gameOver(rally: RallyFacts): void;
  /** Plays the rally again from the last stroke of the person on the court. */
  retry(): void;
}

const BEFORE = 0.03; // time before a contact at which a question stops the playback [s]

export class Screen {
  mode: Mode = "watch";
  analysis: Analysis | null = null;
  /** The last turn of a person, until the reply to it arrives. */
  answered: Turn | null = null;
  readonly layout: Layout;
  readonly learn: Learn;
  readonly board: Board;
  readonly match: MatchPanel;
  readonly decisions: Decisions;
  /** Rallies of a recorded match; null in a match between policies. */
  readonly browser: RallyBrowser | null;
  readonly styles = new StylePanel();
  private readonly sound = new Sound();
  private readonly modes: readonly Mode[];
  private readonly bug = new ScoreBug();
  private readonly chip = new Chip();
  private readonly cameras;
  private readonly curve: Curve;
  private readonly moves: MoveList;
  private readonly options: OptionTable;
  private readonly places: PlacePanel;
  /** Of rallies that were on the court: how many strokes were played, one more at their end. */
  private readonly furthest = new Map<string, number>();
  private readonly back: HTMLElement;
  private readonly sides: [SideCard, SideCard];
  private rally: RallyFacts | null = null;
  private hidden: number | null = null; // in Learn mode: number of strokes that are told
  private saidStroke = -2;
  private shownStroke = -2;
  private ended = false;
  private person = false; // whether one plays
  private readonly player: Player;
  private readonly stage: Stage | null;
  private readonly hall: HallFacts;

  /** @param live whether the page has a server. */
  constructor(
    hello: Hello,
    private readonly frames: Frames,
    private readonly acts: Acts,
    private readonly live: boolean,
  ) {
    const { player, stage } = frames;
    this.hall = hello.hall;
    this.player = player;
    this.stage = stage;
    const match = hello.recorded === null;
    this.modes = match && live ? MODES : MODES.slice(0, 3);
    this.cameras = cameraMenu((camera) => acts.camera(camera));
    this.moves = new MoveList((stroke) => acts.seekStroke(stroke));
    this.options = new OptionTable(live ? (stroke) => acts.whatIf(stroke) : null);
    this.places = new PlacePanel(hello.hall, live ? (position) => acts.waitThere(position) : null);
    this.decisions = new Decisions(() => acts.retry());
    this.match = new MatchPanel((rally, stroke) => acts.open(rally, stroke));
    this.browser = match ? null : new RallyBrowser((rally) => acts.open(rally, null), live, hello.recorded!.matches);
    this.back = h("button", { class: "back hidden", onclick: () => void acts.backToPlayed() }, say("page.back_to_played"));
    this.curve = new Curve((time) => acts.seek(time));
    const card = (seat: number) =>
      new SideCard(
        seat,
        hello.policies,
        (side) => acts.changeSide(seat, side),
        () => acts.takeOver(seat),
      );
    this.sides = [card(0), card(1)];
    this.learn = new Learn(hello.hall, {
      stopBefore: (stroke) => this.stopBefore(stroke),
      reveal: (upTo) => this.reveal(upTo),
      nextRally: () => acts.nextQuestion(),
      isLast: () => acts.isLast(),
      point: (option) => this.point(option),
      mark: (position) => this.markPlace(position),
      playFrom: async (stroke) => {
        await acts.backToPlayed();
        acts.playFrom(stroke);
      },
      playInstead: live
        ? (stroke, other) => {
            acts.seekStroke(stroke);
            other.stroke === undefined ? acts.waitThere(other.position!) : acts.whatIf(other.stroke);
          }
        : null,
      back: () => acts.backToPlayed(),
    });
    this.board = new Board(hello.hall, {
      choose: (choice) => acts.choose(choice),
      hints: () => acts.hints(),
      aim: (box) => (frames.aim = box),
      paint: (boxes) => (frames.legal = boxes),
    });
    this.layout = new Layout(
      {
        canvas: stage?.canvas ?? null,
        overlays: [this.bug.element, this.chip.element, this.back],
        cameras: this.cameras,
        sides: match && live ? this.sides.map((side) => side.element) : [],
        task: [this.learn.element, this.decisions.element, this.board.element],
        facts: [
          this.browser?.element ?? null,
          this.match.element,
          this.moves.element,
          this.options.element,
          this.places.element,
          match ? this.styles.element : null,
        ],
        timeline: this.curve.element,
      },
      this.modes,
      acts,
      live,
      match && live ? hello.duel : null,
    );
    this.layout.showMode(this.mode);
    this.layout.showText(!stage);
    stage?.canvas.addEventListener("pointermove", (event) => {
      this.board.point(stage.floorAt(event.clientX, event.clientY), event.clientX, event.clientY);
    });
    stage?.canvas.addEventListener("pointerleave", () => this.board.point(null, 0, 0));
    stage?.canvas.addEventListener("click", (event) => {
      const place = stage.floorAt(event.clientX, event.clientY);
      if (place && !stage.dragged) {
        this.board.playAt(...place);
        this.learn.answerAt(...place);
      }
    });
    if (stage) {
      const { canvas } = stage;
      const resize = () => canvas.clientWidth && frames.resize(canvas.clientWidth, canvas.clientHeight);
      new ResizeObserver(resize).observe(canvas);
      resize();
    }
  }

  /** Switches the sound on. */
  hear(): void {
    if (!this.sound.on) {
      this.toggleSound();
    }
  }

  /** Switches the sound. */
  toggleSound(): void {
    this.layout.showSound(this.sound.toggle());
  }

  showMode(mode: Mode): void {
    this.mode = mode;
    if (mode !== "analyse") {
      this.match.show(null, ["", ""], 0);
    }
    this.layout.showMode(mode);
  }

  /**
   * Shows a rally or its continuation.
   * @param where name of the match or log.
   * @param sides players; null for recorded rallies.
   * @param seat seat of the person; null: none plays.
   * @param tried whether it has tried strokes.
   */
  show(rally: RallyFacts, where: string, sides: [Side, Side] | null, seat: number | null, tried: boolean): void {
    this.rally = rally;
    this.ended = false;
    this.analysis = null;
    this.saidStroke = -2;
    const quiz = this.mode === "learn" && this.learn.covers(rally);
    this.hidden = this.mode === "learn" && !quiz ? 0 : null;
    if (!quiz) {
      this.learn.end();
    }
    this.board.show(null);
    this.layout.quiet();
    this.person = seat !== null;
    if (this.stage) {
      this.stage.raised = this.person;
    }
    this.board.playing = this.decisions.playing = this.person;
    this.browser?.show(null, rally.number, this.mode === "analyse");
    const [a, b] = rally.names.map((name) => shown(capitalised(displayName(name))));
    this.layout.title([a, say("page.versus"), b], say("page.title", { where, number: rally.number + 1 }));
    sides?.forEach((side, i) => this.sides[i]!.show(side, facing(rally, i) > 0, seat === i, rally.players[i]!.hand));
    this.layout.tellFromStart(startSentence(rally));
    this.back.classList.toggle("hidden", !tried);
    this.showValues();
  }

  showAnalysis(analysis: Analysis): void {
    this.analysis = analysis;
    this.showValues();
    if (this.mode === "learn") {
      this.learn.begin(this.rally!, analysis);
    }
  }

  private isOver(rally: RallyFacts): boolean {
    return rally.winner !== null && this.player.time >= (rally.strokes.at(-1)?.end_time ?? Infinity);
  }

  /** Draws the target and the flight of an answer. */
  private point(option: Option | null): void {
    const stroke = this.rally?.strokes[this.learn.current ?? -1];
    const pointed = option && stroke ? { box: option.box, from: stroke.contact, shot: option.shot } : null;
    this.frames.aim = pointed?.box ?? null;
    this.frames.flight = pointed;
  }

  /** Draws the position of an answer of the receiver. */
  private markPlace(position: number | null): void {
    const { rally } = this;
    const seat = 1 - (rally?.strokes[this.learn.current ?? -1]?.seat ?? 0);
    this.frames.aim = rally && position !== null ? boxOf(this.hall, rally, seat, position) : null;
  }

  /** @param styles null: they are being computed. */
  showStyles(styles: Styles | null): void {
    this.styles.show(styles);
    this.sides.forEach((side, seat) => side.showStrength(styles?.strength[seat as 0 | 1] ?? null));
  }

  /** Number of strokes of the rally that are told, one more with its end: in Watch and Play, what was on the court. */
  get told(): number {
    const { rally, mode } = this;
    const played = mode === "analyse" || mode === "learn" ? Infinity : (this.furthest.get(keyOf(rally!)) ?? 0);
    return this.hidden ?? played;
  }

  private showValues(): void {
    const rally = this.rally!;
    const seen = this.hidden === null ? this.analysis : null;
    this.curve.show(rally, this.player.duration, seen, this.told);
    this.moves.show(rally, seen, this.told);
    this.decisions.became(rally, this.told);
    this.shownStroke = -2;
  }

  private stopBefore(stroke: number): void {
    const { strokes } = this.rally!;
    const target = strokes[stroke]!.time - BEFORE;
    const from = stroke ? strokes[stroke - 1]!.time - 0.3 : 0;
    if (this.player.time < from || this.player.time > target) {
      this.player.seek(Math.max(0, from));
    }
    this.hidden = stroke;
    this.showValues();
    this.player.stopAt = target;
    this.player.playing = true;
  }

  private reveal(upTo: number): void {
    this.hidden = upTo === Infinity ? null : upTo + 1;
    this.showValues();
    if (upTo !== Infinity) {
      this.player.stopAt = this.rally!.strokes[upTo]!.end_time;
      this.player.playing = true;
    }
  }

  /** Updates everything beside the court to the current time. */
  update(): void {
    const { rally, player } = this;
    if (!rally) {
      return;
    }
    this.moves.keepInView();
    const over = this.isOver(rally);
    this.bug.show(rally, player.stroke >= 0, over);
    this.chip.show(rally, player.stroke, over, this.offersNew ? say("page.new_hint") : "");
    if (this.stage) {
      this.cameras.value = this.stage.camera;
    }
    const time = player.waits ? player.choice : player.time;
    this.curve.move(Math.min(time, player.duration));
    this.layout.clock.textContent = `${decimal(Math.min(time, player.duration), 1)} s`;
    this.layout.showPlaying(player.playing);
    if (player.stroke !== this.shownStroke) {
      this.showStroke(rally, player.stroke);
    }
    if (over && !this.ended) {
      this.rallyEnded(rally);
    }
    if (rally.turn && rally.turn !== this.answered && player.stroke === rally.turn.number - 1) {
      this.board.show(rally.turn, rally);
    }
    const question = this.learn.current;
    if (question !== null && !player.playing && Math.abs(player.time - (rally.strokes[question]!.time - BEFORE)) < 0.05) {
      this.learn.ask();
    }
  }

  private showStroke(rally: RallyFacts, stroke: number): void {
    if (this.player.playing && stroke > this.saidStroke && stroke >= 0) {
      this.sound.hit(rally.strokes[stroke]!.speed);
    }
    this.reach(stroke + 1);
    this.shownStroke = stroke;
    const at = Math.max(stroke, 0);
    const known = this.hidden === null ? this.mode === "analyse" : at < this.hidden;
    this.frames.waiting = known && this.mode === "analyse" ? (this.analysis?.strokes[at] ?? null) : null;
    this.moves.mark(stroke);
    this.options.show(rally, at, known ? this.analysis : null, this.mode === "learn");
    this.places.show(rally, at, known ? this.analysis : null);
    for (let i = Math.max(this.saidStroke + 1, 0); i <= stroke; i++) {
      this.layout.tell(strokeSentence(this.hall, rally, i));
    }
    this.saidStroke = Math.max(this.saidStroke, stroke);
  }

  /** Tells so many strokes of the rally, which were on the court. */
  private reach(count: number): void {
    const key = keyOf(this.rally!);
    if (count > (this.furthest.get(key) ?? 0)) {
      this.furthest.set(key, count);
      this.showValues();
    }
  }

  /** Whether `n` starts a new match; while a person plays, it is the net shot. */
  private get offersNew(): boolean {
    return this.live && this.browser === null && !this.person;
  }

  private rallyEnded(rally: RallyFacts): void {
    const after = rally.after!;
    this.ended = true;
    if (this.player.playing) {
      this.sound[rally.strokes.at(-1)?.end === "net" ? "net" : "bounce"]();
    }
    this.reach(rally.strokes.length + 1);
    this.layout.tell(endSentence(rally));
    if (this.person) {
      this.board.say(after.over ? say("board.over") : endSentence(rally));
    }
    if (after.game_won) {
      this.acts.gameOver(rally);
    }
  }
}

/** A rally as it was played. */
function keyOf({ number, names, strokes }: RallyFacts): string {
  return JSON.stringify([number, names, strokes.map(({ stroke }) => stroke)]);
}
