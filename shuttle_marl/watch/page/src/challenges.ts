// Reasons to come back: the puzzles of the day, and a duel with a strong player.

import { Daily, today } from "./daily";
import { h } from "./dom";
import type { Mode } from "./layout";
import type { Source } from "./rallies";
import type { Screen } from "./screen";
import type { StrokeValues } from "./strokeValues";
import { likenessSentence, summary } from "./summary";
import type { Timeline } from "./timeline";
import type { RallyFacts, Side } from "./wire.gen";
import { say } from "./words";

const POINTS = 3; // of a duel
const PRO: Side = { policy: "bc", temperature: 1 };
const STRONG: Side = { policy: "human:0.05", temperature: 1 };

export interface ChallengeHooks {
  /** Number of rallies of the page; null: a server plays others. */
  count: number | null;
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
  ) {}

  /** Starts the puzzles of the day: of a match of its own, or of the rallies of this page. */
  async daily(): Promise<void> {
    const { course, screen, hooks } = this;
    const daily = new Daily(today(), hooks.count);
    if (hooks.count === null) {
      course.open({ seed: daily.seed, sides: [PRO, PRO] });
      course.person = null;
      hooks.seeFrom(0);
    }
    screen.learn.start(daily);
    hooks.enter("learn");
    await hooks.go(daily.first, null, false);
  }

  /** Starts a duel with a strong player. */
  async duel(): Promise<void> {
    const { course, screen, hooks } = this;
    course.open({ seed: Math.floor(Math.random() * 2 ** 31), sides: [PRO, STRONG], points: POINTS });
    course.person = { seat: 0, rally: 0, stroke: 0 };
    this.values.played.length = 0;
    hooks.enter("play");
    hooks.seeFrom(0);
    screen.hear();
    await hooks.go(0, null, true);
    screen.layout.say(say("duel.begins", { points: POINTS }));
  }

  /** Shows the costliest decisions of a person in the finished game, and whose choices theirs are like. */
  async summary(rally: RallyFacts): Promise<void> {
    const { course, hooks, screen } = this;
    const { person } = course;
    if (!person) {
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
    const again = () => {
      leave();
      void this.duel();
    };
    const [found, likeness] = await Promise.all([
      summary(rally, person.seat, this.values.played, open),
      this.source.likeness(course.wanted(rally.number)),
    ]);
    const content = [
      ...found,
      likenessSentence(likeness),
      course.plan?.points ? h("button", { onclick: again }, say("duel.another")) : "",
    ];
    dialog.querySelector("div")!.replaceChildren(...content);
    dialog.addEventListener("close", next, { once: true });
    dialog.showModal();
  }
}
