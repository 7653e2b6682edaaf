// Puts the page together: loads the scene, holds what is shown, and redraws when something changed.

import { Camera } from './camera.js';
import { Controls } from './controls.js';
import { Edits } from './edits.js';
import { LAYERS, layer } from './layers.js';
import { LiveLight } from './live.js';
import { json } from './load.js';
import { $, cameraList, lampControls, layerButtons, materialControls, showLayer, tabs, theme } from './panel.js';
import { showPoint } from './readout.js';
import { Refinement } from './refinement.js';
import { Renderer } from './renderer.js';

// Milliseconds without a change after which the picture is refined.
const REST = 200;

const say = (text) => { $('#status').textContent = text; };
const fail = (error) => {
  $('#fault').hidden = false;
  $('#fault').textContent = error.message ?? String(error);
  $('#loading').hidden = true;
};

function backdrop() {
  const rgb = getComputedStyle(document.documentElement).getPropertyValue('--backdrop').trim();
  return [1, 3, 5].map((i) => parseInt(rgb.slice(i, i + 2), 16) / 255 || 0);
}

async function start() {
  const canvas = $('#canvas');
  const scene = await json('/api/scene.json');
  document.title = `${scene.name}: unbake`;
  $('#name').textContent = scene.name;
  const renderer = new Renderer(canvas, scene);
  const size = Math.hypot(...scene.high.map((h, i) => h - scene.low[i])) || 1;
  const camera = new Camera(size);
  const edits = new Edits(scene);
  const view = { layer: 'final', ev: 0, soft: false, marked: null, photo: null, split: 0, compare: false, lamps: edits.lamps.map(() => [1, 1, 1]), outside: [1, 1, 1], backdrop: backdrop() };

  let wanted = false;
  let traced = false; // reflections can be traced
  let rest = 0;
  const ended = (complete) => { document.body.dataset.refined = complete ? 'yes' : 'no'; };
  const refinement = new Refinement(canvas, (sample, band) => renderer.refine(camera, view, sample, band), ended);
  const frame = (now) => {
    wanted = false;
    const moving = controls.tick(now);
    camera.aspect = renderer.resize();
    renderer.draw(camera, view);
    document.body.dataset.shown = view.layer;
    if (moving) return redraw();
    const apt = traced && /^(final|error)$/.test(view.layer) && view.marked === null;
    rest = setTimeout(() => (apt ? refinement.start() : ended(false)), REST);
  };
  const redraw = () => {
    delete document.body.dataset.refined;
    refinement.stop();
    clearTimeout(rest);
    if (!wanted) requestAnimationFrame(frame);
    wanted = true;
  };

  // --- cameras and comparison -----------------------------------------------------------------------------------------------------
  let at = -1; // camera whose place we are in
  const compare = (on) => {
    view.compare = on && at >= 0;
    $('#compare').checked = view.compare;
    $('#split').hidden = $('#rule').hidden = !view.compare;
    const share = Number($('#split').value) / 100;
    view.split = view.compare ? share : 0;
    $('#rule').style.left = `${share * 100}%`;
    redraw();
  };
  const jump = async (index) => {
    const c = scene.cameras[index];
    if (!c) return;
    at = index;
    $('#camera').selectedIndex = index;
    controls.orbit = null;
    camera.position = [...c.position];
    camera.lookAlong(c.world_from_camera.slice(6, 9).map((x) => -x));
    view.photo = { index, ...c };
    redraw();
    say(`Camera ${c.name}: loading its photograph`);
    try {
      await renderer.photo(index);
      say(`Camera ${c.name}${c.held_out ? ', held out' : ''}`);
    } catch (error) {
      view.photo = null;
      say(error.message);
    }
    redraw();
  };
  const nearest = () => {
    const far = (c) => Math.hypot(...c.position.map((p, i) => p - camera.position[i]));
    return scene.cameras.reduce((best, c, i) => (best < 0 || far(c) < far(scene.cameras[best]) ? i : best), -1);
  };
  const moved = () => {
    if (at < 0) return;
    at = -1;
    $('#camera').selectedIndex = -1;
    view.photo = null;
    if (view.compare || view.layer === 'error') say('Left the camera’s place: the comparison ends.');
    compare(false);
    if (view.layer === 'error') chooseLayer('final');
  };
  const toggleCompare = async (on) => {
    if (on && at < 0) await jump(nearest());
    compare(on);
  };

  // --- layers ---------------------------------------------------------------------------------------------------------------------
  const chooseLayer = async (id) => {
    const chosen = layer(id);
    if (chosen.needsCamera && !scene.cameras.length) return say('The error needs photographs: start with --scene.');
    if (chosen.needsCamera && at < 0) await jump(nearest());
    try {
      await Promise.all(chosen.textures.map((t) => renderer.loadTexture(t)));
    } catch (error) {
      return say(error.message);
    }
    view.layer = id;
    showLayer(chosen);
    say(`${chosen.name}`);
    redraw();
  };

  // --- points ---------------------------------------------------------------------------------------------------------------------
  const pick = async (x, y) => {
    const hit = renderer.pick(camera, x, y);
    if (!hit) return say('Nothing there: this direction leaves the scene.');
    focus = hit.point;
    if (controls.orbit) controls.orbit = hit.point;
    try {
      const [px, py, pz] = hit.point;
      const values = await json(`/api/inspect.json?u=${hit.uv[0]}&v=${hit.uv[1]}&x=${px}&y=${py}&z=${pz}`);
      showPoint($('#point'), values, { jump, edit: (id) => { editClass(id); openTab('tab-material', true); } });
      openTab('tab-point');
      say(`${values.class}: albedo ${values.albedo.map((v) => v.toFixed(2)).join(' ')}, roughness ${values.roughness.toFixed(2)}`);
    } catch (error) {
      say(error.message);
    }
  };
  let focus = null;
  const controls = new Controls(canvas, camera, { changed: redraw, moved, clicked: pick });
  const toggleOrbit = () => {
    const centre = focus ?? renderer.pick(camera, 0, 0)?.point;
    controls.orbit = controls.orbit || !centre ? null : centre;
    if (controls.orbit) {
      camera.lookAlong(centre.map((c, i) => c - camera.position[i]));
      redraw();
    }
    $('#orbit').setAttribute('aria-pressed', String(Boolean(controls.orbit)));
    say(controls.orbit ? 'Circling the picked point' : 'Flying');
  };

  // --- panel ----------------------------------------------------------------------------------------------------------------------
  const openTab = tabs();
  layerButtons(scene.cameras.length > 0, chooseLayer);
  const stepCamera = cameraList(scene.cameras, jump);
  const live = new LiveLight(edits, {
    shown: (answer) => { renderer.setLight(answer); redraw(); },
    reflected: (block) => { renderer.setProbes(block); redraw(); },
    said: (text) => { for (const note of document.querySelectorAll('.light-note')) note.textContent = text; },
  });
  const editClass = materialControls(edits, {
    changed: () => { renderer.setEdits(edits); redraw(); live.ask(); },
    marked: (id) => { view.marked = id; redraw(); },
  });
  lampControls(edits, () => {
    edits.lamps.forEach((l, i) => { view.lamps[i] = l.outside ? [1, 1, 1] : edits.lampFactor(l); });
    const outside = edits.lamps.find((l) => l.outside);
    view.outside = outside ? edits.lampFactor(outside) : [1, 1, 1];
    $('#toml').textContent = edits.lightsToml();
    redraw();
    live.ask();
  });
  const nextTheme = theme(() => { view.backdrop = backdrop(); redraw(); });
  const setExposure = (ev) => {
    view.ev = Math.max(-8, Math.min(8, ev));
    $('#exposure').value = view.ev;
    $('#exposure-value').textContent = `${view.ev >= 0 ? '+' : ''}${view.ev.toFixed(1)} EV`;
    redraw();
  };
  $('#exposure').addEventListener('input', () => setExposure(Number($('#exposure').value)));
  $('#soft').addEventListener('change', () => { view.soft = $('#soft').checked; redraw(); });
  $('#compare').addEventListener('change', () => toggleCompare($('#compare').checked));
  $('#split').addEventListener('input', () => compare(true));
  $('#orbit').addEventListener('click', toggleOrbit);
  const help = $('#help');
  $('#help-open').addEventListener('click', () => help.showModal());
  $('#help-close').addEventListener('click', () => help.close());
  for (const button of document.querySelectorAll('#pad button')) {
    const code = button.dataset.code;
    button.addEventListener('pointerdown', () => controls.press(code, true));
    for (const end of ['pointerup', 'pointerleave', 'pointercancel']) button.addEventListener(end, () => controls.press(code, false));
  }

  // --- keys that work everywhere but in fields -------------------------------------------------------------------------------------
  const shortcuts = {
    '?': () => help.showModal(),
    '[': () => setExposure(view.ev - 0.5),
    ']': () => setExposure(view.ev + 0.5),
    n: () => scene.cameras.length && stepCamera(1),
    p: () => scene.cameras.length && stepCamera(-1),
    c: () => scene.cameras.length && toggleCompare(!view.compare),
    o: toggleOrbit,
    t: nextTheme,
  };
  for (const l of LAYERS) shortcuts[l.key] = () => chooseLayer(l.id);
  addEventListener('keydown', (e) => {
    if (e.ctrlKey || e.metaKey || e.altKey || help.open || /^(SELECT|TEXTAREA)$/.test(e.target.tagName)) return;
    if (e.target.tagName === 'INPUT' && !/^(radio|checkbox|range)$/.test(e.target.type)) return;
    const action = shortcuts[e.key.toLowerCase()];
    if (action) { e.preventDefault(); action(); }
    if (e.target === canvas && (e.key === 'Enter' || e.key === ' ')) { e.preventDefault(); pick(0, 0); }
  });
  addEventListener('resize', redraw);
  new ResizeObserver(redraw).observe(canvas);
  canvas.addEventListener('webglcontextlost', (e) => { e.preventDefault(); fail(new Error('The graphics card dropped this page: reload it.')); });

  // --- first view -----------------------------------------------------------------------------------------------------------------
  await renderer.loadScene((done, all) => { $('#progress').value = done / all; });
  renderer.setEdits(edits);
  $('#loading').hidden = true;
  showLayer(layer('final'));
  setExposure(0);
  if (scene.cameras.length) await jump(Math.max(scene.cameras.findIndex((c) => c.held_out), 0));
  else {
    const place = scene.probes.places[0]?.position ?? scene.low.map((l, i) => (l + scene.high[i]) / 2);
    camera.position = [...place];
    camera.lookAlong(scene.high.map((h, i) => (i === 1 ? 0 : (h + scene.low[i]) / 2 - place[i] || 1)));
  }
  redraw();
  document.body.dataset.ready = 'yes';
  // the first picture does not wait for what refines it
  traced = await renderer.loadRays();
  document.body.dataset.traced = traced ? 'yes' : 'no';
  redraw();
}

start().catch(fail);
