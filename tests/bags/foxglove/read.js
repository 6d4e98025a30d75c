// Prints the profile of an MCAP file, how many messages it has, and of each the x of its pose, or of its transforms by
// their frames, and its log time.
const { McapIndexedReader } = require("@mcap/core");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");
const { FileHandleReadable } = require("@mcap/nodejs");
const { open } = require("fs/promises");
const fzstd = require("fzstd");
const lz4 = require("lz4js");
const decompressHandlers = {
  zstd: (data, size) => fzstd.decompress(data, new Uint8Array(Number(size))),
  lz4: (data) => lz4.decompress(data),
};
(async () => {
  const readable = new FileHandleReadable(await open(process.argv[2], "r"));
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  const readers = new Map();
  const out = { profile: reader.header.profile, count: Number(reader.statistics.messageCount), x: [], times: [] };
  for await (const message of reader.readMessages()) {
    const channel = reader.channelsById.get(message.channelId);
    const schema = reader.schemasById.get(channel.schemaId);
    if (!readers.has(schema.id)) {
      const definition = parse(new TextDecoder().decode(schema.data), { ros2: true });
      readers.set(schema.id, new MessageReader(definition));
    }
    const { pose, transforms } = readers.get(schema.id).readMessage(message.data);
    const places = (transforms ?? []).map((t) => [t.child_frame_id, t.transform.translation.x]);
    out.x.push(pose ? pose.position.x : Object.fromEntries(places));
    out.times.push(String(message.logTime));
  }
  console.log(JSON.stringify(out));
})();
