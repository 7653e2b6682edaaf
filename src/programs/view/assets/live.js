// Changed light: asks the server's light operator, one request at a time and always for the newest edit.

import { bytes, json } from './load.js';

// The parts of an answer: 'UBLL', milliseconds, remainder, bounces, then a block of ratios ('UBTX', size, format) with its texels.
export function unpack(buffer) {
  const view = new DataView(buffer);
  if (buffer.byteLength < 32 || view.getUint32(0, false) !== 0x55424c4c) throw new Error('changed light arrived damaged');
  const [width, height] = [view.getUint32(20, true), view.getUint32(24, true)];
  return {
    milliseconds: view.getFloat32(4, true),
    remainder: view.getFloat32(8, true),
    bounces: view.getUint32(12, true),
    width,
    height,
    texels: new Uint32Array(buffer, 32, width * height),
  };
}

export class LiveLight {
  // `shown(answer)` is given each answer, `reflected(block)` the reflections once nothing has changed for a moment, `said(text)` what
  // there is to tell.
  constructor(edits, { shown, reflected, said }) {
    Object.assign(this, { edits, shown, reflected, said, wanted: false, running: false, about: null, timer: 0 });
  }

  // The edits have changed.
  async ask() {
    this.wanted = true;
    clearTimeout(this.timer);
    delete document.body.dataset.reflections;
    if (this.running) return;
    this.running = true;
    try {
      if (!this.about) {
        this.said('Tracing where light goes: once per result …');
        this.about = await json('/api/light.json');
      }
      while (this.wanted) {
        this.wanted = false;
        const asked = performance.now();
        const answer = unpack(await bytes('/data/light.bin?' + this.edits.lightQuery()));
        const arrived = performance.now();
        this.shown(answer);
        const [trip, update] = [arrived - asked, performance.now() - arrived];
        Object.assign(document.body.dataset, { answer: answer.milliseconds.toFixed(2), trip: trip.toFixed(2), update: update.toFixed(2), bounces: answer.bounces });
        this.said(`Answered in ${answer.milliseconds.toFixed(0)} ms${answer.bounces ? `, ${answer.bounces} bounces` : ''}. ${this.error()}`);
      }
    } catch (error) {
      this.said(error.message);
    } finally {
      this.running = false;
    }
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.reflect(), 150);
  }

  // Reflections follow when the edit rests: their panoramas are blurred anew.
  async reflect() {
    const query = this.edits.lightQuery();
    try {
      const block = await bytes('/data/probes.bin?' + query);
      if (query !== this.edits.lightQuery()) return;
      this.reflected(block);
      document.body.dataset.reflections = 'current';
    } catch (error) {
      this.said(error.message);
    }
  }

  error() {
    const { error, error_db, median_error } = this.about;
    return error > 0 ? `Irradiance of random edits lies within ${(100 * median_error).toFixed(1)} % of the path tracer’s at half of the surface, ${(100 * error).toFixed(1)} % RMS (${error_db.toFixed(0)} dB).` : '';
  }
}
