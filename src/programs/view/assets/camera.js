// The eye: where it is, where it looks, and the matrices that follow. y is up; yaw 0 looks down -z.

const LIMIT = Math.PI / 2 - 0.001;

export class Camera {
  constructor(size) {
    this.size = size; // diagonal of the scene, metres
    this.position = [0, 0, 0];
    this.yaw = 0;
    this.pitch = 0;
    this.fov = 75; // degrees along the longer side of the window
    this.aspect = 1;
    this.shift = [0, 0]; // of the picture within its window of [-1, 1]: parts of a pixel, while samples are added up
  }

  forward() {
    const c = Math.cos(this.pitch);
    return [Math.sin(this.yaw) * c, Math.sin(this.pitch), -Math.cos(this.yaw) * c];
  }

  right() {
    return [Math.cos(this.yaw), 0, Math.sin(this.yaw)];
  }

  up() {
    const s = Math.sin(this.pitch);
    return [-Math.sin(this.yaw) * s, Math.cos(this.pitch), Math.cos(this.yaw) * s];
  }

  turn(dYaw, dPitch) {
    this.yaw = (this.yaw + dYaw) % (2 * Math.PI);
    this.pitch = Math.min(Math.max(this.pitch + dPitch, -LIMIT), LIMIT);
  }

  lookAlong(direction) {
    const length = Math.hypot(...direction) || 1;
    this.pitch = Math.min(Math.max(Math.asin(direction[1] / length), -LIMIT), LIMIT);
    if (Math.hypot(direction[0], direction[2]) > 1e-6 * length) this.yaw = Math.atan2(direction[0], -direction[2]);
  }

  move(forward, right, up) {
    const [f, r] = [this.forward(), this.right()];
    this.position = this.position.map((p, i) => p + f[i] * forward + r[i] * right + (i === 1 ? up : 0));
  }

  // Half the window's size at distance 1, across and down.
  extent() {
    const long = Math.tan((this.fov * Math.PI) / 360);
    return this.aspect >= 1 ? [long, long / this.aspect] : [long * this.aspect, long];
  }

  // Direction through a point of the window in [-1, 1].
  ray(x, y) {
    const [f, r, u, [w, h]] = [this.forward(), this.right(), this.up(), this.extent()];
    const d = f.map((v, i) => v + r[i] * x * w + u[i] * y * h);
    const length = Math.hypot(...d);
    return d.map((v) => v / length);
  }

  // Column-major clip_from_world; `pixel` = [x, y, widthInPixels, heightInPixels] enlarges one pixel to the whole target.
  clipFromWorld(pixel) {
    const [f, r, u, [w, h]] = [this.forward(), this.right(), this.up(), this.extent()];
    const [near, far] = [this.size * 4e-4, this.size * 6];
    const p = this.position;
    const dot = (a) => a[0] * p[0] + a[1] * p[1] + a[2] * p[2];
    const rows = [
      [...r.map((v) => v / w), -dot(r) / w],
      [...u.map((v) => v / h), -dot(u) / h],
      [...f.map((v) => (v * (far + near)) / (far - near)), (-dot(f) * (far + near) - 2 * far * near) / (far - near)],
      [...f, -dot(f)],
    ];
    for (const i of [0, 1]) rows[i] = rows[i].map((v, j) => v + this.shift[i] * rows[3][j]);
    if (pixel) {
      const [x, y, columns, lines] = pixel;
      rows[0] = rows[0].map((v, i) => (v - x * rows[3][i]) * columns);
      rows[1] = rows[1].map((v, i) => (v - y * rows[3][i]) * lines);
    }
    const out = new Float32Array(16);
    rows.forEach((row, i) => row.forEach((v, j) => (out[j * 4 + i] = v)));
    return out;
  }

  // World points on the far side from clip coordinates (z = 1, w = 1), column-major: enough for the background.
  worldFromClip() {
    const [f, r, u, [w, h]] = [this.forward(), this.right(), this.up(), this.extent()];
    const far = this.size * 6;
    const p = this.position;
    const column = (v, s) => [v[0] * s * far, v[1] * s * far, v[2] * s * far, 0];
    const middle = f.map((v, i) => v - r[i] * w * this.shift[0] - u[i] * h * this.shift[1]);
    return new Float32Array([...column(r, w), ...column(u, h), ...column(middle, 1), ...p, 1]);
  }
}
