// What a click, a stroke or a key on the picture does: choose, set a goal, draw a path, teach.

import { byId, make, setText, words } from '../dom.js';
import { order, say } from '../messages.js';

const MODES = {
  choose: ['Choose', 'Click a particle to see its estimates; the wheel zooms, dragging moves the picture. By keyboard: arrow keys move the cross, Shift in small steps, Enter clicks.'],
  goal: ['Goal', 'Click the goal. Its mark appears when the controller has accepted it.'],
  path: ['Path', 'Draw with the pointer held down: it is sent when you let go. Or click corner by corner (Backspace takes one back), then send.'],
  like: ['Teach: this', 'Click something the tracker should find from now on.'],
  unlike: ['Teach: not this', 'Click something the tracker should leave out from now on.'],
};
// What a controller must take for that, and one that does.
const NEEDS = { goal: ['goals', 'waypoint'], path: ['path', 'path_following'] };
const NEAR = 24;
// A stroke [points of the page]: from where a click becomes one, and between its corners.
const STROKE = 8;
const STEP = 3;
const LONGEST = 500;

export class Pointing {
  constructor({ link, control, view, overlay, picture, choose }) {
    Object.assign(this, { link, control, view, overlay, picture, choose });
    this.points = [];
    this.stroke = null;
    this.cross = null;
    this.frame = byId('frame');
    this.#listModes();
    this.#listen();
    this.#enter('choose');
  }

  #listModes() {
    byId('modes').append(...Object.entries(MODES).map(([mode, [label]]) => {
      const input = make('input', { type: 'radio', name: 'mode', value: mode });
      input.onchange = () => this.#enter(mode);
      return make('label', {}, input, make('span', {}, label));
    }));
  }

  #listen() {
    const { frame } = this;
    frame.addEventListener('pointerdown', (event) => this.#down(event));
    frame.addEventListener('pointermove', (event) => this.#move(event));
    frame.addEventListener('pointerup', (event) => this.#up(event));
    frame.addEventListener('pointercancel', () => this.#drop());
    frame.addEventListener('keydown', (event) => this.#key(event));
    frame.addEventListener('blur', () => this.#cross(null));
    byId('path-send').onclick = () => this.#sendPath();
    byId('path-discard').onclick = () => this.#setPoints([]);
    byId('clear-goals').onclick = () => order(this.link, 'Clear goals', 'clear_goals');
    byId('let-drive').onclick = () => order(this.link, 'Switch', 'switch_controller', { name: NEEDS[this.mode][1] });
    this.link.on('lost', () => this.#drop());
    this.link.on('state', ({ controller }) => this.#offer(controller ?? {}));
  }

  // Where this controller would refuse what is clicked: one that takes it.
  #offer({ takes, available }) {
    const [what, name] = NEEDS[this.mode] ?? [];
    byId('let-drive').hidden = !name || !takes || takes.includes(what) || !available.some((one) => one.name === name);
    setText(byId('let-drive'), `Let ${words(name)} drive`);
  }

  #enter(mode) {
    this.mode = mode;
    document.querySelector(`#modes input[value=${mode}]`).checked = true;
    setText(byId('view-hint'), MODES[mode][1]);
    byId('extras-goal').hidden = mode !== 'goal';
    byId('extras-path').hidden = mode !== 'path';
    byId('extras-teach').hidden = mode !== 'like' && mode !== 'unlike';
    this.frame.dataset.mode = mode;
    this.#setPoints([]);
  }

  #place(event) {
    const box = this.frame.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  #down(event) {
    if (event.button !== 0 || !event.isPrimary) return;
    this.frame.setPointerCapture(event.pointerId);
    const [x, y] = this.#place(event);
    this.stroke = { pointer: event.pointerId, x, y, clientX: event.clientX, clientY: event.clientY, moved: false, stamp: this.picture.stamp };
  }

  #move(event) {
    const { stroke } = this;
    if (stroke?.pointer !== event.pointerId) return;
    for (const one of event.getCoalescedEvents?.() ?? [event]) {
      const { clientX, clientY } = one;
      const moved = [clientX - stroke.clientX, clientY - stroke.clientY];
      if (this.mode === 'choose') {
        if (!stroke.moved && Math.hypot(...moved) < STROKE) continue;
        this.view.move(...moved);
        Object.assign(stroke, { clientX, clientY, moved: true });
        continue;
      }
      const [x, y] = this.#place(one);
      const step = Math.hypot(x - stroke.x, y - stroke.y);
      if (step < (stroke.moved ? STEP : STROKE)) continue;
      if (this.mode === 'path') {
        if (!stroke.moved) this.points = [this.view.toPixels(stroke.x, stroke.y)];
        if (this.points.length < LONGEST) this.points.push(this.view.toPixels(x, y));
      }
      Object.assign(stroke, { x, y, moved: true });
    }
    if (this.mode === 'path' && stroke.moved) this.#setPoints(this.points);
  }

  #up(event) {
    const { stroke } = this;
    if (stroke?.pointer !== event.pointerId) return;
    this.stroke = null;
    if (!stroke.moved) this.#click(...this.#place(event), stroke.stamp);
    else if (this.mode === 'path') {
      const [x, y] = this.#place(event);
      if (x !== stroke.x || y !== stroke.y) this.points.push(this.view.toPixels(x, y));
      this.#sendPath();
    }
  }

  #drop() {
    this.stroke = null;
    this.#setPoints([]);
  }

  // A click at a point of the page, on the picture of `stamp`.
  #click(pageX, pageY, stamp) {
    const [x, y] = this.view.toPixels(pageX, pageY);
    if (this.mode === 'choose') {
      const [found] = this.overlay.nearest(pageX, pageY);
      if (found && found.distance <= NEAR) this.choose(found.particle.id);
    } else if (!this.control.mine) {
      say('refused', this.link.up ? 'Another page has control; this page can only watch.'
        : 'No connection to the rig.');
    } else if (this.mode === 'goal') this.#goal(x, y);
    else if (this.mode === 'path') this.#setPoints([...this.points, [x, y]]);
    else this.#teach(x, y, stamp);
  }

  #goal(x, y) {
    const place = this.#micrometres([[x, y]])?.[0];
    if (!place) return;
    const [x_um, y_um] = place;
    const particle = byId('goal-only').checked ? this.overlay.chosen : null;
    order(this.link, `Goal at ${x_um.toFixed(1)}, ${y_um.toFixed(1)} µm`, 'goal',
      { x_um, y_um, particle });
  }

  #teach(x_px, y_px, stamp) {
    if (stamp === null) return;
    const particle_kind = byId('teach-kind').value.trim().replace(/[\s,@]+/g, '_') || null;
    order(this.link, MODES[this.mode][0], 'teach',
      { x_px, y_px, stamp, example: this.mode, particle_kind });
  }

  #sendPath() {
    const points_um = this.#micrometres(this.points);
    this.#setPoints([]);
    if (points_um?.length > 1 && this.control.mine) {
      order(this.link, `Path of ${points_um.length} points`, 'path', { points_um });
    }
  }

  #micrometres(points) {
    if (this.view.matrix) return points.map(([x, y]) => this.view.toMicrometres(x, y));
    say('refused', 'The pixel size is not known yet: positions cannot be shown.');
    return null;
  }

  #setPoints(points) {
    this.points = points;
    setText(byId('path-count'), String(points.length));
    byId('path-send').hidden = points.length < 2 || Boolean(this.stroke); // buttons that come move the picture under the pointer
    byId('path-discard').hidden = !points.length || Boolean(this.stroke);
    this.overlay.sketch(points, this.cross);
  }

  #cross(place) {
    this.cross = place;
    this.overlay.sketch(this.points, place);
  }

  #key(event) {
    const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    if (moves[event.key]) {
      const step = event.shiftKey ? 1 : 10;
      const [x, y] = this.cross ?? [this.view.width / 2, this.view.height / 2];
      const [right, down] = moves[event.key];
      this.#cross([clamp(x + step * right, this.view.width), clamp(y + step * down, this.view.height)]);
    } else if (event.key === 'Enter' && this.cross) {
      this.#click(...this.view.toPage(...this.cross), this.picture.stamp);
    } else if (event.key === 'Backspace' && this.points.length) {
      this.#setPoints(this.points.slice(0, -1));
    } else return;
    event.preventDefault();
  }
}

const clamp = (value, size) => Math.min(Math.max(value, 0), size - 1);
