// Makes a page of a match as the page does, and prints how large it is and how far what it shows is off, as JSON:
// node FILE.js FOLDER RALLIES, with watch.js, watch.css, hello, male.glb, rally-0 … and analysis-0 … in the folder. Where there are
// more rallies than files, the files are taken again.
import { readdirSync, readFileSync } from "node:fs";
import { expanded } from "../../../shuttle_marl/watch/page/src/condensed";
import { BONES, Motion } from "../../../shuttle_marl/watch/page/src/motion";
import { openShared, sharedPage, type Shared } from "../../../shuttle_marl/watch/page/src/share";
import { parseMessage } from "../../../shuttle_marl/watch/page/src/connection";
import type { RallyFacts } from "../../../shuttle_marl/watch/page/src/wire.gen";

const [folder, count] = process.argv.slice(2);
const read = (name: string): ArrayBuffer => {
  const content = readFileSync(`${folder}/${name}`);
  return content.buffer.slice(content.byteOffset, content.byteOffset + content.byteLength) as ArrayBuffer;
};
const files = readdirSync(folder!).filter((name) => name.startsWith("rally-")).length;
const numbers = Array.from({ length: Number(count) }, (_, i) => i);
const replies = new Map(numbers.flatMap((i) => ["rally", "analysis"].map((op) => [`${op} ${i}`, read(`${op}-${i % files}`)] as const)));
const text = (name: string) => new TextDecoder().decode(read(name));
const content = { script: text("watch.js"), style: text("watch.css"), hello: read("hello"), replies, models: new Map([["male", read("male.glb")]]) };
const page = await sharedPage(content, numbers.map((i) => `rally ${i}`), "a v b", "#rally=1");
const found = (await page.text()).match(/id="shared">(.*?)<\/script>/s);
const shared: Shared = JSON.parse(found![1]!);

let [turn, place, seconds] = [0, 0, 0];
for (let i = 0; i < files; i++) {
  const { facts, body } = await openShared<{ rally: RallyFacts }>(shared.replies[`rally ${i}`]!);
  const shown = expanded(body);
  const played = await Motion.unpack(parseMessage(read(`rally-${i}`)).body);
  if (shown.frames !== played.frames || facts.rally.number !== i) {
    throw new Error(`rally ${i} comes back as another one`);
  }
  seconds += played.duration;
  const [a, b] = [new Float64Array(BONES * 4), new Float64Array(BONES * 4)];
  for (let frame = 0; frame < played.frames; frame++) {
    for (const seat of [0, 1]) {
      const time = frame / played.fps;
      played.rotationsAt(time, seat, a);
      shown.rotationsAt(time, seat, b);
      for (let bone = 0; bone < BONES; bone++) {
        const dot = [0, 1, 2, 3].reduce((sum, k) => sum + a[4 * bone + k]! * b[4 * bone + k]!, 0);
        turn = Math.max(turn, 2 * Math.acos(Math.min(1, Math.abs(dot))));
      }
      const [p, q] = [played.hipsAt(time, seat, [0, 0, 0]), shown.hipsAt(time, seat, [0, 0, 0])];
      place = Math.max(place, Math.hypot(p[0] - q[0], p[1] - q[1], p[2] - q[2]));
    }
  }
}
console.log(JSON.stringify({ bytes: page.size, turn, place, seconds: (seconds * numbers.length) / files }));
