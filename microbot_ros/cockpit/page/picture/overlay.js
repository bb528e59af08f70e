// What is drawn over the picture: learned terms, trails, path, goals, rings, the drawing hand.

import { byId, keyed, makeSvg, setText } from '../dom.js';
import { known } from '../numbers.js';

const RING = 11;
const HEADING = 24;
const ARROW = 26;
// Height of a name beside a ring, and width of a letter.
const LABEL = 36;
const LETTER = 9;
const NOTHING = { goals: [], path: [], driven: [], goal: null, learned: [] };

export class Overlay {
  constructor(view, tracks) {
    this.view = view;
    this.tracks = tracks;
    this.stamp = null;
    this.chosen = null;
    this.plan = NOTHING;
    this.layers = {};
    for (const name of ['learned', 'trails', 'path', 'way', 'goals', 'rings', 'sketch']) {
      this.layers[name] = makeSvg('g', { class: name });
      byId('overlay').append(this.layers[name]);
    }
    view.changed = () => this.redraw();
  }

  hear({ controller, discovery }) {
    this.plan = { goals: controller?.goals ?? [], path: controller?.path ?? [], driven: controller?.driven ?? [], goal: controller?.goal,
      learned: (discovery?.learned ?? []).flatMap(({ arrows }) => arrows ?? []) };
    this.#drawPlan();
  }

  // The particles of the picture of `stamp`.
  show(stamp) {
    this.stamp = stamp;
    this.#drawParticles();
  }

  choose(id) {
    this.chosen = id;
    this.#drawParticles();
  }

  // The line being drawn by hand and the crosshair, in camera pixels.
  sketch(points, crosshair) {
    const line = points.map(([x, y]) => this.view.toPage(x, y).join(' ')).join(' ');
    this.layers.sketch.replaceChildren(
      ...(line ? [makeSvg('polyline', { points: line, class: 'pencil' })] : []),
      ...(crosshair ? [cross(this.view.toPage(...crosshair))] : []));
  }

  redraw() {
    this.#drawPlan();
    this.#drawParticles();
  }

  // Particles on the page, nearest to a point first: [{particle, distance}].
  nearest(pageX, pageY) {
    return this.#shown().map((particle) => {
      const [x, y] = this.view.toPage(particle.x_px, particle.y_px);
      return { particle, distance: Math.hypot(x - pageX, y - pageY) };
    }).sort((a, b) => a.distance - b.distance);
  }

  #shown() {
    return this.stamp === null ? [] : this.tracks.at(this.stamp);
  }

  #drawParticles() {
    const particles = this.#shown();
    byId('overlay').dataset.stamp = this.stamp ?? '';
    keyed(this.layers.rings, particles, ({ id }) => id, ring, (node, particle) => {
      const [x, y] = this.view.toPage(particle.x_px, particle.y_px);
      node.setAttribute('transform', `translate(${x.toFixed(2)} ${y.toFixed(2)})`);
      node.classList.toggle('chosen', particle.id === this.chosen);
      this.#label(node.querySelector('text'), particle, x, y);
      const line = node.querySelector('.heading');
      line.toggleAttribute('hidden', !known(particle.heading_rad));
      if (!known(particle.heading_rad)) return;
      const [right, down] = this.view.heading(particle.heading_rad);
      line.setAttribute('d', `M${right * RING} ${down * RING}L${right * HEADING} ${down * HEADING}`);
    });
    this.#drawWay();
    const trails = particles.map(({ id }) => [id, this.tracks.trails.get(id) ?? []]);
    keyed(this.layers.trails, trails, ([id]) => id, () => makeSvg('polyline'), (node, [, trail]) => {
      node.setAttribute('points',
        trail.map(({ x, y }) => this.view.toPage(x, y).map((v) => v.toFixed(1)).join()).join(' '));
    });
  }

  // Beside a ring at x, y, up and to the right; on the other side where the picture ends.
  #label(text, { id, kind }, x, y) {
    setText(text, kind ? `${id} ${kind}` : String(id));
    const left = x + RING + LETTER * text.textContent.length > this.view.width * this.view.scale;
    text.setAttribute('text-anchor', left ? 'end' : 'start');
    text.setAttribute('x', left ? -RING - 3 : RING + 3);
    text.setAttribute('y', y < LABEL ? RING + 9 : -RING + 2);
  }

  #drawPlan() {
    const { goals, path, learned } = this.view.matrix ? this.plan : NOTHING;
    this.layers.path.replaceChildren(makeSvg('polyline', {
      points: path.map(([x, y]) => this.view.micrometresToPage(x, y).join(' ')).join(' ') }));
    keyed(this.layers.goals, goals.map((goal, index) => ({ index, ...goal })),
      ({ index }) => index, goalMark, (node, { index, x_um, y_um, id }) => {
        const [x, y] = this.view.micrometresToPage(x_um, y_um);
        node.setAttribute('transform', `translate(${x.toFixed(2)} ${y.toFixed(2)})`);
        setText(node.querySelector('text'), id != null && id >= 0 ? `goal of ${id}` : `goal ${index + 1}`);
      });
    this.#drawWay();
    this.layers.learned.replaceChildren(...this.#arrows(learned));
  }

  // From each driven particle to its goal: its own, else that at work, else that of its rank; or to the nearest point of the path.
  #drawWay() {
    const { goals, path, driven, goal: present } = this.plan;
    const lines = !this.view.matrix ? [] : this.#shown().filter(({ id }) => driven.includes(id)).flatMap((one) => {
      const [x, y] = this.view.toPage(one.x_px, one.y_px);
      const goal = goals.find(({ id }) => id === one.id) ?? goals.filter(({ id }) => id == null || id < 0)[present ?? driven.indexOf(one.id)];
      const ends = (goal ? [[goal.x_um, goal.y_um]] : path).map((end) => this.view.micrometresToPage(...end));
      const to = ends.reduce((best, end) => (!best || Math.hypot(end[0] - x, end[1] - y) < Math.hypot(best[0] - x, best[1] - y) ? end : best), null);
      return to ? [makeSvg('path', { d: `M${x} ${y}L${to[0]} ${to[1]}` })] : [];
    });
    this.layers.way.replaceChildren(...lines);
  }

  // The longest arrow is `ARROW` points long; the others in proportion.
  #arrows(learned) {
    const most = Math.max(...learned.map(([, , vx, vy]) => Math.hypot(vx, vy)), 1e-12);
    return learned.map(([x, y, vx, vy]) => {
      const [fromX, fromY] = this.view.micrometresToPage(x, y);
      const [right, down] = this.view.heading(Math.atan2(vy, vx));
      const length = ARROW * Math.hypot(vx, vy) / most;
      return makeSvg('path', { d: arrow(fromX, fromY, right * length, down * length) });
    });
  }
}

function ring({ id }) {
  return makeSvg('g', { 'data-id': id }, makeSvg('circle', { r: RING, class: 'halo' }),
    makeSvg('path', { class: 'heading' }), makeSvg('circle', { r: RING, class: 'ring' }),
    makeSvg('text'));
}

function goalMark() {
  const shape = 'M-9 0H9M0-9V9M-6-6L6 6M-6 6L6-6';
  return makeSvg('g', {}, makeSvg('path', { d: shape, class: 'halo' }),
    makeSvg('path', { d: shape, class: 'mark' }), makeSvg('text', { x: 13, y: 5 }));
}

function cross([x, y]) {
  return makeSvg('path', { class: 'crosshair',
    d: `M${x - 16} ${y}h12M${x + 4} ${y}h12M${x} ${y - 16}v12M${x} ${y + 4}v12` });
}

export function arrow(x, y, right, down) {
  const [tipX, tipY] = [x + right, y + down];
  const barb = (turn) => {
    const [c, s] = [Math.cos(turn), Math.sin(turn)];
    return `M${tipX} ${tipY}l${0.3 * (right * c - down * s)} ${0.3 * (right * s + down * c)}`;
  };
  return `M${x} ${y}L${tipX} ${tipY}${barb(2.6)}${barb(-2.6)}`;
}
