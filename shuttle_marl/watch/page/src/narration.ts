// Text description of a rally, for screen readers and text mode.

import { capitalised, does, percent, words } from "./dom";
import { displayName } from "./names";
import type { RallyFacts } from "./wire.gen";

/** One stroke as a sentence. */
export function strokeSentence(rally: RallyFacts, i: number): string {
  const stroke = rally.strokes[i]!;
  const effort = stroke.effort ? `, ${stroke.effort} previous attack${stroke.effort > 1 ? "s" : ""}` : "";
  return (
    `${i + 1}. ${displayName(rally.names[stroke.seat]!)}: ${words(stroke.shot)} to ${words(stroke.area)}, ${words(stroke.technique)} from ` +
    `${stroke.height} the net${stroke.hurried ? ", hurried" : ""}, ${Math.round(3.6 * stroke.speed)} km/h; in ${percent(stroke.p_succ)}, comes back ${percent(stroke.p_ret)}${effort}.`
  );
}

/** The end of a rally as a sentence. */
export function endSentence(rally: RallyFacts): string {
  if (rally.winner === null || !rally.after) {
    return "";
  }
  const last = rally.strokes.at(-1)!;
  const how = ending(last.end);
  return `${does(displayName(rally.names[rally.winner]!), "win", true)} the rally: the ${words(last.shot)} ${how}. ${rally.after.points[0]} to ${rally.after.points[1]}.`;
}

function ending(end: string): string {
  return { winner: "is not returned", out: "lands out", net: "goes into the net" }[end] ?? "ends the rally";
}

/** Why a rally ended, in a few words: "smash not returned". */
export function reason(rally: RallyFacts): string {
  const last = rally.strokes.at(-1)!;
  return `${words(last.shot)} ${ending(last.end).replace("is not", "not").replace("goes into", "into").replace("lands ", "")}`;
}

export function startSentence(rally: RallyFacts): string {
  const court = rally.from_right ? "right" : "left";
  return `${rally.before && `${capitalised(rally.before)}. `}Rally ${rally.number + 1}, ${rally.points[0]} to ${rally.points[1]}, games ${rally.games[0]} to ${rally.games[1]}. ${does(displayName(rally.names[rally.server]!), "serve", true)} from the ${court}.`;
}
