// What the page shows of what it is told, at the sizes of a phone, a tablet, a notebook and a booth's screen. Nobody but this file says it: a stream and
// a control connection in the browser, no daemon.
// Usage: node states_test.mjs FACETD FACET PAGE_FOLDER OUTPUT_FOLDER ASSETS CHROMIUM       Pictures land in the output folder.
import assert from 'node:assert/strict';
import { createReadStream, existsSync } from 'node:fs';
import http from 'node:http';
import { join } from 'node:path';
import { load } from './parts.mjs';
import { drawnBy, kPatience_ms, openBrowser, wait } from './service.mjs';

const [, , pageFolder, output, , chromiumFile] = process.argv.slice(2);
const fake = await load('fake_stream.ts', output);
const kNames = ['eyeBlinkLeft', 'jawOpen', 'mouthSmileLeft', 'mouthSmileRight', 'eyeBlinkRight', 'mouthShrugUpper', 'browDownLeft', 'browDownRight'];
const kTypes = { html: 'text/html', js: 'text/javascript', css: 'text/css', svg: 'image/svg+xml' };
const server = http.createServer((request, answer) => {
  if (request.url === '/look') {
    answer.end('open\n'); // nobody needs a token to look
    return;
  }
  const file = join(pageFolder, request.url === '/' ? 'index.html' : request.url.replace(/[?#].*|\.\./g, ''));
  answer.writeHead(existsSync(file) ? 200 : 404, { 'content-type': kTypes[file.split('.').pop()] ?? 'text/plain' });
  existsSync(file) ? createReadStream(file).pipe(answer) : answer.end();
});
await new Promise((listens) => server.listen(0, '127.0.0.1', listens));
const origin = `http://127.0.0.1:${server.address().port}`;

const plainStatus = () => ({
  version: '0', state: 'running', mode: 'monocular', reason: '', source: null, camera: { state: 'streaming', reason: '' }, rig: null,
  tracking: 'tracking', degraded_reason: '', given_up: '', frames: { processed: 9, face: 9, mesh: 9 }, frames_per_second: 25, gpu: 'llvmpipe (LLVM 15)',
  studio: null, stream: { readers: [{ frames_dropped: 900 }] }, recording: null, learning: null, bridges: null, takes: { list: 1 } });
const kTake = { name: 'monday', created_utc: '2026-01-05T10:00:00Z', frames: 9, mesh_frames: 9, duration_s: 3, bytes: 1e6, closed: true };

async function eventually(what, holds) {
  for (const end = Date.now() + kPatience_ms; Date.now() < end; await wait(50)) {
    const value = await holds();
    if (value) {
      return value;
    }
  }
  return assert.fail(`not within ${kPatience_ms / 1000} s: ${what}`);
}

/** A page before what `says` says: it may be changed at any time. */
async function open(browser, { locale = 'en-GB', token = 'token', coarser = true, says = {} } = {}) {
  const page = await browser.newPage({ viewport: { width: 800, height: 600 }, locale });
  page.setDefaultTimeout(kPatience_ms);
  const told = { status: plainStatus(), expression: kNames.map(() => 0), confidence: null, asked: [], send: null, ...says };
  page.on('pageerror', (error) => assert.fail(error));
  await page.routeWebSocket(/\/control$/, (socket) => socket.onMessage((data) => {
    const { id, method, params } = JSON.parse(data);
    told.asked.push(method);
    const result = method === 'status' ? told.status : method === 'takes.list' ? { folder: '/takes', count: 1, takes: [kTake] }
      : method === 'studio.status' ? told.status.studio : method === 'keys.get' ? { keys: null }
      : method === 'pose.regions' ? { vertices: [], colours: [], rgb: '' } : told.answer?.(method, params) ?? {};
    socket.send(JSON.stringify({ jsonrpc: '2.0', id, result }));
  }));
  await page.routeWebSocket(/\/stream$/, (socket) => {
    socket.send(fake.hello());
    told.send = (message) => socket.send(message);
    told.sendFrame = () => socket.send(fake.frame(told.expression, told.confidence));
    socket.onMessage(() => {
      socket.send(fake.subject(kNames, coarser));
      told.sendFrame();
      told.timer ??= setInterval(told.sendFrame, 400);
    });
  });
  page.on('close', () => clearInterval(told.timer));
  await page.goto(`${origin}/${token ? `#token=${token}` : ''}`);
  await eventually('a face', async () => (await drawnBy(page)) > 1);
  return { page, told };
}

const textOf = (page, id) => page.locator(`#${id}`).textContent();
const rowOf = (page, name) => page.locator('#devices li').filter({ hasText: name });

/** Where the face is on the stage, and what of the notes and controls lies over it or over each other. Each as the screen has it. */
async function overlaps(page) {
  const style = await page.addStyleTag({ content: '#notes, #controls { visibility: hidden !important; } #stage { background: #000 !important; }' });
  const picture = (await page.locator('#stage').screenshot()).toString('base64');
  await style.evaluate((node) => node.remove());
  return page.evaluate(async (base64) => {
    const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
    const bitmap = await createImageBitmap(new Blob([bytes], { type: 'image/png' }));
    const draw = new OffscreenCanvas(bitmap.width, bitmap.height).getContext('2d');
    draw.drawImage(bitmap, 0, 0);
    const { data } = draw.getImageData(0, 0, bitmap.width, bitmap.height);
    const stage = document.getElementById('stage').getBoundingClientRect();
    const face = { left: Infinity, top: Infinity, right: -Infinity, bottom: -Infinity };
    for (let i = 0; i < data.length; i += 4) {
      if (data[i] > 60) {
        const [x, y] = [stage.left + (i / 4) % bitmap.width, stage.top + Math.floor(i / 4 / bitmap.width)];
        Object.assign(face, { left: Math.min(face.left, x), top: Math.min(face.top, y), right: Math.max(face.right, x), bottom: Math.max(face.bottom, y) });
      }
    }
    const boxes = ['#banner', '#recording', '#unknown', '#detail', '#shape', '#legend', '#studio', '#views', '#neutral', '#record']
      .map((name) => ({ name, box: document.querySelector(name).getBoundingClientRect() })).filter(({ box }) => box.width > 0);
    const over = (a, b) => Math.min(a.right, b.right) - Math.max(a.left, b.left) > 1 && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 1;
    const faults = boxes.filter(({ box }) => over(box, face)).map(({ name }) => `${name} lies over the face`);
    boxes.forEach((a, i) => boxes.slice(i + 1).filter((b) => over(a.box, b.box)).forEach((b) => faults.push(`${a.name} lies over ${b.name}`)));
    const inside = face.left > stage.left + 2 && face.right < stage.right - 2 && face.top > stage.top + 2 && face.bottom < stage.bottom - 2;
    for (const card of document.querySelectorAll('.card')) {
      const box = card.getBoundingClientRect();
      const aside = document.querySelector('aside');
      const scrolls = getComputedStyle(aside).overflowY === 'auto' && aside.scrollHeight > aside.clientHeight;
      if (box.width > 0 && box.bottom > innerHeight + 1 && !(scrolls && aside.classList.contains('more-below'))) faults.push(`${card.id} is cut off`);
    }
    for (const name of document.querySelectorAll('.bar span')) {
      if (name.scrollWidth > name.clientWidth + 1) faults.push(`${name.textContent} is cut`);
    }
    return { faults, height: face.bottom - face.top, share: (face.bottom - face.top) / stage.height, inside };
  }, picture);
}

const kSizes = [[390, 844], [820, 1180], [1280, 800], [1920, 1080]];

async function sizesAreRight(browser, step) {
  const learning = { state: 'looking', subject: 1, note: '', seen_deg: [[5, 0]], turned_left_deg: 5, turned_right_deg: 0, needed_deg: 12 };
  const posing = { state: 'ready', take: 'monday', reason: '', done: 1, total: 1, posing: true, shown: 'pose', time_s: 0, duration_s: 3, events: 1,
    solved: 1, superseded: 0, latency_ms: { mean: 12, p95: 20 }, controls: [], places: { nose: 1 }, warnings: [], exported: '' };
  const recording = { state: 'recording', reason: '', warning: '', file: '/takes/tuesday.take', frames: 9, dropped: 2, bytes: 9 };
  for (const locale of ['en-GB', 'de-DE']) {
    const { page, told } = await open(browser, { locale });
    await page.keyboard.press('5');
    const faults = [];
    for (const [name, changes] of [['live', { learning }], ['recording', { learning, recording }], ['studio', { studio: posing }]]) {
      told.status = { ...plainStatus(), ...changes };
      told.confidence = name === 'recording' ? 0.9 : null;
      const until = told.asked.length + 6;
      await eventually('the page knows', () => told.asked.length > until);
      for (const [width, height] of locale === 'en-GB' ? kSizes : kSizes.filter(([width]) => width === 390 || width === 1280)) {
        await page.setViewportSize({ width, height });
        const before = await drawnBy(page);
        await eventually('pictures of this size', async () => (await drawnBy(page)) > before + 3);
        let last = null;
        const stands = async () => {
          const seen = await overlaps(page);
          const moved = !(seen.height > 0) || last?.height !== seen.height;
          last = seen;
          return moved ? null : seen;
        };
        const { faults: wrong, share, inside } = await eventually('the face stands', stands);
        const least = name === 'studio' ? 0.2 : 0.3;
        const where = `${name}, ${locale}, ${width}x${height}`;
        faults.push(...wrong.map((fault) => `${where}: ${fault}`), ...(inside ? [] : [`${where}: the face is not whole on the stage`]),
          ...(share > least ? [] : [`${where}: the face takes ${(100 * share).toFixed(0)} % of the stage's height`]));
        await page.screenshot({ path: join(output, `states-${name}-${locale.slice(0, 2)}-${width}.png`) });
      }
    }
    await page.close();
    assert.equal(faults.length, 0, faults.join('\n'));
    step(`${locale}: nothing over the face`);
  }
}

async function levelsAreDrawn(browser, step) {
  const [coarsest, middle, finest] = fake.kTriangles.map(String);
  const drawn = (page) => page.locator('#face').getAttribute('data-triangles');
  const { page } = await open(browser);
  assert.ok([middle, coarsest].includes(await drawn(page)), `without a GPU: ${await drawn(page)} of ${finest} triangles`);
  await page.close();
  const { page: other } = await open(browser, { coarser: false });
  assert.equal(await drawn(other), finest, 'there is only one level');
  await other.close();
  step('fewer triangles where there is a coarser level');
}

/** Mean colour in the middle of the stage. */
async function middleOf(page) {
  const picture = (await page.locator('#stage').screenshot()).toString('base64');
  return page.evaluate(async (base64) => {
    const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
    const bitmap = await createImageBitmap(new Blob([bytes], { type: 'image/png' }));
    const draw = new OffscreenCanvas(bitmap.width, bitmap.height).getContext('2d');
    draw.drawImage(bitmap, 0, 0);
    const { data } = draw.getImageData(bitmap.width * 0.45, bitmap.height * 0.4, bitmap.width * 0.1, bitmap.height * 0.1);
    return [0, 1, 2].map((channel) => data.filter((_, i) => i % 4 === channel).reduce((sum, value) => sum + value, 0) / (data.length / 4));
  }, picture);
}
const isGrey = ([red, green, blue]) => Math.abs(red - green) < 14 && Math.abs(red - blue) < 22 && red > 60;
const isRed = ([red, green, blue]) => red > green + 40 && red > blue + 40;

async function unknownsAreTold(browser, step) {
  const { page, told } = await open(browser);
  await page.keyboard.press('3');
  await page.getByText('Albedo: not known yet').waitFor();
  await eventually('a grey face', async () => isGrey(await middleOf(page)));
  told.send(fake.albedo());
  await page.locator('#unknown').waitFor({ state: 'hidden' });
  await eventually('its colours', async () => isRed(await middleOf(page)));
  await page.keyboard.press('5');
  await page.getByText('Confidence: not known yet').waitFor();
  await eventually('a grey face', async () => isGrey(await middleOf(page)));
  assert.equal(await page.locator('#legend').isVisible(), false);
  told.confidence = 0;
  await page.locator('#legend').waitFor();
  assert.match(await textOf(page, 'legend'), /nothing measured.*unsure.*sure/);
  await eventually('zeros are grey', async () => isGrey(await middleOf(page)));
  told.confidence = 0.1;
  await eventually('a little is red', async () => isRed(await middleOf(page)));
  told.status = { ...plainStatus(), gpu: '' };
  told.confidence = null;
  await page.getByText('Confidence: not known, refinement is off').waitFor();
  await page.close();
  step('unknown albedo and confidence');
}

async function rowsAreSorted(browser, step) {
  const { page, told } = await open(browser);
  const rows = () => page.evaluate(() => [...document.querySelectorAll('.bar')].sort((a, b) => a.style.order - b.style.order).map((row) => row.querySelector('span').textContent));
  assert.deepEqual((await rows()).slice().sort(), ['brow down', 'eye blink', 'jaw open', 'mouth shrug upper', 'mouth smile']);
  told.expression = kNames.map((name) => ({ mouthSmileLeft: 0.75, mouthSmileRight: 0.25, jawOpen: 0.5 })[name] ?? 0);
  await eventually('the smile first', async () => (await rows()).slice(0, 2).join() === 'mouth smile,jaw open');
  const bars = await page.evaluate(() => [...document.querySelectorAll('.pair')].filter((row) => row.textContent.includes('smile'))
    .flatMap((row) => [...row.querySelectorAll('i')].map((track) => {
      const [outer, inner] = [track.getBoundingClientRect(), track.firstChild.getBoundingClientRect()];
      return { name: track.getAttribute('aria-label'), left: inner.left - outer.left, right: outer.right - inner.right, part: inner.width / outer.width };
    })));
  assert.deepEqual(bars.map(({ name }) => name), ['mouthSmileLeft', 'mouthSmileRight']);
  assert.ok(bars[0].right < 1 && Math.abs(bars[0].part - 0.75) < 0.02, 'the left one grows to the left');
  assert.ok(bars[1].left < 1 && Math.abs(bars[1].part - 0.25) < 0.02, 'the right one grows to the right');
  told.expression = kNames.map(() => 0);
  const until = Date.now() + 4500;
  while (Date.now() < until) {
    assert.equal((await rows())[0], 'mouth smile', 'a rest of some seconds changes nothing');
    await wait(300);
  }
  await page.close();
  step('rows of the expression');
}

async function devicesAreTold(browser, step) {
  for (const [locale, words] of [['en-GB', { skipped: 'This pageskipped 7', lost: '3 frames are missing in the take', sent: '120 sent', refused: '9 sent · 9 refused' }],
                                 ['de-DE', { skipped: 'Diese Seiteließ 7 aus', lost: '3 Bilder fehlen in der Aufnahme', sent: '120 gesendet', refused: '9 gesendet · 9 abgewiesen' }]]) {
    const { page, told } = await open(browser, { locale });
    told.status = { ...plainStatus(), given_up: 'levels 1 to 3 are interpolated',
      recording: { state: 'recording', reason: '', warning: '', file: '/t/a.take', frames: 9, dropped: 3, bytes: 9 },
      bridges: { neutral: { state: 'none', reason: '', frames: 0 }, targets: [
        { protocol: 'vmc', target: '127.0.0.1:39539', frames: 120, failed: 0, reason: '' },
        { protocol: 'vrchat', target: '127.0.0.1:9000', name: 'VRChat-Client-A1B2C3', frames: 5, failed: 0, reason: '' },
        { protocol: 'live_link_face', target: '192.168.1.20:11111', frames: 9, failed: 9, reason: 'Connection refused' }] } };
    told.send(fake.dropped(7));
    await eventually('skipped', async () => (await textOf(page, 'devices')).includes(words.skipped));
    const given = rowOf(page, 'levels 1 to 3 are interpolated');
    assert.equal(await given.getAttribute('class'), 'busy', 'what is left out has an amber dot');
    assert.match(await given.textContent(), /llvmpipe/);
    assert.ok((await textOf(page, 'devices')).includes(words.lost));
    const vmc = rowOf(page, 'VMC 127.0.0.1:39539');
    assert.equal(await vmc.getAttribute('class'), 'good');
    assert.ok((await vmc.textContent()).includes(words.sent));
    assert.equal(await rowOf(page, 'VRChat-Client-A1B2C3 127.0.0.1:9000').getAttribute('class'), 'good');
    const unreal = rowOf(page, 'Live Link Face 192.168.1.20:11111');
    assert.equal(await unreal.getAttribute('class'), 'bad');
    assert.ok((await unreal.textContent()).includes(words.refused) && (await unreal.textContent()).includes('Connection refused'));
    await page.close();
  }
  step('what was given up, skipped, lost and sent');
}

async function neutralIsRecorded(browser, step) {
  const bridges = (state, reason = '') => ({ targets: [], neutral: { state, reason, frames: 0 } });
  const { page, told } = await open(browser);
  told.answer = (method) => {
    if (method === 'neutral.record') {
      told.status = { ...plainStatus(), bridges: bridges('recording') };
    }
  };
  const button = page.getByRole('button', { name: 'Neutral', exact: true });
  await button.click();
  await page.getByText('The neutral pose is recorded', { exact: true }).waitFor();
  await eventually('not twice at a time', () => button.isDisabled());
  told.status = { ...plainStatus(), bridges: bridges('set') };
  await page.getByText('The neutral pose is recorded and used').waitFor();
  await button.click();
  await eventually('asked again', () => told.asked.filter((method) => method === 'neutral.record').length === 2);
  told.status = { ...plainStatus(), bridges: bridges('failed', 'no face was seen') };
  await page.getByText('no face was seen').waitFor();
  await page.close();
  step('the neutral pose');
}

async function lockedIsLocked(browser, step) {
  const studio = { state: 'ready', take: 'monday', reason: '', done: 1, total: 1, posing: true, shown: 'pose', time_s: 0, duration_s: 3, events: 1, solved: 1,
    superseded: 0, latency_ms: { mean: 12, p95: 20 }, controls: [{ vertex: 5, at_mm: [0, 0, 80], met: true, problem: '' }], places: { nose: 1 }, warnings: [], exported: '' };
  for (const [token, locale, points] of [['', 'en-GB', '1 point ·'], ['token', 'de-DE', '1 Punkt ·']]) {
    const { page, told } = await open(browser, { token, locale });
    told.status = { ...plainStatus(), studio };
    await eventually('the studio', async () => (await textOf(page, 'studio-state')).startsWith(points));
    for (const id of ['studio-close', 'key-add']) {
      await eventually(`${id} ${token ? 'works' : 'is locked'}`, async () => (await page.locator(`#${id}`).isDisabled()) === (token === ''));
    }
    if (token === '') {
      for (const id of ['studio-play', 'key-update', 'key-delete', 'point-remove', 'export', 'neutral']) {
        assert.ok(await page.locator(`#${id}`).isDisabled(), id);
      }
      assert.ok(await page.locator('[data-action=pose]').isDisabled());
      assert.equal(await page.locator('.hint').count(), 0);
      assert.ok(await page.locator('.handle').isDisabled());
      const line = await page.locator('#track').boundingBox();
      await page.mouse.click(line.x + 0.5 * line.width, line.y + 5);
      const looks = ['status', 'takes.list', 'studio.status', 'keys.get', 'pose.regions'];
      assert.deepEqual(told.asked.filter((method) => !looks.includes(method)), []);
      assert.equal(await page.locator('dialog[open]').count(), 0);
      await page.screenshot({ path: join(output, 'states-locked.png') });
    }
    told.status = { ...plainStatus(), studio: { ...studio, controls: [...studio.controls, { ...studio.controls[0], vertex: 6 }] } };
    await eventually('two points', async () => /^2 (points|Punkte) ·/.test(await textOf(page, 'studio-state')));
    await page.close();
  }
  step('without the token nothing commands');
}

const began = Date.now();
const step = (words) => console.log(`${((Date.now() - began) / 1000).toFixed(1)} s  ${words}`);
const browser = await openBrowser(chromiumFile);
try {
  const only = process.env.ONLY;
  for (const part of [levelsAreDrawn, unknownsAreTold, rowsAreSorted, devicesAreTold, neutralIsRecorded, lockedIsLocked, sizesAreRight]) {
    if (!only || part.name === only) {
      await part(browser, step);
    }
  }
} finally {
  await browser.close();
  server.close();
}
step('done');
process.exit(0);
