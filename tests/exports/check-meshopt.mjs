// A compressed GLB as three.js plays it, against the true vertices of every frame and against the same export without compression.
// Usage: node check-meshopt.mjs THREE_FOLDER COMPRESSED.glb PLAIN.glb TRUTH_FOLDER [PARTS_FOLDER]
// PARTS_FOLDER holds head.i32: which vertices of the truth the mesh "head" has; without it there is one mesh and it has all.
// TRUTH_FOLDER holds frame_%06d.f32: [vertex_count][3] metres, x right, y up, z towards the viewer.
import fs from 'fs';
import path from 'path';
const [folder, compressedFile, plainFile, truthFolder, partsFolder] = process.argv.slice(2);
const module = (name) => import(path.join(folder, name));
const THREE = await module('build/three.module.js');
const { GLTFLoader } = await module('examples/jsm/loaders/GLTFLoader.js');
const { MeshoptDecoder } = await module('examples/jsm/libs/meshopt_decoder.module.js');
const kRate_hz = 30;
const check = (right, what) => { if (!right) { console.log(`${compressedFile}: ${what}`); process.exit(1); } };
const bytesOf = (file) => { const bytes = fs.readFileSync(file); return bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length); };
const load = (file, decoder) => new Promise((done, failed) => {
  const loader = new GLTFLoader();
  loader.setMeshoptDecoder(decoder);
  // Node.js shows no pictures.
  loader.register(() => ({ name: 'no pictures', loadTexture: () => Promise.resolve(new THREE.Texture()) }));
  loader.parse(bytesOf(file), '', done, failed);
});
const meshOf = (gltf) => { let mesh = null; gltf.scene.traverse((node) => { mesh = node.isMesh && (!partsFolder || node.name === 'head') ? node : mesh; }); return mesh; };

const refusal = await load(compressedFile, null).then(() => '', (error) => error.message);
check(/meshopt/i.test(refusal), `a reader without the decoder says '${refusal}'`);
const gltf = await load(compressedFile, MeshoptDecoder);
const [mesh, plain] = [meshOf(gltf), meshOf(await load(plainFile, null))];

// The same triangles in the same order; each may begin at another corner.
const [indices, expected] = [mesh.geometry.index.array, plain.geometry.index.array];
check(indices.length === expected.length, 'another number of triangles');
for (let t = 0; t < indices.length; t += 3) {
  const turned = [0, 1, 2].some((turn) => [0, 1, 2].every((corner) => indices[t + (corner + turn) % 3] === expected[t + corner]));
  check(turned, `triangle ${t / 3} has other corners`);
}
const apart = (a, b) => { check(a.array.length === b.array.length, 'another number of values'); return a.array.reduce((worst, value, i) => Math.max(worst, Math.abs(value - b.array[i])), 0); };
const names = Object.keys(plain.geometry.attributes).sort();
check(JSON.stringify(Object.keys(mesh.geometry.attributes).sort()) === JSON.stringify(names), 'other attributes');
const bars = { position: 2 ** -20, normal: 2 ** -11, uv: 2 ** -19, color: 2 ** -16 };
for (const name of names) {
  check(apart(mesh.geometry.attributes[name], plain.geometry.attributes[name]) <= 1.01 * bars[name], `${name} is rounded by more than half a step`);
}
const normals = (mesh.geometry.morphAttributes.normal ?? []).map((values, i) => apart(values, plain.geometry.morphAttributes.normal[i]));
check(Math.max(0, ...normals) <= 2.02 * bars.normal, `a target's normals are ${Math.max(...normals)} off`);

const mixer = new THREE.AnimationMixer(gltf.scene);
const action = mixer.clipAction(gltf.animations[0]);
action.setLoop(THREE.LoopOnce);
action.clampWhenFinished = true;
action.play();
const files = fs.readdirSync(truthFolder).filter((name) => name.endsWith('.f32')).sort();
const frames = files.map((name) => Number(name.slice(6, 12)));
const intsOf = (file) => { const bytes = fs.readFileSync(file); return Array.from({ length: bytes.length / 4 }, (_, i) => bytes.readInt32LE(4 * i)); };
const part = partsFolder ? intsOf(path.join(partsFolder, 'head.i32')) : null;
let worst = 0;
const point = new THREE.Vector3();
for (const [i, frame] of frames.entries()) {
  const bytes = fs.readFileSync(path.join(truthFolder, files[i]));
  const truth = new Float32Array(bytes.buffer, bytes.byteOffset, bytes.length / 4);
  mixer.setTime((frame - frames[0]) / kRate_hz);
  gltf.scene.updateMatrixWorld(true);
  const count = part ? part.length : truth.length / 3;
  check(mesh.geometry.attributes.position.count === count, `${mesh.geometry.attributes.position.count} vertices`);
  for (let i = 0; i < count; ++i) {
    const v = part ? part[i] : i;
    mesh.getVertexPosition(i, point).applyMatrix4(mesh.matrixWorld);
    worst = Math.max(worst, Math.abs(point.x - truth[3 * v]), Math.abs(point.y - truth[3 * v + 1]), Math.abs(point.z - truth[3 * v + 2]));
  }
}
const [small, large] = [compressedFile, plainFile].map((file) => fs.statSync(file).size);
console.log(`${compressedFile}: ${frames.length} frames, at most ${(1e6 * worst).toFixed(2)} um off, ${small} bytes of ${large} (${(100 * small / large).toFixed(0)} %)`);
// Half a step along each axis, turned with the head; the steps of 51 shapes that add up are smaller.
check(worst < (mesh.morphTargetInfluences.length === 51 ? 1e-5 : 2.5e-6), 'vertices are elsewhere');
process.exit(0);
