// A rally or a match as one page that opens from disk, and a picture of the moment.

import { parseMessage } from "./wire";

/** What a shared page holds: replies of the server by request, and models; all packed with gzip and written as base64. */
export interface Shared {
  hello: string;
  replies: Record<string, string>;
  models: Record<string, string>;
}

async function gzipped(content: ArrayBuffer): Promise<string> {
  const stream = new Blob([content]).stream().pipeThrough(new CompressionStream("gzip"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  let text = "";
  for (let i = 0; i < bytes.length; i += 0x8000) {
    text += String.fromCharCode(...bytes.subarray(i, i + 0x8000));
  }
  return btoa(text);
}

export async function ungzipped(text: string): Promise<ArrayBuffer> {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
}

export async function packShared(hello: ArrayBuffer, replies: Map<string, ArrayBuffer>, models: Map<string, ArrayBuffer>): Promise<Shared> {
  const all = async (parts: Map<string, ArrayBuffer>) =>
    Object.fromEntries(await Promise.all([...parts].map(async ([key, content]) => [key, await gzipped(content)] as const)));
  return { hello: await gzipped(hello), replies: await all(replies), models: await all(models) };
}

/** The page itself, with script, style and what it shows inside. */
export function sharedPage(script: string, style: string, shared: Shared, title: string, hash: string): Blob {
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
