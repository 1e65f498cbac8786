// Duels: with a ladder of opponents, or with a friend.

import { keepRating, keepRung, rating } from "./decisions";
import { h, replaceChildren } from "./dom";
import type { Mode } from "./layout";
import { displayName, does } from "./names";
import type { Source } from "./rallies";
import type { Screen } from "./screen";
import type { StrokeValues } from "./strokeValues";
import { summary } from "./summary";
import { playing, type Timeline } from "./timeline";
import type { Hello, RallyFacts, Side } from "./wire.gen";
import { say } from "./words";

const PRO: Side = { policy: "bc", temperature: 1 };

export interface ChallengeHooks {
  go(rally: number, stroke: number | null, playing: boolean): Promise<void>;
  setMode(mode: Mode): void;
  enter(mode: Mode): void;
  /** Shows the court from the end of a seat. */
  seeFrom(seat: number): void;
}

export class Challenges {
  constructor(
    private readonly course: Timeline,
    private readonly screen: Screen,
    private readonly source: Source,
    private readonly values: StrokeValues,
    private readonly hooks: ChallengeHooks,
    private readonly hello: Hello,
  ) {}

  /** Starts a duel with an opponent of the ladder. */
  async duel(number: number): Promise<void> {
    const { course, screen, hooks } = this;
    const { duel, ladder } = this.hello;
    const policy = ladder[number]!;
    keepRung(number);
    course.open({ seed: Math.floor(Math.random() * 2 ** 31), sides: [PRO, { policy, temperature: 1 }], points: duel });
    course.person = playing(0);
    this.values.reset();
    hooks.enter("play");
    hooks.seeFrom(0);
    screen.hear();
    await hooks.go(0, null, true);
    screen.layout.say(say("duel.begins", { points: duel, name: displayName(policy) }));
  }

  /**
   * Opens a game with a friend.
   * @param token of the game; null: a new one, whose link is shown.
   */
  async friend(token: string | null): Promise<void> {
    const { course, screen, hooks } = this;
    const now = await course.friend!.join(token);
    course.plan = { seed: 0, sides: [PRO, PRO], points: this.hello.duel }; // the server has the real one
    course.original = course.practice = null;
    course.person = playing(now.seat, 0, 0, true);
    this.values.reset();
    hooks.enter("play");
    await hooks.go(now.rally, null, true);
    if (token === null) {
      course.friend!.invite(location.href);
    } else {
      screen.layout.say(say("friend.begins", { points: this.hello.duel }));
    }
  }

  /** Shows the score, the rating and the costliest decisions of a person in the finished game. */
  async summary(rally: RallyFacts): Promise<void> {
    const { course, hooks, screen } = this;
    const { person } = course;
    if (!person || course.practice) {
      return;
    }
    const dialog = screen.layout.summary;
    const next = () => rally.after!.over || void hooks.go(rally.number + 1, null, true);
    const leave = () => {
      dialog.removeEventListener("close", next);
      dialog.close();
    };
    const open = (number: number, stroke: number) => {
      leave();
      hooks.setMode("analyse");
      void hooks.go(number, stroke, false);
    };
    const { ladder } = this.hello;
    const begin = (number: number, words: string) => {
      const start = () => {
        leave();
        void this.duel(number);
      };
      return h("button", { onclick: start }, words);
    };
    const [found] = await Promise.all([summary(rally, person.seat, this.values.played, open), this.values.latest]);
    const [mine, theirs] = screen.decisions.scores(person.seat);
    const ahead = mine !== null && theirs !== null && mine > theirs;
    const unrated = screen.decisions.unrated(person.seat);
    const before = rating();
    const after = unrated.length ? await this.source.rating(before, unrated) : before;
    keepRating(after);
    const [points, low, high] = [after.points, ...after.interval].map((one) => String(Math.round(one))) as [
      string,
      string,
      string,
    ];
    const at = course.plan?.points && !person.friend ? ladder.indexOf(course.plan.sides[1].policy) : -1;
    if (ahead && at >= 0) {
      keepRung(Math.min(at + 1, ladder.length - 1));
    }
    const stronger = ahead ? ladder[at + 1] : undefined;
    const score = { mine: mine ?? "–", theirs: theirs ?? "–" };
    const won = does(rally.names, rally.winner!, "win") + say(rally.after!.over ? "won.match" : "won.game");
    const content = [
      h("p", {}, h("b", {}, `${won} · ${rally.after!.points.join(" – ")}`)),
      h("p", {}, h("b", {}, say(ahead ? "decide.ahead" : "decide.behind", score))),
      h("p", {}, say("decide.rating", { points, low, high })),
      ...found,
      at >= 0 &&
        h(
          "div",
          { class: "row" },
          begin(at, say("duel.another")),
          stronger && begin(at + 1, say("duel.next", { name: displayName(stronger) })),
        ),
    ];
    replaceChildren(dialog.querySelector("div")!, ...content);
    dialog.addEventListener("close", next, { once: true });
    dialog.showModal();
  }
}
