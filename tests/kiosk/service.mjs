// A facetd that serves its page out of a folder of its own, and Chromium before it: what the tests of the page and bench/page.mjs have in common.
import assert from 'node:assert/strict';
import { spawn } from 'node:child_process';
import { createWriteStream, mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import net from 'node:net';
import { tmpdir } from 'node:os';
import { join } from 'node:path';

const { chromium } = createRequire(new URL('../../clients/kiosk/package.json', import.meta.url))('playwright-core');
export const kPatience_ms = 120_000; // for what must come; passing never takes it

export const wait = (ms) => new Promise((done) => setTimeout(done, ms));

/** Chromium with software GL. */
export const openBrowser = (executablePath) => chromium.launch({
  executablePath, args: ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist'] });

/** A port that nobody has now. */
function freePort() {
  return new Promise((resolve) => {
    const server = net.createServer().listen(0, '127.0.0.1', () => {
      const { port } = server.address();
      server.close(() => resolve(port));
    });
  });
}

/** Not started yet: what `source` names is to be laid into `folder` before, takes into `takes`. */
export class Service {
  /** facetd: the program. page: the folder of the page. source: the lines of [source]; none where `rig` says the mode and what stands for the source.
   * more: further sections. web: further lines of [web]. log: a file for what it says. */
  static async prepare({ facetd, page, assets, source, rig = `[source]\n${source}\npaced = true`, more = '', web = '', log = null }) {
    const service = new Service();
    service.facetd = facetd;
    service.log = log;
    service.folder = mkdtempSync(join(tmpdir(), 'facet-page-'));
    service.takes = join(service.folder, 'takes');
    service.origin = `http://127.0.0.1:${await freePort()}`;
    mkdirSync(service.takes);
    writeFileSync(join(service.folder, 'facet.toml'), `
${rig}
[model]
path = "${assets}/default.facemodel"
landmark_nets = "${assets}/mediapipe/face_mesh_solution_packed_assets.data"
${more}
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
listen = "${new URL(service.origin).host}"
page = "${page}"
token_file = "token"
${web}
`);
    process.on('exit', () => {
      service.daemon?.kill('SIGKILL');
      rmSync(service.folder, { recursive: true, force: true, maxRetries: 5 });
    });
    return service;
  }

  async start() {
    this.daemon = spawn(this.facetd, ['--config', join(this.folder, 'facet.toml')], { stdio: ['ignore', 'ignore', this.log ? 'pipe' : 'inherit'] });
    this.daemon.stderr?.pipe(createWriteStream(this.log));
    this.ended = new Promise((resolve) => this.daemon.on('exit', resolve));
    await this.eventually('facetd listens', () => this.ask('status'));
    await this.eventually('the page is served', () => fetch(this.origin).then((answer) => answer.ok, () => false));
  }

  async stop() {
    this.daemon?.kill('SIGTERM');
    await this.ended;
  }

  get token() {
    return readFileSync(join(this.folder, 'token'), 'utf8').trim();
  }

  /** What the control socket answers to one request; null while nobody listens. Throws what it refuses. */
  ask(method, params = {}) {
    return new Promise((resolve, reject) => {
      let said = '';
      const socket = net.connect(join(this.folder, 'control.sock'), () => socket.write(`${JSON.stringify({ jsonrpc: '2.0', id: 1, method, params })}\n`));
      socket.on('error', () => resolve(null));
      socket.on('close', () => resolve(null));
      socket.on('data', (bytes) => {
        said += bytes;
        if (said.endsWith('\n')) {
          socket.destroy();
          const { result, error } = JSON.parse(said);
          error ? reject(new Error(`${method}: ${error.message}`)) : resolve(result);
        }
      });
    });
  }

  /** The first value of holds() that is true. */
  async eventually(what, holds) {
    for (const end = Date.now() + kPatience_ms; Date.now() < end;) {
      const value = await holds();
      if (value) {
        return value;
      }
      assert.equal(this.daemon.exitCode, null, 'facetd ended; see what it said');
      await wait(30);
    }
    return assert.fail(`not within ${kPatience_ms / 1000} s: ${what}`);
  }
}

/** Pictures of a face that a page has drawn. */
export const drawnBy = (page) => page.evaluate(() => Number(document.getElementById('face').dataset.drawn ?? 0));

/** Runs a test's steps before a service and a browser, ends both whatever happens, and this process with 0 where all holds. onFailure: what is of use then. */
export async function runTest(service, executablePath, steps, onFailure = async () => {}) {
  const began = Date.now();
  const step = (words) => console.log(`${((Date.now() - began) / 1000).toFixed(1)} s  ${words}`);
  let browser = null;
  let failure = null;
  try {
    await service.start();
    browser = await openBrowser(executablePath);
    await steps(browser, step);
  } catch (error) {
    failure = error;
    console.error(error);
    await onFailure().catch((other) => console.error(other));
  } finally {
    await browser?.close();
    await service.stop();
  }
  if (failure) {
    process.exit(1);
  }
  step('done');
  process.exit(0);
}
