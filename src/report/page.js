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
