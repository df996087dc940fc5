// Who may look at a page that others than this machine are meant to reach (web.public): nobody without a token; who shows one, once. In Chromium before a
// running facetd.
// Usage: node look_test.mjs FACETD FACET PAGE_FOLDER OUTPUT_FOLDER ASSETS CHROMIUM       Pictures land in the output folder.
import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { readFileSync } from 'node:fs';
import { join } from 'node:path';
import { Service, kPatience_ms, runTest } from './service.mjs';

const [facetd, , pageFolder, output, assets, chromiumFile] = process.argv.slice(2);
const service = await Service.prepare({ facetd, page: pageFolder, assets, log: join(output, 'facetd-look.log'), source: 'path = "grey.mkv"\nloop = true', web: 'public = true' });
execFileSync('ffmpeg', ['-loglevel', 'error', '-f', 'lavfi', '-i', 'color=gray:s=320x240:r=2', '-t', '5', join(service.folder, 'grey.mkv')]);
const connections = async () => (await service.ask('status')).stream.connections;

await runTest(service, chromiumFile, async (browser, step) => {
  const look = readFileSync(join(service.folder, 'token.look'), 'utf8').trim();
  const open = async (context, hash = '') => {
    const page = await context.newPage();
    page.setDefaultTimeout(kPatience_ms);
    await page.goto(`${service.origin}/${hash}`);
    return page;
  };
  const before = await connections();
  const stranger = await browser.newContext({ viewport: { width: 390, height: 844 }, locale: 'en-GB' });
  const page = await open(stranger);
  const dialog = page.locator('#token-dialog');
  await dialog.waitFor({ state: 'visible' });
  assert.match(await page.locator('#token-help').textContent(), /for those alone who have its token/);
  await page.screenshot({ path: join(output, 'look-stranger-390x844.png') });
  assert.equal(await connections(), before, 'nobody looks before the token');

  await page.locator('#token').fill('0123456789abcdef0123456789abcdef');
  await dialog.getByRole('button', { name: 'Unlock' }).click();
  await page.locator('#token-wrong').filter({ hasText: 'not the token' }).waitFor();
  assert.equal(await connections(), before);
  step('a stranger sees nothing');

  await page.locator('#token').fill(look);
  await dialog.getByRole('button', { name: 'Unlock' }).click();
  await dialog.waitFor({ state: 'hidden' });
  await service.eventually('the page reads the stream', async () => (await connections()) > before);
  await page.getByRole('button', { name: 'Enter the token that allows recording' }).or(page.locator('#unlock')).first().waitFor();
  assert.match(await page.locator('#unlock').textContent(), /^\s*Unlock\s*$/, 'it opens no commands');
  const cookies = await stranger.cookies();
  assert.ok(cookies.some((cookie) => cookie.name.startsWith('facet-look-') && cookie.value === look && cookie.httpOnly && cookie.sameSite === 'Strict'));
  step('the token for looking opens looking');

  await page.locator('#unlock').click();
  await page.locator('#token').fill(look);
  await dialog.getByRole('button', { name: 'Unlock' }).click();
  await page.getByText('That token is for looking alone.').waitFor();
  assert.match(await page.locator('#unlock').textContent(), /^\s*Unlock\s*$/);

  const again = await open(stranger);
  await service.eventually('the browser kept it', async () => (await again.locator('#token-dialog').isVisible()) === false && (await connections()) > before);
  await again.close();
  step('it is asked for once');

  // Also where the browser has the cookie for looking already.
  const operator = await open(stranger, `#token=${service.token}`);
  await operator.locator('#unlock').filter({ hasText: 'Unlocked' }).waitFor();
  assert.equal(await operator.locator('#token-dialog').isVisible(), false);
  step('the token for commands opens both');
});
