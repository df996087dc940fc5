// The page on the booth's own screen, as facet-kiosk.service would start it: packaging/facet-kiosk, cage and Chromium with its sandbox, on a screen that
// Xvfb keeps in memory, before a running facetd.
// Usage: node screen_test.mjs FACETD FACET PAGE_FOLDER OUTPUT_FOLDER ASSETS       Pictures land in the output folder.
import assert from 'node:assert/strict';
import { execFileSync, spawn } from 'node:child_process';
import { chmodSync, chownSync, createWriteStream, mkdirSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { fileURLToPath } from 'node:url';
import { Service } from './service.mjs';

const [facetd, facet, pageFolder, output, assets] = process.argv.slice(2);
const kiosk = fileURLToPath(new URL('../../packaging/facet-kiosk', import.meta.url));
const [kWidth, kHeight] = [1024, 768]; // of cage's window there
const kNobody = 65534; // cage does not start for root, and neither does Chromium's sandbox
const service = await Service.prepare({ facetd, page: pageFolder, assets, log: join(output, 'facetd-screen.log'), source: 'path = "grey.mkv"\nloop = true' });
const { folder } = service;
execFileSync('ffmpeg', ['-loglevel', 'error', '-f', 'lavfi', '-i', 'color=gray:s=320x240:r=2', '-t', '5', join(folder, 'grey.mkv')]);
execFileSync(facet, ['synth', '--seed', '3', '--frames', '90', '--vertices', '8000', '-o', join(service.takes, 'actor.take')], { stdio: 'ignore' });

/** What is on the screen. */
function look() {
  const grab = (...how) => execFileSync('ffmpeg', ['-loglevel', 'error', '-y', '-f', 'x11grab', '-video_size', `${kWidth}x${kHeight}`, '-i', display, '-frames:v', '1', ...how], { maxBuffer: 1 << 26 });
  const pixels = grab('-f', 'rawvideo', '-pix_fmt', 'rgb24', '-');
  const share = (left, top, right, bottom, holds) => {
    let [count, all] = [0, 0];
    for (let y = Math.floor(top * kHeight); y < bottom * kHeight; ++y) {
      for (let x = Math.floor(left * kWidth); x < right * kWidth; ++x, ++all) {
        const at = 3 * (y * kWidth + x);
        count += holds(pixels[at], pixels[at + 1], pixels[at + 2]) ? 1 : 0;
      }
    }
    return count / all;
  };
  const skin = (r, g, b) => r > g + 8 && g > b && r > 70;
  return { pixels, keep: () => grab(join(output, 'screen.png')), face: share(0.27, 0.27, 0.35, 0.42, skin), beside: share(0.04, 0.2, 0.1, 0.4, skin), lit: share(0, 0, 1, 1, (r, g, b) => r + g + b > 15) };
}

// The screen, on a display that nobody has now.
const server = spawn('Xvfb', ['-displayfd', '3', '-screen', '0', `${kWidth}x${kHeight}x24`, '-nolisten', 'tcp'], { stdio: ['ignore', 'ignore', 'ignore', 'pipe'] });
process.on('exit', () => server.kill());
const display = `:${await new Promise((resolve, reject) => { server.stdio[3].on('data', (number) => resolve(String(number).trim())); server.on('exit', () => reject(new Error('Xvfb ended'))); })}`;

let screen = null;
let failure = null;
try {
  await service.start();
  await service.ask('studio.open', { take: 'actor', pose: false });
  await service.eventually('the take', async () => (await service.ask('studio.status')).state === 'ready');
  await service.ask('studio.play', { what: 'take', loop: true });

  // What systemd gives to the unit.
  const [runtime, credentials] = ['run', 'credentials'].map((name) => join(folder, name));
  [runtime, credentials].forEach((place) => mkdirSync(place, { mode: 0o700 }));
  writeFileSync(join(credentials, 'web-token'), service.token, { mode: 0o400 });
  const asRoot = process.getuid() === 0;
  if (asRoot) {
    chmodSync(folder, 0o755);
    [runtime, credentials, join(credentials, 'web-token')].forEach((place) => chownSync(place, kNobody, kNobody));
  }
  const command = asRoot ? ['setpriv', '--reuid', String(kNobody), '--regid', String(kNobody), '--clear-groups', kiosk] : [kiosk];
  screen = spawn(command[0], command.slice(1), {
    detached: true, cwd: '/', stdio: ['ignore', 'pipe', 'pipe'],
    env: { PATH: process.env.PATH, DISPLAY: display, FACET_KIOSK_URL: `${service.origin}/`, RUNTIME_DIRECTORY: runtime, CREDENTIALS_DIRECTORY: credentials,
           WLR_BACKENDS: 'x11', WLR_RENDERER: 'pixman' } });
  const log = createWriteStream(join(output, 'facet-kiosk.log'));
  screen.stdout.pipe(log);
  screen.stderr.pipe(log);
  const reads = async () => (await service.ask('status')).stream.readers.some((reader) => reader.client === 'kiosk' && reader.frames_sent > 10);
  await service.eventually('the page reads the stream', async () => { assert.equal(screen.exitCode, null, 'facet-kiosk ended; see facet-kiosk.log'); return reads(); });
  const seen = await service.eventually('a face on the screen', async () => { const now = look(); return now.face > 0.6 && now.beside < 0.05 && now.lit > 0.9 ? now : null; });
  console.log(`${(100 * seen.face).toFixed(0)} % skin where the face is, ${(100 * seen.beside).toFixed(0)} % beside it`);
  await service.eventually('the face moves', async () => !look().pixels.equals(seen.pixels));
  seen.keep();
} catch (error) {
  failure = error;
  console.error(error);
  try { look().keep(); } catch (other) { console.error(other); }
} finally {
  if (screen && screen.exitCode === null && screen.signalCode === null) {
    const ended = new Promise((resolve) => screen.on('exit', resolve));
    const end = (signal) => { try { process.kill(-screen.pid, signal); } catch { /* it has ended */ } };
    end('SIGTERM');
    const patience = setTimeout(() => end('SIGKILL'), 10_000);
    await ended;
    clearTimeout(patience);
  }
  await service.stop();
}
if (failure) {
  process.exit(1);
}
process.exit(0);
