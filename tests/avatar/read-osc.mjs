// Datagrams read by somebody else's library for Open Sound Control: every message in order, [address, arguments...], as JSON.
// Usage: read-osc.mjs FOLDER FILE      FOLDER: of the npm package osc-min; FILE: datagrams, each behind its length (4 bytes, little-endian)
import { readFileSync } from 'node:fs';

const [folder, file] = process.argv.slice(2);
const { fromBuffer } = await import(`${folder}/dist/index.js`);

function messages(packet) {
  return packet.oscType === 'bundle'
    ? packet.elements.flatMap(messages)
    : [[packet.address, ...packet.args.map((argument) => argument.value)]];
}

const bytes = readFileSync(file);
const found = [];
for (let at = 0; at < bytes.length;) {
  const length = bytes.readUInt32LE(at);
  found.push(...messages(fromBuffer(bytes.subarray(at + 4, at + 4 + length))));
  at += 4 + length;
}
process.stdout.write(JSON.stringify(found));
