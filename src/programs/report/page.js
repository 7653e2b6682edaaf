// Comparison sliders, and a viewer that opens on a click and pages with the arrow keys.
for (const slider of document.querySelectorAll('.compare input')) {
  const move = () => slider.parentElement.style.setProperty('--cut', slider.value + '%');
  slider.addEventListener('input', move);
  move();
}
const viewer = document.querySelector('dialog');
const pictures = [...document.querySelectorAll('figure button')];
let current = 0;
const show = (index) => {
  current = (index + pictures.length) % pictures.length;
  const figure = pictures[current].closest('figure');
  viewer.querySelector('img').src = figure.querySelector('img').src;
  const heading = figure.closest('section')?.querySelector('h3, h2');
  const title = heading ? heading.firstChild.textContent.trim() + ': ' : '';
  viewer.querySelector('span').textContent = title + figure.querySelector('figcaption').textContent;
};
pictures.forEach((button, index) => button.addEventListener('click', () => { show(index); viewer.showModal(); }));
viewer.addEventListener('click', () => viewer.close());
viewer.addEventListener('keydown', (event) => {
  if (event.key === 'ArrowRight') show(current + 1);
  if (event.key === 'ArrowLeft') show(current - 1);
});
// A comparison can fill the window, and be magnified there; Escape or the button brings it back.
for (const compare of document.querySelectorAll('.compare')) {
  const bar = document.createElement('p');
  bar.className = 'zoom-bar';
  const button = (text, action) => {
    const made = Object.assign(document.createElement('button'), { type: 'button', textContent: text });
    made.addEventListener('click', action);
    bar.append(made);
    return made;
  };
  let zoom = 1;
  const magnify = (factor) => {
    zoom = Math.min(Math.max(factor, 1), 8);
    compare.style.setProperty('--zoom', zoom);
  };
  const frame = document.createElement('div');
  frame.className = 'zoom-frame';
  compare.before(frame);
  const scroll = Object.assign(document.createElement('div'), { className: 'zoom-scroll' });
  scroll.append(compare);
  frame.append(scroll, bar);
  const set = (on) => {
    frame.classList.toggle('open', on);
    open.textContent = on ? 'Close' : 'Enlarge';
    larger.hidden = smaller.hidden = !on;
    magnify(1);
    if (on) open.focus();
  };
  const open = button('Enlarge', () => set(!frame.classList.contains('open')));
  const larger = button('+', () => magnify(zoom * 2));
  const smaller = button('−', () => magnify(zoom / 2));
  larger.setAttribute('aria-label', 'magnify');
  smaller.setAttribute('aria-label', 'reduce');
  larger.hidden = smaller.hidden = true;
  frame.addEventListener('keydown', (event) => { if (event.key === 'Escape' && frame.classList.contains('open')) set(false); });
}
