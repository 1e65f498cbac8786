// A rally or a match as one page that opens from disk, and downloads.

import { decode, encode } from "./base91";
import { condense } from "./condensed";
import { parseMessage } from "./connection";
import { Motion } from "./motion";
import type { RallyFacts } from "./wire.gen";
import { say } from "./words";

/** Total duration above which the quantization of motions gets coarser, which limits the size of the page [s]. */
const FINE = 1000;
const COARSEST = 4;

/** Content of a shared page: replies of the server by request, and models; compressed with gzip and encoded with basE91. */
export interface Shared {
  hello: string;
  replies: Record<string, string>;
  models: Record<string, string>;
}

async function gzipped(content: ArrayBuffer): Promise<string> {
  const stream = new Blob([content]).stream().pipeThrough(new CompressionStream("gzip"));
  return encode(new Uint8Array(await new Response(stream).arrayBuffer()));
}

function decompressed(content: BlobPart): Promise<ArrayBuffer> {
  return new Response(new Blob([content]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
}

export async function ungzipped(text: string): Promise<ArrayBuffer> {
  return decompressed(decode(text));
}

/** Parts of a shared page: script, style, and replies of the server. */
export interface Content {
  script: string;
  style: string;
  hello: ArrayBuffer;
  replies: Map<string, ArrayBuffer>;
  models: Map<string, ArrayBuffer>;
}

/**
 * Creates a page that opens from disk; the motions of a match are compressed.
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

/** A reply with a rally and its compressed motion; `seconds` is the duration of all rallies of the page. */
async function condensedReply(reply: ArrayBuffer, seconds: number): Promise<ArrayBuffer> {
  const { body } = parseMessage(reply);
  const motion = condense(await Motion.unpack(body), Math.min(COARSEST, Math.max(1, seconds / FINE)));
  return new Blob([reply.slice(0, reply.byteLength - body.byteLength), motion]).arrayBuffer();
}

/** Content security policy of a saved page: its own inline scripts, and no connection to any host. */
const POLICY =
  "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; media-src blob:; connect-src data: blob:; worker-src blob:; base-uri 'none'; form-action 'none'";

/** HTML of the page with script, style and content. */
function written(script: string, style: string, shared: Shared, title: string, hash: string): Blob {
  const safe = (text: string) => text.replaceAll("<", "\\u003c");
  const plain = title.replace(/[<>&"]/g, "");
  return new Blob(
    [
      `<!doctype html><html lang="${say("language.tag")}"><head><meta charset="utf-8"><meta http-equiv="Content-Security-Policy" content="${POLICY}">`,
      `<meta name="viewport" content="width=device-width, initial-scale=1"><title>${plain}</title>`,
      `<style>${style.replaceAll("</", "<\\/")}</style></head><body>`,
      `<script>if (!location.hash) location.hash = ${safe(JSON.stringify(hash))};</script>`,
      `<script type="application/json" id="shared">${safe(JSON.stringify(shared))}</script>`,
      `<script type="module">${script.replaceAll("</script", "<\\/script").replaceAll("<!--", "<\\!--")}</script></body></html>`,
    ],
    { type: "text/html" },
  );
}

/** Content of this shared page; null if a server sent it. */
export function readShared(): Shared | null {
  const element = document.getElementById("shared");
  return element ? (JSON.parse(element.textContent!) as Shared) : null;
}

/** Whether this page is one of static files, without a server that answers. */
export function isSite(): boolean {
  return document.querySelector("meta[name=site]") !== null;
}

/** Opens a compressed reply. */
export async function openReply<F>(content: BlobPart): Promise<{ facts: F; body: ArrayBuffer }> {
  return parseMessage(await decompressed(content)) as unknown as { facts: F; body: ArrayBuffer };
}

export async function openShared<F>(text: string): Promise<{ facts: F; body: ArrayBuffer }> {
  return openReply<F>(decode(text));
}

export function save(content: Blob, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
