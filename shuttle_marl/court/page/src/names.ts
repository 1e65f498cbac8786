// Names of policies that a viewer knows, beside their identifiers.

import { capitalised, h } from "./dom";
import { say } from "./words";

const KNOWN: Record<string, string> = {
  you: say("names.you"),
  friend: say("names.friend"),
  bc: say("names.pro"),
  "human:0.05": say("names.strong"),
  minimax: say("names.perfect"),
  "minimax:robust": say("names.robust"),
  "best-response:bc": say("names.best_reply"),
  attacking: say("names.attacker"),
  defensive: say("names.defender"),
  safe: say("names.safe"),
  random: say("names.random"),
};
const GROUPS: [string, (identifier: string) => boolean][] = [
  [say("names.people"), (name) => /^bc(:|$)/.test(name)],
  [say("names.strongest"), (name) => /^human(:|$)/.test(name)],
  [say("names.simple"), (name) => ["attacking", "defensive", "safe", "random"].includes(name)],
  [say("names.laboratory"), (name) => /^(minimax|best-response|ppo|a2c|sac)(:|$)/.test(name)],
];
const OTHERS = say("names.others");

function capitalized(words: string): string {
  return words.replace(/(^|[ -])\p{L}/gu, (letter) => letter.toUpperCase());
}

/** A name within other text: its direction changes nothing around it. */
export function shown(name: string): HTMLElement {
  return h("bdi", {}, name);
}

/** Name of a policy that a viewer knows; its identifier if there is none. A suffix `@0.5` is its variety. */
export function displayName(identifier: string): string {
  const [name, variety] = identifier.split(/@(?=[^@]*$)/) as [string, string?];
  const suffix =
    variety === undefined ? "" : variety === "greedy" ? say("names.no_variety") : say("names.variety", { number: variety });
  return `${plainName(name)}${suffix}`;
}

function plainName(name: string): string {
  const [key, argument] = name.split(":", 2) as [string, string?];
  const known = KNOWN[name];
  if (known) {
    return known;
  }
  if (key === "bc" && argument) {
    return capitalized(argument.replaceAll("-", " "));
  }
  if (/^(ppo|a2c|sac)$/.test(key)) {
    const agent = say("names.agent", { name: key.toUpperCase() });
    return argument ? `${agent}, ${argument.replaceAll("-", " ")}` : agent;
  }
  if (key === "human" && argument) {
    return say("names.close", { number: argument });
  }
  return /^[a-z]+(-[a-z]+)+$/.test(name) ? capitalized(name.replaceAll("-", " ")) : name; // a person of a data set
}

/** Name of a seat; two of one name are told apart by their sides. */
export function nameAt(names: readonly [string, string], seat: number): string {
  const name = displayName(names[seat as 0 | 1]);
  return names[0] === names[1] ? `${name} (${"AB"[seat]})` : name;
}

/** Marks a left-handed player. */
export function handTag(hand: string): HTMLElement | null {
  const label = say("page.left_handed");
  return hand === "left"
    ? h("span", { class: "tag", role: "img", "aria-label": label, title: label }, say("page.left_short"))
    : null;
}

/** A seat with a verb, at the start of a sentence: "Average pro wins", "You win". */
export function does(names: readonly [string, string], seat: number, verb: "win" | "serve"): string {
  return names[seat as 0 | 1] === "you"
    ? capitalised(say(`does.you_${verb}`))
    : say(`does.${verb}`, { name: nameAt(names, seat) });
}

const WIDE = 14; // letters that fit on a shirt

/** Name on the shirt of a player: of a person the whole name if it fits, else its last word; the first two words of other names. */
export function nameOnShirt(identifier: string): string {
  const words = displayName(identifier)
    .replace(/[,(].*/, "")
    .trim()
    .split(" ");
  const person = !(identifier in KNOWN) && !/^(ppo|a2c|sac|human|minimax|best-response)\b/.test(identifier);
  const whole = words.join(" ");
  return !person ? words.slice(0, 2).join(" ") : whole.length <= WIDE ? whole : words.at(-1)!;
}

/** Identifiers in groups, in the order of the list. */
export function grouped(identifiers: string[]): [string, string[]][] {
  const of = (name: string) => GROUPS.find(([, test]) => test(name))?.[0] ?? OTHERS;
  const groups = [...GROUPS.map(([group]) => group), OTHERS];
  return groups
    .map((group): [string, string[]] => [group, identifiers.filter((name) => of(name) === group)])
    .filter(([, members]) => members.length > 0);
}
