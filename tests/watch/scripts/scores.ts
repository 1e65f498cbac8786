// Prints what the page and the reports make of a table of scores, as JSON: node FILE.js SCORES COACH RULES.
import { readFile } from "node:fs/promises";
import { winsGame } from "../../../shuttle_marl/watch/page/src/tagging";

const [scores, coach, rules] = await Promise.all(process.argv.slice(2).map((path) => readFile(path, "utf-8")));
const { games, matches } = JSON.parse(scores!);
const source = /^function matchChance[^]*?^}/m.exec(coach!)![0];
const matchChance = new Function(`${source} return matchChance;`)();
const known = JSON.parse(rules!);
console.log(JSON.stringify({
  games: games.map(([own, other]: number[]) => winsGame(own!, other!)),
  matches: matches.map(([serving, receiving, name]: [number, number, string]) => matchChance(serving, receiving, known[name])),
}));
