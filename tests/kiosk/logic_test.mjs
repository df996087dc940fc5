// What the page decides, without a page: levels of detail, rows of the expression and their order.
// Usage: node logic_test.mjs FACETD FACET PAGE_FOLDER OUTPUT_FOLDER
import assert from 'node:assert/strict';
import { load } from './parts.mjs';

const output = process.argv[5];
const { DetailChooser, edgesOf, kDetails, levelFor } = await load('../../clients/kiosk/source/levels.ts', output);
const { SlowOrder, rowsOf } = await load('../../clients/kiosk/source/expressions.ts', output);

// The finest level that is not too much; the coarsest where all are.
const levels = [16768, 32264, 69614, 128922];
assert.equal(levelFor(levels, Infinity), 3);
assert.equal(levelFor(levels, 69614), 2);
assert.equal(levelFor(levels, 69613), 1);
assert.equal(levelFor(levels, 0), 0);
assert.equal(levelFor([128922], 0), 0);

// Less detail after some slow pictures, never below the last step; more after many fast ones, and not for ever to and fro.
const judged = (chooser, took_ms, count) => {
  for (let i = 0; i < count; ++i) {
    chooser.judge(took_ms);
  }
  return chooser.step;
};
const fast = new DetailChooser(false);
assert.equal(judged(fast, 20, 5000), 0, 'neither slow nor fast');
assert.equal(judged(fast, 50, 2), 0, 'two slow pictures are no reason');
assert.equal(judged(fast, 50, 1), 1);
assert.equal(judged(fast, 2, 399), 1);
assert.equal(judged(fast, 2, 1), 0);
for (let round = 0; round < 2; ++round) {
  assert.equal(judged(fast, 50, 3), 1);
  assert.equal(judged(fast, 2, 400), round === 1 ? 1 : 0, 'given up three times: it stays');
}
assert.equal(judged(fast, 500, 1000), kDetails.length - 1);
const software = new DetailChooser(true);
const start = software.step;
assert.ok(levels[levelFor(levels, software.detail.mostTriangles)] <= 35_000, 'a machine without a GPU starts with few triangles');
assert.equal(judged(software, 50, 11), start);
assert.equal(judged(software, 50, 1), start + 1);
assert.ok(judged(software, 1, 100_000) >= 1, "the processor never draws the screen's own pixels twofold");
kDetails.slice(1).forEach((detail, i) => {
  assert.ok(detail.mostTriangles <= kDetails[i].mostTriangles && detail.pixelRatio <= kDetails[i].pixelRatio);
});

assert.deepEqual([...edgesOf(new Uint32Array([0, 1, 2, 2, 1, 3]))].length, 10);

// Left and right in one row, in this order whatever theirs is; what has no other side alone.
assert.deepEqual(rowsOf(['eyeBlinkRight', 'jawOpen', 'eyeBlinkLeft', 'jawLeft', 'jawRight', 'mouthLeft', 'smile_L', 'smile_R']), [
  { base: 'eyeBlink', places: [2, 0] }, { base: 'jawOpen', places: [1] }, { base: 'jaw', places: [3, 4] },
  { base: 'mouthLeft', places: [5] }, { base: 'smile', places: [6, 7] }]);

// What moved most of late comes first; rows that do about the same do not change places; what rests sinks slowly.
const order = new SlowOrder(3);
order.add([0.1, 0.12, 0], 0);
assert.deepEqual([...order.sorted()], [0, 1, 2], 'a difference of 0.02 moves nothing');
order.add([0.1, 0.12, 0.8], 0.1);
assert.deepEqual([...order.sorted()], [2, 0, 1]);
order.add([0.1, 0.5, 0], 1);
assert.deepEqual([...order.sorted()], [2, 1, 0], 'a second of rest is no reason to sink');
for (let i = 0; i < 100; ++i) {
  order.add([0.1 + 0.02 * (i % 2), 0.5, 0], 1);
}
assert.deepEqual([...order.sorted()], [1, 0, 2]);
console.log('levels, rows and their order: as they should be');
