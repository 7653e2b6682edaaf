// The KTX2 textures of one .glb against the PNG textures of another: read by ktx-parse, decoded by Basis Universal's transcoder (three.js
// brings it). Each has all levels, the transfer function of its use, and looks like the PNG (at least 38 dB; every level like the halved
// PNG, at least 30 dB). Usage: ktx2.mjs KTX2.glb PNG.glb
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

const toLinear = (b) => (b <= 0.04045 ? b / 12.92 : ((b + 0.055) / 1.055) ** 2.4);
const toSrgb = (l) => (l <= 0.0031308 ? 12.92 * l : 1.055 * l ** (1 / 2.4) - 0.055);

function half({ width, height, rgb }, srgb) {
  const w = Math.max(width >> 1, 1), h = Math.max(height >> 1, 1), sx = Math.floor(width / w), sy = Math.floor(height / h);
  const out = new Float64Array(3 * w * h);
  for (let y = 0; y < h; y++) for (let x = 0; x < w; x++) for (let c = 0; c < 3; c++) {
    let sum = 0;
    for (let j = 0; j < sy; j++) for (let i = 0; i < sx; i++) {
      const v = rgb[3 * ((sy * y + j) * width + sx * x + i) + c];
      sum += srgb ? toLinear(v) : v;
    }
    out[3 * (y * w + x) + c] = srgb ? toSrgb(sum / (sx * sy)) : sum / (sx * sy);
  }
  return { width: w, height: h, rgb: out };
}

let failed = false;
const plain = images(process.argv[3]);
for (const [k, image] of images(process.argv[2]).entries()) {
  const srgb = !/(ORM|Transmission)$/.test(image.name);
  const container = read(image.bytes);
  const descriptor = container.dataFormatDescriptor[0];
  const file = new basis.KTX2File(new Uint8Array(image.bytes));
  const png = PNG.sync.read(plain[k].bytes);
  let want = { width: png.width, height: png.height, rgb: Float64Array.from({ length: 3 * png.width * png.height }, (_, i) => png.data[4 * Math.floor(i / 3) + (i % 3)] / 255) };
  const levels = Math.floor(Math.log2(Math.max(png.width, png.height))) + 1;
  const wrong = [];
  if (!file.isValid() || !file.startTranscoding()) wrong.push("Basis Universal cannot read it");
  if (container.levels.length !== levels || file.getLevels() !== levels) wrong.push(`${container.levels.length} levels of ${levels}`);
  if (descriptor.colorModel !== UASTC || descriptor.transferFunction !== (srgb ? SRGB : LINEAR)) wrong.push("wrong format or transfer function");
  const decibels = [];
  for (let level = 0; level < levels && wrong.length === 0; level++) {
    const size = file.getImageTranscodedSizeInBytes(level, 0, 0, RGBA32), pixels = new Uint8Array(size);
    if (!file.transcodeImage(pixels, level, 0, 0, RGBA32, 0, -1, -1)) wrong.push(`level ${level} cannot be decoded`);
    let square = 0;
    for (let i = 0; i < want.rgb.length; i++) square += (pixels[4 * Math.floor(i / 3) + (i % 3)] / 255 - want.rgb[i]) ** 2;
    decibels.push(10 * Math.log10(want.rgb.length / Math.max(square, 1e-12)));
    want = half(want, srgb);
  }
  if (decibels[0] < 38 || Math.min(...decibels) < 30) wrong.push("does not look like the PNG");
  console.log(`${image.name}: ${png.width} x ${png.height}, ${levels} levels, ${srgb ? "sRGB" : "linear"}, ${decibels.map((d) => d.toFixed(0)).join(" ")} dB ${wrong.join("; ")}`);
  failed ||= wrong.length > 0;
}
process.exit(failed ? 1 : 0);
