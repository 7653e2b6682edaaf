// The KTX2 textures of one .glb against the PNG textures of another: read by ktx-parse, decoded by Basis Universal's transcoder (three.js
// brings it). Each has all levels, the transfer function of its use, and looks like the PNG of its size (at least 38 dB); levels for which
// there are smaller PNGs (`--max-texture`) look like these (at least 30 dB). Usage: ktx2.mjs KTX2.glb PNG.glb [SMALLER.glb …]
import { createRequire } from "node:module";
import { readFileSync } from "node:fs";
import { join } from "node:path";
const node = join(process.env.TOOLS, "node");
const require = createRequire(node + "/");
const { PNG } = require("pngjs");
const parser = join(node, "node_modules/ktx-parse");
const { read } = await import(join(parser, JSON.parse(readFileSync(join(parser, "package.json"))).main));
const libs = join(node, "node_modules/three/examples/jsm/libs/basis");
const text = readFileSync(join(libs, "basis_transcoder.js"), "utf8");
const BASIS = new Function("require", "process", "__dirname", `${text}; return BASIS;`)(require, process, libs);
const basis = await BASIS({ wasmBinary: readFileSync(join(libs, "basis_transcoder.wasm")) });
basis.initializeBasis();
const RGBA32 = 13, UASTC = 166, LINEAR = 1, SRGB = 2;

function images(path) {
  const data = readFileSync(path), length = data.readUInt32LE(12);
  const root = JSON.parse(data.subarray(20, 20 + length));
  const binary = data.subarray(28 + length);
  return root.images.map((i) => {
    const view = root.bufferViews[i.bufferView];
    return { name: i.name, bytes: binary.subarray(view.byteOffset ?? 0, (view.byteOffset ?? 0) + view.byteLength) };
  });
}

let failed = false;
const plain = process.argv.slice(3).map(images);
for (const [k, image] of images(process.argv[2]).entries()) {
  const srgb = !/(ORM|Transmission)$/.test(image.name);
  const container = read(image.bytes);
  const descriptor = container.dataFormatDescriptor[0];
  const file = new basis.KTX2File(new Uint8Array(image.bytes));
  const pngs = plain.map((file) => PNG.sync.read(file[k].bytes)), png = pngs[0];
  const levels = Math.floor(Math.log2(Math.max(png.width, png.height))) + 1;
  const wrong = [];
  if (!file.isValid() || !file.startTranscoding()) wrong.push("Basis Universal cannot read it");
  if (container.levels.length !== levels || file.getLevels() !== levels) wrong.push(`${container.levels.length} levels of ${levels}`);
  if (descriptor.colorModel !== UASTC || descriptor.transferFunction !== (srgb ? SRGB : LINEAR)) wrong.push("wrong format or transfer function");
  const decibels = [];
  for (let level = 0; level < levels && wrong.length === 0; level++) {
    const size = file.getImageTranscodedSizeInBytes(level, 0, 0, RGBA32), pixels = new Uint8Array(size);
    if (!file.transcodeImage(pixels, level, 0, 0, RGBA32, 0, -1, -1)) wrong.push(`level ${level} cannot be decoded`);
    const [width, height] = [png.width, png.height].map((n) => Math.max(n >> level, 1));
    const want = pngs.find((p) => p.width === width && p.height === height);
    if (!want) continue;
    let square = 0;
    for (let i = 0; i < 3 * width * height; i++) {
      const at = 4 * Math.floor(i / 3) + (i % 3);
      square += ((pixels[at] - want.data[at]) / 255) ** 2;
    }
    decibels.push(10 * Math.log10((3 * width * height) / Math.max(square, 1e-12)));
  }
  const sizes = new Set(pngs.map((p) => `${p.width} ${p.height}`)).size;
  if (decibels.length !== sizes) wrong.push(`${decibels.length} levels compared of ${sizes}`);
  if (decibels[0] < 38 || Math.min(...decibels) < 30) wrong.push("does not look like the PNG");
  console.log(`${image.name}: ${png.width} x ${png.height}, ${levels} levels, ${srgb ? "sRGB" : "linear"}, ${decibels.map((d) => d.toFixed(0)).join(" ")} dB ${wrong.join("; ")}`);
  failed ||= wrong.length > 0;
}
process.exit(failed ? 1 : 0);
