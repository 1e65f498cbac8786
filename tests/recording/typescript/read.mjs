// Reads MCAP files with the official TypeScript implementation, as a stream and by their index, and the rallies in them with
// the official Arrow implementation. Prints one JSON object; a file with anything wrong ends it with exit status 1.
//
//   node read.mjs FILE…
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";
import { tableFromIPC } from "apache-arrow";
import { open, readFile } from "node:fs/promises";

const decompressHandlers = await loadDecompressHandlers();

function must(holds, what) {
  if (!holds) {
    throw new Error(what);
  }
}

async function readStream(path) {
  const reader = new McapStreamReader({ validateCrcs: true, decompressHandlers });
  reader.append(new Uint8Array(await readFile(path)));
  const schemas = new Set();
  const channels = new Map();
  let messages = 0;
  let last = -1n;
  for (let record = reader.nextRecord(); record != undefined; record = reader.nextRecord()) {
    if (record.type === "Schema") {
      schemas.add(record.id);
    } else if (record.type === "Channel") {
      must(schemas.has(record.schemaId), `channel ${record.topic} without a schema`);
      channels.set(record.id, record);
    } else if (record.type === "Message") {
      must(channels.has(record.channelId), "a message without a channel");
      must(record.logTime > last, "messages out of order");
      last = record.logTime;
      messages += 1;
    }
  }
  must(reader.done(), "the file ends too early");
  return { messages, topics: [...channels.values()].map((channel) => channel.topic) };
}

async function readIndexed(path) {
  const handle = await open(path);
  try {
    const reader = await McapIndexedReader.Initialize({ readable: new FileHandleReadable(handle), decompressHandlers });
    const found = { messages: 0, first: [], rallies: 0, strokes: [], updates: [], metadata: {}, attachments: {} };
    for await (const message of reader.readMessages({ topics: ["/rallies"], validateCrcs: true })) {
      const table = tableFromIPC(message.data);
      found.messages += 1;
      found.first.push(Number(table.schema.metadata.get("first_rally")));
      found.rallies += table.numRows;
      for (const row of table) {
        found.strokes.push([...row.strokes]);
        if (row.update != undefined) {
          found.updates.push(row.update);
        }
      }
    }
    must(reader.statistics != undefined, "no statistics");
    must(Number(reader.statistics.messageCount) === found.messages, "the statistics count other messages");
    for await (const metadata of reader.readMetadata()) {
      found.metadata[metadata.name] = Object.fromEntries(metadata.metadata);
    }
    for await (const attachment of reader.readAttachments({ validateCrcs: true })) {
      found.attachments[attachment.name] = tableFromIPC(attachment.data).numRows;
    }
    return found;
  } finally {
    await handle.close();
  }
}

const found = [];
for (const path of process.argv.slice(2)) {
  try {
    found.push({ stream: await readStream(path), indexed: await readIndexed(path) });
  } catch (error) {
    process.exitCode = 1;
    found.push({ error: error.message });
  }
}
process.stdout.write(JSON.stringify(found));
