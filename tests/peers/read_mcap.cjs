// Reads an MCAP file as Foxglove and its open fork Lichtblick do and prints what they would draw, as JSON.
// node read_mcap.cjs FOLDER FILE [parseJsonSchema.ts of Lichtblick]: FOLDER has @mcap/core and the others (test_mcap_readers.py).
const fs = require("node:fs");
const { createRequire } = require("node:module");
const path = require("node:path");

const [folder, file, parser] = process.argv.slice(2);
const load = createRequire(path.join(path.resolve(folder), "x.cjs"));
const { McapIndexedReader } = load("@mcap/core");
const { FileHandleReadable } = load("@mcap/nodejs");
const { loadDecompressHandlers } = load("@mcap/support");

function parserOf(source) {
  const typescript = load("typescript");
  const options = { compilerOptions: { module: "CommonJS", target: "ES2022" } };
  const made = { exports: {} };
  const text = typescript.transpileModule(fs.readFileSync(source, "utf-8"), options).outputText;
  new Function("require", "exports", text)(load, made.exports);
  return made.exports.parseJsonSchema;
}

async function main() {
  const handle = await fs.promises.open(file, "r");
  const decompressHandlers = await loadDecompressHandlers();
  const reader = await McapIndexedReader.Initialize({ readable: new FileHandleReadable(handle), decompressHandlers });
  const parse = parser === undefined ? undefined : parserOf(parser);
  const topics = {};
  const readers = new Map();
  for (const channel of reader.channelsById.values()) {
    const schema = reader.schemasById.get(channel.schemaId);
    const root = JSON.parse(new TextDecoder().decode(schema.data));
    const parsed = parse === undefined ? undefined : parse(root, schema.name);
    readers.set(channel.id, parsed === undefined ? (value) => value : parsed.postprocessValue);
    const fields = parsed === undefined ? [] : parsed.datatypes.get(schema.name).definitions;
    topics[channel.topic] = {
      encodings: [channel.messageEncoding, schema.encoding], schema: schema.name, times: [], rows: [],
      types: Object.fromEntries(fields.map((field) => [field.name, field.type])),
    };
  }
  for await (const message of reader.readMessages()) {
    const topic = topics[reader.channelsById.get(message.channelId).topic];
    const value = readers.get(message.channelId)(JSON.parse(new TextDecoder().decode(message.data)));
    topic.times.push(String(message.logTime), String(message.publishTime));
    topic.rows.push(value);
  }
  await handle.close();
  process.stdout.write(JSON.stringify(topics));
}

main();
