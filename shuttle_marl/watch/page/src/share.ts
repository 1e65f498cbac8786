// A rally or a match as one page that opens from disk, and a picture of the moment.

import { condense } from "./condensed";
import { parseMessage } from "./connection";
import { fromLetters, toLetters } from "./labels";
import { Motion } from "./motion";
import type { RallyFacts } from "./wire.gen";

/** Seconds of play above which motions are condensed the more coarsely, the more there are, so that the page stays small. */
const FINE = 1000;
const COARSEST = 4;

/** What a shared page holds: replies of the server by request, and models; all packed with gzip and written as letters. */
export interface Shared {
  hello: string;
  replies: Record<string, string>;
  models: Record<string, string>;
}

async function gzipped(content: ArrayBuffer): Promise<string> {
  const stream = new Blob([content]).stream().pipeThrough(new CompressionStream("gzip"));
  return toLetters(new Uint8Array(await new Response(stream).arrayBuffer()));
}

export async function ungzipped(text: string): Promise<ArrayBuffer> {
  return new Response(new Blob([fromLetters(text)]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
}

/** What a page is made of: its script and style, and replies of the server. */
export interface Content {
  script: string;
  style: string;
  hello: ArrayBuffer;
  replies: Map<string, ArrayBuffer>;
  models: Map<string, ArrayBuffer>;
}

/**
 * A page that opens from disk; the motions of a match are condensed.
 * @param rallies names of the replies with rallies.
 */
export async function sharedPage(
  { script, style, hello, replies, models }: Content,
  rallies: string[],
  title: string,
  hash: string,
): Promise<Blob> {
  if (rallies.length > 1) {
    const lasting = rallies.map((key) =>
      Number((parseMessage(replies.get(key)!).facts as { rally: RallyFacts }).rally.strokes.at(-1)?.end_time ?? 0),
    );
    const seconds = lasting.reduce((sum, time) => sum + time, 0);
    for (const key of rallies) {
      replies.set(key, await condensedReply(replies.get(key)!, seconds));
    }
  }
  const all = async (parts: Map<string, ArrayBuffer>) => {
    const packed: Record<string, string> = {};
    for (const [key, content] of parts) {
      packed[key] = await gzipped(content);
    }
    return packed;
  };
  return written(
    script,
    style,
    { hello: await gzipped(hello), replies: await all(replies), models: await all(models) },
    title,
    hash,
  );
}

/** A reply with a rally, its motion condensed; `seconds` is how long all rallies of the page play. */
async function condensedReply(reply: ArrayBuffer, seconds: number): Promise<ArrayBuffer> {
  const { body } = parseMessage(reply);
  const motion = condense(await Motion.unpack(body), Math.min(COARSEST, Math.max(1, seconds / FINE)));
  return new Blob([reply.slice(0, reply.byteLength - body.byteLength), motion]).arrayBuffer();
}

/** The page itself, with script, style and what it shows inside. */
function written(script: string, style: string, shared: Shared, title: string, hash: string): Blob {
  const safe = (text: string) => text.replaceAll("<", "\\u003c");
  const plain = title.replace(/[<>&"]/g, "");
  return new Blob(
    [
      `<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1"><title>${plain}</title>`,
      `<style>${style.replaceAll("</", "<\\/")}</style></head><body>`,
      `<script>if (!location.hash) location.hash = ${safe(JSON.stringify(hash))};</script>`,
      `<script type="application/json" id="shared">${safe(JSON.stringify(shared))}</script>`,
      `<script type="module">${script.replaceAll("</script", "<\\/script").replaceAll("<!--", "<\\!--")}</script></body></html>`,
    ],
    { type: "text/html" },
  );
}

/** What the page was shared with, null where it comes from a server. */
export function readShared(): Shared | null {
  const element = document.getElementById("shared");
  return element ? (JSON.parse(element.textContent!) as Shared) : null;
}

export async function openShared<F>(text: string): Promise<{ facts: F; body: ArrayBuffer }> {
  return parseMessage(await ungzipped(text)) as unknown as { facts: F; body: ArrayBuffer };
}

export function save(content: Blob, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
