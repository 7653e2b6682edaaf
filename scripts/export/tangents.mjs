// The tangents of a .glb against those of another build of MikkTSpace (npm mikktspace, the Rust port that glTF-Transform uses): the
// same directions and signs at every corner. Usage: tangents.mjs FILE.glb
import { createRequire } from "node:module";
import { readFileSync } from "node:fs";
import { join } from "node:path";
const { generateTangents } = createRequire(join(process.env.TOOLS, "node") + "/")("mikktspace");
const data = readFileSync(process.argv[2]), length = data.readUInt32LE(12);
const root = JSON.parse(data.subarray(20, 20 + length)), binary = data.subarray(28 + length);
const numbers = (index, Type) => {
  const { byteOffset = 0, byteLength } = root.bufferViews[root.accessors[index].bufferView];
  return new Type(Uint8Array.from(binary.subarray(byteOffset, byteOffset + byteLength)).buffer);
};
let corners = 0, flat = 0, apart = 0, worst = 1;
for (const { attributes: a, indices } of root.meshes.flatMap((m) => m.primitives)) {
  if (a.TANGENT === undefined) continue;
  const order = numbers(indices, Uint32Array);
  const unrolled = (index, width) => {
    const all = numbers(index, Float32Array);
    return Float32Array.from({ length: width * order.length }, (_, i) => all[width * order[Math.floor(i / width)] + (i % width)]);
  };
  const [ours, uvs] = [unrolled(a.TANGENT, 4), unrolled(a.TEXCOORD_0, 2)];
  const theirs = generateTangents(unrolled(a.POSITION, 3), unrolled(a.NORMAL, 3), uvs);
  for (let i = 0; i < order.length; i++) {
    const t = 6 * Math.floor(i / 3);
    const area = (uvs[t + 2] - uvs[t]) * (uvs[t + 5] - uvs[t + 1]) - (uvs[t + 4] - uvs[t]) * (uvs[t + 3] - uvs[t + 1]);
    // without area in the atlas any direction will do
    if (Math.abs(area) < 1e-12) { flat++; continue; }
    const [x, y] = [ours, theirs].map((v) => v.subarray(4 * i, 4 * i + 4));
    const cosine = x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
    // it was given v downwards: its bitangents point the other way
    if (cosine < 0.999 || x[3] !== -y[3]) apart++;
    worst = Math.min(worst, cosine);
    corners++;
  }
}
console.log(`${corners} corners (${flat} without area in the atlas), ${apart} apart, smallest cosine ${worst.toFixed(5)}`);
process.exit(corners > 0 && apart <= 1e-3 * corners ? 0 : 1);
