// Names of policies that a viewer knows, beside their identifiers.

const KNOWN: Record<string, string> = {
  bc: "Average pro",
  "human:0.05": "Strong player",
  minimax: "Perfect play",
  "minimax:robust": "Perfect play, safe against errors of the model",
  "best-response:bc": "Best reply to the average pro",
  attacking: "Attacker",
  defensive: "Defender",
  safe: "Safe player",
  random: "Random strokes",
};
const GROUPS: [string, (identifier: string) => boolean][] = [
  ["Real players, imitated", (name) => /^bc(:|$)/.test(name)],
  ["Strong and perfect play", (name) => /^(minimax|best-response|human)/.test(name)],
  ["Trained agents", (name) => /^(ppo|a2c|sac)(:|$)/.test(name)],
  ["Simple styles", (name) => name in KNOWN],
];

function capitalized(words: string): string {
  return words.replace(/(^|[ -])\p{L}/gu, (letter) => letter.toUpperCase());
}

/** Name of a policy that a viewer knows; its identifier if there is none. A suffix `@0.5` is its variety. */
export function displayName(identifier: string): string {
  const [name, variety] = identifier.split(/@(?=[^@]*$)/) as [string, string?];
  const suffix = variety === undefined ? "" : variety === "greedy" ? ", no variety" : `, variety ${variety}`;
  return `${plainName(name)}${suffix}`;
}

function plainName(name: string): string {
  const [key, argument] = name.split(":", 2) as [string, string?];
  const known = KNOWN[name];
  if (known) {
    return known;
  }
  if (key === "bc" && argument) {
    return `${capitalized(argument.replaceAll("-", " "))} (imitated)`;
  }
  if (/^(ppo|a2c|sac)$/.test(key)) {
    return argument ? `${key.toUpperCase()} agent, ${argument.replaceAll("-", " ")}` : `${key.toUpperCase()} agent`;
  }
  if (key === "human" && argument) {
    return `Strong, close to people (${argument})`;
  }
  return /^[a-z]+(-[a-z]+)+$/.test(name) ? capitalized(name.replaceAll("-", " ")) : name; // a person of a data set
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
  const of = (name: string) => GROUPS.find(([, test]) => test(name))?.[0] ?? "Others";
  const groups = [...GROUPS.map(([group]) => group), "Others"];
  return groups
    .map((group): [string, string[]] => [group, identifiers.filter((name) => of(name) === group)])
    .filter(([, members]) => members.length > 0);
}
