// The panel's fixed parts: tabs, layer buttons, camera list, material and lamp controls, theme. State lives in main.js.

import { LAYERS } from './layers.js';

export const $ = (selector) => document.querySelector(selector);

// Tabs after the usual pattern: one is in the focus order, arrow keys change between them.
export function tabs() {
  const all = [...document.querySelectorAll('[role=tab]')];
  const choose = (tab, focus) => {
    for (const t of all) {
      const on = t === tab;
      t.setAttribute('aria-selected', on);
      t.tabIndex = on ? 0 : -1;
      $('#' + t.getAttribute('aria-controls')).hidden = !on;
    }
    $('#panel').classList.remove('folded');
    $('#fold').setAttribute('aria-expanded', 'true');
    if (focus) tab.focus();
    tab.dispatchEvent(new CustomEvent('chosen'));
  };
  all.forEach((tab, i) => {
    tab.addEventListener('click', () => choose(tab));
    tab.addEventListener('keydown', (e) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[e.key];
      if (step) choose(all[(i + step + all.length) % all.length], true);
    });
  });
  $('#fold').addEventListener('click', () => {
    const folded = $('#panel').classList.toggle('folded');
    $('#fold').setAttribute('aria-expanded', String(!folded));
  });
  return (id, focus) => choose($('#' + id), focus);
}

export function layerButtons(hasCameras, choose) {
  const box = $('#layers');
  for (const layer of LAYERS) {
    if (layer.needsCamera && !hasCameras) continue;
    const label = document.createElement('label');
    const input = Object.assign(document.createElement('input'), { type: 'radio', name: 'layer', value: layer.id });
    input.addEventListener('change', () => choose(layer.id));
    const text = Object.assign(document.createElement('span'), { textContent: layer.name });
    const key = Object.assign(document.createElement('kbd'), { textContent: layer.key.toUpperCase() });
    key.setAttribute('aria-hidden', 'true');
    text.append(key);
    label.append(input, text);
    box.append(label);
  }
}

export function showLayer(layer) {
  const input = $(`#layers input[value="${layer.id}"]`);
  if (input) input.checked = true;
  $('#about').textContent = layer.about;
  const legend = $('#legend');
  legend.hidden = !layer.legend;
  if (layer.legend) {
    $('#legend-bar').style.background = `linear-gradient(90deg, ${layer.legend.colours.join(', ')})`;
    $('#legend-from').textContent = layer.legend.from;
    $('#legend-to').textContent = layer.legend.to;
  }
}

export function cameraList(cameras, jump) {
  $('#cameras').hidden = !cameras.length;
  $('#no-cameras').hidden = Boolean(cameras.length);
  const select = $('#camera');
  cameras.forEach((c, i) => select.add(new Option(`${c.name}${c.held_out ? ' (held out)' : ''}`, i)));
  select.selectedIndex = -1;
  select.addEventListener('change', () => jump(Number(select.value)));
  const step = (d) => jump(((select.selectedIndex < 0 ? (d > 0 ? -1 : 0) : select.selectedIndex) + d + cameras.length) % cameras.length);
  $('#camera-before').addEventListener('click', () => step(-1));
  $('#camera-next').addEventListener('click', () => step(1));
  return step;
}

export function materialControls(edits, { changed, marked }) {
  const select = $('#class');
  for (const c of edits.classes.values()) select.add(new Option(`${c.name} (${(100 * c.share).toFixed(1)} %)`, c.id));
  const id = () => Number(select.value);
  const show = () => {
    if (!edits.classes.has(id())) return;
    const m = edits.material(id());
    $('#colour').value = m.colour;
    $('#rough').value = m.roughness;
    $('#rough-value').textContent = m.roughness.toFixed(2);
    $('#material-reset').disabled = !m.edited;
    marked($('#mark').checked ? id() : null);
  };
  select.addEventListener('change', show);
  $('#mark').addEventListener('change', show);
  const change = (what) => {
    edits.setMaterial(id(), what);
    show();
    changed();
  };
  $('#colour').addEventListener('input', () => change({ colour: $('#colour').value }));
  $('#rough').addEventListener('input', () => change({ roughness: Number($('#rough').value) }));
  $('#material-reset').addEventListener('click', () => {
    edits.resetMaterial(id());
    show();
    changed();
  });
  show();
  return (chosen) => {
    select.value = String(chosen);
    show();
  };
}

// A row per lamp: switch, brightness, colour filter.
export function lampControls(edits, changed) {
  const box = $('#lamps');
  if (!edits.lamps.length) box.textContent = 'Nothing in this scene emits light.';
  const made = (tag, attributes) => Object.assign(document.createElement(tag), attributes);
  const rows = edits.lamps.map((lamp, i) => {
    const row = made('div', { className: 'lamp' });
    const name = made('label', { className: 'check' });
    const on = made('input', { type: 'checkbox', id: `lamp-on-${i}` });
    name.append(on, made('span', { textContent: lamp.name }));
    const output = made('output');
    const colour = made('input', { type: 'color', id: `lamp-colour-${i}`, title: 'colour filter; white leaves the lamp’s own colour' });
    colour.setAttribute('aria-label', `${lamp.name}: colour filter`);
    const gain = made('input', { type: 'range', min: 0, max: 4, step: 0.05, id: `lamp-${i}` });
    gain.setAttribute('aria-label', `${lamp.name}: brightness`);
    output.htmlFor = gain.id;
    row.append(name, output, colour, gain);
    box.append(row);
    const show = () => {
      [on.checked, gain.value, colour.value, gain.disabled] = [lamp.on, lamp.gain, lamp.colour, !lamp.on];
      output.textContent = lamp.on ? `× ${lamp.gain.toFixed(2).replace(/\.?0+$/, '')}` : 'off';
    };
    const change = (what) => {
      Object.assign(lamp, what);
      show();
      changed();
    };
    on.addEventListener('change', () => change({ on: on.checked }));
    gain.addEventListener('input', () => change({ gain: Number(gain.value) }));
    colour.addEventListener('input', () => change({ colour: colour.value }));
    show();
    return show;
  });
  $('#lamps-reset').addEventListener('click', () => {
    edits.resetLamps();
    for (const show of rows) show();
    changed();
  });
}

// Auto follows the system; the choice is remembered by the browser.
export function theme(changed) {
  const order = ['auto', 'light', 'dark'];
  const remembered = () => {
    try { return localStorage.getItem('unbake-theme'); } catch { return null; }
  };
  let current = order.includes(remembered()) ? remembered() : 'auto';
  const apply = () => {
    if (current === 'auto') delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = current;
    $('#theme').textContent = `Theme: ${current}`;
    changed();
  };
  const next = () => {
    current = order[(order.indexOf(current) + 1) % order.length];
    try { localStorage.setItem('unbake-theme', current); } catch { /* private window: not remembered */ }
    apply();
  };
  $('#theme').addEventListener('click', next);
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', apply);
  apply();
  return next;
}
