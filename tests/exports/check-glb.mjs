// Khronos' glTF validator on GLB files: exit status 1 where one has an error, and what it says of them.
// Usage: node check-glb.mjs VALIDATOR_FOLDER FILE...
import fs from 'fs';
import { createRequire } from 'module';
const [folder, ...files] = process.argv.slice(2);
const validator = createRequire(import.meta.url)(folder);
let failed = false;
for (const file of files) {
  const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)), { uri: file, maxIssues: 20 });
  const { numErrors, numWarnings } = report.issues;
  console.log(`${file}: ${numErrors} errors, ${numWarnings} warnings, ${report.info.totalVertexCount} vertices, ` +
              `${report.info.hasMorphTargets} morph targets, ${report.info.animationCount} animations`);
  for (const issue of report.issues.messages.filter((message) => message.severity <= 1)) {
    console.log(`  ${issue.code} ${issue.pointer ?? ''}: ${issue.message}`);
  }
  failed ||= numErrors > 0 || numWarnings > 0;
}
process.exit(failed ? 1 : 0);
