// Measures live relighting in headless Chromium; called by scripts/check_live with the page's address, a folder for pictures, that of
// playwright-core, the result and its scene.

import { execFileSync } from 'node:child_process';
import { existsSync, readFileSync, writeFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import path from 'node:path';

const [url, work, modules, out, scene] = process.argv.slice(2);
const { chromium } = createRequire(path.join(modules, 'x.js'))('playwright-core');
const number = (name, usual) => Number(process.env[name] ?? usual);
const [width, views, bar, most] = [number('WIDTH', 320), number('VIEWS', 3), number('BAR', 32), number('MOST_MS', 50)];
const height = Math.round((width * 2) / 3);
const flags = ['--no-sandbox', '--disable-quic', '--no-first-run', '--disable-background-networking', '--disable-component-update', '--disable-sync',
  '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist'];
const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium', args: flags });
let failures = 0;
const check = (what, good, figure) => {
  console.log(`${good ? 'ok  ' : 'FAIL'} ${what}: ${figure}`);
  failures += good ? 0 : 1;
};
const median = (all) => [...all].sort((a, b) => a - b)[all.length >> 1];

const panel = 330; // the controls beside the picture
const errors = [];
async function open(options) {
  const context = await browser.newContext({ ...options, colorScheme: 'dark' });
  const page = await context.newPage();
  page.setDefaultTimeout(900_000);
  page.on('pageerror', (e) => errors.push(String(e)));
  page.on('console', (m) => m.type() === 'error' && errors.push(m.text()));
  if (process.env.ASSETS) await page.route('**/assets/*', (r) => r.fulfill({ path: path.join(process.env.ASSETS, path.basename(r.request().url())) }));
  await page.goto(url);
  await page.waitForSelector('body[data-ready=yes][data-traced]');
  return page;
}
// twice the reference's size, which the pictures are reduced to: as the path tracer's pixels, they are means over their area
const page = await open({ viewport: { width: 2 * width + panel, height: 2 * height } });
const about = await page.evaluate(async () => (await fetch('/api/scene.json')).json());
const light = await page.evaluate(async () => (await fetch('/api/light.json')).json());
console.log(`operator: ${light.lights} lights, ${light.patches} patches, ${light.width}² map, ready after ${light.seconds.toFixed(1)} s; ` +
  `random edits within ${(100 * light.median_error).toFixed(1)} % of the path tracer's at half of the surface, ${(100 * light.error).toFixed(1)} % RMS (${light.error_db.toFixed(1)} dB)`);

// --- pictures against the path tracer -----------------------------------------------------------------------------------------------
const list = JSON.parse(readFileSync(path.join(scene, 'transforms.json')));
const stem = (f) => path.basename(f.file_path).replace(/\.[^.]*$/, '');
const held = about.cameras.filter((c) => c.held_out);
const step = Math.max(1, Math.floor(held.length / views));
const chosen = held.filter((_, i) => i % step === 0).slice(0, views).map((c) => c.name);
const focal = width / 2 / Math.tan((75 * Math.PI) / 360); // the page's angle of view
const frames = list.frames.filter((f) => chosen.includes(stem(f)));
const cameras = path.join(work, 'cameras.json');
writeFileSync(cameras, JSON.stringify({ camera_model: 'PINHOLE', w: width, h: height, fl_x: focal, frames: frames.map((f) => ({ file_path: `${stem(f)}.png`, transform_matrix: f.transform_matrix })) }));

const asked = () => page.evaluate(() => document.querySelector('#pane-lamps .light-note').textContent);
const settle = async () => {
  await page.waitForFunction(() => document.querySelector('#pane-lamps .light-note').textContent.startsWith('Answered') && document.body.dataset.reflections === 'current');
  await page.waitForTimeout(300);
};
async function lamp(index, { on, gain, colour }) {
  if (colour) await page.fill(`#lamp-colour-${index}`, colour);
  if (gain !== undefined) await page.fill(`#lamp-${index}`, String(gain));
  if (on !== undefined) await page.locator(`#lamp-on-${index}`).setChecked(on);
}
const lamps = about.lamps.map((l, i) => ({ ...l, i }));
const outside = lamps.find((l) => l.outside);
const indoor = lamps.filter((l) => !l.outside);
const lightings = {
  base: async () => {},
  evening: async () => {
    if (indoor.length) await lamp(indoor[0].i, { gain: 2, colour: '#ffdaaa' });
    if (outside) await lamp(outside.i, { on: false });
  },
  day: async () => {
    for (const l of indoor) await lamp(l.i, { on: false });
    if (outside) await lamp(outside.i, { gain: 3.6, colour: '#d5e6ff' });
  },
};

// PSNR of two PNG files at the second one's size, 8-bit sRGB.
const psnr = (a, b) => page.evaluate(async ([both, width, height]) => {
  const pixels = async (base64) => {
    const image = new Image();
    image.src = 'data:image/png;base64,' + base64;
    await image.decode();
    const c = Object.assign(document.createElement('canvas'), { width, height });
    const g = c.getContext('2d');
    g.imageSmoothingQuality = 'high';
    g.drawImage(image, 0, 0, width, height);
    return g.getImageData(0, 0, width, height).data;
  };
  const [x, y] = await Promise.all(both.map(pixels));
  let [sum, count] = [0, 0];
  for (let i = 0; i < x.length; i++) if (i % 4 !== 3) { sum += ((x[i] - y[i]) / 255) ** 2; count++; }
  return -10 * Math.log10(Math.max(sum / count, 1e-12));
}, [[a, b].map((f) => readFileSync(f).toString('base64')), width, height]);

await page.click('#tab-lamps');
for (const [name, change] of Object.entries(lightings)) {
  await page.click('#lamps-reset');
  await change();
  await settle();
  const toml = path.join(work, `${name}.toml`);
  const changes = await page.textContent('#toml');
  const known = process.env.KEEP && existsSync(toml) && readFileSync(toml, 'utf8') === changes;
  writeFileSync(toml, changes);
  const reference = path.join(work, name);
  const ev = about.exposure;
  if (!(known && frames.every((f) => existsSync(path.join(reference, `${stem(f)}.png`))))) execFileSync(process.env.UNBAKE, ['relight', out, '--cameras', cameras, '--lights', toml, '--exposure', String(ev), '--samples', String(number('SPP', 64)),
    '--max-samples', String(number('MAX_SPP', 256)), '--to', reference, '--no-exr', '--quiet'], { stdio: ['ignore', 'ignore', 'inherit'] });
  const scores = [];
  for (const view of frames.map(stem)) {
    await page.click('#tab-view');
    await page.selectOption('#camera', String(about.cameras.findIndex((c) => c.name === view)));
    await page.waitForTimeout(500);
    await page.waitForSelector('body[data-refined]');
    await page.evaluate(() => { for (const e of ['#status', '#pad', '#cross']) document.querySelector(e).hidden = true; });
    const ours = path.join(work, `${name}-${view}.png`);
    await page.locator('#canvas').screenshot({ path: ours });
    await page.evaluate(() => { document.querySelector('#status').hidden = false; });
    scores.push(await psnr(ours, path.join(reference, `${view}.png`)));
  }
  await page.click('#tab-lamps');
  const mean = scores.reduce((a, b) => a + b, 0) / scores.length;
  check(`${name}: PSNR against the path tracer`, mean >= bar, `mean ${mean.toFixed(2)} dB, worst ${Math.min(...scores).toFixed(2)} dB over ${scores.length} views`);
}

// --- times --------------------------------------------------------------------------------------------------------------------------
async function drag(name, selector, values) {
  const run = await page.evaluate(async ([selector, values]) => {
    const input = document.querySelector(selector);
    const times = { answer: [], trip: [], update: [] };
    let frames = 0;
    let running = true;
    const count = () => { frames++; if (running) requestAnimationFrame(count); };
    requestAnimationFrame(count);
    const begin = performance.now();
    for (const value of values) {
      input.value = value;
      input.dispatchEvent(new Event('input'));
      await new Promise((done) => setTimeout(done, 60));
      for (const key of Object.keys(times)) if (document.body.dataset[key]) times[key].push(Number(document.body.dataset[key]));
    }
    running = false;
    return { ...times, rate: (1000 * frames) / (performance.now() - begin) };
  }, [selector, values]);
  const answer = median(run.answer);
  check(`${name}: the server's answer`, answer < most, `median ${answer.toFixed(1)} ms, longest ${Math.max(...run.answer).toFixed(1)} ms`);
  console.log(`     with its way to the page ${median(run.trip).toFixed(1)} ms, texture and redraw order ${median(run.update).toFixed(2)} ms, ` +
    `${run.rate.toFixed(0)} frames a second while dragging (software rendering)`);
}
await page.click('#lamps-reset');
const steps = Array.from({ length: 40 }, (_, i) => i);
await drag('a lamp dimmed', '#lamp-0', steps.map((i) => 0.1 * i));
await page.click('#tab-material');
await drag('a class recoloured', '#colour', steps.map((i) => `#${(64 + 4 * i).toString(16)}60${(220 - 4 * i).toString(16)}`));
console.log(`     ${await asked()}`);

// --- legible and operable -----------------------------------------------------------------------------------------------------------
for (const [name, size] of [['wide', { width: 1400, height: 900 }], ['narrow', { width: 420, height: 880 }]]) {
  await page.setViewportSize(size);
  for (const tab of ['lamps', 'material']) {
    await page.click(`#tab-${tab}`);
    await page.waitForTimeout(800);
    await page.screenshot({ path: path.join(work, `${name}-${tab}.png`) });
    check(`${name} ${tab}: nothing sticks out`, await page.evaluate(() => document.documentElement.scrollWidth <= innerWidth && [...document.querySelectorAll('#panels section:not([hidden]) *')].every((e) => e.closest('#toml, select') || e.getBoundingClientRect().right <= innerWidth + 1)), `${size.width} px`);
  }
}
await page.click('#tab-lamps');
await page.focus('#lamp-on-0');
await page.keyboard.press('Space');
check('Space switches a lamp', !(await page.isChecked('#lamp-on-0')), 'off');
await page.keyboard.press('Space');
const reached = [];
for (let i = 0; i < 2; i++) {
  await page.keyboard.press('Tab');
  reached.push(await page.evaluate(() => document.activeElement.id));
}
check('Tab reaches colour and brightness', reached.includes('lamp-colour-0') && reached.includes('lamp-0'), reached.join(' '));
await page.click('#lamps-reset');
await page.focus('#lamp-0');
await page.keyboard.press('ArrowLeft');
check('arrow keys dim', (await page.inputValue('#lamp-0')) === '0.95', await page.inputValue('#lamp-0'));
check('no errors on the page', errors.length === 0, errors.join('\n') || 'none');
await browser.close();
process.exit(failures ? 1 : 0);
