// A rally as one page that opens from disk.

import { parseMessage } from "./connection";
import { say } from "./words";

/** Content of a shared page: replies of the server by request, and models; compressed with gzip and encoded with base64. */
export interface Shared {
  hello: string;
  replies: Record<string, string>;
  models: Record<string, string>;
}

async function gzipped(content: ArrayBuffer): Promise<string> {
  const stream = new Blob([content]).stream().pipeThrough(new CompressionStream("gzip"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  return btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
}

function decompressed(content: BlobPart): Promise<ArrayBuffer> {
  return new Response(new Blob([content]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
}

export function ungzipped(text: string): Promise<ArrayBuffer> {
  return decompressed(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)));
}

/** Parts of a shared page: script, style, and replies of the server. */
export interface Content {
  script: string;
  style: string;
  hello: ArrayBuffer;
  replies: Map<string, ArrayBuffer>;
  models: Map<string, ArrayBuffer>;
}

/** Creates a page that opens from disk. */
export async function sharedPage(
  { script, style, hello, replies, models }: Content,
  title: string,
  hash: string,
): Promise<Blob> {
  const all = async (parts: Map<string, ArrayBuffer>) =>
    Object.fromEntries(await Promise.all([...parts].map(async ([key, content]) => [key, await gzipped(content)])));
  const packed = { hello: await gzipped(hello), replies: await all(replies), models: await all(models) };
  return written(script, style, packed, title, hash);
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
  return parseMessage(await ungzipped(text)) as unknown as { facts: F; body: ArrayBuffer };
}

export function save(content: Blob, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
