// Drives the page of `unbake view` in headless Chromium; called by scripts/check_view with the address and a folder for pictures.

import { createRequire } from 'node:module';
import path from 'node:path';

const [url, shots, modules] = process.argv.slice(2);
const { chromium } = createRequire(path.join(modules, 'x.js'))('playwright-core');
const flags = ['--no-sandbox', '--disable-quic', '--no-first-run', '--disable-background-networking', '--disable-component-update', '--disable-sync',
  '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist'];
const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium', args: flags });
let failures = 0;
const check = (what, good, more = '') => {
  console.log(`${good ? 'ok  ' : 'FAIL'} ${what}${good || !more ? '' : ': ' + more}`);
  failures += good ? 0 : 1;
};

async function open(options) {
  const context = await browser.newContext(options);
  const page = await context.newPage();
  page.setDefaultTimeout(60_000);
  const errors = [];
  page.on('pageerror', (e) => errors.push(String(e)));
  page.on('console', (m) => m.type() === 'error' && errors.push(m.text()));
  await page.goto(url);
  await page.waitForSelector('body[data-ready=yes]');
  await page.waitForTimeout(800);
  return { page, context, errors };
}

const shot = async (page, name) => page.screenshot({ path: path.join(shots, name + '.png') });
const status = (page) => page.textContent('#status');
// Mean and spread of the canvas as one sees it.
async function look(page) {
  const png = await page.locator('#canvas').screenshot();
  return page.evaluate(async (base64) => {
    const image = new Image();
    image.src = 'data:image/png;base64,' + base64;
    await image.decode();
    const c = Object.assign(document.createElement('canvas'), { width: 160, height: 100 });
    const g = c.getContext('2d');
    g.drawImage(image, 0, 0, 160, 100);
    const d = g.getImageData(0, 0, 160, 100).data;
    let [sum, squares] = [0, 0];
    for (let i = 0; i < d.length; i += 4) {
      const v = (d[i] + d[i + 1] + d[i + 2]) / 3;
      sum += v;
      squares += v * v;
    }
    const n = d.length / 4;
    return { mean: sum / n, spread: Math.sqrt(squares / n - (sum / n) ** 2) };
  }, png.toString('base64'));
}

const { page, errors } = await open({ viewport: { width: 1280, height: 800 }, colorScheme: 'dark' });
const cameras = await page.evaluate(() => document.querySelector('#camera').options.length);
check('the page loads and shows something', (await look(page)).spread > 10);
await shot(page, 'final');
const seen = new Map();
for (const layer of await page.$$eval('#layers input', (all) => all.map((i) => i.value))) {
  await page.locator(`#layers input[value="${layer}"]`).check({ force: true });
  await page.waitForSelector(`body[data-shown="${layer}"]`);
  await page.waitForTimeout(300);
  const state = await look(page);
  seen.set(layer, state.mean.toFixed(2));
  await shot(page, 'layer-' + layer);
}
check('every layer looks different', new Set(seen.values()).size >= seen.size - 1, JSON.stringify([...seen]));

// back to the final layer; a click reads the surface
await page.locator('#layers input[value="final"]').check({ force: true });
await page.locator('#canvas').click({ position: { x: 420, y: 520 } });
await page.waitForSelector('#point table');
const table = await page.textContent('#point table');
check('a click reads the values', /Albedo\s*\d/.test(table) && /Roughness\s*\d/.test(table), table);
if (cameras) check('evidence is listed', /Seen by [1-9]\d* of \d+ photographs/.test(await page.textContent('#point')));
await shot(page, 'point');

// a material
await page.click('#point > button');
const before = await look(page);
await page.fill('#colour', '#c03020');
await page.locator('#rough').fill('0.1');
await page.waitForTimeout(500);
const after = await look(page);
check('an edited material changes the picture', Math.abs(after.mean - before.mean) > 0.3, `${before.mean} ${after.mean}`);
await shot(page, 'material');
await page.click('#material-reset');

// lamps
await page.click('#tab-lamps');
if (await page.locator('#lamp-0').count()) {
  await page.waitForTimeout(300);
  const lit = await look(page);
  for (const slider of await page.locator('#lamps input[type=range]').all()) await slider.fill('0.2');
  await page.waitForFunction(() => document.querySelector('#pane-lamps .light-note').textContent.startsWith('Answered'), null, { timeout: 300_000 });
  await page.waitForTimeout(800);
  const dim = await look(page);
  check('dimmed lamps darken the picture', dim.mean < lit.mean - 5, `${lit.mean} ${dim.mean}`);
  await shot(page, 'lamps');
  await page.click('#lamps-reset');
}

// keyboard only
await page.click('#tab-view');
await page.focus('#canvas');
await page.keyboard.press('2');
await page.waitForTimeout(300);
check('number keys change the layer', await page.isChecked('#layers input[value="albedo"]'));
await page.keyboard.press('1');
await page.keyboard.press(']');
check('brackets change the exposure', (await page.textContent('#exposure-value')) === '+0.5 EV');
await page.keyboard.press('[');
const still = await page.locator('#canvas').screenshot();
await page.keyboard.down('w');
await page.waitForTimeout(700);
await page.keyboard.up('w');
await page.waitForTimeout(300);
check('W moves', !still.equals(await page.locator('#canvas').screenshot()));
await page.keyboard.press('Enter');
await page.waitForTimeout(1500);
check('Enter reads the middle', /albedo/.test(await status(page)) || /leaves the scene/.test(await status(page)), await status(page));
await page.keyboard.press('?');
check('? opens the help', await page.isVisible('#help'));
await shot(page, 'help');
await page.keyboard.press('Escape');
check('Escape closes it', !(await page.isVisible('#help')));
if (cameras) {
  await page.click('#tab-view');
  await page.focus('#canvas');
  await page.keyboard.press('n');
  await page.waitForTimeout(1500);
  await page.keyboard.press('c');
  await page.waitForTimeout(800);
  check('C compares with the photograph', await page.isVisible('#split'));
  await shot(page, 'compare');
  const photo = async (v) => { await page.fill('#split', v); await page.waitForTimeout(500); return look(page); };
  const [all, none] = [await photo('100'), await photo('0')];
  check('photograph and rendering are alike', Math.abs(all.mean - none.mean) < 12 && all.mean !== none.mean, `${all.mean} ${none.mean}`);
  await page.focus('#canvas');
  await page.keyboard.down('s');
  await page.waitForTimeout(400);
  await page.keyboard.up('s');
  check('moving away ends the comparison', !(await page.isVisible('#split')));
}
const order = [];
await page.focus('#canvas');
for (let i = 0; i < 8; i++) {
  await page.keyboard.press('Tab');
  order.push(await page.evaluate(() => document.activeElement.id || document.activeElement.name || document.activeElement.tagName));
}
check('Tab reaches the controls in order', order.includes('theme') && order.includes('tab-view') && order.includes('layer'), order.join(' '));
const nameless = await page.$$eval('button, input, select', (all) =>
  all.filter((e) => !(e.textContent.trim() || e.getAttribute('aria-label') || e.labels?.length)).map((e) => e.id));
check('every control has a name', nameless.length === 0, nameless.join(' '));
await page.click('#theme');
await page.waitForTimeout(400);
await shot(page, 'light');
check('no errors on the desktop page', errors.length === 0, errors.join('\n'));
await page.context().close(); // it would go on refining, and in software there is one renderer for all pages

// a small window at rest: reflections are traced, sample after sample
const small = await open({ viewport: { width: 560, height: 320 }, colorScheme: 'dark' });
await small.page.waitForSelector('body[data-traced]');
if ((await small.page.getAttribute('body', 'data-traced')) === 'yes') {
  const refined = () => small.page.waitForSelector('body[data-refined=yes]', { timeout: 300_000 });
  await refined();
  const traced = await look(small.page);
  check('the picture at rest is refined', traced.spread > 10, JSON.stringify(traced));
  await shot(small.page, 'refined');
  if (cameras) {
    await small.page.focus('#canvas');
    await small.page.keyboard.press('c');
    await small.page.fill('#split', '100');
    await refined();
    const photo = await look(small.page);
    check('refined and photographed are alike', Math.abs(photo.mean - traced.mean) < 12 && photo.mean !== traced.mean, `${photo.mean} ${traced.mean}`);
  }
}
check('no errors on the small page', small.errors.length === 0, small.errors.join('\n'));
await small.context.close();

const phone = await open({ viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true, deviceScaleFactor: 2, colorScheme: 'light' });
const wide = await phone.page.evaluate(() => document.documentElement.scrollWidth > innerWidth);
check('nothing sticks out on a phone', !wide);
check('the scene keeps half of a phone', await phone.page.evaluate(() => document.querySelector('#canvas').clientHeight > 0.45 * innerHeight));
await shot(phone.page, 'phone');
await phone.page.locator('#canvas').tap({ position: { x: 150, y: 300 } });
await phone.page.waitForSelector('#point table');
check('a tap reads the values', true);
await shot(phone.page, 'phone-point');
await phone.page.tap('#fold');
await phone.page.waitForTimeout(600);
await shot(phone.page, 'phone-folded');
check('no errors on the phone page', phone.errors.length === 0, phone.errors.join('\n'));
await browser.close();
process.exit(failures ? 1 : 0);
