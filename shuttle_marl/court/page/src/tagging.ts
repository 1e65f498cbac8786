// Tagging a video: the state that follows from a person's inputs, as a pure reducer, and the rows of the table.

import { type HallFacts, RULES, type TagRow, type TagStroke } from "./wire.gen";
import { areaWords, say, words } from "./words";

export const ENDINGS = ["out", "net", "short", "foul", "let", "landed", "misjudged"] as const;
export type Ending = (typeof ENDINGS)[number];
type Seat = 0 | 1;
type Point = [number, number];
type Discipline = TagRow["discipline"];
export type Hand = TagRow["hand"];
export type Rules = TagRow["rules"];

/** What a person enters; x and y are fractions of the picture, seat 0 is the player who is near in the first game. */
export type Input =
  | {
      kind: "setup";
      match: string;
      discipline: Discipline;
      players: [string, string];
      hands: [Hand, Hand];
      server: Seat;
      rules: Rules;
    }
  | { kind: "corner"; x: number; y: number }
  | {
      kind: "shot";
      shot: number;
      time: number;
      technique: number;
      height: number;
      /** Of the shot, and of its targets; null: not known. */
      probability: number | null;
      areas: number[] | null;
    }
  | { kind: "way"; technique: number; height: number }
  | { kind: "cell"; cell: number; time: number }
  | { kind: "place"; x: number; y: number; time: number }
  | { kind: "end"; ending: Ending }
  | { kind: "confirm" };

export type Phase = "setup" | "shot" | "place" | "ask" | "over";

interface Setup {
  match: string;
  discipline: Discipline;
  players: [string, string];
  /** Racket hands; null: not known, taken for the right. */
  hands: [Hand, Hand];
  rules: Rules;
}

/** A stroke; `place` is where it was met or fell, in the frame of its striker [m]; null: only the area is known. */
export interface Tagged {
  seat: Seat;
  shot: number;
  technique: number;
  height: number;
  time: number;
  area: number | null;
  place: Point | null;
  /** Probabilities of targets; null: not known. */
  areas: number[] | null;
}

export interface Rally {
  game: number;
  number: number;
  server: Seat;
  points: Point;
  strokes: Tagged[];
  ending: Ending | null;
}

export interface State {
  phase: Phase;
  setup: Setup | null;
  corners: Point[];
  rallies: Rally[];
  games: Point;
  near: Seat;
  /** Time at which the last place was entered, when the next stroke is struck [s]. */
  met: number | null;
  /** The question of the phase "ask", and the state after it is confirmed. */
  question: string;
  after: State | null;
}

export const START: State = {
  phase: "setup",
  setup: null,
  corners: [],
  rallies: [],
  games: [0, 0],
  near: 0,
  met: null,
  question: "",
  after: null,
};

/** An input that is not possible now. */
export class Refused extends Error {}

const SERVES = 2; // the first shot types of the vocabulary
const FRAME_RATE = 30; // of the column `frame`: browsers do not tell that of a video
const BY_HAND = 0.2; // accuracy of places that are clicked [m]
const FLAT = 1e-4; // least area of three corners, of that of the picture
const RARE = 0.001; // probability below which a shot is asked about
const RARE_TARGET = 0.005; // … a target is asked about
const FAULTS: readonly Ending[] = ["out", "net", "short", "foul"];
const WITHOUT_PLACE: readonly Ending[] = ["net", "short", "foul", "let"];

export function current(state: State): Rally {
  return state.rallies.at(-1)!;
}

export function striker(rally: Rally): Seat {
  return ((rally.server + rally.strokes.length) % 2) as Seat;
}

/** Winner of a rally that has ended, and is not replayed. */
export function winnerOf(rally: Rally): Seat | null {
  const last = rally.strokes.at(-1);
  return rally.ending === null || rally.ending === "let" || !last
    ? null
    : FAULTS.includes(rally.ending)
      ? ((1 - last.seat) as Seat)
      : last.seat;
}

/** State after an input; throws Refused if it is not possible. */
export function reduce(state: State, input: Input, hall: HallFacts): State {
  switch (input.kind) {
    case "setup":
      return state.phase === "setup" ? begun(state, input) : refuse(say("refusal.begun"));
    case "corner": {
      if (state.phase === "setup" || state.corners.length === 4) {
        refuse(say("refusal.corners_known"));
      }
      const corners: Point[] = [...state.corners, [input.x, input.y]];
      if (!inOrder(corners)) {
        refuse(say("refusal.corner_order", { corner: say(`tag.${CORNER_NAMES[corners.length - 1]!}`) }));
      }
      return asked({ ...state, corners }, corners.length === 4 && say("refusal.court"));
    }
    case "confirm":
      return state.phase === "ask" ? state.after! : refuse(say("refusal.not_asked"));
    case "shot":
      return state.phase === "shot" ? struck(state, input, hall) : refuse(waiting(state));
    case "way":
      return changed(state, input);
    case "cell":
      return placed({ ...state, met: input.time }, cellArea(input.cell, nearStrikes(state)), null, hall);
    case "place": {
      const place = onCourt(state, input.x, input.y);
      return placed({ ...state, met: input.time }, areaOf(place, hall), place, hall);
    }
    case "end":
      return ended(state, input.ending, hall);
  }
}

export function replay(inputs: readonly Input[], hall: HallFacts): State {
  return inputs.reduce((state, input) => reduce(state, input, hall), START);
}

function refuse(reason: string): never {
  throw new Refused(reason);
}

function waiting(state: State): string {
  return state.phase === "ask" ? state.question : say(`refusal.${state.phase}`);
}

function begun(state: State, { match, discipline, players, hands, server, rules }: Input & { kind: "setup" }): State {
  if (!match || !players[0] || !players[1] || players[0] === players[1]) {
    refuse(say("refusal.players"));
  }
  const rally: Rally = { game: 1, number: 1, server, points: [0, 0], strokes: [], ending: null };
  return { ...state, phase: "shot", setup: { match, discipline, players, hands, rules }, rallies: [rally] };
}

function withRally(state: State, change: Partial<Rally>): State {
  return { ...state, rallies: [...state.rallies.slice(0, -1), { ...current(state), ...change }] };
}

function asked(state: State, question: string | false): State {
  return question ? { ...state, phase: "ask", question, after: state } : state;
}

function struck(state: State, input: Input & { kind: "shot" }, hall: HallFacts): State {
  const rally = current(state);
  const before = rally.strokes.at(-1);
  if (input.shot < SERVES !== !before) {
    refuse(say(before ? "refusal.serve_begins" : "refusal.no_serve"));
  }
  if (before && input.time - before.time < 1 / FRAME_RATE) {
    refuse(say("refusal.earlier"));
  }
  const { shot, technique, height, time, areas } = input;
  const stroke = { seat: striker(rally), shot, technique, height, time, area: null, place: null, areas };
  const next = { ...withRally(state, { strokes: [...rally.strokes, stroke] }), phase: "place", met: null } as const;
  return asked(
    next,
    input.probability !== null && input.probability < RARE && say("refusal.unlikely", { shot: words(hall.shots[shot]!) }),
  );
}

function changed(state: State, { technique, height }: Input & { kind: "way" }): State {
  const { strokes } = state.phase === "shot" || state.phase === "place" ? current(state) : refuse(waiting(state));
  const last = strokes.at(-1) ?? refuse(say("refusal.shot_first"));
  return withRally(state, { strokes: [...strokes.slice(0, -1), { ...last, technique, height }] });
}

function nearStrikes(state: State): boolean {
  return state.phase === "place" && current(state).strokes.at(-1)!.seat === state.near;
}

/** Area of a key of the keypad, which lies over the receiver's half as the picture shows it: 7 8 9 are the top row. */
export function cellArea(cell: number, nearStrikes: boolean): number {
  const [column, row] = [(cell - 1) % 3, Math.floor((cell - 1) / 3)];
  // Areas count from the receiver's right, and from the net.
  return nearStrikes ? 3 * row + column : 3 * (2 - row) + 2 - column;
}

function areaOf([x, y]: Point, hall: HallFacts): number {
  const [u, v] = [clamped(x, singlesWidth(hall)), Math.min(Math.max(y, 0), hall.court.half_length)];
  return hall.areas.findIndex(({ box: [[x0, x1], [y0, y1]] }) => x0 <= u && u <= x1 && y0 <= v && v <= y1);
}

function clamped(value: number, most: number): number {
  return Math.min(Math.max(value, -most), most);
}

function placed(state: State, area: number, place: Point | null, hall: HallFacts): State {
  if (state.phase !== "place") {
    refuse(waiting(state));
  }
  const rally = current(state);
  const last = { ...rally.strokes.at(-1)!, area, place };
  const next = { ...withRally(state, { strokes: [...rally.strokes.slice(0, -1), last] }), phase: "shot" } as const;
  const [side, right] = [area % 3, rally.points[rally.server]! % 2 === 0];
  const wrong = rally.strokes.length === 1 && side === (right ? 2 : 0);
  const score = rally.points.join(":");
  const rare = rally.strokes.length > 1 && (last.areas?.[area] ?? 1) < RARE_TARGET;
  const receiver = state.setup!.hands[other(last.seat)] ?? "right";
  return asked(
    next,
    (wrong && say(right ? "refusal.right_court" : "refusal.left_court", { score })) ||
      (place !== null && place[1] < -hall.court.net_depth && say("refusal.own_side")) ||
      (rare &&
        say("refusal.unlikely_place", {
          shot: words(hall.shots[last.shot]!),
          area: areaWords(hall.areas[area]!.name, receiver),
        })),
  );
}

function ended(state: State, ending: Ending, hall: HallFacts): State {
  const rally = state.phase === "shot" || state.phase === "place" ? current(state) : refuse(waiting(state));
  const last = rally.strokes.at(-1) ?? refuse(say("refusal.no_serve"));
  if (last.area === null && !WITHOUT_PLACE.includes(ending)) {
    refuse(say("refusal.fell"));
  }
  const strokes = WITHOUT_PLACE.includes(ending)
    ? [...rally.strokes.slice(0, -1), { ...last, area: null, place: null }]
    : rally.strokes;
  const over = afterRally(withRally({ ...state, phase: "shot", met: null }, { ending, strokes }));
  const wrong =
    (ending === "landed" && outside(last.place, hall) > BY_HAND && say("refusal.outside")) ||
    (ending === "out" && outside(last.place, hall) < -BY_HAND && say("refusal.inside"));
  return asked(over, last.place !== null && wrong);
}

/** How a rally ends whose shuttle fell at the last place; null: a serve, whose court is smaller, or too near to a line to tell. */
export function fell(state: State, hall: HallFacts): Ending | null {
  const { strokes } = current(state);
  const far = state.phase === "shot" && strokes.length > 1 ? outside(strokes.at(-1)!.place, hall) : 0;
  return Math.abs(far) < BY_HAND ? null : far > 0 ? "out" : "landed";
}

/** How far a place is outside of the singles court [m], negative inside. */
function outside(place: Point | null, hall: HallFacts): number {
  const [x, y] = place ?? [0, 0];
  return Math.max(Math.abs(x) - singlesWidth(hall), y - hall.court.half_length);
}

function singlesWidth(hall: HallFacts): number {
  return Math.max(...hall.areas.flatMap(({ box }) => box[0]));
}

/** Whether the first of two point scores has won the game. */
export function winsGame(own: number, other: number, rules: Rules): boolean {
  const { points, clear, cap } = RULES[rules];
  return own >= cap || (own >= points && own - other >= clear);
}

/** The next rally: its score, server and ends (Laws of Badminton, 7, 8 and 14). */
function afterRally(state: State): State {
  const rally = current(state);
  const { rules } = state.setup!;
  const winner = winnerOf(rally);
  if (winner === null) {
    return { ...state, rallies: [...state.rallies, { ...rally, number: rally.number + 1, strokes: [], ending: null }] };
  }
  const points: Point = [rally.points[0], rally.points[1]];
  points[winner] += 1;
  const next = { game: rally.game, number: rally.number + 1, server: winner, points, strokes: [], ending: null };
  if (!winsGame(points[winner]!, points[1 - winner]!, rules)) {
    const [deciding, half] = [2 * RULES[rules].games - 1, Math.ceil(RULES[rules].points / 2)];
    const interval = rally.game === deciding && points[winner] === half && points[1 - winner]! < half;
    return { ...state, near: interval ? other(state.near) : state.near, rallies: [...state.rallies, next] };
  }
  const games: Point = [state.games[0], state.games[1]];
  games[winner] += 1;
  if (games[winner] === RULES[rules].games) {
    return { ...state, games, phase: "over" };
  }
  const fresh = { ...next, game: rally.game + 1, number: 1, points: [0, 0] as Point };
  return { ...state, games, near: other(state.near), rallies: [...state.rallies, fresh] };
}

function other(seat: Seat): Seat {
  return (1 - seat) as Seat;
}

/** Point of the court [m] in the frame of the striker, at a place of the picture. */
function onCourt(state: State, u: number, v: number): Point {
  if (state.phase !== "place") {
    refuse(waiting(state));
  }
  if (state.corners.length < 4) {
    refuse(say("refusal.click_corners"));
  }
  const [x, y] = mapped(homography(state.corners, CORNERS), u, v);
  return nearStrikes(state) ? [x, y] : [-x, -y];
}

export const CORNER_NAMES = ["near left", "near right", "far right", "far left"] as const;

/** Outer corners of the court [m], in the order in which they are clicked. */
export const CORNERS: Point[] = [
  [-3.05, -6.7],
  [3.05, -6.7],
  [3.05, 6.7],
  [-3.05, 6.7],
];

/** Lines of the court and the net [m], as CORNERS. */
export function courtLines({ half_width, half_length, short_service, long_service }: HallFacts["court"]): [Point, Point][] {
  const [outer] = CORNERS[1]!;
  const edges = [outer, half_width, -half_width, -outer];
  const rows = [half_length, half_length - long_service, short_service].flatMap((y) => [y, -y]);
  return [
    ...edges.map((x): [Point, Point] => [
      [x, -half_length],
      [x, half_length],
    ]),
    ...[...rows, 0].map((y): [Point, Point] => [
      [-outer, y],
      [outer, y],
    ]),
    ...[short_service, -short_service].map((y): [Point, Point] => [
      [0, y],
      [0, Math.sign(y) * half_length],
    ]),
  ];
}

/** Whether clicked corners are those of a court that is seen from behind: near ones lie lower, and left ones left. */
function inOrder(corners: readonly Point[]): boolean {
  const [a, b, c, d] = corners;
  const far = [c, d].every((corner) => !corner || corner[1] < Math.min(a![1], b![1]));
  // They run anticlockwise, and no three lie on one line.
  const turns = (d ? [...corners, a!, b!] : corners).map(
    (corner, i, all) => i < 2 || turn(all[i - 2]!, all[i - 1]!, corner) < -FLAT,
  );
  return (!b || a![0] < b[0]) && far && turns.every(Boolean);
}

/** Twice the area of a triangle of the picture; negative where its corners run anticlockwise. */
function turn([ax, ay]: Point, [bx, by]: Point, [cx, cy]: Point): number {
  return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
}

/** The eight numbers of the plane projection that maps four points to others, by Gaussian elimination. */
export function homography(from: readonly Point[], to: readonly Point[]): number[] {
  const rows = from.flatMap(([u, v], i) => {
    const [x, y] = to[i]!;
    return [
      [u, v, 1, 0, 0, 0, -u * x, -v * x, x],
      [0, 0, 0, u, v, 1, -u * y, -v * y, y],
    ];
  });
  for (let k = 0; k < 8; k++) {
    const pivot = rows.reduce((best, row, i) => (i >= k && Math.abs(row[k]!) > Math.abs(rows[best]![k]!) ? i : best), k);
    [rows[k], rows[pivot]] = [rows[pivot]!, rows[k]!];
    const lead = rows[k]![k]!;
    rows[k] = rows[k]!.map((value) => value / lead);
    for (let i = 0; i < 8; i++) {
      const factor = i === k ? 0 : rows[i]![k]!;
      rows[i] = rows[i]!.map((value, j) => value - factor * rows[k]![j]!);
    }
  }
  return rows.map((row) => row[8]!);
}

export function mapped([a, b, c, d, e, f, g, h]: number[], u: number, v: number): Point {
  const w = g! * u + h! * v + 1;
  return [(a! * u + b! * v + c!) / w, (d! * u + e! * v + f!) / w];
}

/** Racket hands of who receives the serve of a rally, and of its server. */
export function receivers({ rallies, setup }: State): ["right" | "left", "right" | "left"] {
  const { server } = rallies.at(-1)!;
  return [setup!.hands[other(server)] ?? "right", setup!.hands[server] ?? "right"];
}

/** The strokes of the current rally, for suggestions. */
export function line(rally: Rally): TagStroke[] {
  return rally.strokes.map(({ shot, technique, height, area }) => ({ shot, technique, height, area }));
}

/** Rows of the table: all strokes but one whose place is asked for. */
export function rows(state: State): TagRow[] {
  return state.rallies.flatMap((rally) => rowsOf(rally, state.setup!)).slice(0, state.phase === "place" ? -1 : undefined);
}

function rowsOf(rally: Rally, { match, discipline, players, hands, rules }: Setup): TagRow[] {
  const winner = winnerOf(rally);
  const after = rally.points.map((points, seat) => points + Number(seat === winner));
  return rally.strokes.map((stroke, i) => {
    const { seat, shot, technique, height, area, place, time } = stroke;
    const met = rally.strokes[i - 1]?.place ?? null;
    return {
      match,
      discipline,
      rules,
      game: rally.game,
      rally: rally.number,
      stroke: i + 1,
      player: players[seat],
      opponent: players[other(seat)],
      hand: hands[seat],
      shot,
      technique,
      height,
      area,
      landing_x: rounded(place?.[0]),
      landing_y: rounded(place?.[1]),
      contact_x: met && rounded(-met[0]),
      contact_y: met && rounded(-met[1]),
      seconds: time,
      frame: Math.round(time * FRAME_RATE),
      ending: i === rally.strokes.length - 1 ? rally.ending : null,
      winner: winner === null ? null : players[winner],
      points: winner === null ? null : after[seat]!,
      points_opponent: winner === null ? null : after[1 - seat]!,
    };
  });
}

function rounded(metres: number | undefined): number | null {
  return metres === undefined ? null : Math.round(1000 * clamped(metres, 30)) / 1000;
}
