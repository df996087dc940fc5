// An animator at the page: opens a take, drags points on the face, saves key poses, plays them, exports; replays and scrubs. In
// Chromium before a running facetd.
// Usage: node pose_test.mjs FACETD FACET PAGE_FOLDER OUTPUT_FOLDER ASSETS CHROMIUM       Pictures land in the output folder.
import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { join } from 'node:path';
import { Service, drawnBy, kPatience_ms, runTest } from './service.mjs';

const [facetd, facet, pageFolder, output, assets, chromiumFile] = process.argv.slice(2);
const service = await Service.prepare({ facetd, page: pageFolder, assets, log: join(output, 'facetd-pose.log'), source: 'path = "grey.mkv"\nloop = true' });
const { folder } = service;
const ask = (method, params) => service.ask(method, params);
const eventually = (what, holds) => service.eventually(what, holds);

execFileSync('ffmpeg', ['-loglevel', 'error', '-f', 'lavfi', '-i', 'color=gray:s=320x240:r=2', '-t', '5', join(folder, 'grey.mkv')]);
execFileSync(facet, ['synth', '--seed', '3', '--frames', '150', '--vertices', '16000', '-o', join(folder, 'takes/actor.take')], { stdio: ['ignore', 'ignore', 'inherit'] });
const studio = () => ask('studio.status');
const settled = (status) => status && status.state === 'ready' && status.events === status.solved + status.superseded;

let page = null;
await runTest(service, chromiumFile, async (browser, step) => {
  page = await browser.newPage({ viewport: { width: 1280, height: 800 }, locale: 'en-GB' });
  page.setDefaultTimeout(kPatience_ms);
  const faults = [];
  page.on('pageerror', (error) => faults.push(error.message));
  await page.goto(`${service.origin}/#token=${service.token}`);
  const drawn = () => drawnBy(page);
  const freshPicture = async () => {
    const at = await drawn();
    await eventually('another picture', async () => (await drawn()) > at + 1);
  };
  /** Mean colour and its spread over the middle of the face, and a sample of pixels. */
  async function look() {
    const picture = await page.locator('#stage').screenshot();
    return page.evaluate(async (base64) => {
      const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
      const bitmap = await createImageBitmap(new Blob([bytes], { type: 'image/png' }));
      const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
      const draw = canvas.getContext('2d');
      draw.drawImage(bitmap, 0, 0);
      const data = draw.getImageData(bitmap.width * 0.45, bitmap.height * 0.2, bitmap.width * 0.12, bitmap.height * 0.2).data;
      let cool = 0;
      for (let i = 0; i < data.length; i += 4) {
        cool += data[i + 2] > data[i] + 12 || data[i + 1] > data[i] + 12 ? 1 : 0;
      }
      return { cool: (4 * cool) / data.length, pixels: Array.from(data.filter((_, i) => i % 29 === 0)) };
    }, picture.toString('base64'));
  }
  const difference = (a, b) => a.pixels.reduce((sum, value, i) => sum + Math.abs(value - b.pixels[i]), 0) / a.pixels.length;

  // Replay: the take is on the stream; the time-line scrubs.
  await page.getByRole('button', { name: 'Replay take actor' }).click();
  await eventually('the take is open', async () => { const now = await studio(); return settled(now) && now.shown === 'take'; });
  await eventually('a picture', async () => (await drawn()) > 0);
  await page.locator('#track').waitFor();
  const line = await page.locator('#track').boundingBox();
  await page.mouse.move(line.x + 0.2 * line.width, line.y + 6);
  await page.mouse.down();
  await page.mouse.move(line.x + 0.6 * line.width, line.y + 6, { steps: 4 });
  await page.mouse.up();
  const scrubbed = await eventually('the frame at 60 %', async () => { const now = await studio(); return Math.abs(now.time_s - 0.6 * now.duration_s) < 0.2 ? now : null; });
  assert.ok(scrubbed.frame > 80 && scrubbed.frame < 100, `frame ${scrubbed.frame}`);
  await page.locator('#studio-play').click();
  await eventually('it plays on', async () => (await studio()).frame > scrubbed.frame);
  step('replayed and scrubbed');

  // Pose: a press sets a point, a drag moves it, the face follows.
  await page.getByRole('button', { name: 'Pose take actor' }).click();
  await eventually('posing', async () => { const now = await studio(); return settled(now) && now.posing; });
  await page.getByText('Press the face to set a point').waitFor();
  await freshPicture();
  const handle = page.locator('.handle');
  async function setPoint(place) {
    const count = (await studio()).controls.length;
    const at = await page.locator(`.hint[data-place="${place}"]`).boundingBox();
    await page.mouse.click(at.x + at.width / 2, at.y + at.height / 2);
    await eventually('one more point', async () => { const now = await studio(); return settled(now) && now.controls.length === count + 1; });
    await eventually('its handle', async () => (await handle.count()) === count + 1);
  }
  await page.locator('.hint').first().waitFor();
  // Pictures of the take may still be under way: the pose is seen where a hint lies still while three more frames come.
  const received = () => page.evaluate(() => Number(document.body.dataset.frames ?? 0));
  await eventually('the pose is seen', async () => {
    const place = () => page.locator('.hint[data-place="nose"]').boundingBox();
    const before = await place();
    const until = (await received()) + 3;
    await eventually('three more frames', async () => (await received()) >= until);
    await freshPicture();
    const after = await place();
    return before && after && before.x === after.x && before.y === after.y;
  });
  // A press beside the hints: the vertex that is seen there.
  const nose = await page.locator('.hint[data-place="nose"]').boundingBox();
  await page.mouse.click(nose.x + nose.width / 2, nose.y - 30);
  await eventually('a point on the bridge of the nose', async () => { const now = await studio(); return settled(now) && now.controls.length === 1; });
  await eventually('its handle lies where the face was pressed', async () => {
    const at = await handle.first().boundingBox();
    return at && Math.hypot(at.x + at.width / 2 - nose.x - nose.width / 2, at.y + at.height / 2 - nose.y + 30) < 8;
  });
  await handle.first().focus();
  await page.keyboard.press('Delete');
  await eventually('no point', async () => { const now = await studio(); return settled(now) && now.controls.length === 0 && (await handle.count()) === 0; });
  await setPoint('lip-lower');
  step('a point is set');
  const middle = async (locator) => { const at = await locator.boundingBox(); return { x: at.x + at.width / 2, y: at.y + at.height / 2 }; };
  const resting = await look();
  const before = await studio();
  const from = await middle(handle.first());
  await page.mouse.move(from.x, from.y);
  await page.mouse.down();
  await page.mouse.move(from.x + 3, from.y + 14, { steps: 6 });
  await page.mouse.up();
  const after = await eventually('the point moved', async () => {
    const now = await studio();
    return settled(now) && now.controls[0].at_mm[1] < before.controls[0].at_mm[1] - 0.5 ? now : null;
  });
  assert.ok(after.solved > before.solved);
  await eventually('the face follows', async () => difference(resting, await look()) > 0.3);
  await eventually('the handle is on its vertex', async () => {
    const at = await middle(handle.first());
    return Math.hypot(at.x - from.x, at.y - from.y) > 2;
  });
  step(`dragged: ${after.solved - before.solved} events, latency ${after.latency_ms.mean.toFixed(1)} ms, miss ${after.controls[0].miss.toFixed(3)} mm`);

  // Two more points: regions in colours, and one goes again.
  await setPoint('brow-left');
  await setPoint('brow-right');
  const coloured = await eventually('soft colours', async () => { const now = await look(); return now.cool > 0.1 ? now : null; });
  await page.getByRole('button', { name: 'Regions' }).click();
  await eventually('no colours', async () => (await look()).cool < coloured.cool / 2);
  await page.getByRole('button', { name: 'Regions' }).click();
  await eventually('three points', async () => (await studio()).controls.length === 3);
  await page.getByRole('button', { name: 'Remove point' }).click();
  await eventually('two points', async () => { const now = await studio(); return settled(now) && now.controls.length === 2 && (await handle.count()) === 2; });
  step(`regions: ${(100 * coloured.cool).toFixed(0)} % of the face coloured`);

  // By keyboard: an arrow moves the focused point by a millimetre.
  const still = await studio();
  await handle.last().focus();
  await page.keyboard.press('ArrowUp');
  await eventually('a millimetre up', async () => {
    const now = await studio();
    return settled(now) && Math.abs(now.controls[1].at_mm[1] - still.controls[1].at_mm[1] - 1) < 0.3;
  });

  // Keys: this pose, then another; their times are dragged; the animation plays.
  await page.getByRole('button', { name: 'Save key' }).click();
  await page.locator('#keys button').first().waitFor();
  const lower = await middle(handle.first());
  await page.mouse.move(lower.x, lower.y);
  await page.mouse.down();
  await page.mouse.move(lower.x - 2, lower.y - 12, { steps: 4 });
  await page.mouse.up();
  await eventually('settled', async () => settled(await studio()));
  await page.getByRole('button', { name: 'Save key' }).click();
  await eventually('two keys', async () => (await page.locator('#keys button').count()) === 2);
  const second = await middle(page.locator('#keys button').last());
  const track = await page.locator('#track').boundingBox();
  await page.mouse.move(second.x, second.y);
  await page.mouse.down();
  await page.mouse.move(track.x + 0.4 * track.width, second.y, { steps: 5 });
  await page.mouse.up();
  const keys = await eventually('the key stands at 2 s', async () => {
    const stored = (await ask('keys.get')).keys;
    return Math.abs(stored.keys[1].time_s - 2) < 0.1 ? stored : null;
  });
  assert.equal(keys.keys.length, 2);
  assert.equal(keys.keys[0].controls.length, 2);
  step(`keys at ${keys.keys.map((key) => key.time_s).join(' s and ')} s`);
  for (const [name, width, height] of [['pose-landscape', 1920, 1080], ['pose-portrait', 1080, 1920]]) {
    await page.setViewportSize({ width, height });
    await freshPicture();
    const wrong = await page.evaluate(() => [...document.querySelectorAll('#studio button, #takes button, header button')].flatMap((button) => {
      const at = button.getBoundingClientRect();
      const named = (button.getAttribute('aria-label') ?? button.textContent) !== '';
      return at.width === 0 || (at.width >= 44 && at.height >= 44 && at.left >= 0 && at.right <= innerWidth && at.bottom <= innerHeight && named) ? [] : [button.id || button.textContent];
    }));
    assert.deepEqual(wrong, [], name);
    await page.screenshot({ path: join(output, `${name}.png`) });
  }
  await page.setViewportSize({ width: 1280, height: 800 });
  await page.locator('#studio-play').click();
  await eventually('the animation plays', async () => { const now = await studio(); return now.shown === 'keys' && now.time_s > 0.5; });
  await eventually('to its end', async () => { const now = await studio(); return now.state === 'ready' && now.shown === 'keys' && now.time_s > 1.8; });
  step('played');

  await page.getByRole('button', { name: 'Export' }).click();
  await eventually('an exported take', async () => (await ask('takes.list')).takes.some((take) => take.name === 'actor-animated' && take.closed && take.mesh_frames > 55));
  const summary = execFileSync(facet, ['summary', join(folder, 'takes/actor-animated.take')], { encoding: 'utf8' });
  assert.match(summary, /frames +6[0-9]\b/);
  step('exported');

  await page.getByRole('button', { name: 'Back to live' }).click();
  await eventually('closed', async () => (await studio()).state === 'closed');
  await page.locator('#studio').waitFor({ state: 'hidden' });
  assert.equal(await handle.count(), 0);
  assert.deepEqual(faults, []);
}, async () => {
  await page?.screenshot({ path: join(output, 'pose-failure.png') });
  console.error(JSON.stringify(await studio()));
});
