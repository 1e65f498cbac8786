// The summary of a game that a person played: their costliest decisions.

import { h, percent, words } from "./dom";
import type { Analysis, RallyFacts } from "./wire.gen";

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
    .filter(({ value }) => value.regret > 0)
    .sort((a, b) => b.value.regret - a.value.regret)
    .slice(0, MOST);
  const rows = worst.map(({ number, i, stroke, value }) => {
    const better = value.options.find((option) => option.stroke === value.better);
    return h(
      "li",
      { style: "margin:6px 0" },
      h("button", { onclick: () => go(number, i) }, `rally ${number + 1}, stroke ${i + 1}`),
      ` ${words(stroke.shot)} to ${words(stroke.area)} · regret ${percent(value.regret)}`,
      better ? ` · better: ${words(better.shot)} to ${words(better.area)}` : "",
    );
  });
  const mean = strokes.length ? strokes.reduce((sum, { value }) => sum + value.regret, 0) / strokes.length : 0;
  const score = last.after!.points.join(" – ");
  return [
    h(
      "p",
      {},
      `${score}. You chose ${strokes.length} strokes, with a mean regret of ${(100 * mean).toFixed(1)} %. Largest regrets:`,
    ),
    h("ol", {}, ...rows),
  ];
}
