// Parts of the page, and what the tests write beside it, as modules for node.
import { createRequire } from 'node:module';
import { join } from 'node:path';
import { fileURLToPath, pathToFileURL } from 'node:url';

const kiosk = fileURLToPath(new URL('../../clients/kiosk/', import.meta.url));
const { buildSync } = createRequire(join(kiosk, 'package.json'))('esbuild');

/** file: TypeScript, from here. output: a folder. */
export async function load(file, output) {
  const outfile = join(output, `${file.replace(/.*\//, '').replace(/\.ts$/, '')}.mjs`);
  buildSync({
    entryPoints: [fileURLToPath(new URL(file, import.meta.url))], outfile, bundle: true, platform: 'node', format: 'esm',
    absWorkingDir: kiosk, alias: { flatbuffers: './node_modules/flatbuffers' }, logLevel: 'warning' });
  return import(pathToFileURL(outfile).href);
}
