// Cache of requested rallies; replies that a later request supersedes are dropped.

import type { Motion } from "./motion";
import type {
  Analysis,
  FriendReply,
  FriendRequest,
  FriendSeat,
  MatchReply,
  OptionsReply,
  Person,
  Plan,
  RallyFacts,
  RatingReply,
  Styles,
} from "./wire.gen";

/** A requested rally: of a match by its plan, of a game with a friend, or a recorded one. */
export interface Wanted {
  plan: Plan | null;
  rally: number;
  person: Person | null;
  tried: Record<string, number>;
  /** The seat in a game with a friend, and what the server has played of it; null: none. */
  friend: { seat: FriendSeat; version: string } | null;
}

export interface Shown {
  rally: RallyFacts;
  motion: Motion;
}

export interface Source {
  /** `before` has the frames before the branch of a motion that continues it. */
  rally(wanted: Wanted, before: Motion | null): Promise<Shown>;
  analysis(wanted: Wanted): Promise<Analysis>;
  options(wanted: Wanted): Promise<OptionsReply>;
  styles(wanted: Wanted): Promise<Styles>;
  match(wanted: Wanted): Promise<MatchReply>;
  /** How a game with a friend stands; null: this page has no server. */
  friend: ((asked: FriendRequest) => Promise<FriendReply>) | null;
  /** The rating of a person after a match. */
  rating(before: RatingReply, scores: number[]): Promise<RatingReply>;
  model(athlete: string): Promise<ArrayBuffer>;
  /** Creates a page that opens from disk with a rally; null on such a page. */
  share: ((wanted: Wanted, title: string, hash: string) => Promise<Blob>) | null;
}

const MAX_CACHED = 10;

export class Rallies {
  /** Number of the last request. */
  request = 0;
  /** Whether the last request is unanswered. */
  pending = false;
  private readonly cache = new Map<string, Promise<Shown>>();

  /**
   * @param prepare awaited before a rally is shown.
   * @param failed receives errors.
   * @param waits told when a requested rally is awaited, and when it is there.
   */
  constructor(
    private readonly source: Source,
    private readonly prepare: (rally: RallyFacts) => Promise<void>,
    private readonly failed: (error: Error) => void,
    private readonly waits: (pending: boolean) => void,
  ) {}

  load(wanted: Wanted, before: Motion | null = null): Promise<Shown> {
    const key = JSON.stringify(wanted);
    let found = this.cache.get(key);
    if (!found) {
      found = this.source.rally(wanted, before);
      this.cache.set(key, found);
      found.catch(() => this.cache.delete(key));
      while (this.cache.size > MAX_CACHED) {
        this.cache.delete(this.cache.keys().next().value!);
      }
    }
    return found;
  }

  /** Fetches a rally; null after an error, which calls `undo`, or if a later request superseded it. */
  async fetch(wanted: Wanted, before: Motion | null = null, undo: () => void = () => {}): Promise<Shown | null> {
    const request = ++this.request;
    this.pending = true;
    this.waits(true);
    try {
      const shown = await this.load(wanted, before);
      await this.prepare(shown.rally);
      return request === this.request ? shown : null;
    } catch (error) {
      if (request === this.request) {
        undo();
        this.failed(error as Error);
      }
      return null;
    } finally {
      if (request === this.request) {
        this.pending = false;
        this.waits(false);
      }
    }
  }
}
