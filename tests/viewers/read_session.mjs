// What the official TypeScript reader finds in the session named on the command line, as JSON on standard output:
// by topic, the number of messages, and of every number its sum in the order of the file, and how often it is no number.
// Integers of 64 bits and their sums are decimal text. Log lines are kept as they are.
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers, protobufFromBinaryDescriptor } from "@mcap/support";
import { open } from "node:fs/promises";

const handle = await open(process.argv[2], "r");
const reader = await McapIndexedReader.Initialize({
  readable: new FileHandleReadable(handle),
  decompressHandlers: await loadDecompressHandlers(),
});

const topics = {};
const types = new Map();
for (const [id, channel] of reader.channelsById) {
  const schema = reader.schemasById.get(channel.schemaId);
  const type = protobufFromBinaryDescriptor(schema.data).lookupType(schema.name);
  const fields = type.fieldsArray.map((field) => field.name);
  types.set(id, type);
  topics[channel.topic] = { schema: schema.name, fields, messages: 0, sums: {}, notNumbers: {}, members: {}, lines: [] };
}

function add(summary, field, value) {
  if (!["number", "boolean"].includes(typeof value) && !field.type.endsWith("64")) {
    return;
  }
  if (field.resolvedType?.values) {
    const counts = (summary.members[field.name] ??= {});
    const member = field.resolvedType.valuesById[value];
    counts[member] = (counts[member] ?? 0) + 1;
  }
  if (Number.isNaN(value)) {
    summary.notNumbers[field.name] = (summary.notNumbers[field.name] ?? 0) + 1;
    return;
  }
  const number = typeof value === "object" ? BigInt(value.toString()) : Number(value);
  const before = summary.sums[field.name];
  summary.sums[field.name] = before === undefined ? number : before + number;
}

for await (const message of reader.readMessages()) {
  const summary = topics[reader.channelsById.get(message.channelId).topic];
  const type = types.get(message.channelId);
  const decoded = type.decode(message.data);
  summary.messages += 1;
  if (summary.schema === "foxglove.Log") {
    summary.lines.push(decoded.message);
  } else {
    for (const field of type.fieldsArray) {
      if (!field.repeated && !field.map) {
        add(summary, field, decoded[field.name]);
      }
    }
  }
}

const metadata = [];
for await (const record of reader.readMetadata()) {
  metadata.push(record.name);
}
const attachments = {};
for await (const record of reader.readAttachments()) {
  attachments[record.name] = record.data.length;
}
await handle.close();

const texts = (_key, value) => (typeof value === "bigint" ? value.toString() : value);
console.log(JSON.stringify({ topics, metadata, attachments, counted: reader.statistics.messageCount }, texts));
