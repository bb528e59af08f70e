// STOP: by its button, Esc or a pad's button; from any page, with no question.

import { byId } from './dom.js';
import { say } from './messages.js';

const BY_HAND = 'Switch the amplifier off by hand.';
const SLOW_MS = 500;

export function stopper(link, sticks) {
  let touched = -Infinity;
  const stop = () => {
    sticks.release();
    send(link);
  };
  // The finger that comes down stops; the click that follows when it is lifted is the same one.
  byId('stop').addEventListener('pointerdown', () => {
    touched = performance.now();
    stop();
  });
  byId('stop').addEventListener('click', () => {
    if (performance.now() - touched > 1000) stop();
  });
  window.addEventListener('keydown', (event) => {
    if (event.key !== 'Escape' || event.repeat) return;
    event.preventDefault();
    stop();
  }, true);
  return stop;
}

async function send(link) {
  if (!link.up) {
    say('refused', `STOP could not be sent: there is no link to the rig. ${BY_HAND}`);
    return;
  }
  const late = setTimeout(() => say('refused', `STOP was sent, no answer yet. ${BY_HAND}`), SLOW_MS);
  const { ok, reason } = await link.ask('stop');
  clearTimeout(late);
  if (ok) say('ok', reason ? `STOP: ${reason}` : 'STOP: done');
  else say('refused', `STOP: ${reason}. ${BY_HAND}`);
}
