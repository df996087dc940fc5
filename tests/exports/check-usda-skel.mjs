// A USDA file with UsdSkel blend shapes as TinyUSDZ reads it, posed here by the schemas' rules and held against the true vertices of
// every frame.
// Usage: node check-usda-skel.mjs TINYUSDZ_FOLDER FILE.usda TRUTH_FOLDER CURVES.json
// TRUTH_FOLDER holds frame_%06d.f32: [vertex_count][3] metres, x right, y up, z towards the viewer. CURVES.json: the shapes' names and
// their weights by frame.
import fs from 'fs';
import os from 'os';
import path from 'path';
// The module is made for browsers alone and asks whether it is in one.
process.type = 'renderer';
globalThis.window = globalThis;
const [folder, file, truthFolder, curvesFile] = process.argv.slice(2);
// It is an ES module that neither its name nor its package says to be one: only newer versions of Node.js find that out.
const named = fs.mkdtempSync(path.join(os.tmpdir(), 'tinyusdz-'));
process.on('exit', () => fs.rmSync(named, { recursive: true, force: true }));
fs.copyFileSync(path.join(folder, 'tinyusdz.js'), path.join(named, 'tinyusdz.mjs'));
const open = (await import(path.join(named, 'tinyusdz.mjs'))).default;
const usd = await open({ wasmBinary: fs.readFileSync(path.join(folder, 'tinyusdz.wasm')) });
const check = (right, what) => { if (!right) { console.log(`${file}: ${what}`); process.exit(1); } };

const layer = new usd.TinyUSDZLoaderNative();
check(layer.loadAsLayerFromBinary(new Uint8Array(fs.readFileSync(file)), file), layer.error());
// What it understood, in its own writing: prims with their attributes, one a line.
const text = layer.layerToString();
const prims = new Map();
{
  const open = [];
  let pending = null;
  for (const line of text.split('\n')) {
    const start = line.match(/^\s*def (\w+) "(\w+)"/);
    if (start) pending = { type: start[1], path: `${open.length ? open.at(-1).path : ''}/${start[2]}`, lines: [] };
    else if (/^\s*\{\s*$/.test(line) && pending) { open.push(pending); prims.set(pending.path, pending); pending = null; }
    else if (/^\s*\}\s*$/.test(line) && open.at(-1)?.block) open.at(-1).block = false;
    else if (/^\s*\}\s*$/.test(line)) open.pop();
    else if (open.length) {
      open.at(-1).lines.push(line.trim());
      open.at(-1).block ||= /=\s*\{\s*$/.test(line);
    }
  }
}
const of = (primPath, type) => { const prim = prims.get(primPath); check(prim?.type === type, `${primPath} is no ${type}: ${[...prims.keys()]}`); return prim; };
const numbers = (line) => (line.match(/-?\d+(\.\d+)?(e[-+]?\d+)?/gi) ?? []).map(Number);
const value = (prim, name) => {
  const line = prim.lines.find((each) => each.split(' = ')[0].split(' ').at(-1) === name);
  check(line !== undefined, `${prim.path} has no ${name}`);
  return line.slice(line.indexOf(' = ') + 3);
};
const samples = (prim, name) => {
  const begin = prim.lines.findIndex((line) => line.includes(`${name}.timeSamples = {`));
  check(begin >= 0, `${prim.path} has no samples of ${name}`);
  const found = new Map();
  for (let i = begin + 1; i < prim.lines.length && /^-?[\d.]+: /.test(prim.lines[i]); ++i) {
    found.set(Number(prim.lines[i].split(':')[0]), numbers(prim.lines[i].slice(prim.lines[i].indexOf(':') + 1)));
  }
  return found;
};
const words = (line) => [...line.matchAll(/"([^"]*)"/g)].map((match) => match[1]);
const paths = (line) => [...line.matchAll(/<([^>]*)>/g)].map((match) => match[1]);

const root = of('/face', 'SkelRoot'), mesh = of('/face/head', 'Mesh'), skeleton = of('/face/skeleton', 'Skeleton');
check(/upAxis = "Y"/.test(text) && /metersPerUnit = 1\b/.test(text), 'not metres and y up');
check(paths(value(mesh, 'skel:skeleton'))[0] === skeleton.path, 'the mesh has another skeleton');
const animation = of(paths(value(skeleton, 'skel:animationSource'))[0], 'SkelAnimation');
const joints = words(value(skeleton, 'joints')).length;
for (const name of ['bindTransforms', 'restTransforms']) check(numbers(value(skeleton, name)).length === 16 * joints, name);

const truth = JSON.parse(fs.readFileSync(curvesFile));
const names = words(value(mesh, 'skel:blendShapes'));
check(JSON.stringify(names) === JSON.stringify(truth.names), `shapes ${names}`);
const animated = words(value(animation, 'blendShapes'));
const weights = samples(animation, 'blendShapeWeights');
const poses = samples(root, 'xformOp:transform');
const rest = numbers(value(mesh, 'points'));
const extent = numbers(value(root, 'extent'));
check(numbers(value(mesh, 'normals')).length === rest.length, 'normals');
check(2 * rest.length === 3 * numbers(value(mesh, 'primvars:st')).length, 'texture coordinates');
check(numbers(value(mesh, 'primvars:displayColor')).length === rest.length, 'colours');
let sparse = 0;
const shapes = paths(value(mesh, 'skel:blendShapeTargets')).map((target) => {
  const prim = of(target, 'BlendShape');
  const shape = { offsets: numbers(value(prim, 'offsets')), normals: numbers(value(prim, 'normalOffsets')), indices: numbers(value(prim, 'pointIndices')) };
  check(shape.offsets.length === 3 * shape.indices.length && shape.normals.length === shape.offsets.length, `${target} has arrays of different lengths`);
  check(shape.indices.every((index) => Number.isInteger(index) && index >= 0 && index < rest.length / 3), `${target} has other indices`);
  sparse += shape.indices.length;
  return shape;
});
check(shapes.length === names.length, `${shapes.length} targets`);
check(sparse < 0.5 * shapes.length * rest.length / 3, 'shapes hold vertices that they do not move');

const files = fs.readdirSync(truthFolder).filter((name) => name.endsWith('.f32')).sort();
let worst = 0, worstWeight = 0;
for (const name of files) {
  const frame = Number(name.slice(6, 12));
  const bytes = fs.readFileSync(path.join(truthFolder, name));
  const expected = new Float32Array(bytes.buffer, bytes.byteOffset, bytes.length / 4);
  const w = weights.get(frame), m = poses.get(frame);
  check(w && m && w.length === animated.length && expected.length === rest.length, `frame ${frame}`);
  names.forEach((each, i) => { worstWeight = Math.max(worstWeight, Math.abs(w[animated.indexOf(each)] - truth.weights[frame][i])); });
  const points = rest.slice();
  shapes.forEach((shape, s) => {
    const weight = w[animated.indexOf(names[s])];
    shape.indices.forEach((index, i) => { for (let axis = 0; axis < 3; ++axis) points[3 * index + axis] += weight * shape.offsets[3 * i + axis]; });
  });
  for (let v = 0; v < points.length; v += 3) {
    for (let axis = 0; axis < 3; ++axis) {
      check(points[v + axis] >= extent[axis] - 1e-5 && points[v + axis] <= extent[3 + axis] + 1e-5, `frame ${frame}: a vertex is outside the extent`);
      // Row vectors: p M.
      const moved = points[v] * m[axis] + points[v + 1] * m[4 + axis] + points[v + 2] * m[8 + axis] + m[12 + axis];
      worst = Math.max(worst, Math.abs(moved - expected[v + axis]));
    }
  }
}
check(poses.size === files.length && weights.size === files.length, 'another number of samples');
console.log(`${file}: ${files.length} frames, ${shapes.length} shapes, at most ${(1e6 * worst).toFixed(2)} um off, weights ${worstWeight}`);
check(worst < 1e-5, 'vertices are elsewhere');
check(worstWeight < 1e-6, 'weights are others');
process.exit(0);
