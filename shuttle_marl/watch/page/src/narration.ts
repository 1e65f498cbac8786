// Text description of a rally, for screen readers and text mode.

import { percent, words } from "./dom";
import type { RallyFacts } from "./wire.gen";

/** One stroke as a sentence. */
export function strokeSentence(rally: RallyFacts, i: number): string {
  const stroke = rally.strokes[i]!;
  const effort = stroke.effort ? `, ${stroke.effort} previous attack${stroke.effort > 1 ? "s" : ""}` : "";
  return (
    `${i + 1}. ${rally.names[stroke.seat]}: ${words(stroke.shot)} to ${words(stroke.area)}, ${words(stroke.technique)} from ` +
    `${stroke.height} the net, ${Math.round(3.6 * stroke.speed)} km/h; P(success) ${percent(stroke.p_succ)}, P(returned) ${percent(stroke.p_ret)}${effort}.`
  );
}

/** The end of a rally as a sentence. */
export function endSentence(rally: RallyFacts): string {
  if (rally.winner === null || !rally.after) {
    return "";
  }
  const last = rally.strokes.at(-1)!;
  const how = { winner: "is not returned", out: "lands out", net: "goes into the net" }[last.end] ?? "ends the rally";
  return `${rally.names[rally.winner]} wins the rally: the ${words(last.shot)} ${how}. ${rally.after.points[0]} to ${rally.after.points[1]}.`;
}

export function startSentence(rally: RallyFacts): string {
  return `Rally ${rally.number + 1}, ${rally.points[0]} to ${rally.points[1]}, games ${rally.games[0]} to ${rally.games[1]}. ${rally.names[rally.server]} serves.`;
}
