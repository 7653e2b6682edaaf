// The Khronos glTF validator on one file: fails on any error or warning, prints every message.
import { createRequire } from "node:module";
import { readFileSync } from "node:fs";
const require = createRequire(process.env.TOOLS + "/node/");
const validator = require("gltf-validator");
const file = process.argv[2];
const report = await validator.validateBytes(new Uint8Array(readFileSync(file)), { uri: file, maxIssues: 0 });
const { numErrors, numWarnings, numInfos, messages } = report.issues;
for (const m of messages) console.log(["error", "warning", "info", "hint"][m.severity], m.code, m.message, m.pointer ?? "");
console.log(`validator ${report.validatorVersion}: ${numErrors} errors, ${numWarnings} warnings, ${numInfos} infos`);
process.exit(numErrors + numWarnings === 0 && report.info ? 0 : 1);
