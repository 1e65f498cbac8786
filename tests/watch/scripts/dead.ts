// Prints where a film goes on: node FILE.js GIVEN, a JSON file with the arguments.
import { readFile } from "node:fs/promises";
import { nextPlay } from "../../../shuttle_marl/court/page/src/dead_time";

const { motion, rallies, from, within } = JSON.parse(await readFile(process.argv[2]!, "utf-8"));
console.log(JSON.stringify(nextPlay(motion, rallies, from, within)));
