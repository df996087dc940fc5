// Takes at the page: one after the other in the live face's place, though they name their meshes alike; an animation that takes long to prepare, broken
// off; a booth's recorded pictures, downloaded. In Chromium before a running facetd.
// Usage: node takes_test.mjs FACETD FACET PAGE_FOLDER OUTPUT_FOLDER ASSETS CHROMIUM       Pictures land in the output folder.
import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { mkdirSync, readFileSync, readdirSync, renameSync } from 'node:fs';
import { join } from 'node:path';
import { Service, drawnBy, kPatience_ms, runTest } from './service.mjs';

const [facetd, facet, pageFolder, output, assets, chromiumFile] = process.argv.slice(2);
const service = await Service.prepare({ facetd, page: pageFolder, assets, log: join(output, 'facetd-takes.log'), source: 'path = "grey.mkv"\nloop = true' });
const { folder, takes } = service;
const eventually = (what, holds) => service.eventually(what, holds);
const studio = () => service.ask('studio.status');

execFileSync('ffmpeg', ['-loglevel', 'error', '-f', 'lavfi', '-i', 'color=gray:s=320x240:r=2', '-t', '5', join(folder, 'grey.mkv')]);
/** One person by two meshes. Their numbers of vertices. */
const meshes = {};
for (const [name, most, frames] of [['small', '4000', '300'], ['large', '20000', '90']]) {
  const said = execFileSync(facet, ['synth', '--seed', '3', '--frames', frames, '--vertices', most, '-o', join(takes, `${name}.take`)], { encoding: 'utf8', stdio: ['ignore', 'pipe', 'ignore'] });
  meshes[name] = Number(said.match(/meshes of (\d+) vertices/)[1]);
}
assert.ok(meshes.large > 2 * meshes.small);
execFileSync(facet, ['synth-booth', '--seed', '5', '--slots', '3', '--samples', '1', '--resolution', '0.25', '--meshes', 'none', '-o', join(folder, 'booth')], { stdio: 'ignore' });
renameSync(join(folder, 'booth/capture.take'), join(takes, 'booth one.take'));
renameSync(join(folder, 'booth/capture.frames'), join(takes, 'booth one.frames'));

let page = null;
await runTest(service, chromiumFile, async (browser, step) => {
  const open = async () => {
    const opened = await browser.newPage({ viewport: { width: 1280, height: 800 }, locale: 'en-GB', acceptDownloads: true });
    opened.setDefaultTimeout(kPatience_ms);
    await opened.goto(`${service.origin}/#token=${service.token}`);
    return opened;
  };
  page = await open();
  const faults = [];
  page.on('pageerror', (error) => faults.push(error.message));

  // Whoever is at the page already, and whoever comes then, sees each take's own mesh.
  const isSeen = async (on, name) => {
    const vertices = meshes[name].toLocaleString('en-GB');
    await eventually(`the take ${name}`, async () => (await on.locator('#figures').textContent()).includes(`${vertices} points`));
    const at = await drawnBy(on);
    await eventually(`pictures of the take ${name}`, async () => (await drawnBy(on)) > at + 3);
  };
  for (const name of ['small', 'large', 'small']) {
    await page.getByRole('button', { name: `Replay take ${name}` }).click();
    await eventually('the take plays', async () => (await studio()).take === name && (await studio()).state === 'ready');
    await isSeen(page, name);
    const other = await open();
    await isSeen(other, name);
    await other.close();
    await page.getByRole('button', { name: 'Back to live' }).click();
    await eventually('closed', async () => (await studio()).state === 'closed');
  }
  step(`meshes of ${meshes.small} and ${meshes.large} vertices, one after the other`);

  // To seek ways of hours takes many seconds.
  await page.getByRole('button', { name: 'Pose take small' }).click();
  await eventually('posing', async () => (await studio()).posing && (await studio()).state === 'ready');
  const keys = Array.from({ length: 13 }, (_, i) => ({ time_s: 7000 * i, frame: (37 * i) % 300 }));
  await service.ask('keys.set', { keys: { keys } });
  await page.getByRole('button', { name: 'Back to live' }).click();
  await eventually('closed', async () => (await studio()).state === 'closed');
  await page.getByRole('button', { name: 'Pose take small' }).click();
  await eventually('posing again', async () => (await studio()).posing && (await studio()).state === 'ready');
  await eventually('its keys', async () => (await page.locator('#keys button').count()) === keys.length);
  await page.locator('#studio-play').click();
  await eventually('preparing', async () => (await studio()).state === 'preparing');
  const cancel = page.getByRole('button', { name: 'Cancel', exact: true });
  await cancel.waitFor();
  await cancel.click();
  const broken = await eventually('broken off', async () => { const now = await studio(); return now.state === 'ready' ? now : null; });
  assert.equal(broken.reason, 'broken off');
  assert.equal(broken.shown, 'pose');
  await page.locator('#banner').getByText('broken off').waitFor();
  await page.getByRole('button', { name: 'Export', exact: true }).waitFor();
  // What takes no time is prepared all the same.
  await service.ask('keys.set', { keys: { keys: [{ time_s: 0, frame: 3 }, { time_s: 0.5, frame: 40 }] } });
  await service.ask('studio.play', { what: 'keys' });
  await eventually('the short animation', async () => { const now = await studio(); return now.state === 'ready' && now.shown === 'keys' && now.time_s > 0.4; });
  await page.getByRole('button', { name: 'Back to live' }).click();
  step('broken off');

  // The pictures' archive, unpacked beside the take as docs/web.md says, holds what was recorded.
  const unpacked = join(folder, 'unpacked');
  mkdirSync(unpacked);
  for (const [link, name] of [[/^Download take booth one/, 'booth one.take'], [/^Download the recorded pictures of take booth one/, 'booth one.frames.tar']]) {
    const [download] = await Promise.all([page.waitForEvent('download'), page.getByRole('link', { name: link }).click()]);
    assert.equal(download.suggestedFilename(), name);
    await download.saveAs(join(unpacked, name));
  }
  assert.equal(await page.getByRole('link', { name: /^Download the recorded pictures/ }).count(), 1, 'takes without pictures have no link to them');
  execFileSync('tar', ['-C', unpacked, '-xf', join(unpacked, 'booth one.frames.tar')]);
  const pictures = (from, to) => {
    execFileSync(facet, ['export', join(from, 'booth one.take'), '--format', 'png', '-o', join(folder, to)], { stdio: 'ignore' });
    return readdirSync(join(folder, to), { recursive: true }).filter((name) => name.endsWith('.png')).sort();
  };
  const recorded = pictures(takes, 'recorded');
  assert.ok(recorded.length >= 18, `three slots of six cameras: ${recorded}`);
  assert.deepEqual(pictures(unpacked, 'downloaded'), recorded);
  for (const name of recorded) {
    assert.ok(readFileSync(join(folder, 'recorded', name)).equals(readFileSync(join(folder, 'downloaded', name))), name);
  }
  step(`downloaded: ${recorded.length} pictures`);
  assert.deepEqual(faults, []);
}, async () => {
  await page?.screenshot({ path: join(output, 'takes-failure.png') });
  console.error(JSON.stringify(await studio()));
});
