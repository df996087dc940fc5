// The page where words are long and the screen is small: no text is cut off or lies over another, in both languages. A booth whose cameras have long names
// and are not there, a take with a long name, one that is damaged and one that is replayed; in Chromium before a running facetd.
// Usage: node layout_test.mjs FACETD FACET PAGE_FOLDER OUTPUT_FOLDER ASSETS CHROMIUM       Pictures land in the output folder.
import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { Service, drawnBy, kPatience_ms, runTest } from './service.mjs';

const [facetd, facet, pageFolder, output, assets, chromiumFile] = process.argv.slice(2);
const camera = (name, lines) => `[[camera]]\nname = "${name}"\nwidth_px = 320\nheight_px = 240\nrate_hz = 30.0\n${lines}`;
const absent = (path) => `kind = "v4l2"\ndevice = "/dev/v4l/by-path/${path}"`;
const service = await Service.prepare({
  facetd, page: pageFolder, assets, log: join(output, 'facetd-layout.log'),
  rig: ['mode = "frames"', camera('left', 'kind = "simulated"'), camera('Seitenkamera-oben-links-neben-dem-Fensterrahmen', absent('pci-0000:00:14.0-usb-0:1.4.3.2:1.0-video-index0')),
        camera('the_colour_camera_over_the_left_projector_of_the_second_rig', absent(`platform-${'fd500000.pcie'.repeat(9)}-video-index0`)),
        '[trigger]\nkind = "virtual"\nslots_per_second = 30.0\npatterns = [[]]\n[[trigger.line]]\nname = "cameras"\nrole = "camera"'].join('\n') });
const kLongName = 'Aufnahme mit dem zweiten Beleuchtungsaufbau und einem Namen, der kein Ende nimmt';
execFileSync(facet, ['synth', '--seed', '3', '--frames', '60', '--vertices', '8000', '-o', join(service.takes, `${kLongName}.take`)], { stdio: 'ignore' });
writeFileSync(join(service.takes, `${'beschädigt'.repeat(6)}.take`), 'no take');

/** What is wrong with how text lies on the page. Runs in the page. */
function faultsOfLayout() {
  const faults = [];
  const shown = (node) => node.getClientRects().length > 0 && getComputedStyle(node).visibility !== 'hidden';
  const name = (node) => `${node.id ? `#${node.id}` : node.closest('[id]') ? `#${node.closest('[id]').id} ${node.localName}` : node.localName} '${node.textContent.trim().replace(/\s+/g, ' ').slice(0, 40)}'`;
  // What may end in an ellipsis says the whole of it otherwise.
  const shortened = (node) => getComputedStyle(node).textOverflow === 'ellipsis' && (node.title === node.textContent || node.parentElement.getAttribute('aria-label') === node.textContent);
  const texts = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    const parent = node.parentElement;
    if (node.textContent.trim() === '' || !shown(parent) || parent.closest('.unseen, dialog:not([open]), script, noscript')) {
      continue;
    }
    const range = document.createRange();
    range.selectNodeContents(node);
    for (const box of range.getClientRects()) {
      texts.push({ node: parent, box });
    }
  }
  for (const { node, box } of texts) {
    if (shortened(node)) {
      continue;
    }
    // Each box around it must hold it; upwards and downwards it may be reached by scrolling, sideways in a row that shows that there is more.
    let scrolls = false;
    for (let around = node; around; around = around.parentElement) {
      const style = getComputedStyle(around);
      const outer = around.getBoundingClientRect();
      if (around.matches('.more-left, .more-right')) {
        break;
      }
      if (style.overflowX !== 'visible' && around.scrollWidth > around.clientWidth + 1) {
        faults.push(`${name(around)} is ${around.scrollWidth} px in ${around.clientWidth} px`);
      }
      if (around.localName !== 'span' && style.display !== 'inline' && outer.width > 0 && (box.left < outer.left - 1 || box.right > outer.right + 1)) {
        faults.push(`${name(node)} sticks out of ${name(around)} by ${Math.max(outer.left - box.left, box.right - outer.right).toFixed(0)} px`);
        break;
      }
      scrolls ||= style.overflowY === 'auto' || style.overflowY === 'scroll';
      if (!scrolls && style.overflowY === 'hidden' && (box.top < outer.top - 1 || box.bottom > outer.bottom + 1)) {
        faults.push(`${name(node)} is cut off above or below by ${name(around)}`);
      }
    }
  }
  // No text over another, as far as both are to be seen.
  const seen = texts.map(({ node, box }) => {
    let [left, top, right, bottom] = [box.left, box.top, box.right, box.bottom];
    for (let around = node; around; around = around.parentElement) {
      if (getComputedStyle(around).overflow !== 'visible') {
        const outer = around.getBoundingClientRect();
        [left, top, right, bottom] = [Math.max(left, outer.left), Math.max(top, outer.top), Math.min(right, outer.right), Math.min(bottom, outer.bottom)];
      }
    }
    return { node, left, top, right, bottom };
  }).filter(({ left, top, right, bottom }) => right > left && bottom > top);
  for (const [i, a] of seen.entries()) {
    for (const b of seen.slice(i + 1)) {
      const [width, height] = [Math.min(a.right, b.right) - Math.max(a.left, b.left), Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top)];
      if (a.node !== b.node && width > 1 && height > 4) {
        faults.push(`${name(a.node)} lies over ${name(b.node)}`);
      }
    }
  }
  // Every card can be reached: inside of the page or of what scrolls.
  for (const card of document.querySelectorAll('.card')) {
    const aside = card.closest('aside');
    const box = card.getBoundingClientRect();
    if (box.width > 0 && (box.right > innerWidth || box.height < 60 || (box.bottom > innerHeight + 1 && getComputedStyle(aside).overflowY !== 'auto'))) {
      faults.push(`${name(card)} can't be seen: ${JSON.stringify(box)}`);
    }
  }
  for (const button of document.querySelectorAll('#stage button, #stage .chip, header button')) {
    const box = button.getBoundingClientRect();
    const stage = button.closest('#stage, header').getBoundingClientRect();
    if (shown(button) && !button.closest('.more-left, .more-right') && (box.left < stage.left || box.right > stage.right + 1 || box.top < stage.top || box.bottom > stage.bottom + 1)) {
      faults.push(`${name(button)} sticks out`);
    }
  }
  return [...new Set(faults)];
}

await runTest(service, chromiumFile, async (browser, step) => {
  const found = [];
  for (const [locale, lang] of [['en-GB', 'en'], ['de-DE', 'de']]) {
    const page = await browser.newPage({ viewport: { width: 1920, height: 1080 }, locale });
    page.setDefaultTimeout(kPatience_ms);
    await page.goto(`${service.origin}/#token=${service.token}`);
    assert.equal(await page.locator('html').getAttribute('lang'), lang);
    const devices = page.locator('#devices');
    await service.eventually('the absent cameras', async () => (await devices.locator('li.bad small').count()) >= 2 && (await page.locator('#takes li').count()) === 2);
    const look = async (state) => {
      for (const [width, height] of [[390, 844], [820, 1180], [800, 600], [1024, 768], [1280, 800], [1920, 1080], [1080, 1920]]) {
        await page.setViewportSize({ width, height });
        await page.waitForTimeout(700);
        found.push(...(await page.evaluate(faultsOfLayout)).map((fault) => `${state}, ${lang}, ${width}x${height}: ${fault}`));
        await page.screenshot({ path: join(output, `layout-${state}-${lang}-${width}x${height}.png`) });
      }
    };
    await look('booth');
    await service.ask('studio.open', { take: kLongName, pose: false });
    await service.eventually('the take', async () => (await service.ask('studio.status')).state === 'ready');
    await service.ask('studio.play', { what: 'take', loop: true });
    const at = await drawnBy(page);
    await service.eventually('its face', async () => (await drawnBy(page)) > at + 1 && (await page.locator('#expressions .bar').count()) > 10);
    await look('replay');
    await service.ask('studio.close');
    await service.eventually('closed', async () => (await service.ask('studio.status')).state === 'closed');
    await page.close();
    step(`${lang}: looked at`);
  }
  assert.equal(found.length, 0, found.join('\n'));
});
