// What the user changed: materials per class, and the lamps. Nothing is written back to the reconstruction.

export const linear = (c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);

export const fromHex = (hex) => [1, 3, 5].map((i) => linear(parseInt(hex.slice(i, i + 2), 16) / 255));

// A factor as the server reads it: plain digits.
const decimal = (x) => String(Number(Math.max(x, 0).toFixed(5)));
const triple = (v) => v.map(decimal).join('_');
const WHITE = '#ffffff';

export class Edits {
  constructor(scene) {
    this.classes = new Map(scene.classes.map((c) => [c.id, c]));
    this.changed = new Map(); // class id -> { colour: '#rrggbb' | null, roughness: number | null }
    const largest = Math.max(...this.classes.keys(), 255);
    this.rows = (largest >> 8) + 1;
    this.lamps = scene.lamps.map((lamp) => ({ ...lamp, on: true, gain: 1, colour: WHITE }));
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

  // Factor per channel on a lamp's light.
  lampFactor(lamp) {
    return fromHex(lamp.colour).map((c) => (lamp.on ? c * lamp.gain : 0));
  }

  resetLamps() {
    for (const lamp of this.lamps) Object.assign(lamp, { on: true, gain: 1, colour: WHITE });
  }

  // The edit as the light operator is asked for it.
  lightQuery() {
    const table = this.table();
    const classes = [...this.changed].filter(([, edit]) => edit.colour).map(([id]) => `${id}_${triple([0, 1, 2].map((c) => table[id * 4 + c]))}`);
    return `lights=${this.lamps.map((lamp) => triple(this.lampFactor(lamp))).join('-')}&classes=${classes.join('-')}`;
  }

  // The lamps' changes as a lighting file of `unbake relight --lights`.
  lightsToml() {
    const lines = [];
    for (const lamp of this.lamps) {
      const colour = fromHex(lamp.colour);
      const change = [];
      if (!lamp.on) change.push('off = true');
      else {
        if (lamp.gain !== 1) change.push(`scale = ${decimal(lamp.gain)}`);
        if (lamp.colour !== WHITE) change.push(`colour = [${colour.map(decimal).join(', ')}]`);
      }
      if (!change.length) continue;
      const heads = lamp.outside ? ['[environment]'] : lamp.ids.map((id) => `[[lamp]]\ngroup = ${id}`);
      for (const head of heads) lines.push([head, ...change].join('\n'));
    }
    return lines.join('\n\n');
  }
}
