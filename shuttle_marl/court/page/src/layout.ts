// Layout of the page.

import { h, replaceChildren } from "./dom";
import { term } from "./glossary";
import { icon } from "./icons";
import { keyList } from "./keys";
import { dialog, menu } from "./menus";
import { SPEEDS } from "./player";
import { filmFormat } from "./recorder";
import { type Tabs, tabList } from "./tabs";
import { LANGUAGES, language, say, speak } from "./words";

export const MODES = ["watch", "analyse", "learn", "play"] as const;
export type Mode = (typeof MODES)[number];

export interface Hooks {
  mode(mode: Mode): void;
  newMatch(): void;
  /** Opens a game with a friend. */
  friend(): void;
  copyLink(): void;
  savePicture(): void;
  savePage(match: boolean): void;
  saveFilm(): void;
  rally(step: number): void;
  stroke(step: number): void;
  toggle(): void;
  replay(): void;
  speed(speed: number): void;
  loop(on: boolean): void;
  autoNext(on: boolean): void;
  seek(time: number): void;
  textMode(on: boolean): void;
  sound(): void;
}

/** Containers of panels. */
export interface Parts {
  canvas: HTMLCanvasElement | null;
  overlays: HTMLElement[];
  left: (HTMLElement | null)[];
  /** What the viewer has to do: a question, or the choice of a stroke. */
  task: HTMLElement[];
  right: (HTMLElement | null)[];
  curve: HTMLElement;
}

export class Layout {
  readonly court = h("div", { class: "court" });
  readonly notice = h("div", { class: "notice hidden", role: "alert" });
  readonly banner = h("div", { class: "banner hidden" });
  private readonly lines = h("ol", { "aria-live": "polite" });
  readonly what = h("p", { class: "what" });
  readonly clock = h("span", { class: "clock" });
  readonly scrubber: HTMLInputElement;
  readonly speed: HTMLSelectElement;
  readonly summary: HTMLDialogElement;
  private readonly play: HTMLButtonElement;
  private readonly help: HTMLDialogElement;
  private readonly tabs: Tabs<Mode>;
  private readonly busy = h("p", { class: "busy hidden", role: "status" });
  private readonly panel = h("div", { class: "page", role: "tabpanel", id: "page" });
  private readonly autoNext: HTMLButtonElement;
  private readonly words: HTMLElement;
  private readonly textButton: HTMLButtonElement;
  private readonly soundButton: HTMLButtonElement;
  /** Whether figures for experts are shown beside a watched rally. */
  readonly details: HTMLButtonElement;
  private timer = 0;
  private busyTimer = 0;

  constructor(
    parts: Parts,
    modes: readonly Mode[],
    private readonly hooks: Hooks,
    canShare: boolean,
    isMatch: boolean,
  ) {
    const keys = keyList(isMatch);
    const list = (entries: [string, string][]) =>
      h("ul", { class: "keys" }, ...entries.map(([key, what]) => h("li", {}, h("kbd", {}, key), ` ${what}`)));
    const playing = keys.play.length ? [h("h3", {}, say("page.keys_play")), list(keys.play)] : [];
    this.help = dialog(say("page.keys"), h("div", {}, list(keys.general), ...playing));
    this.summary = dialog(say("page.game_summary"), h("div"));
    this.play = h("button", { class: "play", onclick: () => hooks.toggle(), "aria-label": say("page.play") }, icon("play"));
    this.speed = h(
      "select",
      { "aria-label": say("page.playback_speed"), onchange: () => hooks.speed(Number(this.speed.value)) },
      ...SPEEDS.map((speed) => h("option", { value: speed }, `${speed}×`)),
    );
    this.speed.value = "1";
    this.scrubber = h("input", {
      type: "range",
      min: 0,
      max: 1,
      step: 0.02,
      value: 0,
      "aria-label": say("page.position"),
      oninput: () => hooks.seek(Number(this.scrubber.value)),
    });
    this.autoNext = toggleButton(say("page.auto_next"), true, (on) => hooks.autoNext(on));
    this.textButton = toggleButton(say("page.in_words"), false, (on) => hooks.textMode(on));
    this.soundButton = toggleButton(say("page.sound_on"), false, () => hooks.sound());
    const detailed = (on: boolean) => document.body.classList.toggle("details", on);
    this.details = toggleButton(say("page.details"), remembered(DETAILS), (on) => {
      detailed(on);
      remember(DETAILS, on);
    });
    detailed(remembered(DETAILS));
    this.tabs = tabList(
      say("page.mode"),
      modes,
      (mode) => say(`mode.${mode}`),
      "page",
      (mode) => hooks.mode(mode),
    );
    parts.curve.append(this.transport());
    const canvas = parts.canvas ?? h("p", { class: "end" }, say("page.no_webgl"));
    this.court.append(canvas, ...parts.overlays, this.banner, this.busy);
    this.words = h(
      "section",
      { class: "panel words", "aria-label": say("page.rally_in_words") },
      h("h2", {}, term("words", say("term.words"))),
      h("div", { class: "announcements", role: "region", "aria-label": say("page.strokes_in_words"), tabindex: 0 }, this.lines),
    );
    const keyPanel = h(
      "section",
      { class: "panel keylist", "aria-label": say("page.keys") },
      h("h2", {}, h("span", {}, say("page.keys"))),
      list(keys.general),
    );
    const share = canShare
      ? menu(
          say("page.share"),
          ...(isMatch ? [h("button", { onclick: () => hooks.friend() }, say("friend.title"))] : []),
          h("button", { onclick: () => hooks.copyLink() }, say("page.copy_link")),
          h("button", { onclick: () => hooks.savePage(false) }, say("page.save_rally")),
          h("button", { onclick: () => hooks.savePage(true) }, say("page.save_match")),
          h("button", { onclick: () => hooks.savePicture() }, say("page.save_png")),
          filmFormat()
            ? h("button", { onclick: () => hooks.saveFilm() }, say("page.record"))
            : h("p", { class: "quiet" }, say("page.no_film")),
        )
      : h("button", { onclick: () => hooks.savePicture() }, say("page.save_picture"));
    this.panel.append(
      h("div", { class: "column agents" }, ...parts.left.filter((part) => part !== null), keyPanel),
      this.court,
      h("div", { class: "column task" }, ...parts.task),
      parts.curve,
      h("div", { class: "column facts" }, ...parts.right.filter((part) => part !== null), this.words),
    );
    document.body.append(
      h(
        "header",
        { class: "top" },
        h("h1", {}, "shuttle_marl"),
        this.tabs.element,
        this.what,
        ...actions(
          isMatch ? h("button", { onclick: () => hooks.newMatch() }, say("page.new_match")) : null,
          this.details,
          this.textButton,
          this.soundButton,
          share,
          languageMenu(),
          h("button", { onclick: () => this.toggleHelp() }, `${say("page.keys")} `, h("kbd", {}, "h")),
        ),
      ),
      h("main", {}, this.panel),
      this.notice,
      this.help,
      this.summary,
    );
  }

  private transport(): HTMLElement {
    const { hooks } = this;
    const button = (name: string, label: string, act: () => void) =>
      h("button", { onclick: act, "aria-label": label, title: label }, icon(name));
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
      toggleButton(say("page.loop"), false, (on) => hooks.loop(on)),
      this.autoNext,
      this.scrubber,
      this.clock,
    );
  }

  showMode(mode: Mode): void {
    this.tabs.show(mode);
    this.panel.setAttribute("aria-labelledby", `tab-${mode}`);
    document.body.dataset["mode"] = mode;
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

const DETAILS = "shuttle_marl.details";

function remembered(name: string): boolean {
  try {
    return localStorage.getItem(name) !== null;
  } catch {
    return false; // a browser that stores nothing
  }
}

function remember(name: string, on: boolean): void {
  try {
    on ? localStorage.setItem(name, "") : localStorage.removeItem(name);
  } catch {}
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

/** Buttons of the header; on narrow screens a button opens them. */
function actions(...buttons: (HTMLElement | null)[]): HTMLElement[] {
  const more = h("button", { class: "more", "aria-expanded": "false", "aria-controls": "actions" }, say("page.menu"));
  const element = h("div", { class: "actions", id: "actions" }, ...buttons);
  const open = (on: boolean) => {
    element.classList.toggle("open", on);
    more.setAttribute("aria-expanded", String(on));
  };
  more.addEventListener("click", () => open(!element.classList.contains("open")));
  document.addEventListener("pointerdown", ({ target }) => {
    if (!element.contains(target as Node) && target !== more) {
      open(false);
    }
  });
  element.addEventListener("keydown", ({ key }) => {
    if (key === "Escape" && element.classList.contains("open")) {
      open(false);
      more.focus();
    }
  });
  element.addEventListener("click", ({ target }) => {
    if ((target as HTMLElement).tagName === "BUTTON") {
      open(false);
    }
  });
  return [element, more];
}
