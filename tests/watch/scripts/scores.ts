// Prints what the page makes of a table of scores, as JSON: node FILE.js SCORES.
import { readFile } from "node:fs/promises";
import { winsGame } from "../../../shuttle_marl/court/page/src/tagging";

const { games } = JSON.parse(await readFile(process.argv[2]!, "utf-8"));
console.log(JSON.stringify(games.map(([own, other]: number[]) => winsGame(own!, other!, "21"))));
