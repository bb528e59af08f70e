// Arming: the button held by a pointer for one second, in view all the time. No key does it.

import { byId, setText } from '../dom.js';
import { order } from '../messages.js';

const HOLD_MS = 1000;
// A page that stood still counts no more than this for one frame.
const FRAME_MS = 100;

// `arming` is called before it is asked for.
export function armButton(link, arming) {
  const button = byId('arm');
  let pointer = null;
  let heldMs = 0;
  let last = 0;

  const show = () => {
    button.style.setProperty('--held', heldMs / HOLD_MS);
    button.toggleAttribute('data-held', pointer !== null);
    setText(button.querySelector('.words'), pointer === null ? 'Hold 1 s to arm' : 'Keep holding …');
  };
  const end = () => {
    pointer = null;
    heldMs = 0;
    show();
  };
  const frame = (now) => {
    if (pointer === null) return;
    heldMs += Math.min(Math.max(now - last, 0), FRAME_MS);
    last = now;
    show();
    if (heldMs < HOLD_MS) requestAnimationFrame(frame);
    else {
      end();
      arming();
      order(link, 'Arm', 'arm', { attended: byId('attended').checked });
    }
  };

  button.addEventListener('pointerdown', (event) => {
    if (event.button !== 0 || !event.isPrimary || pointer !== null) return;
    pointer = event.pointerId;
    button.setPointerCapture(pointer);
    last = performance.now();
    show();
    requestAnimationFrame(frame);
  });
  for (const type of ['pointerup', 'pointercancel', 'lostpointercapture']) {
    button.addEventListener(type, end);
  }
  button.addEventListener('contextmenu', (event) => event.preventDefault());
  window.addEventListener('blur', end);
  document.addEventListener('visibilitychange', end);
  link.on('lost', end);
  byId('disarm').onclick = () => order(link, 'Disarm', 'disarm');
}
