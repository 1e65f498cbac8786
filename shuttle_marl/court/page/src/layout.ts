// Layout of the page: the court fills it; who plays stands above, the time line below, and panels open at the right.

import { type Child, h, replaceChildren } from "./dom";
import { icon } from "./icons";
import { keyList } from "./keys";
import { dialog, menu } from "./menus";
import { SPEEDS } from "./player";
import { type Tabs, tabList } from "./tabs";
import { LANGUAGES, language, say, speak } from "./words";

export const MODES = ["watch", "analyse", "learn", "play"] as const;
export type Mode = (typeof MODES)[number];

export interface Hooks {
  mode(mode: Mode): void;
  newMatch(): void;
  /** Opens a game with a friend. */
  friend(): void;
  /** Offers duels. */
  duel(): void;
  copyLink(): void;
  savePage(): void;
  rally(step: number): void;
  stroke(step: number): void;
  toggle(): void;
  replay(): void;
  speed(speed: number): void;
  autoNext(on: boolean): void;
  textMode(on: boolean): void;
  sound(): void;
}

/** Containers of panels. */
export interface Parts {
  canvas: HTMLCanvasElement | null;
  /** Over the court, in its corner. */
  overlays: HTMLElement[];
  cameras: HTMLElement;
  /** Who may play, for the menu of the title. */
  sides: HTMLElement[];
  /** What the viewer has to do: a question, or the choice of a stroke. */
  task: HTMLElement[];
  facts: (HTMLElement | null)[];
  timeline: HTMLElement;
}

export class Layout {
  readonly court = h("div", { class: "court" });
  readonly notice = h("div", { class: "notice hidden", role: "alert" });
  private readonly lines = h("ol", { "aria-live": "polite" });
  private readonly who = h("b", {});
  private readonly where = h("small", {});
  readonly clock = h("span", { class: "clock" });
  readonly speed: HTMLSelectElement;
  readonly summary: HTMLDialogElement;
  private readonly play: HTMLButtonElement;
  private readonly help: HTMLDialogElement;
  private readonly tabs: Tabs<Mode>;
  private readonly busy = h("p", { class: "busy hidden", role: "status" });
  private readonly autoNext: HTMLButtonElement;
  private readonly textButton: HTMLButtonElement;
  private readonly soundButton: HTMLButtonElement;
  /** Opens the panel of strokes and rallies. */
  readonly panel: HTMLButtonElement;
  private readonly page: HTMLElement;
  private timer = 0;
  private busyTimer = 0;

  /** @param duel points that win a duel; null: nobody can play. */
  constructor(parts: Parts, modes: readonly Mode[], hooks: Hooks, canShare: boolean, duel: number | null) {
    const keys = keyList(duel !== null);
    const list = (entries: [string, string][]) =>
      h("ul", { class: "keys" }, ...entries.map(([key, what]) => h("li", {}, h("kbd", {}, key), ` ${what}`)));
    const playing = keys.play.length ? [h("h3", {}, say("page.keys_play")), list(keys.play)] : [];
    this.help = dialog(say("page.keys"), h("div", {}, list(keys.general), ...playing));
    this.summary = dialog(say("page.game_summary"), h("div"));
    this.play = h("button", { class: "play", onclick: () => hooks.toggle(), "aria-label": say("page.play") }, icon("play"));
    this.speed = h(
      "select",
      { class: "speed", "aria-label": say("page.playback_speed"), onchange: () => hooks.speed(Number(this.speed.value)) },
      ...SPEEDS.map((speed) => h("option", { value: speed }, `${speed}×`)),
    );
    this.speed.value = "1";
    this.autoNext = toggleButton(say("page.auto_next"), true, (on) => hooks.autoNext(on));
    this.textButton = toggleButton(say("page.in_words"), false, (on) => hooks.textMode(on));
    this.soundButton = toggleButton(say("page.sound_on"), false, () => hooks.sound());
    this.panel = toggleButton(say("page.panel"), false, (on) => document.body.classList.toggle("open", on));
    this.panel.classList.add("opens");
    this.tabs = tabList(
      say("page.mode"),
      modes,
      (mode) => say(`mode.${mode}`),
      "page",
      (mode) => hooks.mode(mode),
    );
    const button = (text: Child, act: () => void) => h("button", { onclick: act }, text);
    const more = menu(
      say("page.menu"),
      ...(duel ? [button(say("page.new_match"), hooks.newMatch), button(say("start.duel", { points: duel }), hooks.duel)] : []),
      duel !== null && button(say("friend.title"), hooks.friend),
      ...(canShare ? [button(say("page.copy_link"), hooks.copyLink), button(say("page.save_rally"), hooks.savePage)] : []),
      this.textButton,
      this.soundButton,
      this.autoNext,
      h("button", { onclick: () => this.toggleHelp() }, `${say("page.keys")} `, h("kbd", {}, "h")),
      languageMenu(),
    );
    const title = parts.sides.length
      ? menu(h("span", {}, this.who, this.where), ...parts.sides)
      : h("p", {}, h("span", {}, this.who, this.where));
    title.classList.add("title");
    const canvas = parts.canvas ?? h("p", { class: "end" }, say("page.no_webgl"));
    this.court.append(canvas, h("div", { class: "hud" }, ...parts.overlays), parts.cameras, this.busy);
    const facts = parts.facts.filter((part) => part !== null);
    this.page = h(
      "div",
      { class: "page", role: "tabpanel", id: "page" },
      h(
        "div",
        { class: "front" },
        this.court,
        h("div", { class: "column task" }, ...parts.task),
        h("section", { class: "bottom", "aria-label": say("page.timeline") }, parts.timeline, this.transport(hooks)),
      ),
      h("div", { class: "column facts" }, ...facts),
      h(
        "section",
        { class: "panel words", "aria-label": say("page.rally_in_words") },
        h("h2", {}, say("term.words")),
        h(
          "div",
          { class: "announcements", role: "region", "aria-label": say("page.strokes_in_words"), tabindex: 0 },
          this.lines,
        ),
      ),
    );
    document.body.append(
      h("header", { class: "top" }, h("h1", {}, "shuttle_marl"), this.tabs.element, title, more),
      h("main", {}, this.page),
      this.notice,
      this.help,
      this.summary,
    );
  }

  private transport(hooks: Hooks): HTMLElement {
    const button = (name: string, label: string, act: () => void) =>
      h("button", { class: name, onclick: act, "aria-label": label, title: label }, icon(name));
    return h(
      "div",
      { class: "transport", role: "group", "aria-label": say("page.playback") },
      button("first", say("page.previous_rally"), () => hooks.rally(-1)),
      button("back", say("page.previous_stroke"), () => hooks.stroke(-1)),
      this.play,
      button("forward", say("page.next_stroke"), () => hooks.stroke(1)),
      button("last", say("page.next_rally"), () => hooks.rally(1)),
      button("replay", say("page.replay"), () => hooks.replay()),
      this.speed,
      this.clock,
      this.panel,
    );
  }

  showMode(mode: Mode): void {
    this.tabs.show(mode);
    this.page.setAttribute("aria-labelledby", `tab-${mode}`);
    document.body.dataset["mode"] = mode;
  }

  /** Says who plays, and where. */
  title(who: Child[], where: string): void {
    replaceChildren(this.who, ...who);
    this.where.textContent = where;
  }

  /** Says what the page waits for; null: nothing. Short waits are not announced. */
  showBusy(what: string | null): void {
    clearTimeout(this.busyTimer);
    if (what === null) {
      this.busy.classList.add("hidden");
      this.busy.textContent = "";
    } else {
      this.busyTimer = window.setTimeout(() => {
        this.busy.textContent = what;
        this.busy.classList.remove("hidden");
      }, 250);
    }
  }

  showPlaying(playing: boolean): void {
    const name = say(playing ? "page.pause" : "page.play");
    if (this.play.getAttribute("aria-label") !== name) {
      this.play.setAttribute("aria-label", name);
      replaceChildren(this.play, icon(playing ? "pause" : "play"));
    }
  }

  showAutoNext(on: boolean): void {
    this.autoNext.setAttribute("aria-pressed", String(on));
  }

  /** Whether text replaces the court. */
  showText(on: boolean): void {
    document.body.classList.toggle("text", on);
    this.textButton.setAttribute("aria-pressed", String(on));
  }

  showSound(on: boolean): void {
    this.soundButton.setAttribute("aria-pressed", String(on));
  }

  toggleHelp(): void {
    if (this.help.open) {
      this.help.close();
    } else {
      this.help.showModal();
    }
  }

  /** Shows a message; it disappears unless it is an error. */
  say(words: string, failure = false): void {
    clearTimeout(this.timer);
    this.notice.textContent = words;
    this.notice.classList.toggle("good", !failure);
    this.notice.classList.remove("hidden");
    if (!failure) {
      this.timer = window.setTimeout(() => this.notice.classList.add("hidden"), 4000);
    }
  }

  quiet(): void {
    if (!this.notice.classList.contains("good")) {
      this.notice.classList.add("hidden");
    }
  }

  /** Starts the text of another rally. */
  tellFromStart(words: string): void {
    this.lines.replaceChildren();
    this.tell(words);
  }

  tell(words: string): void {
    this.lines.append(h("li", {}, words));
  }
}

function toggleButton(name: string, on: boolean, act: (on: boolean) => void): HTMLButtonElement {
  const button = h(
    "button",
    {
      "aria-pressed": String(on),
      onclick: () => {
        const now = button.getAttribute("aria-pressed") !== "true";
        button.setAttribute("aria-pressed", String(now));
        act(now);
      },
    },
    name,
  );
  return button;
}

/** Chooses the language; a page in the frame of a report has that of the report. */
export function languageMenu(): HTMLElement | null {
  const options = LANGUAGES.map(([name, text]) => h("option", { value: name, lang: name, selected: name === language }, text));
  const select = h("select", { "aria-label": say("page.language"), onchange: () => speak(select.value) }, ...options);
  return parent === window ? select : null;
}
