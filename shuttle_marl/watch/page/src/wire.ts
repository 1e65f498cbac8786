// Requests to the server and what it answers; see docs/watch.md.

export type Vec3 = [number, number, number];
export type Quat = [number, number, number, number];

export interface AthleteFacts {
  height: number;
  parents: number[];
  rest: Vec3[];
  shaft: Vec3;
  strings: Vec3;
  fingers: Record<string, Quat>;
}

export interface HallFacts {
  court: Record<
    "length" | "width" | "half_length" | "half_width" | "short_service" | "long_service_doubles" | "net" | "net_centre" | "net_depth" | "tape" | "line",
    number
  >;
  areas: { name: string; box: [[number, number], [number, number]] }[];
  racket: { length: number; sweet_spot: number; butt: number; head: [number, number] };
  /** Both ends of a feather: distance from the axis, half the width, distance behind the middle of the cork. */
  shuttle: { scale: number; cork: number; feathers: number; feather: [Vec3, Vec3] };
  bones: string[];
  athletes: Record<string, Record<string, AthleteFacts>>;
  shots: string[];
  heights: string[];
  techniques: string[];
}

export interface Side {
  policy: string;
  temperature: number;
}

export interface Change {
  rally: number;
  seat: number;
  side: Side;
}

export interface Plan {
  seed: number;
  sides: [Side, Side];
  changes?: Change[];
  chosen?: Record<string, Record<string, number>>;
}

export interface Person {
  seat: number;
  rally: number;
  stroke: number;
}

export interface StrokeFacts {
  stroke: number;
  seat: number;
  shot: string;
  area: string;
  height: string;
  technique: string;
  box: [number, number, number, number];
}

export interface Stroke extends StrokeFacts {
  state: number;
  p_succ: number;
  p_ret: number;
  person: boolean;
  effort: number | null;
  opponent_effort: number | null;
  duel: number | null;
  support: number | null;
  time: number;
  frame: number;
  contact: Vec3;
  end: string;
  end_time: number;
  end_point: Vec3;
  speed: number;
}

export interface TurnStroke extends StrokeFacts {
  p_succ: number;
  p_ret: number;
}

/** A person has to choose. */
export interface Turn {
  seat: number;
  number: number;
  height: string;
  strokes: TurnStroke[];
}

export interface RallyFacts {
  number: number;
  names: [string, string];
  server: number;
  points: [number, number];
  games: [number, number];
  finished: [number, number][];
  winner: number | null;
  reason: string | null;
  after: { points: [number, number]; games: [number, number]; over: boolean; game_won: boolean } | null;
  strokes: Stroke[];
  turn: Turn | null;
  players: [{ athlete: string; hand: string }, { athlete: string; hand: string }];
}

export interface Hello {
  version: string;
  game: string;
  hall: HallFacts;
  policies: string[];
  plan: Plan;
  recorded: { title: string; count: number; first: number } | null;
}

export interface Reply<F> {
  facts: F;
  body: ArrayBuffer;
  raw: ArrayBuffer;
}

/** Splits a message: length of the JSON, the JSON, and what follows. */
export function parseMessage(message: ArrayBuffer): Reply<Record<string, unknown>> {
  const length = new DataView(message).getUint32(0, true);
  const facts = JSON.parse(new TextDecoder().decode(new Uint8Array(message, 4, length)));
  return { facts, body: message.slice(4 + length), raw: message };
}

interface Waiting {
  resolve(reply: Reply<Record<string, unknown>>): void;
  reject(error: Error): void;
  text: string;
}

/** One connection to the server that comes back by itself, and asks again what was not answered. */
export class Connection {
  private socket: WebSocket | null = null;
  private waiting = new Map<number, Waiting>();
  private next = 1;
  private pause = 500;

  constructor(
    private readonly address: string,
    private readonly onState: (open: boolean) => void,
  ) {
    this.open();
  }

  ask<F>(op: string, body: object = {}): Promise<Reply<F>> {
    const id = this.next++;
    const text = JSON.stringify({ id, op, ...body });
    return new Promise((resolve, reject) => {
      this.waiting.set(id, { resolve: resolve as Waiting["resolve"], reject, text });
      if (this.socket?.readyState === WebSocket.OPEN) {
        this.socket.send(text);
      }
    });
  }

  private open(): void {
    const socket = new WebSocket(this.address);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.pause = 500;
      this.onState(true);
      for (const { text } of this.waiting.values()) {
        socket.send(text);
      }
    };
    socket.onmessage = ({ data }) => this.receive(data as ArrayBuffer);
    socket.onclose = () => {
      this.onState(false);
      setTimeout(() => this.open(), this.pause);
      this.pause = Math.min(2 * this.pause, 5000);
    };
    this.socket = socket;
  }

  private receive(data: ArrayBuffer): void {
    const reply = parseMessage(data);
    const id = reply.facts["id"] as number;
    const waiting = this.waiting.get(id);
    if (!waiting) {
      return;
    }
    this.waiting.delete(id);
    const error = reply.facts["error"];
    if (typeof error === "string") {
      waiting.reject(new Error(error));
    } else {
      waiting.resolve(reply);
    }
  }
}
