// Steering by hand. 20 messages a second while something is held, the page visible and focused;
// on release one 0, 0. Nothing goes on by itself: whatever interrupts wants neutral and a new press.
//
// A source has `value()` → [right, up] on the screen, each −1…1, and `forget()`, after which its
// value is 0, 0 until it was let go and is pressed anew.

import { byId } from '../dom.js';

const PERIOD_MS = 50;
// A page that was frozen wakes up with what was held then. Sooner than `joy_timeout_ms` (250): what
// was frozen for so long that the coils went to zero must not go on.
const FROZEN_MS = 200;

export class Sticks {
  constructor(link, control, view) {
    Object.assign(this, { link, control, view, sources: [], held: false });
    this.ticked = performance.now();
    setInterval(() => this.#tick(), PERIOD_MS);
    for (const type of ['blur', 'pagehide']) window.addEventListener(type, () => this.release());
    for (const type of ['visibilitychange', 'freeze']) {
      document.addEventListener(type, () => this.release());
    }
    link.on('lost', () => this.release());
  }

  add(source) {
    source.forget();
    this.sources.push(source);
  }

  // For sources that know when they are let go: the last message need not wait.
  settle() {
    if (!this.#value()) this.#end();
  }

  // Let go of everything, whatever the hand does.
  release() {
    for (const source of this.sources) source.forget();
    this.#end();
  }

  #tick() {
    const now = performance.now();
    const frozen = now - this.ticked > FROZEN_MS;
    this.ticked = now;
    const value = this.#value();
    if (frozen || !this.#permitted()) this.release();
    else if (value) this.#send(value);
    else this.#end();
  }

  #permitted() {
    return this.link.up && this.control.steering && document.hasFocus()
      && document.visibilityState === 'visible';
  }

  // What the first source that is held says, at most 1 long; null where none is.
  #value() {
    for (const source of this.sources) {
      const [right, up] = source.value();
      const length = Math.hypot(right, up);
      if (length > 0) return [right / Math.max(length, 1), up / Math.max(length, 1)];
    }
    return null;
  }

  #send([right, up]) {
    const [x, y] = this.view.direction(right, up);
    this.held = true;
    drawKnob(right, up);
    this.link.tell('stick', { x, y });
  }

  #end() {
    drawKnob(0, 0);
    if (!this.held) return;
    this.held = false;
    this.link.tell('stick', { x: 0, y: 0 });
  }
}

// The page's stick shows what is sent, whichever source it is from.
function drawKnob(right, up) {
  byId('knob').setAttribute('transform', `translate(${right * 66} ${-up * 66})`);
}
