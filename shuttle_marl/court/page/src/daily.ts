// Puzzles of the day: five questions chosen by the date, the same for everyone, with a rating kept in the browser.

import { say } from "./words";

const KEY = "shuttle_marl.puzzles";
const START = 1500; // rating of a new viewer
const GUESS = 1000; // rating of a viewer who guesses
const STEP = 32; // most points that one answer changes
const SPREAD = 400; // difference of ratings at which the stronger side is right ten times as often

const STRICT = 8; // rallies in which no theme is asked twice

export const PUZZLES = 5;

interface History {
  rating: number;
  /** Answers by date, such as "11011". */
  days: Record<string, string>;
}

/** The date at Greenwich, the same for everyone at the same time. */
export function today(): string {
  return new Date().toISOString().slice(0, 10);
}

function stored(): History {
  try {
    const found = JSON.parse(localStorage.getItem(KEY) ?? "{}") as Partial<History>;
    return { rating: Number(found.rating) || START, days: { ...found.days } };
  } catch {
    return { rating: START, days: {} };
  }
}

/** Elo rating of a puzzle with a number of answers: a viewer who guesses, rated 1000, solves one of so many. */
export function difficulty(answers: number): number {
  return GUESS + SPREAD * Math.log10(answers - 1);
}

export class Daily {
  /** Whether each answer was right. */
  readonly answers: boolean[] = [];
  /** Shot types of the best strokes so far; puzzles prefer others. */
  readonly shots = new Set<string>();
  readonly themes = new Set<string>();
  /** Number of rallies that were looked at. */
  rallies = 0;
  private readonly history = stored();
  private readonly before = this.history.rating;
  /** Whether this day was played before; then the rating stays. */
  private readonly again: boolean;

  /**
   * @param date the day, as in 2026-05-01.
   * @param count number of rallies between which the puzzles are chosen; null: a match of its own.
   */
  constructor(
    readonly date: string,
    private readonly count: number | null,
  ) {
    this.again = date in this.history.days;
  }

  /** Whether a puzzle is asked: not about serves, of a new shot type and, in the first rallies, of a new theme. */
  takes(theme: string, shot: string): boolean {
    return theme !== "serve" && !this.shots.has(shot) && (this.rallies >= STRICT || !this.themes.has(theme));
  }

  /** Seed of the match from which the puzzles are taken. */
  get seed(): number {
    return Number(this.date.replaceAll("-", ""));
  }

  /** The first rally; of given ones, another one every day. */
  get first(): number {
    return this.count ? (PUZZLES * Math.floor(Date.parse(this.date) / 864e5)) % this.count : 0;
  }

  /** The rally after another; null: all were shown. */
  after(rally: number): number | null {
    const next = this.count ? (rally + 1) % this.count : rally + 1;
    return next === this.first ? null : next;
  }

  get done(): boolean {
    return this.answers.length >= PUZZLES;
  }

  /** @param answers number of answers of the puzzle. */
  add(right: boolean, answers: number): void {
    this.answers.push(right);
    if (this.again) {
      return;
    }
    const { history } = this;
    const expected = 1 / (1 + 10 ** ((difficulty(answers) - history.rating) / SPREAD));
    history.rating += STEP * (Number(right) - expected);
    history.days[this.date] = this.answers.map(Number).join("");
    try {
      localStorage.setItem(KEY, JSON.stringify(history));
    } catch {
      // A browser that stores nothing keeps no rating.
    }
  }

  /** The rating after the answers, in a sentence. */
  get rating(): string {
    const { rating } = this.history;
    const change = Math.round(rating - this.before);
    return this.again
      ? say("learn.again", { rating: Math.round(rating) })
      : say("learn.rating", {
          rating: Math.round(rating),
          change: `${change < 0 ? "−" : "+"}${Math.abs(change)}`,
          guess: GUESS,
        });
  }

  /** Text to share. */
  get card(): string {
    const right = this.answers.filter(Boolean).length;
    const marks = this.answers.map((answer) => (answer ? "🟩" : "🟥")).join("");
    return say("learn.card", { date: this.date, result: `${right}/${this.answers.length} ${marks}` });
  }
}
