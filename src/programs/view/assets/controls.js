// Mouse, touch and keyboard: how the eye moves. Says when something changed, was clicked, or moved away from its place.

export class Controls {
  constructor(canvas, camera, { changed, moved, clicked }) {
    Object.assign(this, { canvas, camera, changed, moved, clicked });
    this.keys = new Set();
    this.pointers = new Map();
    this.orbit = null; // the point circled round, or null
    this.speed = camera.size / 7;
    canvas.addEventListener('pointerdown', (e) => this.down(e));
    canvas.addEventListener('pointermove', (e) => this.drag(e));
    canvas.addEventListener('pointerup', (e) => this.up(e));
    canvas.addEventListener('pointercancel', (e) => this.pointers.delete(e.pointerId));
    canvas.addEventListener('contextmenu', (e) => e.preventDefault());
    canvas.addEventListener('wheel', (e) => this.wheel(e), { passive: false });
    canvas.addEventListener('keydown', (e) => this.key(e, true));
    canvas.addEventListener('keyup', (e) => this.key(e, false));
    canvas.addEventListener('blur', () => this.keys.clear());
  }

  down(e) {
    this.canvas.focus({ preventScroll: true });
    this.canvas.setPointerCapture?.(e.pointerId);
    this.pointers.set(e.pointerId, { x: e.clientX, y: e.clientY, startX: e.clientX, startY: e.clientY, time: e.timeStamp });
    if (this.pointers.size > 1) this.gesture = true;
    else this.gesture = false;
  }

  drag(e) {
    const p = this.pointers.get(e.pointerId);
    if (!p) return;
    const [dx, dy] = [e.clientX - p.x, e.clientY - p.y];
    const spread = () => {
      const [a, b] = [...this.pointers.values()];
      return Math.hypot(a.x - b.x, a.y - b.y);
    };
    if (this.pointers.size === 2) {
      const before = spread();
      Object.assign(p, { x: e.clientX, y: e.clientY });
      const step = this.speed * 0.004;
      this.travel((spread() - before) * step, -dx * step * 0.5, dy * step * 0.5);
      return;
    }
    Object.assign(p, { x: e.clientX, y: e.clientY });
    if (e.buttons & 6) return this.travel(0, -dx * this.speed * 0.003, dy * this.speed * 0.003);
    const [w, h] = this.camera.extent();
    const angle = (2 * Math.atan(Math.max(w, h))) / Math.max(this.canvas.clientWidth, this.canvas.clientHeight);
    this.turn(-dx * angle, dy * angle);
  }

  up(e) {
    const p = this.pointers.get(e.pointerId);
    this.pointers.delete(e.pointerId);
    if (!p || this.gesture || e.button !== 0) return;
    if (Math.hypot(e.clientX - p.startX, e.clientY - p.startY) < 6 && e.timeStamp - p.time < 600) {
      const box = this.canvas.getBoundingClientRect();
      this.clicked(((e.clientX - box.left) / box.width) * 2 - 1, 1 - ((e.clientY - box.top) / box.height) * 2);
    }
  }

  wheel(e) {
    e.preventDefault();
    const step = Math.max(-3, Math.min(3, e.deltaY / 60));
    if (e.ctrlKey || e.shiftKey) {
      this.camera.fov = Math.max(15, Math.min(110, this.camera.fov + step * 3));
      this.changed();
    } else this.travel(-step * this.speed * 0.12, 0, 0);
  }

  key(e, pressed) {
    if (e.ctrlKey || e.metaKey || e.altKey) return;
    const code = e.code;
    if (!/^(Key[WASDQE]|Arrow(Up|Down|Left|Right)|Page(Up|Down))$/.test(code)) return;
    e.preventDefault();
    this.fast = e.shiftKey;
    if (pressed) {
      if (!this.keys.size) this.last = null;
      this.keys.add(code);
      this.changed();
    } else this.keys.delete(code);
  }

  // Moves for the keys held; returns whether any is.
  tick(now) {
    if (!this.keys.size) return false;
    const dt = Math.min((now - (this.last ?? now - 16)) / 1000, 0.1);
    this.last = now;
    const held = (...codes) => (codes.some((c) => this.keys.has(c)) ? 1 : 0);
    const step = this.speed * dt * (this.fast ? 3 : 1);
    const forward = held('KeyW', 'ArrowUp') - held('KeyS', 'ArrowDown');
    const side = held('KeyD') - held('KeyA');
    const up = held('KeyE', 'PageUp') - held('KeyQ', 'PageDown');
    const turn = held('ArrowRight') - held('ArrowLeft');
    if (turn) this.turn(turn * dt * 1.5, 0);
    if (forward || side || up) this.travel(forward * step, side * step, up * step);
    return true;
  }

  press(code, pressed) {
    if (pressed) {
      this.last = null;
      this.keys.add(code);
      this.changed();
    } else this.keys.delete(code);
  }

  turn(dYaw, dPitch) {
    const { camera, orbit } = this;
    if (orbit) {
      const distance = Math.hypot(...camera.position.map((p, i) => p - orbit[i]));
      camera.turn(dYaw, dPitch);
      const f = camera.forward();
      camera.position = orbit.map((o, i) => o - f[i] * distance);
      this.moved();
    } else camera.turn(dYaw, dPitch);
    this.changed();
  }

  travel(forward, side, up) {
    this.camera.move(forward, side, up);
    if (forward || side || up) this.moved();
    this.changed();
  }
}
