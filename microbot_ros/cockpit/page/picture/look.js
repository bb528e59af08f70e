// How the picture is looked at, by everybody: zoom, contrast, layers, a scale bar, the cursor in µm.

import { byId, make, setText } from '../dom.js';
import { known } from '../numbers.js';

const LAYERS = ['rings', 'ids', 'headings', 'trails', 'goals', 'path', 'flow'];
const LENGTHS_UM = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000];
const LONGEST = 140;

export function lookPanel(link, view) {
  const stage = byId('stage');
  byId('layers').append(...LAYERS.map((name) => {
    const input = make('input', { type: 'checkbox', checked: '' });
    input.onchange = () => byId('overlay').classList.toggle(`without-${name}`, !input.checked);
    return make('label', { class: 'tick' }, input, name);
  }));
  byId('contrast').oninput = () => { byId('picture').style.filter = `contrast(${byId('contrast').value})`; };
  const about = (by) => {
    const box = stage.getBoundingClientRect();
    view.zoomTo(by * view.zoom, box.left + box.width / 2, box.top + box.height / 2);
  };
  byId('zoom-in').onclick = () => about(1.5);
  byId('zoom-out').onclick = () => about(1 / 1.5);
  byId('zoom-all').onclick = () => about(0);
  stage.addEventListener('wheel', (event) => {
    event.preventDefault();
    view.zoomTo(view.zoom * 1.2 ** -Math.sign(event.deltaY), event.clientX, event.clientY);
  }, { passive: false });
  stage.addEventListener('pointermove', ({ clientX, clientY }) => {
    const box = byId('frame').getBoundingClientRect();
    const place = view.toMicrometres(...view.toPixels(clientX - box.left, clientY - box.top));
    setText(byId('scale-cursor'), place ? `· ${place.map((one) => one.toFixed(1)).join(', ')} µm` : '');
  });
  stage.addEventListener('pointerleave', () => setText(byId('scale-cursor'), ''));
  let frames = '';
  link.on('state', ({ frames: now }) => {
    frames = [known(now?.rate_hz) && `${now.rate_hz.toFixed(0)} frames/s`, known(now?.exposure_ms) && `exposed ${now.exposure_ms} ms`]
      .filter(Boolean).map((one) => ` · ${one}`).join('');
  });
  setInterval(() => {
    byId('scale').hidden = !view.matrix;
    if (!view.matrix) return;
    const perUm = view.scale / Math.hypot(view.matrix[0][0], view.matrix[1][0]);
    const length = LENGTHS_UM.findLast((one) => one * perUm <= LONGEST) ?? LENGTHS_UM[0];
    byId('scale-bar').style.width = `${length * perUm}px`;
    setText(byId('scale-words'), `${length} µm${frames}`);
  }, 250);
}
