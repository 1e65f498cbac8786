// The summary of a game that a person played: their costliest decisions.

import { h, signed } from "./dom";
import type { Analysis, RallyFacts } from "./wire.gen";
import { say, words } from "./words";

/** A rally that a person played to its end. */
export interface Played {
  number: number;
  rally: RallyFacts;
  analysis: Promise<Analysis>;
}

const MOST = 5;

/**
 * Content of the dialog after a game.
 * @param go opens a stroke of a rally.
 */
export async function summary(
  last: RallyFacts,
  seat: number,
  played: Played[],
  go: (number: number, stroke: number) => void,
): Promise<HTMLElement[]> {
  const games = last.games[0] + last.games[1];
  const mine = played.filter(({ rally }) => rally.games[0] + rally.games[1] === games);
  const found = await Promise.all(mine.map(async (one) => ({ ...one, analysis: await one.analysis })));
  const strokes = found.flatMap(({ number, rally: { strokes }, analysis }) =>
    strokes.flatMap((stroke, i) =>
      stroke.seat === seat && stroke.person ? [{ number, i, stroke, value: analysis.strokes[i]! }] : [],
    ),
  );
  const worst = strokes
    .filter(({ value }) => value.mark.includes("?"))
    .sort((a, b) => (a.value.change ?? 0) - (b.value.change ?? 0))
    .slice(0, MOST);
  const rows = worst.map(({ number, i, stroke, value }) => {
    const better = value.options.find((option) => option.stroke === value.better);
    return h(
      "li",
      { style: "margin:6px 0" },
      h("button", { onclick: () => go(number, i) }, say("duel.place", { rally: number + 1, stroke: i + 1 })),
      say("duel.loses", { stroke: target(stroke), share: signed(value.change ?? 0) }),
      better ? say("duel.better", { stroke: target(better) }) : "",
    );
  });
  return [
    h("p", {}, say("duel.summary", { count: strokes.length }), worst.length ? say("duel.costliest") : ""),
    h("ol", {}, ...rows),
  ];
}

function target({ shot, area }: { shot: string; area: string }): string {
  return say("stroke.to", { shot: words(shot), area: words(area) });
}
