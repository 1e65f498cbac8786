// Reads a scene file with the official TypeScript implementation of MCAP, as a stream and by its index, with all checksums.
// Prints the number of messages of every topic both ways and the sizes of the attachments; anything wrong ends it with 1.
//
//   node scene.mjs FILE
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";
import { open, readFile } from "node:fs/promises";

const decompressHandlers = await loadDecompressHandlers();
const path = process.argv[2];

function count(counts, topic) {
  counts[topic] = (counts[topic] ?? 0) + 1;
}

const streamed = {};
const reader = new McapStreamReader({ validateCrcs: true, decompressHandlers });
reader.append(new Uint8Array(await readFile(path)));
const channels = new Map();
for (let record = reader.nextRecord(); record != undefined; record = reader.nextRecord()) {
  if (record.type === "Channel") {
    channels.set(record.id, record.topic);
  } else if (record.type === "Message") {
    count(streamed, channels.get(record.channelId));
  }
}
if (!reader.done()) {
  throw new Error("the file ends too early");
}

const indexed = {};
const attachments = {};
const handle = await open(path);
const byIndex = await McapIndexedReader.Initialize({ readable: new FileHandleReadable(handle), decompressHandlers });
let last = -1n;
for await (const message of byIndex.readMessages({ validateCrcs: true })) {
  if (message.logTime < last) {
    throw new Error("messages out of order");
  }
  last = message.logTime;
  count(indexed, byIndex.channelsById.get(message.channelId).topic);
}
for await (const attachment of byIndex.readAttachments({ validateCrcs: true })) {
  attachments[attachment.name] = attachment.data.length;
}
await handle.close();
process.stdout.write(JSON.stringify({ streamed, indexed, attachments }));
