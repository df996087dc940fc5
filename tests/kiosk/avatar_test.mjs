// The avatar's desk: a cartoon head that follows what is sent, and gain, dead zone and formulas that are changed while it is watched; what is wrong with a
// formula is told under it, what is saved is there after a restart. In Chromium before a running facetd that shows a take.
// Usage: node avatar_test.mjs FACETD FACET PAGE_FOLDER OUTPUT_FOLDER ASSETS CHROMIUM       Pictures land in the output folder.
import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { readFileSync } from 'node:fs';
import { join } from 'node:path';
import { Service, kPatience_ms, runTest } from './service.mjs';

const [facetd, facet, pageFolder, output, assets, chromiumFile] = process.argv.slice(2);
const service = await Service.prepare({
  facetd, page: pageFolder, assets, log: join(output, 'facetd-avatar.log'), source: 'path = "grey.mkv"\nloop = true', more: '[bridges]\nmapping = "avatar.toml"' });
const { folder, takes } = service;
const eventually = (what, holds) => service.eventually(what, holds);
execFileSync('ffmpeg', ['-loglevel', 'error', '-f', 'lavfi', '-i', 'color=gray:s=320x240:r=2', '-t', '5', join(folder, 'grey.mkv')]);
execFileSync(facet, ['synth', '--seed', '3', '--frames', '90', '--vertices', '4000', '-o', join(takes, 'actor.take')], { stdio: 'ignore' });

const showTake = async () => {
  await service.ask('studio.open', { take: 'actor', pose: false, lease_s: 0 });
  await eventually('the take', async () => (await service.ask('studio.status')).state === 'ready');
  await service.ask('studio.play', { what: 'take', loop: true });
};
const tuning = async (name) => (await service.ask('status')).bridges.values[name];

/** What lies beyond the screen, or over something else, of the open desk. Runs in the page. */
function faultsOfDesk() {
  const faults = [];
  const boxOf = (id) => document.getElementById(id).getBoundingClientRect();
  for (const id of ['avatar-head', 'avatar-stage', 'avatar-edit', 'avatar-save', 'avatar-reset', 'avatar-close', 'avatar-show-values', 'avatar-show-formulas']) {
    const box = boxOf(id);
    if (box.width < 40 || box.height < 40 || box.left < 0 || box.top < 0 || box.right > innerWidth || box.bottom > innerHeight) {
      faults.push(`${id}: ${JSON.stringify(box)}`);
    }
  }
  const apart = (one, other) => one.right <= other.left || other.right <= one.left || one.bottom <= other.top || other.bottom <= one.top;
  const parts = ['avatar-head', 'avatar-stage', 'avatar-edit'].map(boxOf);
  parts.forEach((one, i) => parts.slice(i + 1).forEach((other) => apart(one, other) || faults.push('parts lie over one another')));
  for (const box of document.querySelectorAll('#avatar-head, #avatar-head *, #avatar-edit, #avatar-edit *')) {
    if (box.scrollWidth > box.clientWidth + 1 && getComputedStyle(box).display !== 'inline' && !['INPUT', 'B', 'I'].includes(box.tagName)) {
      faults.push(`${box.id || box.className || box.tagName} is ${box.scrollWidth} px in ${box.clientWidth} px: ${box.textContent.slice(0, 40)}`);
    }
  }
  return faults;
}

await runTest(service, chromiumFile, async (browser, step) => {
  await showTake();
  const page = await browser.newPage({ viewport: { width: 1280, height: 800 }, locale: 'en-GB' });
  page.setDefaultTimeout(kPatience_ms);
  page.on('pageerror', (error) => assert.fail(error));
  await page.goto(`${service.origin}/#token=${service.token}`);
  await page.getByRole('button', { name: 'Avatar', exact: true }).click();
  const drawn = () => page.locator('#avatar').getAttribute('data-drawn').then(Number);
  await eventually('the head follows', async () => (await drawn()) > 5);
  const row = (name) => page.locator(`.value[data-name=${name}]`);
  await eventually('numbers', async () => Number(await row('jawOpen').locator('output').first().textContent()) > 0.05);
  step('the head follows');

  // A value's sliders: both sides together, or one alone.
  await page.getByRole('slider', { name: 'Gain of mouth smile' }).fill('1.5');
  await eventually('both sides', async () => (await tuning('mouthSmileRight'))?.gain === 1.5 && (await tuning('mouthSmileLeft'))?.gain === 1.5);
  await page.getByLabel('Left and right together').uncheck();
  await row('mouthSmileLeft').locator('[data-key=dead_zone]').fill('0.1');
  await eventually('one side', async () => (await tuning('mouthSmileLeft')).dead_zone === 0.1);
  assert.equal((await tuning('mouthSmileRight')).dead_zone, 0);
  assert.equal((await tuning('mouthSmileLeft')).gain, 1.5);
  await page.getByLabel('Left and right together').check();
  // A jaw that does not open: the value and the head's mouth.
  const mouth = async () => (await page.locator('#avatar-stage').screenshot()).toString('base64');
  await row('jawOpen').locator('[data-key=gain]').fill('0');
  await eventually('no jaw', async () => (await row('jawOpen').locator('.meter output').textContent()) === '0.00');
  await eventually('it is not saved', async () => (await page.locator('#avatar-state').textContent()) === 'Not saved');
  const still = await mouth();
  // By other hands.
  await service.ask('values.set', { name: 'jawOpen', gain: 4 });
  await eventually('the slider follows', async () => (await row('jawOpen').locator('[data-key=gain]').inputValue()) === '4');
  await eventually('another picture', async () => (await mouth()) !== still);
  step('values');

  // Formulas.
  await page.getByRole('button', { name: 'Formulas', exact: true }).click();
  const fresh = page.locator('#avatar-vmc li.new');
  await fresh.getByLabel('Name of a new value for VMC').fill('A');
  await fresh.getByLabel('Formula of a new value for VMC').fill('0.8 * jawOpne');
  await fresh.getByRole('button', { name: 'Add' }).click();
  await fresh.getByText("'jawOpne' is no value of ARKit's").waitFor();
  assert.match(await fresh.getByRole('alert').textContent(), /\(letter 7\)/);
  assert.equal((await service.ask('mapping.get')).vmc.length, 0);
  await page.screenshot({ path: join(output, 'avatar-wrong.png') });
  await fresh.getByLabel('Formula of a new value for VMC').fill('0.8 * jawOpen');
  await fresh.getByRole('button', { name: 'Add' }).click();
  const formula = page.getByLabel('Formula of A', { exact: true });
  await formula.waitFor();
  assert.deepEqual((await service.ask('mapping.get')).vmc, [{ name: 'A', formula: '0.8 * jawOpen' }]);
  await eventually('what is sent', async () => Number(await page.locator('#avatar-vmc .meter output').textContent()) > 0.05);
  await formula.fill('0.8 * jawOpen +');
  await page.locator('#avatar-vmc').getByText('(letter 16)').waitFor();
  assert.equal(await formula.getAttribute('aria-invalid'), 'true');
  assert.equal((await service.ask('mapping.get')).vmc[0].formula, '0.8 * jawOpen', 'what is no formula changes nothing');
  await formula.fill('0.8 * jawOpen + 0.1');
  await eventually('the formula', async () => (await service.ask('mapping.get')).vmc[0].formula === '0.8 * jawOpen + 0.1');
  await eventually('no fault any more', async () => (await formula.getAttribute('aria-invalid')) === 'false');
  await service.ask('mapping.set', { table: 'vrchat', name: 'v2/JawOpen', formula: '1.2 * jawOpen - 0.5' });
  await page.getByLabel('Formula of v2/JawOpen', { exact: true }).waitFor();
  step('formulas');

  await page.getByRole('button', { name: 'Save', exact: true }).click();
  await page.locator('#avatar-state').getByText('Saved: ').waitFor();
  const saved = readFileSync(join(folder, 'avatar.toml'), 'utf8');
  assert.match(saved, /A = "0\.8 \* jawOpen \+ 0\.1"/);
  assert.match(saved, /jawOpen = \{ gain = 4,/);
  await page.getByRole('button', { name: 'Remove A', exact: true }).click();
  await eventually('gone', async () => (await service.ask('mapping.get')).vmc.length === 0);
  await page.getByRole('button', { name: 'Undo changes' }).click();
  await formula.waitFor();
  step('saved');

  await page.close();

  // At every size, in both languages, nothing is covered or cut off.
  const found = [];
  for (const [locale, sizes] of [['en-GB', [[390, 844], [820, 1180], [1280, 800], [1920, 1080]]], ['de-DE', [[390, 844], [1280, 800]]]]) {
    const other = await browser.newPage({ locale });
    other.setDefaultTimeout(kPatience_ms);
    await other.goto(`${service.origin}/#token=${service.token}`);
    await other.locator('#avatar-open').click();
    for (const [width, height] of sizes) {
      await other.setViewportSize({ width, height });
      const before = Number(await other.locator('#avatar').getAttribute('data-drawn'));
      await eventually('a picture', async () => Number(await other.locator('#avatar').getAttribute('data-drawn')) > before + 1);
      for (const part of ['values', 'formulas']) {
        await other.locator(`#avatar-show-${part}`).click();
        found.push(...(await other.evaluate(faultsOfDesk)).map((fault) => `${part}, ${locale}, ${width}x${height}: ${fault}`));
        await other.screenshot({ path: join(output, `avatar-${part}-${locale.slice(0, 2)}-${width}x${height}.png`) });
      }
    }
    await other.close();
  }
  assert.equal(found.length, 0, found.join('\n'));
  step('looked at');

  // Kept over a restart; without the token it is looked at alone.
  await service.stop();
  await service.start();
  assert.equal((await service.ask('mapping.get')).vmc[0].formula, '0.8 * jawOpen + 0.1');
  assert.equal((await tuning('jawOpen')).gain, 4);
  const stranger = await browser.newPage({ viewport: { width: 1280, height: 800 }, locale: 'en-GB' });
  await stranger.goto(service.origin);
  await stranger.getByRole('button', { name: 'Avatar', exact: true }).click();
  await stranger.locator('#avatar-state').getByText('Changes need the token').waitFor();
  assert.ok(await stranger.getByRole('slider', { name: 'Gain of jaw open' }).isDisabled());
  assert.ok(await stranger.getByRole('button', { name: 'Save', exact: true }).isDisabled());
  await stranger.locator('#avatar-unlock').click();
  await stranger.getByLabel('Token', { exact: true }).fill(service.token);
  await stranger.keyboard.press('Enter');
  await eventually('unlocked', async () => stranger.getByRole('slider', { name: 'Gain of jaw open' }).isEnabled());
});
