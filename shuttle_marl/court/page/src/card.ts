// The court with score, stroke and probability drawn into one picture, for pictures and films.

import { capitalised, percent } from "./dom";
import { does, nameAt } from "./names";
import { breakWords, reason } from "./narration";
import { COLOURS } from "./stage";
import type { RallyFacts } from "./wire.gen";
import { say, words } from "./words";

/** What is drawn over the court at a moment. */
export interface Moment {
  rally: RallyFacts;
  /** Number of the last stroke; -1: none. */
  stroke: number;
  over: boolean;
  /** Probability that side A wins the rally; null: unknown. */
  win: number | null;
}

const FONT = 'system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif';
const [VEIL, TEXT, DIM, INK, GOLD, GREEN] = ["rgb(8 13 23 / 0.9)", "#e6edf7", "#a3b3ca", "#06101f", "#fbbf24", "#34d399"];
const BASE = 1080; // shorter side for which all lengths are given [px]

/** Size of a card: full high definition, upright where the window is. */
export function cardSize(): [number, number] {
  return innerHeight > innerWidth ? [1080, 1920] : [1920, 1080];
}

class Pen {
  constructor(
    readonly g: CanvasRenderingContext2D,
    readonly unit: number,
  ) {
    g.textBaseline = "middle";
  }

  box(x: number, y: number, width: number, height: number, colour: string, round = 10): void {
    this.g.fillStyle = colour;
    this.g.beginPath();
    this.g.roundRect(x, y, width, height, round * this.unit);
    this.g.fill();
  }

  font(size: number, weight = 400): void {
    this.g.font = `${weight} ${size * this.unit}px ${FONT}`;
  }

  /** Writes text; returns its width. */
  text(words: string, x: number, y: number, colour: string, align: CanvasTextAlign = "left", most?: number): number {
    this.g.fillStyle = colour;
    this.g.textAlign = align;
    this.g.fillText(words, x, y, most);
    return Math.min(this.g.measureText(words).width, most ?? Infinity);
  }
}

/** Draws a moment over the picture of the court. */
export function drawCard(canvas: HTMLCanvasElement, court: HTMLCanvasElement, moment: Moment): void {
  const g = canvas.getContext("2d")!;
  const { width, height } = canvas;
  g.drawImage(court, 0, 0, width, height);
  const pen = new Pen(g, Math.min(width, height) / BASE);
  drawScore(pen, moment);
  drawStroke(pen, moment, width, height);
  if (moment.win !== null) {
    drawChance(pen, moment.win, width, height);
  }
  if (moment.over && moment.rally.after) {
    drawEnd(pen, moment.rally, width, height);
  }
}

function drawScore(pen: Pen, { rally, stroke, over }: Moment): void {
  const { unit } = pen;
  const [left, top, row, wide] = [36 * unit, 36 * unit, 58 * unit, 560 * unit];
  const points = over && rally.after ? rally.after.points : rally.points;
  const serving = over && rally.winner !== null ? rally.winner : rally.server;
  pen.box(left, top, wide, 2 * row, VEIL);
  for (const seat of [0, 1] as const) {
    const y = top + (seat + 0.5) * row;
    pen.g.fillStyle = COLOURS[seat];
    pen.g.fillRect(left, top + seat * row, 10 * unit, row);
    if (seat === serving) {
      pen.box(left + 26 * unit, y - 7 * unit, 14 * unit, 14 * unit, GOLD, 7);
    }
    pen.font(30, 650);
    const games = rally.finished.map((game) => game[seat]);
    pen.text(nameAt(rally.names, seat), left + 56 * unit, y, TEXT, "left", wide - (150 + 50 * games.length) * unit);
    pen.font(28);
    games.forEach((game, i) =>
      pen.text(String(game), left + wide - (110 + 50 * (games.length - 1 - i)) * unit, y, DIM, "center"),
    );
    pen.box(left + wide - 76 * unit, top + seat * row, 76 * unit, row, "#1d2b44", 0);
    pen.font(32, 700);
    pen.text(String(points[seat]), left + wide - 38 * unit, y, TEXT, "center");
  }
  if (rally.before && stroke < 0) {
    pen.box(left, top + 2 * row, wide, 0.8 * row, VEIL);
    pen.font(28);
    pen.text(capitalised(breakWords(rally.before)), left + 56 * unit, top + 2.4 * row, GOLD, "left", wide - 76 * unit);
  }
}

function drawStroke(pen: Pen, { rally, stroke: index }: Moment, width: number, height: number): void {
  const stroke = rally.strokes[index];
  if (!stroke) {
    return;
  }
  const { unit, g } = pen;
  const [left, tall] = [36 * unit, 100 * unit];
  const top = height - tall - 92 * unit;
  const facts: [string, string, string][] = [
    [say("page.target"), words(stroke.area), TEXT],
    [say("term.in"), percent(stroke.p_succ), GREEN],
    [say("term.comes back"), percent(stroke.p_ret), GOLD],
  ];
  pen.font(34, 750);
  const shot = words(stroke.shot).toUpperCase();
  const first = g.measureText(shot).width + 56 * unit;
  pen.font(30, 650);
  const widths = facts.map(
    ([name, value]) => Math.max(g.measureText(value).width, 0.62 * g.measureText(name).width) + 44 * unit,
  );
  const total = first + widths.reduce((sum, one) => sum + one, 0);
  const shrink = Math.min(1, (width - 2 * left) / total);
  g.save();
  g.translate(left, top);
  g.scale(shrink, shrink);
  pen.box(0, 0, total, tall, VEIL);
  pen.box(0, 0, first, tall, COLOURS[stroke.seat]!);
  pen.font(34, 750);
  pen.text(shot, first / 2, tall / 2, INK, "center");
  let x = first;
  facts.forEach(([name, value, colour], i) => {
    pen.font(22);
    pen.text(name, x + 22 * unit, 0.3 * tall, DIM);
    pen.font(30, 650);
    pen.text(value, x + 22 * unit, 0.68 * tall, colour);
    x += widths[i]!;
  });
  g.restore();
}

function drawChance(pen: Pen, win: number, width: number, height: number): void {
  const { unit, g } = pen;
  const [left, top, wide, tall] = [36 * unit, height - 68 * unit, width - 72 * unit, 34 * unit];
  pen.box(left, top, wide, tall, VEIL);
  const split = left + win * wide;
  g.fillStyle = COLOURS[0];
  g.fillRect(left, top, split - left, tall);
  g.fillStyle = COLOURS[1];
  g.fillRect(split, top, left + wide - split, tall);
  pen.font(24, 700);
  pen.text(say("page.a_wins", { share: percent(win) }), left + 14 * unit, top + tall / 2, INK);
  pen.text(say("page.b_wins", { share: percent(1 - win) }), left + wide - 14 * unit, top + tall / 2, INK, "right");
}

function drawEnd(pen: Pen, rally: RallyFacts, width: number, height: number): void {
  const { unit } = pen;
  const winner = does(rally.names, rally.winner!, "win");
  const [wide, tall, top] = [Math.min(760 * unit, width - 72 * unit), 120 * unit, height - 340 * unit];
  pen.box((width - wide) / 2, top, wide, tall, VEIL);
  pen.font(36, 700);
  pen.text(winner + say("won.rally"), width / 2, top + 0.34 * tall, COLOURS[rally.winner!]!, "center", wide - 40 * unit);
  pen.font(26);
  const [a, b] = rally.after!.points;
  pen.text(`${reason(rally)} · ${a} – ${b}`, width / 2, top + 0.72 * tall, TEXT, "center", wide - 40 * unit);
}
