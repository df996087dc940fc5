// What a face recogniser says of pictures: 128 numbers each.
// Usage: node descriptors.mjs MODULES COUNT < PICTURES     MODULES: a folder in which `npm ci` was run with this folder's package-lock.json.
// PICTURES: COUNT of 150 x 150 px, R G B bytes one after the other. Prints one JSON array a picture and line.
// The net: face-api's port of dlib's face recognition net (a residual net, trained on some 3 million pictures of 7,485 persons). It is given the
// pictures as they are: neither the package's detector nor its landmarks have a say, which find no face in most renderings.
import { createRequire } from 'node:module';
import { readFileSync } from 'node:fs';
import { dirname, join, resolve } from 'node:path';

const kSide_px = 150;
const kBytes = 3 * kSide_px * kSide_px;
const [modules, count] = process.argv.slice(2);
const require = createRequire(join(resolve(modules), 'package.json'));
const faceapi = require('@vladmandic/face-api/dist/face-api.node-wasm.js');
require('@tensorflow/tfjs-backend-wasm').setWasmPaths(dirname(require.resolve('@tensorflow/tfjs-backend-wasm')) + '/');
await faceapi.tf.setBackend('wasm');
await faceapi.tf.ready();
const net = new faceapi.FaceRecognitionNet();
await net.loadFromDisk(join(dirname(require.resolve('@vladmandic/face-api/package.json')), 'model'));

const bytes = readFileSync(0);
if (bytes.length !== Number(count) * kBytes) {
  console.error(`descriptors.mjs: ${bytes.length} bytes on standard input, not ${count} pictures of ${kSide_px} x ${kSide_px} px`);
  process.exit(2);
}
for (let at = 0; at < bytes.length; at += kBytes) {
  const picture = faceapi.tf.tensor3d(Float32Array.from(bytes.subarray(at, at + kBytes)), [kSide_px, kSide_px, 3]);
  const descriptor = net.forwardInput(new faceapi.NetInput([picture]));
  console.log(JSON.stringify(Array.from(await descriptor.data())));
  picture.dispose();
  descriptor.dispose();
}
