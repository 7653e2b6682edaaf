// Opens scene.glb in three.js in headless Chromium and saves, for each camera, the base colour as three.js shows it and the
// picture under the file's own lights.
import { createRequire } from "node:module";
import { createServer } from "node:http";
import { readFileSync, writeFileSync, existsSync } from "node:fs";
import { join } from "node:path";
const [, , folder, out] = process.argv;
const node = join(process.env.TOOLS, "node");
const { chromium } = createRequire(node + "/")("playwright-core");
const cameras = JSON.parse(readFileSync(join(folder, "cameras.json"))).frames;
const page_text = `<!doctype html><meta charset="utf-8"><style>body{margin:0}</style><script type="importmap">
{"imports":{"three":"/three/build/three.module.js","three/addons/":"/three/examples/jsm/"}}</script><script type="module">
import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
const renderer = new THREE.WebGLRenderer({ antialias: false, preserveDrawingBuffer: true });
renderer.toneMapping = THREE.NoToneMapping;
document.body.appendChild(renderer.domElement);
const gltf = await new GLTFLoader().loadAsync("/scene.glb");
const scene = new THREE.Scene();
scene.add(gltf.scene);
const plain = [];
gltf.scene.traverse((o) => {
  if (o.isMesh) plain.push([o, o.material, new THREE.MeshBasicMaterial({ map: o.material.map, side: THREE.DoubleSide })]);
});
const lamp = new THREE.HemisphereLight(0xffffff, 0x888888, 2);
window.shot = (c, lit) => {
  renderer.setSize(c.w, c.h);
  const camera = new THREE.PerspectiveCamera((2 * Math.atan(c.h / 2 / c.fl_y) * 180) / Math.PI, c.w / c.h, 0.01, 1000);
  const m = c.transform_matrix.flat();
  camera.matrixAutoUpdate = false;
  camera.matrix.set(...m);
  camera.matrixWorldNeedsUpdate = true;
  for (const [mesh, own, basic] of plain) mesh.material = lit ? own : basic;
  if (lit) scene.add(lamp); else scene.remove(lamp);
  renderer.render(scene, camera);
  return renderer.domElement.toDataURL("image/png");
};
window.ready = true;
</script>`;
const types = { js: "text/javascript", glb: "model/gltf-binary" };
const server = createServer((request, response) => {
  const path = new URL(request.url, "http://x").pathname;
  if (path === "/") return response.writeHead(200, { "content-type": "text/html" }).end(page_text);
  const file = path === "/scene.glb" ? join(folder, "scene.glb") : join(node, "node_modules", path);
  if (path.includes("..") || !existsSync(file)) return response.writeHead(404).end();
  response.writeHead(200, { "content-type": types[file.split(".").pop()] ?? "application/octet-stream" }).end(readFileSync(file));
}).listen(0, "127.0.0.1");
await new Promise((resolve) => server.once("listening", resolve));
const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
  args: ["--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"],
});
let failed = false;
try {
  const page = await browser.newPage();
  page.on("console", (m) => m.type() === "error" && !m.location().url.includes("favicon") && (console.log("page:", m.text()), (failed = true)));
  page.on("pageerror", (e) => (console.log("page:", e.message), (failed = true)));
  await page.goto(`http://127.0.0.1:${server.address().port}/`);
  await page.waitForFunction(() => window.ready, null, { timeout: 180000 });
  for (const c of cameras) {
    const name = c.file_path.replace(/\.[^.]*$/, "");
    for (const [lit, kind] of [[false, "albedo"], [true, "lit"]]) {
      const url = await page.evaluate(([c, lit]) => window.shot(c, lit), [c, lit]);
      writeFileSync(join(out, `three_${kind}_${name}.png`), Buffer.from(url.split(",")[1], "base64"));
    }
  }
} finally {
  await browser.close();
  server.close();
}
process.exit(failed ? 1 : 0);
