// The page on the booth's own screen, as facet-kiosk.service would start it: packaging/facet-kiosk, cage and Chromium with its sandbox, on a screen that
// wlroots keeps in memory, before a running facetd.
// Usage: node screen_test.mjs FACETD FACET PAGE_FOLDER OUTPUT_FOLDER ASSETS       Pictures land in the output folder.
import assert from 'node:assert/strict';
import { execFileSync, spawn } from 'node:child_process';
import { chmodSync, chownSync, createWriteStream, mkdirSync, readFileSync, readdirSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { fileURLToPath } from 'node:url';
import { Service, kPatience_ms } from './service.mjs';

const [facetd, facet, pageFolder, output, assets] = process.argv.slice(2);
const kiosk = fileURLToPath(new URL('../../packaging/facet-kiosk', import.meta.url));
const kNobody = 65534; // cage does not start for root, and neither does Chromium's sandbox
const service = await Service.prepare({ facetd, page: pageFolder, assets, log: join(output, 'facetd-screen.log'), source: 'path = "grey.mkv"\nloop = true' });
const { folder } = service;
execFileSync('ffmpeg', ['-loglevel', 'error', '-f', 'lavfi', '-i', 'color=gray:s=320x240:r=2', '-t', '5', join(folder, 'grey.mkv')]);
execFileSync(facet, ['synth', '--seed', '3', '--frames', '90', '--vertices', '8000', '-o', join(service.takes, 'actor.take')], { stdio: 'ignore' });

/** What is on the screen; null while there is none. What was drawn before the window had its size may be missing from the picture: wlroots 0.15 without a
 * display drops the first commits, so that only what changes later is sure to be there, as the face is. */
function look(runtime, file) {
  const display = readdirSync(runtime).find((name) => /^wayland-\d+$/.test(name));
  if (!display) {
    return null;
  }
  try {
    execFileSync('grim', [file], { env: { ...process.env, XDG_RUNTIME_DIR: runtime, WAYLAND_DISPLAY: display }, stdio: 'ignore', timeout: kPatience_ms });
    const pixels = execFileSync('ffmpeg', ['-loglevel', 'error', '-i', file, '-f', 'rawvideo', '-pix_fmt', 'rgb24', '-'], { maxBuffer: 1 << 26 });
    const header = readFileSync(file);
    const [width, height] = [header.readUInt32BE(16), header.readUInt32BE(20)]; // of a PNG
    assert.equal(pixels.length, 3 * width * height);
    const share = (left, top, right, bottom, holds) => {
      let [count, all] = [0, 0];
      for (let y = Math.floor(top * height); y < bottom * height; ++y) {
        for (let x = Math.floor(left * width); x < right * width; ++x, ++all) {
          const at = 3 * (y * width + x);
          count += holds(pixels[at], pixels[at + 1], pixels[at + 2]) ? 1 : 0;
        }
      }
      return count / all;
    };
    const skin = (r, g, b) => r > g + 8 && g > b && r > 70;
    return { width, height, pixels, face: share(0.23, 0.2, 0.33, 0.5, skin), beside: share(0.04, 0.2, 0.14, 0.5, skin) };
  } catch (error) {
    if (error instanceof assert.AssertionError) {
      throw error;
    }
    return null; // the compositor is not there yet
  }
}

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
    env: { PATH: process.env.PATH, FACET_KIOSK_URL: `${service.origin}/`, RUNTIME_DIRECTORY: runtime, CREDENTIALS_DIRECTORY: credentials,
           WLR_BACKENDS: 'headless', WLR_RENDERER: 'pixman', WLR_LIBINPUT_NO_DEVICES: '1' } });
  const log = createWriteStream(join(output, 'facet-kiosk.log'));
  screen.stdout.pipe(log);
  screen.stderr.pipe(log);
  const reads = async () => (await service.ask('status')).stream.readers.some((reader) => reader.client === 'kiosk' && reader.frames_sent > 10);
  await service.eventually('the page reads the stream', async () => { assert.equal(screen.exitCode, null, 'facet-kiosk ended; see facet-kiosk.log'); return reads(); });
  const file = join(output, 'screen.png');
  const seen = await service.eventually('a face on the screen', async () => { const now = look(runtime, file); return now && now.face > 0.6 && now.beside < 0.05 ? now : null; });
  console.log(`a screen of ${seen.width}x${seen.height}: ${(100 * seen.face).toFixed(0)} % skin where the face is, ${(100 * seen.beside).toFixed(0)} % beside it`);
  await service.eventually('the face moves', async () => { const now = look(runtime, file); return now && !now.pixels.equals(seen.pixels); });
} catch (error) {
  failure = error;
} finally {
  if (screen) {
    try { process.kill(-screen.pid, 'SIGTERM'); } catch { /* it has ended */ }
  }
  await service.stop();
}
if (failure) {
  console.error(failure);
  process.exit(1);
}
process.exit(0);
