// Keyboard shortcuts of the page.

import { hideTip } from "./glossary";
import { type Player, SPEEDS } from "./player";
import { CAMERAS, type Camera, type Stage } from "./stage";
import { say } from "./words";

/** What keys do to the match and to the page. */
interface Acts {
  toggle(): void;
  stroke(step: number): void;
  rally(step: number): void;
  camera(camera: Camera): void;
  replay(): void;
  sound(): void;
  newMatch(): void;
  takeOver(seat: number): void;
  retry(): void;
}

interface Page {
  speed: { value: string };
  panel: { click(): void };
  showText(on: boolean): void;
  toggleHelp(): void;
}

/** Keys and what they do: everywhere, in a match between policies, and while a person plays. */
export function keyList(match: boolean): { general: [string, string][]; play: [string, string][] } {
  const general: [string, string][] = [
    [say("keys.space"), say("keys.play")],
    ["← →", say("keys.stroke")],
    ["↑ ↓", say("keys.rally")],
    [", .", say("keys.frame")],
    ["< >", say("keys.speed")],
    ["1 – 7", say("keys.camera")],
    ["f", say("keys.ends")],
    ["r", say("keys.replay")],
    ["m", say("keys.sound")],
    ["w", say("keys.words")],
    ["e", say("page.panel")],
    ["h", say("keys.keys")],
  ];
  if (!match) {
    return { general, play: [] };
  }
  general.push(["t T", say("keys.take_over")], ["n", say("keys.new")]);
  return {
    general,
    play: [
      ["c l d s", say("keys.shots_1")],
      ["a v p k", say("keys.shots_2")],
      ["n x b g", say("keys.shots_3")],
      ["1 – 9", say("keys.target")],
      ["q", say("keys.technique")],
      ["i", say("keys.hint")],
      ["u", say("keys.retry")],
      ["Enter", say("keys.hit")],
    ],
  };
}

/** Actions of keys outside of the stroke board. */
export function keyTable(
  acts: Acts,
  player: Player,
  stage: Stage | null,
  layout: Page,
  match: boolean,
): Record<string, () => void> {
  const speed = (step: number) => {
    const at = SPEEDS.findIndex((speed) => speed >= player.speed);
    player.speed = SPEEDS[Math.min(Math.max(at + step, 0), SPEEDS.length - 1)]!;
    layout.speed.value = String(player.speed);
  };
  const matchKeys = { n: () => acts.newMatch(), t: () => acts.takeOver(0), T: () => acts.takeOver(1), u: () => acts.retry() };
  return {
    " ": () => acts.toggle(),
    ArrowLeft: () => acts.stroke(-1),
    ArrowRight: () => acts.stroke(1),
    ArrowUp: () => acts.rally(-1),
    ArrowDown: () => acts.rally(1),
    ",": () => player.stepFrame(-1),
    ".": () => player.stepFrame(1),
    "<": () => speed(-1),
    ">": () => speed(1),
    ...Object.fromEntries(CAMERAS.map((camera, i) => [String(i + 1), () => acts.camera(camera)])),
    r: () => acts.replay(),
    f: () => {
      if (stage) {
        stage.flipped = !stage.flipped;
      }
    },
    ...(match ? matchKeys : {}),
    m: () => acts.sound(),
    w: () => layout.showText(!document.body.classList.contains("text")),
    e: () => layout.panel.click(),
    h: () => layout.toggleHelp(),
    "?": () => layout.toggleHelp(),
    Escape: () => hideTip(),
  };
}

/** Keys without and with Shift, by their place. */
const PLACES: Record<string, [string, string]> = { Comma: [",", "<"], Period: [".", ">"] };

/** The key of an event: digits count by their place, and so do letters and points on a keyboard of another alphabet. */
export function keyOf({ code, key, shiftKey }: KeyboardEvent): string {
  const [, digit, letter] = /^(?:(?:Numpad|Digit)(\d)|Key([A-Z]))$/.exec(code) ?? [];
  const place = letter ? [letter.toLowerCase(), letter] : PLACES[code];
  return digit ?? (place && !/^[\x20-\x7e]$/.test(key) ? place[Number(shiftKey)]! : key);
}

/** Calls `act` with every key that no control handles; it returns whether it handled the key. */
export function listen(act: (key: string) => boolean, board: HTMLElement): void {
  document.addEventListener("keydown", (event) => {
    const target = event.target as HTMLElement;
    const typing = /^(SELECT|TEXTAREA)$/.test(target.tagName) || /^(range|search)$/.test((target as HTMLInputElement).type);
    const key = keyOf(event);
    const dialog = document.querySelector("dialog[open]") !== null && !"h?".includes(key);
    if (
      event.ctrlKey ||
      event.metaKey ||
      event.altKey ||
      typing ||
      dialog ||
      (key === " " && target.closest("button, summary"))
    ) {
      return;
    }
    if (key === "Enter" && target.closest("button, summary") && !board.contains(target)) {
      return;
    }
    if (act(key)) {
      event.preventDefault();
    }
  });
}
