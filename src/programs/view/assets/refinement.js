// Refines a picture at rest, sample after sample, in bands of rows that a card can draw without holding up the page.

// Samples of a pixel: what the shader adds up fits half floats up to that many.
const SAMPLES = 64;
// Milliseconds between two bands beyond which they get narrower, and below which they get wider.
const [SLOW, FAST] = [150, 60];
// Pixels of the first band, before it is known how fast the card is, and rows of the narrowest.
const FIRST = 65536;
const LEAST_ROWS = 16;

export class Refinement {
  // `draw(sample, band)` adds a sample to a band, or says false; `done(complete)` is told the end.
  constructor(canvas, draw, done) {
    Object.assign(this, { canvas, draw, done, rows: 0, running: 0 });
  }

  // From the first sample.
  start() {
    Object.assign(this, { sample: 0, row: 0, last: null });
    this.rows ||= Math.max(Math.ceil(FIRST / this.canvas.width), LEAST_ROWS);
    const run = ++this.running;
    const step = (now) => run === this.running && this.step(now) && requestAnimationFrame(step);
    requestAnimationFrame(step);
  }

  stop() {
    this.running++;
  }

  // One band; whether another is to follow.
  step(now) {
    const { height } = this.canvas;
    if (this.last !== null) {
      if (now - this.last > SLOW) this.rows = Math.max(this.rows >> 1, LEAST_ROWS);
      else if (now - this.last < FAST) this.rows = Math.min(this.rows * 2, height);
    }
    this.last = now;
    const rows = Math.min(this.rows, height - this.row);
    if (!this.draw(this.sample, { row: this.row, rows })) {
      this.done(false);
      return false;
    }
    this.row += rows;
    if (this.row >= height) Object.assign(this, { row: 0, sample: this.sample + 1 });
    if (this.sample < SAMPLES) return true;
    this.done(true);
    return false;
  }
}
