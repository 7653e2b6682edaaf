// Called by scripts/make_gltf_files: a bent sheet, packed in every way that glTF knows.
import { Document, Logger, NodeIO } from '@gltf-transform/core';
import { ALL_EXTENSIONS } from '@gltf-transform/extensions';
import { draco, instance, meshopt, quantize } from '@gltf-transform/functions';
import draco3d from 'draco3dgltf';
import { MeshoptDecoder, MeshoptEncoder } from 'meshoptimizer';

const QUADS = 4;
const [folder, textured, copies] = process.argv.slice(2);
await MeshoptEncoder.ready;
const io = new NodeIO().registerExtensions(ALL_EXTENSIONS).registerDependencies({
  'draco3d.encoder': await draco3d.createEncoderModule(),
  'draco3d.decoder': await draco3d.createDecoderModule(),
  'meshopt.encoder': MeshoptEncoder,
  'meshopt.decoder': MeshoptDecoder,
});

function sheet(repeats, image) {
  const document = new Document();
  document.setLogger(new Logger(Logger.Verbosity.ERROR));
  const buffer = document.createBuffer();
  const [positions, normals, uvs, indices] = [[], [], [], []];
  for (let j = 0; j <= QUADS; j++) {
    for (let i = 0; i <= QUADS; i++) {
      const x = (4 * i) / QUADS - 2;
      positions.push(x, 0.25 * x * x, (4 * j) / QUADS - 2);
      const length = Math.hypot(1, 0.5 * x);
      normals.push((-0.5 * x) / length, 1 / length, 0);
      uvs.push((repeats * i) / QUADS, (repeats * j) / QUADS);
    }
  }
  for (let j = 0; j < QUADS; j++) {
    for (let i = 0; i < QUADS; i++) {
      const a = j * (QUADS + 1) + i;
      indices.push(a, a + QUADS + 1, a + 1, a + 1, a + QUADS + 1, a + QUADS + 2);
    }
  }
  const accessor = (array, type) => document.createAccessor().setArray(array).setType(type).setBuffer(buffer);
  const material = document.createMaterial('paint');
  if (image) {
    material.setBaseColorTexture(document.createTexture('image').setImage(image).setMimeType('image/png'));
  }
  const primitive = document.createPrimitive()
    .setAttribute('POSITION', accessor(new Float32Array(positions), 'VEC3'))
    .setAttribute('NORMAL', accessor(new Float32Array(normals), 'VEC3'))
    .setAttribute('TEXCOORD_0', accessor(new Float32Array(uvs), 'VEC2'))
    .setIndices(accessor(new Uint16Array(indices), 'SCALAR'))
    .setMaterial(material);
  const node = document.createNode('sheet').setMesh(document.createMesh('sheet').addPrimitive(primitive));
  document.createScene().addChild(node.setTranslation([1, 2, 3]));
  return document;
}

const packed = {
  'quantized': quantize(),
  'meshopt-high': meshopt({ encoder: MeshoptEncoder, level: 'high' }),
  'draco-edgebreaker': draco({ method: 'edgebreaker' }),
  'draco-sequential': draco({ method: 'sequential' }),
};
for (const [name, transform] of Object.entries(packed)) {
  const document = sheet(1);
  await document.transform(transform);
  await io.write(`${folder}/${name}.glb`, document);
}
const pixel = 'iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg==';
await io.write(textured, sheet(3, new Uint8Array(Buffer.from(pixel, 'base64'))));

// six copies: turned by half a radian each about y, larger by an eighth, ten metres apart in x and one in y
const many = sheet(1);
const scene = many.getRoot().listScenes()[0];
const mesh = many.getRoot().listMeshes()[0];
many.getRoot().listNodes()[0].dispose();
for (let k = 0; k < 6; k++) {
  const half = 0.25 * k;
  const size = 1 + 0.125 * k;
  scene.addChild(many.createNode(`copy ${k}`).setMesh(mesh).setTranslation([10 * k, k, 0])
    .setRotation([0, Math.sin(half), 0, Math.cos(half)]).setScale([size, size, size]));
}
await io.write(copies, many);
await many.transform(instance({ min: 2 }));
await io.write(`${folder}/instanced.glb`, many);
