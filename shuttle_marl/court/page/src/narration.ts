// Text description of a rally, for screen readers and text mode.

import { capitalised, percent } from "./dom";
import { does, nameAt } from "./names";
import { positionWords } from "./recover";
import type { HallFacts, RallyFacts } from "./wire.gen";
import { type Key, say, words } from "./words";

/** One stroke as a sentence. */
export function strokeSentence(hall: HallFacts, rally: RallyFacts, i: number): string {
  const stroke = rally.strokes[i]!;
  const count = stroke.effort ?? 0;
  return say("stroke.sentence", {
    number: i + 1,
    name: capitalised(nameAt(rally.names, stroke.seat)),
    shot: words(stroke.shot),
    area: words(stroke.area),
    technique: words(stroke.technique),
    from: say(`from_net.${stroke.height}` as Key),
    hurried: stroke.hurried ? say("language.comma") + say("term.hurried") : "",
    good: percent(stroke.p_succ),
    back: percent(stroke.p_ret),
    effort: count ? say(count > 1 ? "stroke.effort" : "stroke.effort_one", { count }) : "",
    waited:
      stroke.waited === null
        ? ""
        : say("stroke.waited", { name: nameAt(rally.names, 1 - stroke.seat), position: positionWords(hall, stroke.waited) }),
  });
}

/** The end of a rally as a sentence. */
export function endSentence(rally: RallyFacts): string {
  if (rally.winner === null || !rally.after) {
    return "";
  }
  const last = rally.strokes.at(-1)!;
  const [a, b] = rally.after.points;
  const won = does(rally.names, rally.winner, "win") + say("won.rally");
  return say("stroke.end", { won, shot: words(last.shot), end: say(`end.${ending(last.end)}`), a, b });
}

function ending(end: string): "winner" | "out" | "net" | "other" {
  return end === "winner" || end === "out" || end === "net" ? end : "other";
}

/** Why a rally ended, in a few words: "smash not returned". */
export function reason(rally: RallyFacts): string {
  const last = rally.strokes.at(-1)!;
  return say("stroke.reason", { shot: words(last.shot), end: say(`brief_end.${ending(last.end)}`) });
}

/** An interval or a change of ends. */
export function breakWords(before: string): string {
  return before
    .split(" and ")
    .map((part) => say(`before.${part}` as Key))
    .join(say("before.and"));
}

export function startSentence(rally: RallyFacts): string {
  const [[a, b], [c, d]] = [rally.points, rally.games];
  const who = does(rally.names, rally.server, "serve");
  const begins = say(rally.from_right ? "stroke.start" : "stroke.start_left", { number: rally.number + 1, a, b, c, d, who });
  return rally.before ? `${capitalised(breakWords(rally.before))}${say("learn.stop")} ${begins}` : begins;
}
