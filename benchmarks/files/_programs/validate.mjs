// What Khronos's validator says of .glb files: node validate.mjs FILE..., beside node_modules with gltf-validator.
// One line of JSON: version, and for each file its numbers of errors and warnings, and its messages.
import { readFileSync } from 'node:fs';
import { createRequire } from 'node:module';

const require = createRequire(process.cwd() + '/');
const validator = require('gltf-validator');
const files = {};
for (const path of process.argv.slice(2)) {
  const report = await validator.validateBytes(new Uint8Array(readFileSync(path)), { maxIssues: 100 });
  files[path] = {
    errors: report.issues.numErrors,
    warnings: report.issues.numWarnings,
    messages: report.issues.messages.map(({ code, message, severity, pointer }) => ({ code, message, severity, pointer })),
  };
}
console.log(JSON.stringify({ version: validator.version(), files }));
