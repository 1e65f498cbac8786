// The page: state, playback and actions of the viewer.

import { Challenges } from "./challenges";
import { nextPicture, still } from "./dom";
import { Ending } from "./ending";
import { type FrameListener, Frames } from "./frame";
import { FriendGame } from "./friend";
import { facing } from "./hall";
import { keyTable, listen } from "./keys";
import type { Mode } from "./layout";
import { type Place, readLink } from "./link";
import { confirmed } from "./menus";
import { displayName, nameOnShirt } from "./names";
import type { Player } from "./player";
import { Rallies, type Shown, type Source } from "./rallies";
import { matchOf } from "./rally_browser";
import { type Acts, Screen } from "./screen";
import { save } from "./share";
import type { Stage } from "./stage";
import { type Choice, startCard } from "./start";
import { state } from "./state";
import { StrokeValues } from "./strokeValues";
import { playing, Timeline, type Tried } from "./timeline";
import type { FriendReply, Hello, RallyFacts, Side } from "./wire.gen";
import { decimal, say } from "./words";

/** That the strokes have the skill of both players, of a day or of the last one known. */
function skillWords(day: string): string {
  return day ? say("page.skill_of", { date: day }) : say("page.skill");
}

export class App {
  readonly stage: Stage | null;
  private readonly frames: Frames;
  private readonly player: Player;
  private readonly course: Timeline;
  private readonly screen: Screen;
  private readonly rallies: Rallies;
  private readonly keys: Record<string, () => void>;
  private readonly values: StrokeValues;
  private readonly challenges: Challenges;
  private shown: Shown | null = null;
  private card: HTMLElement | null = null; // of the first visit
  private pictured: Promise<void> | null = null; // resolves after the first picture
  private readonly ending: Ending;
  private readonly unseen: number[] = []; // times of choices after which no frame has moved yet
  private readonly listener: FrameListener = { update: () => this.screen.update(), drawn: (ended) => this.drawn(ended) };
  private readonly turnTimes: number[] = [];

  constructor(
    private readonly hello: Hello,
    private readonly source: Source,
  ) {
    const place = readLink(location.hash);
    this.course = new Timeline(hello.recorded ? null : (place.plan ?? hello.plan), place.tried);
    const quality = new URLSearchParams(location.search).get("quality");
    const known = quality === "full" || quality === "lite" ? quality : "auto";
    this.frames = new Frames(hello.hall, (name) => source.model(name), known, still(), nameOnShirt);
    const { player, stage } = this.frames;
    this.player = player;
    this.stage = stage;
    const acts = this.acts();
    this.screen = new Screen(hello, this.frames, acts, source.share !== null);
    const { layout } = this.screen;
    this.keys = keyTable(acts, this.player, this.stage, layout, this.live);
    this.rallies = new Rallies(
      source,
      async (rally) => this.stage?.prepare(rally),
      (error) => layout.say(error.message, true),
      (pending) => layout.showBusy(pending ? say("page.computing") : null),
    );
    this.values = new StrokeValues(source, this.course, this.rallies, this.screen);
    this.challenges = new Challenges(
      this.course,
      this.screen,
      source,
      this.values,
      {
        go: (rally, stroke, playing) => this.go(rally, stroke, playing),
        setMode: (mode) => this.setMode(mode),
        enter: (mode) => this.enter(mode, mode === "play"),
        seeFrom: (seat) => this.seeFrom(seat, null),
      },
      hello,
    );
    if (source.friend && this.live) {
      this.course.friend = new FriendGame(source.friend, layout, (now) => this.friendPlayed(now));
    }
    this.ending = new Ending(this.course, this.frames, this.rallies, () => this.go(this.course.number + 1, null, true));
    listen((key) => this.key(key), this.screen.board.element);
    window.addEventListener("hashchange", () => this.visit());
    const first = location.hash ? place.rally : (hello.recorded?.first ?? 0);
    const opened = this.openPlace({ ...place, rally: first }, place.stroke === null);
    this.frames.start(this.listener);
    if (!location.hash && this.live) {
      this.offer(opened);
    }
  }

  /** Offers duels and what else there is to do, once the first rally is open. */
  private offer(opened = Promise.resolve()): void {
    const { hello, screen } = this;
    const names = hello.plan.sides.map(({ policy }) => policy) as [string, string];
    this.card?.remove();
    this.card = startCard(names, hello.ladder, hello.duel, (choice) => void opened.then(() => this.begin(choice)));
    screen.layout.court.append(this.card);
  }

  /** Shows what a link names: a game with a friend, or a rally. */
  private async openPlace({ game, rally, stroke }: Place, playing: boolean): Promise<void> {
    const { challenges, course, screen } = this;
    let refused = "";
    if (game && course.friend) {
      await challenges.friend(game).catch((error: Error) => (refused = error.message));
    }
    if (!course.friend?.now) {
      await this.go(rally, stroke, playing);
    }
    if (!this.shown) {
      await this.openDefault();
    }
    if (refused) {
      screen.layout.say(refused, true);
    }
  }

  /** Shows the match of the server after a link that cannot be shown. */
  private async openDefault(): Promise<void> {
    const { course, hello } = this;
    if (hello.recorded === null) {
      course.open(hello.plan);
    }
    course.visit({ plan: null, rally: 0, stroke: null, tried: {}, game: null });
    await this.go(hello.recorded?.first ?? 0, null, true);
    this.screen.layout.say(say("page.bad_link"), true);
  }

  private acts(): Acts {
    const failed = (error: Error) => this.screen.layout.say(error.message, true);
    return {
      mode: (mode) => this.setMode(mode),
      newMatch: () => this.askNewMatch(),
      friend: () => this.begin("friend"),
      duel: () => (this.course.friend?.now ? this.askLeave(() => this.offer()) : this.offer()),
      copyLink: () => this.copyLink(),
      savePage: () => void this.savePage(),
      rally: (step) => void this.go(this.course.number + step),
      stroke: (step) => this.stepStroke(step),
      toggle: () => this.toggle(),
      replay: () => this.player.replay(),
      speed: (speed) => (this.player.speed = speed),
      autoNext: (on) => (this.ending.autoNext = on),
      seek: (time) => this.seek(time),
      sound: () => this.screen.toggleSound(),
      textMode: (on) => this.screen.layout.showText(on),
      camera: (camera) => {
        if (this.stage) {
          this.stage.camera = camera;
        }
      },
      open: (rally, stroke) => void this.go(rally, stroke, false),
      seekStroke: (stroke) => this.seekStroke(stroke),
      whatIf: (stroke) => void this.whatIf({ stroke }),
      waitThere: (position) => void this.whatIf({ position }),
      backToPlayed: () => this.backToPlayed(),
      playFrom: (stroke) => {
        this.player.stopAt = null;
        this.player.seek(Math.max(0, (this.shown?.rally.strokes[stroke]?.time ?? 0) - 0.7));
        this.player.playing = true;
      },
      changeSide: (seat, side) => this.changeSide(seat, side),
      takeOver: (seat) => void this.takeOver(seat),
      choose: (choice) => void this.choose(choice),
      nextQuestion: () => void this.go(this.course.number + 1),
      isLast: () => this.isLast,
      retry: () => void this.retry(),
      hints: async () => {
        const { friend, number } = this.course;
        return friend?.now ? { options: [], positions: [] } : this.source.options(this.course.wanted(number));
      },
      gameOver: (rally) => void this.challenges.summary(rally).catch(failed),
    };
  }

  /** Whether the page shows a match that can be changed and played. */
  private get live(): boolean {
    return this.hello.recorded === null && this.source.share !== null;
  }

  /** Number of rallies of the page; null: a server plays any. */
  private get count(): number | null {
    const { recorded, rallies } = this.hello;
    return recorded?.count ?? rallies ?? null;
  }

  private get isLast(): boolean {
    return this.course.number + 1 === this.count;
  }

  // Navigation.

  /** Shows a rally, from its start or from a stroke of it. */
  async go(number: number, stroke: number | null = null, playing = this.player.playing): Promise<void> {
    const { course } = this;
    if (number < 0 || number >= (this.count ?? Infinity)) {
      return;
    }
    if (number !== course.number) {
      course.tried = {};
      if (course.practice) {
        const { over } = course.practice;
        course.back();
        number = over ? number : course.number;
      }
    }
    const shown = await this.rallies.fetch(course.wanted(number));
    if (shown) {
      course.number = number;
      const time = stroke === null ? 0 : (shown.rally.strokes[stroke]?.time ?? 0);
      this.show(shown, time, playing && stroke === null);
    }
  }

  private show(shown: Shown, time: number, playing: boolean): void {
    const { course, frames, player, hello } = this;
    const { rally, motion } = shown;
    this.shown = shown;
    if (course.person) {
      this.seeFrom(course.person.seat, rally);
    }
    frames.show(rally, motion, time);
    player.playing = playing;
    document.body.dataset["ready"] = "";
    const known = hello.recorded && matchOf(hello.recorded.matches, rally.number);
    const event = known ? [known.title, known.date].filter(Boolean).join(", ") : hello.recorded?.title;
    const played = course.friend?.now;
    const match = event ?? (played ? say("friend.title") : say("page.seed", { seed: course.plan!.seed }));
    const where = rally.skill === null ? match : say("page.in_match", { match, skill: skillWords(rally.skill) });
    this.screen.show(rally, where, course.sides, course.person?.seat ?? null, course.isTried);
    if (played?.chosen && played.rally === rally.number && played.strokes === rally.strokes.length) {
      this.screen.answered = rally.turn; // before the page was loaded again
    }
    this.updateAddress();
    // A new server compiles for these; on a machine of few cores, the first picture would wait for it.
    this.pictured ??= nextPicture();
    this.values.latest = this.pictured.then(() => {
      if (this.shown !== shown) {
        return undefined;
      }
      if (rally.winner !== null && !rally.after?.over && !this.isLast && this.screen.mode !== "learn") {
        this.rallies.load({ ...course.wanted(course.number + 1), tried: {} }).catch(() => {}); // staged while this one plays
      }
      return this.values.request(rally);
    });
  }

  // Actions.

  private begin(choice: Choice): void {
    const { challenges } = this;
    const failed = (error: Error) => this.screen.layout.say(error.message, true);
    this.player.playing = false; // what runs is not the match that begins
    this.screen.answered = this.shown?.rally.turn ?? null;
    this.screen.board.show(null);
    if (typeof choice === "number") {
      challenges.duel(choice).catch(failed);
    } else if (choice === "friend") {
      challenges.friend(null).catch(failed);
    } else if (choice !== "watch") {
      this.setMode(choice);
    }
  }

  setMode(mode: Mode): void {
    const { course, screen } = this;
    const before = screen.mode;
    if (course.friend?.now) {
      this.askLeave(() => this.setMode(mode));
      return;
    }
    if (mode !== "learn") {
      screen.learn.end();
    }
    this.enter(mode, mode === "watch" || mode === "play");
    if (mode === "play" && !course.person && course.plan) {
      course.playFromStart();
      this.values.reset();
      void this.go(0, null, true);
      return;
    }
    if (before === "play") {
      this.leave();
    }
    void this.go(course.number, mode === "analyse" ? Math.max(this.player.stroke, 0) : null, mode === "watch");
  }

  private enter(mode: Mode, autoNext = true): void {
    this.card?.remove();
    this.screen.showMode(mode);
    this.ending.autoNext = autoNext;
    this.screen.layout.showAutoNext(autoNext);
  }

  toggle(): void {
    const { player } = this;
    if (!player.playing && player.time >= player.duration) {
      player.seek(0);
    }
    const mine = this.screen.board.turn && (player.waits || player.time >= player.choice);
    player.playing = !player.playing && !mine;
  }

  seek(time: number): void {
    const limit = this.shown?.rally.turn ? this.player.choice : Infinity;
    this.player.seek(Math.min(time, limit));
  }

  seekStroke(stroke: number): void {
    this.player.playing = false;
    this.seek(this.shown?.rally.strokes[stroke]?.time ?? 0);
    this.updateAddress();
  }

  stepStroke(step: number): void {
    if (this.player.stepStroke(step)) {
      this.updateAddress();
    } else {
      this.seek(step > 0 ? this.player.duration : 0);
    }
  }

  /** Leaves the game with a friend after a question, then acts. */
  private askLeave(act: () => void): void {
    confirmed(say("friend.leave"), say("friend.leave_about"), say("friend.leave_yes"), () => {
      this.course.open(this.hello.plan);
      this.course.person = null;
      this.course.number = 0;
      act();
    });
  }

  /** Starts a new match; asks first while a person plays. */
  private askNewMatch(): void {
    if (this.course.friend?.now) {
      this.askLeave(() => this.newMatch());
    } else if (this.course.person) {
      confirmed(say("page.ask_new"), say("page.ask_new_about"), say("page.new_match"), () => this.newMatch());
    } else {
      this.newMatch();
    }
  }

  private newMatch(): void {
    if (this.live) {
      this.course.newMatch();
      this.values.reset();
      this.screen.learn.end();
      void this.go(0, null, true);
    }
  }

  /** Opens the link in the address. */
  private visit(): void {
    const place = readLink(location.hash);
    const played = this.course.person !== null;
    this.course.visit(place);
    if (played && !this.course.person) {
      this.seeFrom(0, null);
      this.enter("watch");
    }
    void this.openPlace(place, this.player.playing && place.stroke === null);
  }

  /** Changes agent or temperature from the next rally on; before the first serve, from this one on. */
  changeSide(seat: number, side: Side): void {
    const { course } = this;
    if (!course.plan) {
      return;
    }
    const from = course.number === 0 && this.player.stroke < 0 ? 0 : course.number + 1;
    course.changeSide(seat, side, from);
    if (from === 0) {
      void this.go(0);
      return;
    }
    const { layout } = this.screen;
    layout.say(say("page.plays_so", { name: displayName(side.policy) }));
    this.updateAddress();
    this.rallies.load(course.wanted(from)).catch((error: Error) => layout.say(error.message, true));
  }

  /** Replaces a policy by a person from the next stroke that can still be chosen, or the person by the policy. */
  async takeOver(seat: number): Promise<void> {
    const { course, player, shown } = this;
    const { layout } = this.screen;
    if (!course.plan || !this.source.share || !shown || course.friend?.now) {
      return;
    }
    if (course.person?.seat === seat) {
      this.leave();
      this.enter("watch");
      await this.go(course.number, null, true);
      layout.say(say(shown.rally.winner === null ? "page.replays" : "page.continues"));
      return;
    }
    const { stroke, time } = player;
    const undo = course.mark();
    course.person = playing(seat, course.number, stroke < 0 ? 0 : stroke + 2);
    this.values.reset();
    this.enter("play");
    const taken = await this.rallies.fetch(course.wanted(course.number), null, undo);
    if (taken) {
      this.show(taken, Math.min(time, taken.motion.duration), true);
    }
  }

  /** Plays the rally again from the last stroke of the person that is on the court, for practice. */
  private async retry(): Promise<void> {
    const { course, player, shown } = this;
    const at = shown?.rally.strokes.findLastIndex((stroke, i) => stroke.person && i <= player.stroke) ?? -1;
    if (!shown || at < 0 || !course.person || course.friend?.now || !course.plan?.chosen) {
      return;
    }
    const undo = course.mark();
    course.retry(at, shown.rally.winner !== null);
    const next = await this.rallies.fetch(course.wanted(course.number), null, undo);
    if (next) {
      this.show(next, at ? next.rally.strokes[at - 1]!.time : 0, true);
    }
  }

  /** Ends the play of the person. */
  private leave(): void {
    if (this.course.practice) {
      this.course.back();
    }
    this.course.person = null;
    this.seeFrom(0, null);
  }

  /** Shows the court from the end where a seat is in a rally; null: at the beginning of a match. */
  private seeFrom(seat: number, rally: RallyFacts | null): void {
    if (this.stage) {
      this.stage.flipped = rally ? facing(rally, seat) < 0 : seat === 1;
    }
  }

  /** Plays the stroke, or waits in the position, that a person chose. */
  private async choose(choice: number): Promise<void> {
    const { course, player, screen, shown } = this;
    const turn = shown?.rally.turn;
    if (!turn || !course.plan) {
      return;
    }
    screen.board.show(null);
    screen.answered = turn;
    if (course.friend?.now) {
      await course.friend.choose(course.number, turn.number, choice).catch((error: Error) => {
        screen.answered = null; // they choose again
        screen.layout.say(error.message, true);
      });
      return;
    }
    const chosen = performance.now();
    const undo = course.mark();
    course.choose(turn, choice);
    if (turn.strokes.length) {
      screen.decisions.clear();
    }
    player.finish(); // while the rest is staged
    this.unseen.push(chosen);
    const next = await this.rallies.fetch(course.wanted(course.number), shown.motion, () => {
      undo();
      screen.answered = null; // they choose again
    });
    if (next) {
      const { time } = player;
      const contact = next.rally.strokes[turn.number]?.time ?? Infinity;
      this.stage?.blendFrom(shown.motion, time);
      this.show(next, Math.min(time, contact - 0.12), true);
    }
  }

  /** Shows the strokes of a game with a friend that the server has played and the page does not show yet. */
  private async friendPlayed({ rally, strokes, plan }: FriendReply): Promise<void> {
    const { course, player, rallies, shown } = this;
    if (!shown || rallies.pending || shown.rally.number !== course.number) {
      return;
    }
    const known = shown.rally.strokes.length;
    if (shown.rally.winner === null && (rally > course.number || strokes > known)) {
      const next = await rallies.fetch(course.wanted(course.number));
      if (next && shown === this.shown) {
        this.stage?.blendFrom(shown.motion, player.time);
        this.show(next, Math.min(player.time, next.rally.strokes[known]!.time - 0.12), true);
      }
    } else if (plan) {
      course.open(plan);
      this.updateAddress();
    }
  }

  /** Replaces a played stroke, or where its receiver waits; the rally continues from it. */
  async whatIf(tried: Tried): Promise<void> {
    const { course } = this;
    if (!this.shown || !this.source.share) {
      return;
    }
    const at = Math.max(this.player.stroke, 0);
    (document.activeElement as HTMLElement | null)?.blur(); // the next space plays or pauses
    const undo = course.mark();
    course.person = course.person?.friend ? null : course.person; // average pros go on
    course.try(at, tried);
    const next = await this.rallies.fetch(course.wanted(course.number), null, undo);
    if (next) {
      const contact = next.rally.strokes[at]!.time;
      const earliest = at ? next.rally.strokes[at - 1]!.time : 0;
      this.show(next, Math.max(earliest, contact - 0.5), true);
    }
  }

  private async backToPlayed(): Promise<void> {
    if (this.course.isTried) {
      this.course.back();
      await this.go(this.course.number, Math.max(this.player.stroke, 0));
    }
  }

  /** Handles a key; returns whether it has an action. While a person plays, `n` is the net shot alone. */
  key(key: string): boolean {
    if (this.screen.board.key(key) || (key === "n" && this.course.person)) {
      return true;
    }
    const act = this.keys[key];
    act?.();
    return act !== undefined;
  }

  // Time.

  private drawn(ended: boolean): void {
    if (ended) {
      this.ending.reached(this.shown!);
    }
    for (const chosen of this.unseen.splice(0)) {
      this.turnTimes.push(performance.now() - chosen);
    }
  }

  draw(): void {
    this.frames.draw(this.listener);
  }

  // Links and files.

  /** Updates the address of the page. */
  private updateAddress(): void {
    history.replaceState(null, "", this.course.link(this.player.stroke));
  }

  private copyLink(): void {
    this.updateAddress();
    navigator.clipboard?.writeText(location.href).catch(() => {});
    this.screen.layout.say(say("page.link_copied"));
  }

  /** Saves the rally as a page that opens from disk. */
  private async savePage(): Promise<void> {
    const { course, source, shown } = this;
    const { layout } = this.screen;
    if (!source.share || !shown) {
      return;
    }
    layout.say(say("page.creating"));
    try {
      const title = shown.rally.names.map(displayName).join(say("page.versus"));
      const page = await source.share(course.wanted(course.number), title, course.link(this.player.stroke));
      save(page, `rally-${course.number + 1}.html`);
      layout.say(say("page.saved", { size: decimal(page.size / 1e6, 1) }));
    } catch (error) {
      layout.say((error as Error).message, true);
    }
  }

  /** Where players and shuttle are in the picture at a time; nothing is drawn. */
  held(time: number): ReturnType<Stage["held"]> | null {
    return this.shown && (this.stage?.held(this.shown.rally, this.shown.motion, time) ?? null);
  }

  /** State of the page for tests and scripts. */
  state(): Record<string, unknown> {
    const { course, player, screen, stage } = this;
    return state(this.shown, course, player, screen, stage, {
      script_ms: [...this.frames.durations],
      turn_ms: [...this.turnTimes],
    });
  }
}
