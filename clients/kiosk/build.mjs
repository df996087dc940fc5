// Builds the page: message types from the schema (flatc), types checked (tsc), one script (esbuild).
// Usage: node build.mjs SCHEMA OUTPUT_FOLDER       where node_modules/ lies beside this file (npm ci).
import { execFileSync } from 'node:child_process';
import { cpSync, mkdirSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { dirname, join } from 'node:path';
import { fileURLToPath } from 'node:url';
import { build } from 'esbuild';

const [schema, output] = process.argv.slice(2);
if (!schema || !output) {
  console.error('usage: node build.mjs SCHEMA OUTPUT_FOLDER');
  process.exit(2);
}
const here = dirname(fileURLToPath(import.meta.url));
const wire = join(here, 'generated');

// flatc 2.0 makes no TypeScript of arrays in structs: as many single fields are the same bytes.
const spread = readFileSync(schema, 'utf8').replace(/(\w+):\[float:(\d+)\];/g, (_, name, count) =>
  Array.from({ length: Number(count) }, (_, i) => `${name}_${i}:float;`).join(' '));
rmSync(wire, { recursive: true, force: true });
mkdirSync(wire, { recursive: true });
writeFileSync(join(wire, 'facet.fbs'), spread);
execFileSync('flatc', ['--ts', '-o', wire, join(wire, 'facet.fbs')], { stdio: 'inherit' });

try {
  execFileSync(process.execPath, [join(here, 'node_modules/typescript/bin/tsc'), '--noEmit', '-p', here], { stdio: 'inherit' });
} catch {
  process.exit(1); // tsc has said what is wrong
}
mkdirSync(output, { recursive: true });
await build({
  entryPoints: [join(here, 'source/kiosk.ts')], outfile: join(output, 'kiosk.js'), bundle: true, minify: true,
  format: 'iife', target: 'chrome102', legalComments: 'none', logLevel: 'warning',
  banner: { js: '/* Facet (Apache-2.0); three.js (MIT), FlatBuffers (Apache-2.0): licences.txt */' },
});
for (const file of ['index.html', 'kiosk.css', 'icon.svg']) {
  cpSync(join(here, file), join(output, file));
}
const licence = (name) => `${name}\n\n${readFileSync(join(here, 'node_modules', name, name === 'three' ? 'LICENSE' : 'LICENSE.txt'), 'utf8')}\n`;
writeFileSync(join(output, 'licences.txt'), licence('three') + licence('flatbuffers'));
