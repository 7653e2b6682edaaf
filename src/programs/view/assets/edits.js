// What the user changed: materials per class, and the strength of lamps. Nothing is written back to the reconstruction.

import { json, bytes } from './load.js';

export const linear = (c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
const encode = (x) => (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);

export const fromHex = (hex) => [1, 3, 5].map((i) => linear(parseInt(hex.slice(i, i + 2), 16) / 255));

// The largest factor on light that the light texture can hold.
export const MAX_GAIN = 4;

export class Edits {
  constructor(scene) {
    this.classes = new Map(scene.classes.map((c) => [c.id, c]));
    this.changed = new Map(); // class id -> { colour: '#rrggbb' | null, roughness: number | null }
    const largest = Math.max(...this.classes.keys(), 255);
    this.rows = (largest >> 8) + 1;
    this.lamps = scene.lamps.map((lamp) => ({ ...lamp, gain: 1 }));
    this.shares = null;
  }

  material(id) {
    const original = this.classes.get(id);
    const edit = this.changed.get(id) ?? {};
    return { colour: edit.colour ?? original.albedo_srgb, roughness: edit.roughness ?? original.roughness, edited: this.changed.has(id) };
  }

  setMaterial(id, change) {
    this.changed.set(id, { ...this.changed.get(id), ...change });
  }

  resetMaterial(id) {
    this.changed.delete(id);
  }

  // Per class a factor on the albedo (its texture is kept) and an offset on the roughness: 256 classes per row.
  table() {
    const texels = new Float32Array(256 * this.rows * 4);
    for (let i = 0; i < texels.length; i++) texels[i] = i % 4 === 3 ? 0 : 1;
    for (const [id, edit] of this.changed) {
      const original = this.classes.get(id);
      if (edit.colour) {
        fromHex(edit.colour).forEach((x, c) => (texels[id * 4 + c] = Math.min(x / Math.max(original.albedo[c], 1e-3), 1e3)));
      }
      if (edit.roughness != null) texels[id * 4 + 3] = edit.roughness - original.roughness;
    }
    return texels;
  }

  lampsChanged() {
    return this.lamps.some((l) => l.gain !== 1);
  }

  // The lamps' shares of the light are traced by the server when they are first needed.
  async loadShares() {
    this.loading ??= Promise.all([json('/api/lamps.json'), bytes('/data/lamps.bin')]).then(([about, buffer]) => {
      this.shares = { ...about, planes: new Uint8Array(buffer) };
    });
    return this.loading;
  }

  // Factor on the irradiance of every texel, divided by MAX_GAIN, in sRGB. See src/view/lamps.rs for the formula.
  lightTexels() {
    if (!this.shares || !this.lampsChanged()) {
      const one = Math.round(255 * encode(1 / MAX_GAIN));
      return { width: 1, height: 1, texels: new Uint8Array([one, one, one, 255]) };
    }
    const { width, height, bounce, planes } = this.shares;
    const count = width * height;
    const direct = new Float32Array(count);
    const gained = new Float32Array(count);
    let indirect = 0;
    this.lamps.forEach((lamp, l) => {
      indirect += (lamp.gain - 1) * bounce[l];
      for (let i = 0, p = l * count; i < count; i++, p++) {
        const share = (planes[p] / 255) ** 2;
        direct[i] += share;
        gained[i] += (lamp.gain - 1) * share;
      }
    });
    const code = new Uint8Array(4097).map((_, i) => Math.round(255 * encode(i / 4096)));
    const texels = new Uint8Array(count * 4).fill(255);
    for (let i = 0; i < count; i++) {
      const factor = 1 + gained[i] + Math.max(1 - direct[i], 0) * indirect;
      const value = code[Math.round((Math.min(Math.max(factor, 0), MAX_GAIN) / MAX_GAIN) * 4096)];
      texels[i * 4] = texels[i * 4 + 1] = texels[i * 4 + 2] = value;
    }
    return { width, height, texels };
  }
}
