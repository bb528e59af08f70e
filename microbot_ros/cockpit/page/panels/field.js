// The field at the workspace centre: wanted, applied, measured, as numbers and as arrows.

import { byId, make, makeSvg, setText } from '../dom.js';
import { fixed, known } from '../numbers.js';
import { arrow } from '../picture/overlay.js';

const KINDS = { wanted: 'wanted_mT', applied: 'applied_mT', measured: 'measured_mT' };
const RADIUS = 88;
// Full scale of the dial [mT]: the first that holds the longest arrow.
const SCALES = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];

export function fieldPanel(link) {
  const rows = Object.fromEntries(Object.keys(KINDS).map((kind) => [kind,
    make('tr', { class: kind }, make('th', { scope: 'row' }, kind), ...[0, 1, 2, 3].map(() => make('td')))]));
  byId('field-table').tBodies[0].append(...Object.values(rows));
  const arrows = Object.fromEntries(Object.keys(KINDS).map((kind) => [kind, makeSvg('path', { class: kind })]));
  const scale = makeSvg('text', { x: 0, y: 106, 'text-anchor': 'middle' });
  byId('dial').append(makeSvg('circle', { r: RADIUS }), makeSvg('circle', { r: RADIUS / 2 }),
    makeSvg('path', { d: `M0 ${-RADIUS}V${RADIUS}M${-RADIUS} 0H${RADIUS}`, class: 'axes' }),
    arrows.applied, arrows.wanted, arrows.measured, scale);
  link.on('state', ({ field, currents_a }) => {
    show(field ?? {}, rows, arrows, scale);
    setText(byId('currents'), currents_a?.length
      ? `Coil currents: ${currents_a.map((one) => fixed(one, 3)).join(', ')} A` : 'No coil currents received yet.');
  });
}

function show(field, rows, arrows, scale) {
  const vectors = Object.entries(KINDS).map(([kind, key]) => [kind, valid(field[key])]);
  const most = Math.max(...vectors.map(([, vector]) => (vector ? Math.hypot(...vector) : 0)));
  const full = SCALES.find((one) => one >= most) ?? most;
  for (const [kind, vector] of vectors) {
    const cells = rows[kind].querySelectorAll('td');
    const shown = vector
      ? [...vector.map((one) => fixed(one, 2)), fixed(Math.hypot(...vector), 2), direction(vector)]
      : ['–', '–', '–', '–'];
    shown.forEach((text, index) => setText(cells[index], text));
    arrows[kind].setAttribute('d', vector && Math.hypot(...vector) > 0.005 * full
      ? arrow(0, 0, vector[0] / full * RADIUS, -vector[1] / full * RADIUS) : '');
  }
  setText(scale, `outer ring ${full} mT`);
  const said = vectors.map(([kind, vector]) => (vector
    ? `${kind} ${fixed(Math.hypot(...vector), 2)} mT at ${direction(vector)}°` : `${kind} not known`));
  byId('dial').setAttribute('aria-label', `Field: ${said.join(', ')}`);
}

const valid = (vector) => (vector?.slice(0, 2).every(known) ? vector.slice(0, 2) : null);

function direction([x, y]) {
  return Math.hypot(x, y) < 1e-6 ? '–' : fixed(Math.atan2(y, x) * 180 / Math.PI, 1);
}
