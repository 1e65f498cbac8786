// Keyboard shortcuts of the page.

import type { Layout } from "./layout";
import { type Player, SPEEDS } from "./player";
import type { Acts } from "./screen";
import { CAMERAS, type Stage } from "./stage";

/** Actions of keys outside of the stroke board. */
export function keyTable(acts: Acts, player: Player, stage: Stage | null, layout: Layout): Record<string, () => void> {
  const speed = (step: number) => {
    const at = SPEEDS.findIndex((speed) => speed >= player.speed);
    player.speed = SPEEDS[Math.min(Math.max(at + step, 0), SPEEDS.length - 1)]!;
    layout.speed.value = String(player.speed);
  };
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
    n: () => acts.newMatch(),
    t: () => acts.takeOver(0),
    T: () => acts.takeOver(1),
    w: () => layout.showText(!document.body.classList.contains("text")),
    h: () => layout.toggleHelp(),
    "?": () => layout.toggleHelp(),
  };
}

/** Calls `act` with every key that no control handles; it returns whether it handled the key. */
export function listen(act: (key: string) => boolean, board: HTMLElement): void {
  document.addEventListener("keydown", (event) => {
    const target = event.target as HTMLElement;
    const typing = /^(SELECT|TEXTAREA)$/.test(target.tagName) || (target as HTMLInputElement).type === "range";
    const dialog = document.querySelector("dialog[open]") !== null && event.key !== "h";
    if (
      event.ctrlKey ||
      event.metaKey ||
      event.altKey ||
      typing ||
      dialog ||
      (event.key === " " && target.closest("button, summary"))
    ) {
      return;
    }
    if (event.key === "Enter" && target.closest("button, summary") && !board.contains(target)) {
      return;
    }
    if (act(event.key)) {
      event.preventDefault();
    }
  });
}
