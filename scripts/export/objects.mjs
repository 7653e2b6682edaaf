// Objects with textures of their own (one .glb) against the same objects on shared textures (another): at several points of every
// triangle, base colour, roughness and metal must be the same to a step of 8 bits. Usage: objects.mjs OWN.glb SHARED.glb
import { createRequire } from "node:module";
import { readFileSync } from "node:fs";
import { join } from "node:path";
const { PNG } = createRequire(join(process.env.TOOLS, "node") + "/")("pngjs");

function scene(path) {
  const data = readFileSync(path), length = data.readUInt32LE(12);
  const root = JSON.parse(data.subarray(20, 20 + length)), binary = data.subarray(28 + length);
  const bytes = (view) => binary.subarray(view.byteOffset ?? 0, (view.byteOffset ?? 0) + view.byteLength);
  const numbers = (index, Type) => {
    const own = Uint8Array.from(bytes(root.bufferViews[root.accessors[index].bufferView]));
    return new Type(own.buffer);
  };
  const images = root.images.map((i) => PNG.sync.read(bytes(root.bufferViews[i.bufferView])));
  const picture = (use) => images[root.textures[use.index].source];
  const parts = new Map();
  for (const node of root.nodes) {
    if (node.mesh === undefined || /_LOD\d+$/.test(node.name)) continue;
    parts.set(node.name, root.meshes[node.mesh].primitives.map((p) => {
      const pbr = root.materials[p.material].pbrMetallicRoughness;
      return {
        indices: numbers(p.indices, Uint32Array),
        uvs: numbers(p.attributes.TEXCOORD_0, Float32Array),
        pictures: [picture(pbr.baseColorTexture), picture(pbr.metallicRoughnessTexture)],
      };
    }));
  }
  return parts;
}

function sample(picture, [u, v]) {
  const clamp = (i, n) => Math.min(Math.max(i, 0), n - 1);
  const x = u * picture.width - 0.5, y = v * picture.height - 0.5, x0 = Math.floor(x), y0 = Math.floor(y);
  return [0, 1, 2].map((c) => {
    const at = (i, j) => picture.data[4 * (clamp(j, picture.height) * picture.width + clamp(i, picture.width)) + c];
    const row = (j) => at(x0, j) * (1 - (x - x0)) + at(x0 + 1, j) * (x - x0);
    return row(y0) * (1 - (y - y0)) + row(y0 + 1) * (y - y0);
  });
}

const [own, shared] = [scene(process.argv[2]), scene(process.argv[3])];
const weights = [[1 / 3, 1 / 3, 1 / 3], [0.98, 0.01, 0.01], [0.01, 0.98, 0.01], [0.01, 0.01, 0.98], [0.5, 0.5, 0]];
let worst = 0, points = 0, failed = own.size !== shared.size;
for (const [name, primitives] of shared) {
  const others = own.get(name);
  if (!others || others.length !== primitives.length) { failed = true; console.log(`${name}: missing, or of other materials`); continue; }
  primitives.forEach((p, k) => {
    const q = others[k];
    for (let t = 0; t < p.indices.length; t += 3) for (const w of weights) {
      const at = ({ indices, uvs }) => [0, 1].map((c) => w.reduce((sum, wi, i) => sum + wi * uvs[2 * indices[t + i] + c], 0));
      const [a, b] = [at(p), at(q)];
      p.pictures.forEach((picture, i) => {
        const [x, y] = [sample(picture, a), sample(q.pictures[i], b)];
        worst = Math.max(worst, ...x.map((v, c) => Math.abs(v - y[c])));
      });
      points++;
    }
  });
}
console.log(`${own.size} objects, ${points} points, at most ${worst.toFixed(3)} steps of 8 bits apart`);
process.exit(failed || worst > 1 ? 1 : 0);
