// The newest picture on the canvas, as soon as it is known what is in it. Every picture is answered with `seen`: drawn or passed over.

import { byId, setText } from '../dom.js';

const OLD_MS = 1500;
const HIDDEN_MS = 250;

export class Picture {
  // `drawn(stamp)` is called after each picture, from within an animation frame.
  constructor(link, tracks, drawn) {
    Object.assign(this, { link, tracks, drawn });
    this.canvas = byId('picture');
    this.context = this.canvas.getContext('2d', { alpha: false });
    this.stamp = null;
    this.waiting = null;
    this.busy = false;
    this.drawnAt = -Infinity;
    link.on('picture', (picture) => this.#take(picture));
    link.on('lost', () => { this.waiting = null; });
    setInterval(() => this.#curtain(), 250);
  }

  #take(picture) {
    if (this.waiting) this.link.tell('seen', { stamp: this.waiting.stamp });
    this.waiting = picture;
    if (!this.busy) this.#work();
  }

  async #work() {
    this.busy = true;
    while (this.waiting) {
      const { stamp, jpeg } = this.waiting;
      this.waiting = null;
      const bitmap = await createImageBitmap(new Blob([jpeg], { type: 'image/jpeg' }))
        .catch(() => null);
      if (bitmap) {
        await this.tracks.found(stamp);
        await nextFrame();
        this.#draw(bitmap, stamp);
      }
      this.link.tell('seen', { stamp });
    }
    this.busy = false;
  }

  #draw(bitmap, stamp) {
    const { canvas } = this;
    const { width, height } = bitmap;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    this.context.drawImage(bitmap, 0, 0);
    bitmap.close();
    this.stamp = stamp;
    canvas.dataset.stamp = stamp;
    this.drawnAt = performance.now();
    this.drawn(stamp);
  }

  #curtain() {
    const since = performance.now() - this.drawnAt;
    byId('curtain').hidden = since < OLD_MS;
    if (since < OLD_MS) return;
    setText(byId('curtain'), this.stamp === null ? 'No picture yet.'
      : `No picture for ${Math.round(since / 1000)}\u00a0s. This one is old.`);
  }
}

// A page that is hidden has no frames, but goes on slowly.
const nextFrame = () => Promise.race([
  new Promise(requestAnimationFrame), new Promise((resolve) => { setTimeout(resolve, HIDDEN_MS); })]);
