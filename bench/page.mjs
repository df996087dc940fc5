// The page of facetd drawn without a GPU: how soon the face is there, and how many pictures a second it is drawn in, as the mesh grows.
// Usage: node bench/page.mjs [BUILD_FOLDER [VERTICES ...]]        (build/release; 20000 100000). Needs what tests/kiosk needs, but no footage.
// The face is a take of the virtual actor that the studio replays on the stream at 30 a second, so that nothing but facetd's stream and the page is at work.
import { execFileSync } from 'node:child_process';
import { dirname, join, resolve } from 'node:path';
import { fileURLToPath } from 'node:url';
import { Service, openBrowser, wait } from '../tests/kiosk/service.mjs';

const top = join(dirname(fileURLToPath(import.meta.url)), '..');
const [build = join(top, 'build/release'), ...asked] = process.argv.slice(2);
const sizes = asked.length > 0 ? asked : ['20000', '100000'];
const kSettle_ms = 15_000; // the page finds the level of detail that the machine bears
const kMeasure_ms = 15_000;

// The live source is five grey pictures a second, in which nobody is: what is streamed is what the studio shows.
const service = await Service.prepare({
  facetd: join(build, 'daemon/service/facetd'), page: join(resolve(build), 'clients/kiosk/page'), assets: process.env.FACET_ASSETS ?? join(top, 'assets'), source: 'path = "none.mkv"' });
for (const vertices of sizes) {
  execFileSync(join(build, 'tools/facet'), ['synth', '--seed', '3', '--frames', '90', '--vertices', vertices, '-o', join(service.takes, `actor${vertices}.take`)], { stdio: 'ignore' });
}
execFileSync('ffmpeg', ['-loglevel', 'error', '-f', 'lavfi', '-i', 'color=gray:s=320x240:r=5:d=600', '-c:v', 'ffv1', join(service.folder, 'none.mkv')]);
await service.start();

const browser = await openBrowser('/usr/bin/chromium');
console.log('| finest mesh | start of the page to the face, ms | drawn, 1/s | level of detail | frames received, 1/s |');
console.log('|---|---|---|---|---|');
for (const vertices of sizes) {
  await service.ask('studio.open', { take: `actor${vertices}`, pose: false });
  await service.eventually('the take', async () => (await service.ask('studio.status')).state === 'ready');
  await service.ask('studio.play', { what: 'take', loop: true });
  const page = await browser.newPage({ viewport: { width: 1280, height: 720 }, locale: 'en-GB' });
  const count = () => page.evaluate(() => ({
    drawn: Number(document.getElementById('face').dataset.drawn ?? 0), frames: Number(document.body.dataset.frames ?? 0),
    level: document.getElementById('detail')?.dataset.level ?? '' }));
  const opened = Date.now();
  await page.goto(service.origin);
  await service.eventually('the face', async () => (await count()).drawn > 0);
  const start_ms = Date.now() - opened;
  await wait(kSettle_ms);
  const before = await count();
  const from = Date.now();
  await wait(kMeasure_ms);
  const after = await count();
  const seconds = (Date.now() - from) / 1000;
  console.log(`| ${vertices} | ${start_ms} | ${((after.drawn - before.drawn) / seconds).toFixed(1)} | ${after.level} | ${((after.frames - before.frames) / seconds).toFixed(1)} |`);
  await page.close();
  await service.ask('studio.close');
}
await browser.close();
await service.stop();
process.exit(0);
