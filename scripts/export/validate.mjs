// The Khronos glTF validator on one file: fails on any error or warning, prints every message. It does not know KHR_texture_basisu:
// that images are KTX2 is no fault where the file requires this (scripts/export/ktx2.mjs looks at them).
import { createRequire } from "node:module";
import { readFileSync } from "node:fs";
const require = createRequire(process.env.TOOLS + "/node/");
const validator = require("gltf-validator");
const file = process.argv[2];
const report = await validator.validateBytes(new Uint8Array(readFileSync(file)), { uri: file, maxIssues: 0 });
const { numErrors, numInfos, messages } = report.issues;
const basisu = report.info?.extensionsRequired?.includes("KHR_texture_basisu");
const known = (m) => basisu && m.pointer?.startsWith("/images/") && ["VALUE_NOT_IN_LIST", "IMAGE_UNRECOGNIZED_FORMAT"].includes(m.code);
const numWarnings = messages.filter((m) => m.severity === 1 && !known(m)).length;
for (const m of messages) console.log(["error", "warning", "info", "hint"][m.severity], m.code, m.message, m.pointer ?? "");
console.log(`validator ${report.validatorVersion}: ${numErrors} errors, ${numWarnings} warnings, ${numInfos} infos`);
process.exit(numErrors + numWarnings === 0 && report.info ? 0 : 1);
