// The page of facetd drawn without a GPU: how soon the face is there, and how many pictures a second it is drawn in, as the mesh grows.
// Usage: node bench/page.mjs [BUILD_FOLDER [VERTICES ...]]        (build/release; 20000 100000). Needs what tests/kiosk needs, but no footage.
// The face is a take of the virtual actor that the studio replays on the stream at 30 a second, so that nothing but facetd's stream and the page is at work.
import { execFileSync, spawn } from 'node:child_process';
import { mkdirSync, mkdtempSync, rmSync, writeFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import net from 'node:net';
import { tmpdir } from 'node:os';
import { dirname, join, resolve } from 'node:path';
import { fileURLToPath } from 'node:url';

const top = join(dirname(fileURLToPath(import.meta.url)), '..');
const [build = join(top, 'build/release'), ...asked] = process.argv.slice(2);
const sizes = asked.length > 0 ? asked : ['20000', '100000'];
const { chromium } = createRequire(join(top, 'clients/kiosk/package.json'))('playwright-core');
const assets = process.env.FACET_ASSETS ?? join(top, 'assets');
const kSettle_s = 15; // the page finds the level of detail that the machine bears
const kMeasure_s = 15;
const kPatience_ms = 120_000;
const wait = (seconds) => new Promise((done) => setTimeout(done, 1000 * seconds));

const folder = mkdtempSync(join(tmpdir(), 'facet-page-bench-'));
mkdirSync(join(folder, 'takes'));
const port = await new Promise((done) => {
  const server = net.createServer().listen(0, '127.0.0.1', () => {
    const { port: free } = server.address();
    server.close(() => done(free));
  });
});
// The live source is five grey pictures a second, in which nobody is: what is streamed is what the studio shows.
writeFileSync(join(folder, 'facet.toml'), `
[source]
path = "none.mkv"
paced = true
[model]
path = "${assets}/default.facemodel"
[gpu]
device = "none"
[stream]
socket = "stream.sock"
[control]
socket = "control.sock"
[takes]
folder = "takes"
disk_reserve_mb = 1
[metrics]
listen = ""
[web]
listen = "127.0.0.1:${port}"
page = "${resolve(build)}/clients/kiosk/page"
token_file = ""
`);
for (const vertices of sizes) {
  execFileSync(join(build, 'tools/facet'), ['synth', '--seed', '3', '--frames', '90', '--vertices', vertices, '-o', join(folder, 'takes', `actor${vertices}.take`)], { stdio: 'ignore' });
}
execFileSync('ffmpeg', ['-loglevel', 'error', '-f', 'lavfi', '-i', 'color=gray:s=320x240:r=5:d=600', '-c:v', 'ffv1', join(folder, 'none.mkv')]);
const daemon = spawn(join(build, 'daemon/service/facetd'), ['--config', join(folder, 'facet.toml')], { stdio: ['ignore', 'ignore', 'inherit'] });
process.on('exit', () => { daemon.kill('SIGKILL'); rmSync(folder, { recursive: true, force: true }); });

function ask(method, params = {}) {
  return new Promise((done) => {
    let said = '';
    const socket = net.connect(join(folder, 'control.sock'), () => socket.write(`${JSON.stringify({ jsonrpc: '2.0', id: 1, method, params })}\n`));
    socket.on('error', () => done(null));
    socket.on('data', (bytes) => {
      said += bytes;
      if (said.endsWith('\n')) {
        socket.destroy();
        done(JSON.parse(said));
      }
    });
  });
}
async function eventually(what, holds) {
  for (const end = Date.now() + kPatience_ms; Date.now() < end;) {
    const value = await holds();
    if (value) {
      return value;
    }
    if (daemon.exitCode !== null) {
      throw new Error('facetd ended');
    }
    await wait(0.02);
  }
  throw new Error(`not within ${kPatience_ms / 1000} s: ${what}`);
}

const browser = await chromium.launch({
  executablePath: '/usr/bin/chromium',
  args: ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist'] });
await eventually('facetd', () => ask('status'));
console.log('| finest mesh | start of the page to the face, ms | drawn, 1/s | level of detail | frames received, 1/s |');
console.log('|---|---|---|---|---|');
for (const vertices of sizes) {
  await ask('studio.open', { take: `actor${vertices}`, pose: false });
  await eventually('the take', async () => (await ask('studio.status')).result.state === 'ready');
  await ask('studio.play', { what: 'take', loop: true });
  const page = await browser.newPage({ viewport: { width: 1280, height: 720 }, locale: 'en-GB' });
  const count = () => page.evaluate(() => ({
    drawn: Number(document.getElementById('face').dataset.drawn ?? 0), frames: Number(document.body.dataset.frames ?? 0),
    level: document.getElementById('detail')?.dataset.level ?? '' }));
  const opened = Date.now();
  await page.goto(`http://127.0.0.1:${port}`);
  await eventually('the face', async () => (await count()).drawn > 0);
  const start_ms = Date.now() - opened;
  await wait(kSettle_s);
  const before = await count();
  const from = Date.now();
  await wait(kMeasure_s);
  const after = await count();
  const seconds = (Date.now() - from) / 1000;
  console.log(`| ${vertices} | ${start_ms} | ${((after.drawn - before.drawn) / seconds).toFixed(1)} | ${after.level} | ${((after.frames - before.frames) / seconds).toFixed(1)} |`);
  await page.close();
  await ask('studio.close');
}
await browser.close();
daemon.kill('SIGTERM');
await new Promise((done) => daemon.on('exit', done));
process.exit(0);
