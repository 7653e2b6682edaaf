// What is known about the clicked point, as a table.

const number = (x) => (x === 0 ? '0' : Math.abs(x) >= 1e4 || Math.abs(x) < 1e-3 ? x.toExponential(2) : x.toPrecision(3));
const triple = (v) => v.map(number).join('  ');
const luminance = (v) => 0.2126 * v[0] + 0.7152 * v[1] + 0.0722 * v[2];
const error = (e) => (e == null ? 'not observed' : '± ' + number(e));

function element(tag, text, attributes = {}) {
  const made = document.createElement(tag);
  if (text != null) made.textContent = text;
  for (const [k, v] of Object.entries(attributes)) made.setAttribute(k, v);
  return made;
}

export function showPoint(target, values, { jump, edit }) {
  target.replaceChildren();
  target.append(element('h2', values.class));
  target.append(element('p', `room ${values.room}`, { class: 'soft' }));
  const table = element('table', null, { class: 'values' });
  const row = (name, value, note, swatch) => {
    const tr = element('tr');
    tr.append(element('th', name, { scope: 'row' }));
    const td = element('td');
    if (swatch) {
      const s = element('span', null, { class: 'swatch' });
      s.style.background = swatch;
      td.append(s);
    }
    td.append(element('span', value));
    if (note) td.append(element('small', note));
    tr.append(td);
    table.append(tr);
  };
  row('Albedo', triple(values.albedo), error(values.albedo_error), values.albedo_srgb);
  row('Roughness', number(values.roughness), error(values.roughness_error));
  if (values.metallic > 0) row('Metal', number(values.metallic), 'share');
  if (values.transmission > 0) row('Transmission', number(values.transmission), 'share');
  row('Irradiance', triple(values.irradiance));
  row('Radiance seen', triple(values.radiance));
  row('Diffuse part', triple(values.diffuse), 'albedo × irradiance / π');
  if (values.emission.some((x) => x > 0)) row('Emission', triple(values.emission));
  target.append(table);
  const change = element('button', `Change ${values.class} …`, { type: 'button' });
  change.addEventListener('click', () => edit(values.label));
  target.append(change);
  const o = values.observations;
  if (!o) {
    target.append(element('p', 'Start with --scene to see which photographs show this point.', { class: 'soft' }));
    return;
  }
  target.append(element('h3', `Seen by ${o.seeing} of ${o.views} photographs`));
  const list = element('table', null, { class: 'values' });
  const head = element('tr');
  for (const t of ['view', 'distance', 'luminance']) head.append(element('th', t, { scope: 'col' }));
  list.append(head);
  for (const v of o.nearest) {
    const tr = element('tr');
    const cell = element('td');
    const go = element('button', v.stem, { type: 'button', title: 'go to this camera' });
    go.addEventListener('click', () => jump(v.camera));
    cell.append(go);
    if (v.held_out) cell.append(element('small', 'held out'));
    tr.append(cell, element('td', `${number(v.distance)} m`), element('td', v.radiance ? number(luminance(v.radiance)) : '–'));
    list.append(tr);
  }
  target.append(list);
  const ours = element('p', `This model’s diffuse part: ${number(luminance(values.diffuse))}`, { class: 'soft' });
  target.append(ours);
}
