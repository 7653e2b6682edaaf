// Drawing: holds the textures and programs, draws a frame when asked, and answers what lies under a pixel.

import * as g from './gl.js';
import { bytes, textureCap } from './load.js';
import { MODES, MAX_LAMPS, MAX_PROBES, backgroundFragment, backgroundVertex, depthFragment, meanFragment, pickFragment, surfaceFragment, surfaceVertex } from './shaders.js';
import { rayTexture } from './tracing.js';

const ALWAYS = ['albedo', 'roughness', 'irradiance', 'emission', 'ids'];
const UNITS = ['albedo', 'roughness', 'irradiance', 'radiance', 'emission', 'confidence', 'ids', 'edits', 'light', 'photo', 'environment', 'probe_radiance', 'probe_distance', 'response', 'rays'];

export class Renderer {
  constructor(canvas, scene) {
    this.canvas = canvas;
    this.scene = scene;
    const gl = (this.gl = g.context(canvas));
    this.surface = g.program(gl, surfaceVertex, surfaceFragment({ panes: scene.panes }));
    this.background = g.program(gl, backgroundVertex, backgroundFragment);
    this.picking = g.program(gl, surfaceVertex, pickFragment);
    this.pickTarget = g.pickTarget(gl);
    this.empty = gl.createVertexArray();
    this.cap = textureCap(gl, scene.caps);
    this.textures = new Map();
    this.photos = new Map();
    this.pending = new Map();
    // stand-ins until the real textures arrive: no unit may be without one of its kind
    const black = g.writtenTexture(gl, 'srgb8', 1, 1, new Uint8Array([0, 0, 0, 255]));
    for (const name of ['radiance', 'confidence', 'photo']) this.textures.set(name, black.texture);
    this.edits = g.writtenTexture(gl, 'float4', 256, 1, new Float32Array(1024).fill(1).map((v, i) => (i % 4 === 3 ? 0 : v)));
    this.textures.set('edits', this.edits.texture);
    // one with a shared exponent, three times: light as it is
    this.light = g.writtenTexture(gl, 'rgb9e5', 1, 1, new Uint32Array([0x84020100]));
    this.textures.set('light', this.light.texture);
    this.probes = 0;
  }

  // Everything the first frame needs; `step` is told how far it is.
  async loadScene(step) {
    const { gl, scene } = this;
    let done = 0;
    const counted = async (work) => {
      const result = await work;
      step(++done, ALWAYS.length + 4);
      return result;
    };
    const jobs = ALWAYS.map((name) => counted(this.loadTexture(name)));
    const mesh = counted(bytes('/data/mesh.bin')).then((b) => {
      this.mesh = g.meshFromBlock(gl, b, scene.vertices, scene.triangles);
      this.meshBlock = b;
    });
    // a square table of four half floats a cell
    const response = counted(bytes('/data/response.bin')).then((b) => {
      const size = Math.sqrt(b.byteLength / 8);
      this.textures.set('response', g.writtenTexture(gl, 'half4', size, size, new Uint16Array(b)).texture);
    });
    const sky = counted(bytes('/data/environment.bin')).then((b) => {
      this.textures.set('environment', g.textureFromBlock(gl, b, { wrapX: 'repeat' }).texture);
    });
    const places = scene.probes.places.slice(0, MAX_PROBES);
    const probes = counted(bytes('/data/probes.bin')).then((b) => {
      this.setProbes(b);
      this.probes = places.length;
      this.probePlaces = new Float32Array(places.flatMap((p) => [...p.position, p.room]));
    });
    await Promise.all([...jobs, mesh, response, sky, probes]);
  }

  // What reflections are traced through; after it `refine` can be called if it says true.
  async loadRays() {
    const { gl, scene } = this;
    const made = rayTexture(gl, await bytes('/data/rays.bin'), this.meshBlock, scene);
    this.meshBlock = null;
    if (!made) return false;
    this.textures.set('rays', made.texture);
    this.rayNodes = made.nodes;
    this.traced = g.program(gl, surfaceVertex, surfaceFragment({ traced: true }));
    this.depth = g.program(gl, surfaceVertex, depthFragment(scene.panes));
    this.mean = g.program(gl, backgroundVertex, meanFragment);
    return true;
  }

  // Panoramas of the reflection probes; from the second on they are those of changed light.
  setProbes(block) {
    const { gl, scene, textures } = this;
    const made = g.probeTextures(gl, block, scene.probes.places.length, scene.probes.levels);
    this.relit = textures.has('probe_radiance');
    for (const name of ['probe_radiance', 'probe_distance']) if (this.relit) gl.deleteTexture(textures.get(name));
    textures.set('probe_radiance', made.radiance).set('probe_distance', made.distance);
  }

  // Loads a layer's texture once.
  loadTexture(name) {
    if (!this.pending.has(name)) {
      const cap = name === 'ids' || name === 'confidence' ? Math.min(this.cap, 2048) : this.cap;
      const loaded = bytes(`/data/${name}-${cap}.bin`).then((b) => {
        this.textures.set(name, g.textureFromBlock(this.gl, b).texture);
      });
      loaded.catch(() => this.pending.delete(name));
      this.pending.set(name, loaded);
    }
    return this.pending.get(name);
  }

  // The photograph of a camera; the last few stay on the card.
  async photo(index) {
    if (!this.photos.has(index)) {
      const buffer = await bytes(`/data/photo-${index}-${this.cap}.bin`);
      this.photos.set(index, g.textureFromBlock(this.gl, buffer, { wrapX: 'repeat' }).texture);
      if (this.photos.size > 6) {
        const [oldest] = this.photos.keys();
        this.gl.deleteTexture(this.photos.get(oldest));
        this.photos.delete(oldest);
      }
    }
    return this.photos.get(index);
  }

  setEdits(edits) {
    Object.assign(this.edits, { width: 256, height: edits.rows });
    g.rewrite(this.gl, this.edits, edits.table());
  }

  // Ratios of changed to reconstructed irradiance.
  setLight({ width, height, texels }) {
    Object.assign(this.light, { width, height });
    g.rewrite(this.gl, this.light, texels);
  }

  resize() {
    const { canvas } = this;
    const scale = Math.min(devicePixelRatio || 1, 2);
    const [w, h] = [Math.max(Math.round(canvas.clientWidth * scale), 1), Math.max(Math.round(canvas.clientHeight * scale), 1)];
    if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
    return w / h;
  }

  bind(uniforms) {
    const { gl } = this;
    UNITS.forEach((name, unit) => {
      const location = uniforms['u_' + name];
      if (!location) return;
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(name.startsWith('probe_') ? gl.TEXTURE_2D_ARRAY : gl.TEXTURE_2D, this.textures.get(name));
      gl.uniform1i(location, unit);
    });
    gl.activeTexture(gl.TEXTURE0 + UNITS.length);
  }

  // What all programs are told of a view; `sample` is that to add up, -1 to draw to the screen.
  common({ program, uniforms: u }, camera, view, sample) {
    const { gl, canvas } = this;
    const photo = view.photo && this.photos.get(view.photo.index);
    if (photo) this.textures.set('photo', photo);
    gl.useProgram(program);
    gl.uniform1i(u.u_mode, MODES.indexOf(view.layer));
    gl.uniform1f(u.u_exposure, 2 ** view.ev);
    gl.uniform1i(u.u_soft, view.soft ? 1 : 0);
    gl.uniform1i(u.u_sample, sample);
    gl.uniform3fv(u.u_eye, camera.position);
    // by which rays start beside a surface
    gl.uniform1f(u.u_least_distance, camera.size * 2e-5);
    gl.uniform1i(u.u_has_photo, photo ? 1 : 0);
    gl.uniform1f(u.u_split, view.split * canvas.width);
    gl.uniform3fv(u.u_outside, view.outside);
    if (photo) {
      gl.uniform3fv(u.u_photo_eye, view.photo.position);
      // columns of world_from_camera are the rows of its inverse
      gl.uniformMatrix3fv(u.u_camera_from_world, true, view.photo.world_from_camera);
    }
    this.bind(u);
    return u;
  }

  drawBackground(camera, view, sample) {
    const { gl } = this;
    const u = this.common(this.background, camera, view, sample);
    gl.uniformMatrix4fv(u.u_world_from_clip, false, camera.worldFromClip());
    gl.uniform3fv(u.u_backdrop, view.backdrop);
    gl.bindVertexArray(this.empty);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  // With `sheets`, panes over what is drawn already.
  drawSurface(camera, view, sample, sheets = false) {
    const { gl } = this;
    const u = this.common(sample < 0 ? this.surface : this.traced, camera, view, sample);
    gl.uniformMatrix4fv(u.u_clip_from_world, false, camera.clipFromWorld());
    gl.uniform1i(u.u_marked, view.marked ?? -1);
    gl.uniform1i(u.u_probe_count, this.probes);
    if (this.probes) gl.uniform4fv(u.u_probes, this.probePlaces);
    gl.uniform1i(u.u_probes_relit, this.relit ? 1 : 0);
    gl.uniform1f(u.u_probe_levels, this.scene.probes.levels);
    gl.uniform1i(u.u_ray_nodes, this.rayNodes);
    // many samples of a pixel need no texture blurred for it
    gl.uniform1f(u.u_bias, sample < 0 ? 0 : -2);
    gl.uniform1i(u.u_sheets, sheets ? 1 : 0);
    const gains = new Float32Array(MAX_LAMPS * 3).fill(1);
    view.lamps.forEach((gain, i) => gains.set(gain, 3 * (i + 1)));
    gl.uniform3fv(u.u_lamp_gain, gains);
    this.drawMesh();
  }

  drawMesh() {
    const { gl } = this;
    gl.bindVertexArray(this.mesh.vao);
    gl.drawElements(gl.TRIANGLES, this.mesh.count, gl.UNSIGNED_INT, 0);
    gl.bindVertexArray(null);
  }

  // view: { layer, ev, soft, marked, photo: {index, position, world_from_camera} | null, split (0..1), backdrop, lamps, outside }
  draw(camera, view) {
    const { gl, canvas } = this;
    if (!this.mesh || gl.isContextLost()) return;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.disable(gl.DEPTH_TEST);
    this.drawBackground(camera, view, -1);
    gl.enable(gl.DEPTH_TEST);
    this.drawSurface(camera, view, -1);
    if (!this.scene.panes) return;
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.ONE, gl.SRC_ALPHA, gl.ZERO, gl.ONE);
    gl.depthMask(false);
    this.drawSurface(camera, view, -1, true);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
  }

  // Adds a sample to the pixels of some rows, with traced reflections, and draws the mean of those so far (layers 'final' and 'error'):
  // `sample` counts from 0 for an unmoved view, each for all rows. False where the card cannot.
  refine(camera, view, sample, { row, rows }) {
    const { gl, canvas } = this;
    const [width, height] = [canvas.width, canvas.height];
    if (gl.isContextLost()) return false;
    if (this.sum && (this.sum.width !== width || this.sum.height !== height)) {
      g.dropSumTarget(gl, this.sum);
      this.sum = null;
    }
    this.sum ??= g.sumTarget(gl, width, height);
    if (!this.sum) return false;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.sum.framebuffer);
    gl.viewport(0, 0, width, height);
    if (sample === 0 && row === 0) gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 0]);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(0, row, width, rows);
    gl.clearBufferfv(gl.DEPTH, 0, [1]);
    camera.shift = [2, 3].map((base, i) => (2 * radicalInverse(sample + 1, base) - 1) / [width, height][i]);
    // depth first: only what is seen is shaded, and added once
    gl.enable(gl.DEPTH_TEST);
    gl.drawBuffers([gl.NONE]);
    const depth = this.common(this.depth, camera, view, sample);
    gl.uniformMatrix4fv(depth.u_clip_from_world, false, camera.clipFromWorld());
    this.drawMesh();
    gl.drawBuffers([gl.COLOR_ATTACHMENT0]);
    gl.depthFunc(gl.EQUAL);
    gl.depthMask(false);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE);
    const lit = { ...view, layer: 'final', split: 0 };
    this.drawBackground(camera, lit, sample);
    this.drawSurface(camera, lit, sample);
    gl.disable(gl.SCISSOR_TEST);
    gl.disable(gl.BLEND);
    gl.depthMask(true);
    gl.depthFunc(gl.LESS);
    camera.shift = [0, 0];

    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    // rows with fewer samples stay as they were: panes are passed by chance, and the first samples show specks
    const fewest = this.scene.panes ? 8 : 1;
    if (sample < fewest) this.draw(camera, view);
    gl.disable(gl.DEPTH_TEST);
    const u = this.common(this.mean, camera, view, -1);
    gl.uniformMatrix4fv(u.u_world_from_clip, false, camera.worldFromClip());
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.sum.texture);
    gl.uniform1i(u.u_sum, 0);
    gl.uniform1f(u.u_fewest, fewest);
    gl.bindVertexArray(this.empty);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    return true;
  }

  // Atlas coordinate and world point under a place of the window in [-1, 1], or null.
  pick(camera, x, y) {
    const { gl, canvas } = this;
    if (!this.mesh) return null;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.pickTarget);
    gl.viewport(0, 0, 1, 1);
    gl.clearBufferuiv(gl.COLOR, 0, [0, 0, 0, 0]);
    gl.clearBufferfv(gl.DEPTH, 0, [1]);
    gl.enable(gl.DEPTH_TEST);
    const { program, uniforms: u } = this.picking;
    gl.useProgram(program);
    gl.uniformMatrix4fv(u.u_clip_from_world, false, camera.clipFromWorld([x, y, canvas.width, canvas.height]));
    gl.uniform3fv(u.u_eye, camera.position);
    gl.bindVertexArray(this.mesh.vao);
    gl.drawElements(gl.TRIANGLES, this.mesh.count, gl.UNSIGNED_INT, 0);
    gl.bindVertexArray(null);
    const words = new Uint32Array(4);
    gl.readPixels(0, 0, 1, 1, gl.RGBA_INTEGER, gl.UNSIGNED_INT, words);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    if (words[3] === 0) return null;
    const [u0, v0, distance] = new Float32Array(words.buffer);
    const ray = camera.ray(x, y);
    return { uv: [u0, v0], distance, lamp: words[3] - 1, point: camera.position.map((p, i) => p + ray[i] * distance) };
  }
}

// The digits of a number to a base behind the point in reverse: equidistributed in [0, 1) (van der Corput 1935).
function radicalInverse(n, base) {
  let [sum, place] = [0, 1 / base];
  for (let i = n; i > 0; i = Math.floor(i / base), place /= base) sum += (i % base) * place;
  return sum;
}
