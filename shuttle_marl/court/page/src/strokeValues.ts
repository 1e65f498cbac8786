// Requests stroke values and styles of the rally on the page, and shows them when they arrive.

import type { Rallies, Source, Wanted } from "./rallies";
import type { Screen } from "./screen";
import type { Played } from "./summary";
import type { Timeline } from "./timeline";
import type { MatchReply, RallyFacts } from "./wire.gen";

export class StrokeValues {
  /** Rallies of the match that a person played to their end. */
  readonly played: Played[] = [];
  /** Resolves when the last request is answered. */
  latest: Promise<void> = Promise.resolve();
  private match: { key: string; reply: Promise<MatchReply | null>; rallies: [number, number] | null } = {
    key: "",
    reply: Promise.resolve(null),
    rallies: null,
  };
  private styled = ""; // sides whose style is shown
  private matches = 0; // that a person began

  constructor(
    private readonly source: Source,
    private readonly course: Timeline,
    private readonly rallies: Rallies,
    private readonly screen: Screen,
  ) {}

  /** Forgets the decisions of a person; another match begins. */
  reset(): void {
    this.played.length = 0;
    this.matches++;
    this.screen.decisions.reset();
  }

  /** Requests stroke values and styles; shows them unless another rally was requested meanwhile. */
  request(rally: RallyFacts): Promise<void> {
    this.latest = this.requested(rally);
    return this.latest;
  }

  /** The match of a rally; asked once while its plan stays. A saved rally has none. */
  private overview(wanted: Wanted): Promise<MatchReply | null> {
    const key = JSON.stringify([wanted.plan, wanted.person && wanted.rally]);
    const known = this.match.rallies;
    const inside = wanted.plan !== null || (known !== null && known[0] <= wanted.rally && wanted.rally <= known[1]);
    if (key !== this.match.key || !inside) {
      const reply = this.source.match(wanted).catch(() => null);
      const match: typeof this.match = { key, reply, rallies: null };
      this.match = match;
      void reply.then((found) => {
        match.rallies = found?.rallies.length ? [found.rallies[0]!.number, found.rallies.at(-1)!.number] : null;
      });
    }
    return this.match.reply;
  }

  private async requested(rally: RallyFacts): Promise<void> {
    const { course, source, screen, matches } = this;
    const { person, practice } = course;
    const { request } = this.rallies;
    const wanted = course.wanted(course.number);
    const sides = JSON.stringify(course.sides);
    const now = () => request === this.rallies.request;
    try {
      if (rally.strokes.length) {
        const asked = source.analysis(wanted);
        if (
          course.person &&
          !course.practice &&
          rally.winner !== null &&
          !this.played.some((one) => one.number === rally.number)
        ) {
          this.played.push({ number: rally.number, rally, analysis: asked });
        }
        const { played } = screen.decisions;
        const analysis = await asked;
        if (person && !practice && matches === this.matches) {
          screen.decisions.count(rally, analysis); // also if the next rally is shown already
        }
        if (now()) {
          screen.showAnalysis(analysis);
        }
        const named = now() || rally.winner === null ? screen.told : Infinity;
        if (person && matches === this.matches && played === screen.decisions.played) {
          screen.decisions.show(rally, analysis, person.seat, practice !== null, named);
        }
      }
      if (screen.mode === "analyse" || screen.browser) {
        const match = await this.overview(wanted);
        if (now()) {
          screen.browser?.show(match, rally.number, screen.mode === "analyse", true);
          screen.match.show(screen.mode === "analyse" ? match : null, rally.names, rally.number);
        }
      }
      if (wanted.plan && sides !== this.styled) {
        screen.showStyles(null);
        const styles = await source.styles(wanted);
        if (now()) {
          this.styled = sides;
          screen.showStyles(styles);
        }
      }
    } catch (error) {
      if (now()) {
        screen.layout.say((error as Error).message, true);
      }
    }
  }
}
