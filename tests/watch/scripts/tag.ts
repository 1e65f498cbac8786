// Prints what follows from inputs, as JSON: node FILE.js HALL INPUTS; inputs that are refused are left out, with the reason.
import { readFile } from "node:fs/promises";
import { homography, type Input, mapped, reduce, replay, rows, START } from "../../../shuttle_marl/court/page/src/tagging";

const [hall, inputs] = await Promise.all(process.argv.slice(2).map(async (path) => JSON.parse(await readFile(path, "utf-8"))));
const taken: Input[] = [];
const refused: string[] = [];
const phases: string[] = [];
let state = START;
for (const input of inputs as Input[]) {
  try {
    state = reduce(state, input, hall);
    taken.push(input);
  } catch (error) {
    refused.push((error as Error).message);
  }
  phases.push(state.phase);
}
const same = JSON.stringify(replay(taken, hall)) === JSON.stringify(state);
const last = state.rallies.at(-1);
const middle = state.corners.length === 4 ? mapped(homography(state.corners, [[-1, -1], [1, -1], [1, 1], [-1, 1]]), 0.5, 0.4) : null;
console.log(JSON.stringify({ refused, phases, same, middle, games: state.games, near: state.near, question: state.question, last, rows: state.setup ? rows(state) : [] }));
