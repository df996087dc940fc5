// A USDA file as TinyUSDZ reads it, against the true vertices of every frame.
// Usage: node check-usda.mjs TINYUSDZ_FOLDER FILE.usda TRUTH_FOLDER
// TRUTH_FOLDER holds frame_%06d.f32: [vertex_count][3] metres, x right, y up, z towards the viewer.
import fs from 'fs';
import os from 'os';
import path from 'path';
// The module is made for browsers alone and asks whether it is in one.
process.type = 'renderer';
globalThis.window = globalThis;
const [folder, file, truthFolder] = process.argv.slice(2);
// It is an ES module that neither its name nor its package says to be one: only newer versions of Node.js find that out.
const named = fs.mkdtempSync(path.join(os.tmpdir(), 'tinyusdz-'));
process.on('exit', () => fs.rmSync(named, { recursive: true, force: true }));
fs.copyFileSync(path.join(folder, 'tinyusdz.js'), path.join(named, 'tinyusdz.mjs'));
const open = (await import(path.join(named, 'tinyusdz.mjs'))).default;
const usd = await open({ wasmBinary: fs.readFileSync(path.join(folder, 'tinyusdz.wasm')) });
const check = (right, what) => { if (!right) { console.log(`${file}: ${what}`); process.exit(1); } };

const layer = new usd.TinyUSDZLoaderNative();
check(layer.loadAsLayerFromBinary(new Uint8Array(fs.readFileSync(file)), file), layer.error());
// What it understood, in its own writing: one sample a line.
const text = layer.layerToString();
const numbers = (line) => line.match(/-?\d+(\.\d+)?(e[-+]?\d+)?/gi).map(Number);
const single = (name) => numbers(text.match(new RegExp(`${name} = (.*)`))[1]);
const samples = (name) => {
  const block = text.match(new RegExp(`${name.replace(/[.[\]]/g, '\\$&')}\\.timeSamples = \\{\\n([^}]*)\\}`))[1];
  return new Map(block.trim().split('\n').map((line) => [Number(line.slice(0, line.indexOf(':'))),
                                                          numbers(line.slice(line.indexOf(':') + 1))]));
};
check(/upAxis = "Y"/.test(text) && single('metersPerUnit')[0] === 1, 'not metres and y up');
const points = samples('points');
const normals = samples('normals');
const poses = samples('xformOp:transform');
const extents = samples('extent');
const names = fs.readdirSync(truthFolder).filter((name) => name.endsWith('.f32')).sort();
const frames = names.map((name) => Number(name.slice(6, 12)));
check(JSON.stringify([...points.keys()]) === JSON.stringify(frames), `frames ${[...points.keys()]}, not ${frames}`);
check(single('startTimeCode')[0] === frames[0] && single('endTimeCode')[0] === frames.at(-1), 'wrong time codes');
let worst = 0;
for (const [i, frame] of frames.entries()) {
  const bytes = fs.readFileSync(path.join(truthFolder, names[i]));
  const truth = new Float32Array(bytes.buffer, bytes.byteOffset, bytes.length / 4);
  const p = points.get(frame), n = normals.get(frame), m = poses.get(frame), e = extents.get(frame);
  check(p.length === truth.length && n.length === truth.length, `frame ${frame} has ${p.length / 3} vertices`);
  for (let v = 0; v < p.length; v += 3) {
    check(Math.abs(Math.hypot(n[v], n[v + 1], n[v + 2]) - 1) < 1e-4, `frame ${frame}: a normal is not of length 1`);
    for (let axis = 0; axis < 3; ++axis) {
      check(p[v + axis] >= e[axis] && p[v + axis] <= e[3 + axis], `frame ${frame}: a vertex is outside the extent`);
      // Row vectors: p M.
      const moved = p[v] * m[axis] + p[v + 1] * m[4 + axis] + p[v + 2] * m[8 + axis] + m[12 + axis];
      worst = Math.max(worst, Math.abs(moved - truth[v + axis]));
    }
  }
}
const corners = single('faceVertexIndices').length;
check(single('faceVertexCounts').length * 3 === corners && single('primvars:st').length * 3 === 2 * points.get(frames[0]).length,
      'counts of faces or texture coordinates');
console.log(`${file}: ${frames.length} frames, at most ${(1e6 * worst).toFixed(2)} um off`);
check(worst < 1e-6, 'vertices are elsewhere');
process.exit(0);
