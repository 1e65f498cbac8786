// Prints what the page's decoder finds in a packed motion, as JSON: node FILE.js PACKED FRAME…
import { readFile } from "node:fs/promises";
import { BONES, Motion } from "../../../shuttle_marl/court/page/src/motion";

const [path, ...frames] = process.argv.slice(2);
const content = await readFile(path!);
const motion = await Motion.unpack(content.buffer.slice(content.byteOffset, content.byteOffset + content.byteLength) as ArrayBuffer);
const at = frames.map(Number).map((frame) => {
  const time = frame / motion.fps;
  const seats = [0, 1].map((seat) => {
    const local = new Float64Array(BONES * 4);
    motion.rotationsAt(time, seat, local);
    return { hips: motion.hipsAt(time, seat, [0, 0, 0]), local: [...local], planted: motion.plantedAt(frame, seat) };
  });
  return { frame, shuttle: motion.shuttleAt(time, [0, 0, 0]), seats };
});
console.log(JSON.stringify({ fps: motion.fps, frames: motion.frames, players: motion.head.players, at }));
