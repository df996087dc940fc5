// Takes taken care of at the page: another name, note and slate, a part as a new take, deleted and brought back; by mouse, keyboard and touch, in both
// languages; nothing of it without the token. And the switch that lets points go beyond what was captured. In Chromium before a running facetd.
// Usage: node care_test.mjs FACETD FACET PAGE_FOLDER OUTPUT_FOLDER ASSETS CHROMIUM       Pictures land in the output folder.
import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { existsSync } from 'node:fs';
import { join } from 'node:path';
import { Service, drawnBy, kPatience_ms, runTest } from './service.mjs';

const [facetd, facet, pageFolder, output, assets, chromiumFile] = process.argv.slice(2);
const service = await Service.prepare({ facetd, page: pageFolder, assets, log: join(output, 'facetd-care.log'), source: 'path = "grey.mkv"\nloop = true' });
const { folder, takes } = service;
const eventually = (what, holds) => service.eventually(what, holds);
const studio = () => service.ask('studio.status');
const listed = async (name) => (await service.ask('takes.list')).takes.find((take) => take.name === name);

execFileSync('ffmpeg', ['-loglevel', 'error', '-f', 'lavfi', '-i', 'color=gray:s=320x240:r=2', '-t', '5', join(folder, 'grey.mkv')]);
for (const [name, seed] of [['actor', 3], ['other', 4]]) {
  execFileSync(facet, ['synth', '--seed', String(seed), '--frames', '90', '--vertices', '4000', '-o', join(takes, `${name}.take`)], { stdio: 'ignore' });
}

let page = null;
await runTest(service, chromiumFile, async (browser, step) => {
  const open = async (more = {}, token = true) => {
    const opened = await browser.newPage({ viewport: { width: 1280, height: 800 }, locale: 'en-GB', ...more });
    // What waits for ten seconds does so until the test lets it: a busy machine may need as long for a press.
    await opened.addInitScript(() => {
      const real = window.setTimeout;
      const late = [];
      window.setTimeout = (work, ms, ...more) => (ms === 10_000 ? (late.push(work), 0) : real(work, ms, ...more));
      window.tenSecondsLater = () => late.splice(0).forEach((work) => work());
    });
    opened.setDefaultTimeout(kPatience_ms);
    await opened.goto(`${service.origin}/${token ? `#token=${service.token}` : ''}`);
    await opened.locator('#takes li').first().waitFor();
    return opened;
  };
  page = await open();
  const faults = [];
  page.on('pageerror', (error) => faults.push(error.message));
  const card = (name) => page.locator('#takes li').filter({ hasText: name });
  const edit = (name, on = page) => on.getByRole('button', { name: `Rename, note, trim or delete take ${name}`, exact: true });
  const field = (id) => page.locator(`#${id}`);
  const isOpen = (id, on = page) => on.locator(`#${id}[open]`).count().then((count) => count > 0);

  // Name, note and slate.
  await edit('actor').click();
  for (const [id, words] of [['take-name', 'Name'], ['take-scene', 'Scene'], ['take-number', 'Take'], ['take-note', 'Note']]) {
    assert.equal(await page.locator('#take-dialog').getByLabel(words, { exact: true }).getAttribute('id'), id);
  }
  await field('take-name').fill('scene one');
  await field('take-scene').fill('12a');
  await field('take-number').fill('3');
  await field('take-note').fill('the better one\nonce more tomorrow');
  await page.screenshot({ path: join(output, 'care-edit.png') });
  await page.locator('#take-dialog').getByRole('button', { name: 'Save', exact: true }).click();
  const noted = await eventually('the take has its new name', () => listed('scene one'));
  assert.equal(noted.note, 'the better one\nonce more tomorrow');
  assert.deepEqual(noted.slate, { scene: '12a', take: '3' });
  assert.equal(await listed('actor'), undefined);
  await card('scene one').getByText('Scene 12a, take 3 · the better one').waitFor();
  assert.equal(await isOpen('take-dialog'), false);

  // What is refused is told where it was asked for, and nothing is lost.
  await edit('scene one').click();
  assert.equal(await field('take-note').inputValue(), 'the better one\nonce more tomorrow');
  await field('take-name').fill('other');
  await page.locator('#take-dialog').getByRole('button', { name: 'Save', exact: true }).click();
  await page.locator('#take-wrong').getByText('exists already').waitFor();
  assert.equal(await field('take-name').inputValue(), 'other');
  await page.keyboard.press('Escape');
  await eventually('the dialog is closed', async () => !(await isOpen('take-dialog')));
  step('renamed, noted');

  // A part by two numbers, then one by where the replay stands.
  await edit('scene one').click();
  await page.locator('#take-trim').click();
  await field('trim-from').fill('0.5');
  await field('trim-to').fill('1.5');
  assert.equal(await page.locator('#trim-to-slider').inputValue(), '1.5', 'handles follow the numbers');
  await page.locator('#trim-length').getByText('1.00 s of').waitFor();
  await field('trim-name').fill('middle');
  await page.screenshot({ path: join(output, 'care-trim.png') });
  await page.getByRole('button', { name: 'Make the take' }).click();
  const middle = await eventually('the part', () => listed('middle'));
  assert.ok(middle.closed && middle.frames >= 25 && middle.frames <= 31, `${middle.frames} frames`);
  assert.match(middle.cut_from, /^scene one, frames /);
  assert.equal(middle.note, 'the better one\nonce more tomorrow', 'the note goes along');
  assert.equal((await listed('scene one')).frames, 90, 'the old one is as it was');
  await page.locator('#banner').getByText('middle is there').waitFor();
  // The handles: an end that is moved past the other takes it along.
  await edit('scene one').click();
  await page.locator('#take-trim').click();
  await field('trim-to').fill('1');
  await page.locator('#trim-from-slider').fill('2');
  assert.equal(await field('trim-from').inputValue(), '2');
  assert.ok(Number(await field('trim-to').inputValue()) > 2);
  await field('trim-name').fill('middle');
  await page.getByRole('button', { name: 'Make the take' }).click();
  await page.locator('#trim-wrong').getByText('exists already').waitFor();
  await page.locator('#trim-cancel').click();

  await page.getByRole('button', { name: 'Replay take scene one' }).click();
  await eventually('the replay', async () => (await studio()).state === 'ready');
  const seek = async (time_s) => {
    await service.ask('studio.seek', { what: 'take', time_s });
    await eventually(`it stands at ${time_s} s`, async () => (await page.locator('#studio-state').textContent()).startsWith(`${time_s.toFixed(1)} s of`));
  };
  await seek(1);
  await page.getByRole('button', { name: 'Start here' }).click();
  await seek(2);
  await page.getByRole('button', { name: 'End here' }).click();
  const [kept, track] = [await page.locator('#kept').boundingBox(), await page.locator('#track').boundingBox()];
  assert.ok(Math.abs(kept.width / track.width - 1 / 2.97) < 0.06, `the part is marked: ${kept.width} of ${track.width} px`);
  await page.screenshot({ path: join(output, 'care-replay.png') });
  await page.locator('#trim-open').click();
  assert.ok(Math.abs(Number(await field('trim-from').inputValue()) - 1) < 0.05);
  assert.ok(Math.abs(Number(await field('trim-to').inputValue()) - 2) < 0.05);
  assert.equal(await field('trim-name').inputValue(), 'scene one-part');
  await page.keyboard.press('Enter');
  const replayed = await eventually('the part of the replay', () => listed('scene one-part'));
  assert.ok(replayed.frames >= 29 && replayed.frames <= 32, `${replayed.frames} frames`);
  // What is open can be trimmed, but not renamed.
  await edit('scene one').click();
  await field('take-name').fill('elsewhere');
  await page.locator('#take-dialog').getByRole('button', { name: 'Save', exact: true }).click();
  await page.locator('#take-wrong').getByText('open in the studio').waitFor();
  await page.keyboard.press('Escape');
  await page.getByRole('button', { name: 'Back to live' }).click();
  await eventually('closed', async () => (await studio()).state === 'closed');
  step('trimmed');

  // Deleted by keyboard alone, and back by keyboard.
  await edit('middle').focus();
  await page.keyboard.press('Enter');
  await eventually('the dialog', () => isOpen('take-dialog'));
  await page.locator('#take-delete').focus();
  await page.keyboard.press('Enter');
  await eventually('it is gone', async () => (await listed('middle')) === undefined);
  await page.locator('#undo').getByText('Deleted: middle').waitFor();
  await page.screenshot({ path: join(output, 'care-undo.png') });
  assert.equal(await page.evaluate(() => document.activeElement.id), 'undo-button', 'the way back has the focus');
  await page.keyboard.press('Enter');
  await eventually('it is back', () => listed('middle'));
  await page.locator('#undo').waitFor({ state: 'hidden' });
  await page.locator('#banner').getByText('middle is back').waitFor();
  // By touch, and not undone: the notice goes after ten seconds, the take stays in the daemon's bin.
  const touched = await open({ hasTouch: true, viewport: { width: 390, height: 844 } });
  await edit('middle', touched).scrollIntoViewIfNeeded();
  await edit('middle', touched).tap();
  await touched.screenshot({ path: join(output, 'care-edit-390.png') });
  await touched.locator('#take-delete').tap();
  await eventually('it is gone again', async () => (await listed('middle')) === undefined);
  await touched.locator('#undo-button').waitFor();
  await touched.evaluate(() => window.tenSecondsLater());
  await touched.locator('#undo').waitFor({ state: 'hidden' });
  assert.deepEqual((await service.ask('takes.deleted')).takes.map((take) => take.name), ['middle']);
  await touched.close();
  step('deleted, undone');

  // Without the token nothing of it is to be had; in German it has German words.
  const locked = await open({}, false);
  assert.ok(await edit('other', locked).isDisabled());
  assert.match(await edit('other', locked).getAttribute('title'), /Unlock/);
  await locked.close();
  const german = await open({ locale: 'de-DE' });
  await german.getByRole('button', { name: 'Aufnahme other umbenennen, beschriften, kürzen oder löschen' }).click();
  await german.getByLabel('Notiz').waitFor();
  for (const name of ['Speichern', 'Abbrechen', 'Löschen', 'Kürzen']) {
    assert.ok(await german.locator('#take-dialog').getByRole('button', { name, exact: true }).isVisible(), name);
  }
  await german.close();
  step('locked, German');

  // Points are pulled back to what was captured until the switch says otherwise.
  await page.getByRole('button', { name: 'Pose take other' }).click();
  await eventually('posing', async () => { const now = await studio(); return now.posing && now.state === 'ready' && now.take === 'other'; });
  const beyond = page.getByRole('button', { name: 'Beyond captured' });
  assert.equal(await beyond.getAttribute('aria-pressed'), 'false');
  await service.ask('pose.set', { controls: [{ vertex: 'lip-lower', move_mm: [0, -30, 0] }] });
  const settled = (now) => now.events === now.solved + now.superseded;
  const control = (holds) => eventually('the point', async () => { const now = await studio(); return settled(now) && now.controls.length === 1 && holds(now.controls[0]) ? now.controls[0] : null; });
  await control((one) => one.clamped);
  await eventually('the page has the point', async () => (await page.locator('.handle').count()) === 1);
  await beyond.click();
  await control((one) => !one.clamped && one.outside > 1);
  assert.equal(await beyond.getAttribute('aria-pressed'), 'true');
  await page.getByRole('button', { name: 'Save key' }).click();
  const keys = await eventually('a key', async () => (await service.ask('keys.get')).keys);
  assert.equal(keys.beyond, true, 'the animation follows the same rule');
  await beyond.click();
  await control((one) => one.clamped);
  await eventually('the keys, too', async () => (await service.ask('keys.get')).keys.beyond === false);
  const at = await drawnBy(page);
  await eventually('it is drawn', async () => (await drawnBy(page)) > at);
  assert.ok(existsSync(join(takes, 'other.keys.json')));
  assert.deepEqual(faults, []);
  await page.getByRole('button', { name: 'Back to live' }).click();
  await eventually('closed', async () => (await studio()).state === 'closed');
  step('beyond what was captured');

  // The same by command; the page hears of it.
  const run = (...words) => execFileSync(facet, ['takes', ...words, '--socket', join(folder, 'control.sock')], { encoding: 'utf8', stdio: ['ignore', 'pipe', 'ignore'] });
  const refused = (...words) => { try { run(...words); return 0; } catch (error) { return error.status; } };
  assert.match(run(), /^\d takes in .*\n(.*\n)*scene one .*slate 12a\/3  "the better one \.\.\."/);
  assert.equal(run('list'), run());
  assert.equal(JSON.parse(run('--json')).takes.find((take) => take.name === 'scene one').slate.scene, '12a');
  run('rename', 'other', 'a third');
  await card('a third').waitFor();
  assert.match(run('note', 'a third', '--note', '', '--take', '7'), /^slate \/7\n/);
  assert.match(run('trim', 'a third', 'its end', '--from', '2', '--until', '99'), /its end\.take: 30 frames|its end\.take: 29 frames/);
  await card('its end').waitFor();
  assert.match(run('delete', 'its end'), /facet takes restore 'its end'/);
  assert.match(run('deleted'), /its end +deleted .*\nmiddle +deleted /);
  run('restore', 'its end', '--to', 'its end again');
  await card('its end again').waitFor();
  assert.equal(refused('delete', 'its end again', '--now'), 2, 'nobody to ask: it stays');
  assert.match(run('delete', 'its end again', '--now', '--yes'), /is deleted for good/);
  await card('its end again').waitFor({ state: 'detached' });
  assert.match(run('purge'), /^1 takes are removed/);
  assert.equal(refused('rename', 'nobody', 'x'), 2);
  assert.equal(refused('rename', 'a third', 'scene one'), 6);
  step('by command');
}, async () => {
  await page?.screenshot({ path: join(output, 'care-failure.png') });
  console.error(JSON.stringify(await service.ask('takes.list')), JSON.stringify(await studio()));
});
