// A game with a friend by a link: the server collects the choices of both, and this page asks once a second how it stands.

import { h, keep, kept } from "./dom";
import type { Layout } from "./layout";
import { dialog } from "./menus";
import type { Wanted } from "./rallies";
import type { FriendReply, FriendRequest, FriendSeat } from "./wire.gen";
import { type Key, say } from "./words";

const STORED = "shuttle_marl.friend";
const EVERY = 800; // between two questions [ms]
const LOCAL = /^(localhost|127\.|\[::1\])/;

type Ask = (asked: FriendRequest) => Promise<FriendReply>;

/** The key of the seat that this browser has in a game; null: none. */
function keyIn(token: string): string | null {
  return kept<FriendSeat | null>(STORED, null, (seat) => seat?.token === token)?.key ?? null;
}

export class FriendGame {
  /** How the game stands; null: none is played. */
  now: FriendReply | null = null;
  private timer = 0;
  private invitation: HTMLDialogElement | null = null;

  /** @param follow shows what the server has played. */
  constructor(
    private readonly ask: Ask,
    private readonly layout: Layout,
    private readonly follow: (now: FriendReply) => Promise<void>,
  ) {}

  /** What names a rally of the game; null: none is played. */
  get wanted(): Wanted["friend"] {
    return this.now && { seat: this.seat, version: `${this.now.rally}/${this.now.strokes}` };
  }

  /**
   * Takes the seat that this browser has in a game, or the next free one.
   * @param token null: a new game.
   * @throws a reason in words.
   */
  async join(token: string | null): Promise<FriendReply> {
    this.leave();
    const now = await this.ask({ token, key: token && keyIn(token), rally: 0, stroke: 0 });
    if (now.refused) {
      throw new Error(say(`friend.${now.refused}`));
    }
    keep(STORED, { token: now.token, key: now.key });
    this.now = now;
    document.body.classList.add("friend");
    this.again();
    return now;
  }

  leave(): void {
    clearTimeout(this.timer);
    this.now = null;
    document.body.classList.remove("friend");
    this.invitation?.close();
  }

  /** Shows the link to the game until the friend is there. */
  invite(address: string): void {
    const link = h("input", { readonly: true, value: address, "aria-label": say("friend.link"), onfocus: () => link.select() });
    const copied = h(
      "p",
      { role: "status", class: "quiet" },
      say(LOCAL.test(location.hostname) ? "friend.local" : "friend.waiting"),
    );
    const copy = h(
      "button",
      {
        onclick: () => {
          link.select();
          navigator.clipboard?.writeText(address).then(
            () => (copied.textContent = say("friend.copied")),
            () => {},
          );
        },
      },
      say("page.copy_link"),
    );
    const element = dialog(
      say("friend.title"),
      h("div", { class: "invite" }, h("p", {}, say("friend.about")), link, copied),
      copy,
    );
    element.addEventListener("close", () => {
      element.remove();
      this.invitation = null;
    });
    this.invitation = element;
    document.body.append(element);
    element.showModal();
  }

  /** Chooses a stroke or a position for a stroke of a rally. */
  async choose(rally: number, stroke: number, choice: number): Promise<void> {
    await this.told(await this.ask({ ...this.seat, rally, stroke, choice }));
  }

  get seat(): FriendSeat {
    const { token, key } = this.now!;
    return { token, key };
  }

  private again(): void {
    clearTimeout(this.timer);
    this.timer = window.setTimeout(async () => {
      const { now } = this;
      try {
        const reply = now && (await this.ask({ ...this.seat, rally: 0, stroke: 0 }));
        if (reply && this.now?.token === reply.token) {
          await this.told(reply);
        } else if (reply?.refused && this.now === now) {
          this.layout.say(say(`friend.${reply.refused}`), true);
          return;
        }
      } catch (error) {
        this.layout.say((error as Error).message, true);
      }
      if (this.now) {
        this.again();
      }
    }, EVERY);
  }

  private async told(reply: FriendReply): Promise<void> {
    const before = this.now;
    if (!before) {
      return; // left meanwhile
    }
    this.now = reply;
    if (reply.friend !== before.friend) {
      this.invitation?.close();
      this.layout.say(say(`friend.${before.friend === "absent" ? "came" : reply.friend}` as Key));
    }
    await this.follow(reply);
  }
}
