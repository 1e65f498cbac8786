// Rallies that are asked for: each once, the next one ahead of time, and only the last answer counts.

import type { Motion } from "./motion";
import type { Analysis, Option, Person, Plan, RallyFacts, Styles } from "./wire.gen";

/** A rally that is asked for: of a match by its plan, or of what was recorded. */
export interface Wanted {
  plan: Plan | null;
  rally: number;
  person: Person | null;
  tried: Record<string, number>;
}

export interface Shown {
  rally: RallyFacts;
  motion: Motion;
}

export interface Source {
  /** `before` has the frames before the branch of a motion that continues it. */
  rally(wanted: Wanted, before: Motion | null): Promise<Shown>;
  analysis(wanted: Wanted): Promise<Analysis>;
  options(wanted: Wanted): Promise<Option[]>;
  styles(wanted: Wanted): Promise<Styles>;
  model(athlete: string): Promise<ArrayBuffer>;
  /** A page that opens from disk with these rallies, told of each as it is fetched; null where the page itself is one. */
  share: ((wanted: Wanted[], title: string, hash: string, progress: (done: number) => void) => Promise<Blob>) | null;
}

const KEPT = 10;

export class Rallies {
  /** Number of the request that counts. */
  request = 0;
  /** Whether its rally is still on its way. */
  pending = false;
  private readonly cache = new Map<string, Promise<Shown>>();

  /**
   * @param prepare awaited before a rally is shown.
   * @param failed told why a rally cannot be had.
   */
  constructor(
    private readonly source: Source,
    private readonly prepare: (rally: RallyFacts) => Promise<void>,
    private readonly failed: (error: Error) => void,
  ) {}

  load(wanted: Wanted, before: Motion | null = null): Promise<Shown> {
    const key = JSON.stringify(wanted);
    let found = this.cache.get(key);
    if (!found) {
      found = this.source.rally(wanted, before);
      this.cache.set(key, found);
      found.catch(() => this.cache.delete(key));
      while (this.cache.size > KEPT) {
        this.cache.delete(this.cache.keys().next().value!);
      }
    }
    return found;
  }

  /** A rally, or null if something else was asked for meanwhile, or it cannot be had; `undo` then takes back what it was for. */
  async fetch(wanted: Wanted, before: Motion | null = null, undo: () => void = () => {}): Promise<Shown | null> {
    const request = ++this.request;
    this.pending = true;
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
      }
    }
  }
}
