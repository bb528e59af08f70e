// STOP: by its button, Esc or a pad's button; from any page, with no question. It is sent again
// until the driver says that the zero is confirmed, or sent where the amplifier reads nothing back.

import { byId, setText } from '../dom.js';
import { say } from '../messages.js';

const BY_HAND = 'Switch the amplifier off by hand.';
const SLOW_MS = 500;
const AGAIN_MS = 300;

export const ZERO = {
  confirmed: 'zero, confirmed by a reading',
  sent: 'zero sent, not confirmed',
  unreachable: 'NOT REACHABLE',
  waiting: 'sent, no answer yet',
};

export class Stopper {
  #run = 0;
  #going = false;
  #off = false;

  constructor(link, sticks) {
    Object.assign(this, { link, sticks });
    let touched = -Infinity;
    // The finger that comes down stops; the click that follows when it is lifted is the same one.
    byId('stop').addEventListener('pointerdown', () => {
      touched = performance.now();
      this.stop();
    });
    byId('stop').addEventListener('click', () => {
      if (performance.now() - touched > 1000) this.stop();
    });
    window.addEventListener('keydown', (event) => {
      if (event.key !== 'Escape' || event.repeat) return;
      event.preventDefault();
      this.stop();
    }, true);
    byId('alarm-off').onclick = () => {
      this.end();
      this.#off = true;
    };
    link.on('state', ({ rig, zero }) => this.#hear(rig, zero));
    link.on('lost', () => { if (!this.#going) show(null); });
  }

  // Send it now, and again until it is done. A press while it goes on sends it once more.
  async stop() {
    this.sticks.release();
    const run = ++this.#run;
    this.#going = true;
    show('waiting');
    while (run === this.#run) {
      if (!this.link.up) return this.#unsent();
      const late = setTimeout(() => alarm(`STOP was sent, no answer yet. ${BY_HAND}`), SLOW_MS);
      const { ok, reason, zero } = await this.link.ask('stop');
      clearTimeout(late);
      if (run !== this.#run) return;
      if (ok) {
        this.end();
        show(zero ?? null);
        return say('ok', reason ? `STOP: ${reason}` : 'STOP: done', 'stop');
      }
      show(zero ?? 'unreachable');
      say('refused', `STOP: ${reason}. ${BY_HAND}`, 'stop');
      alarm(zero === 'sent' ? `The zero was sent, but no reading confirms it. STOP is repeated. ${BY_HAND}`
        : `The coils may carry current. STOP is repeated. ${BY_HAND}`);
      await new Promise((resolve) => { setTimeout(resolve, AGAIN_MS); });
    }
  }

  // No more of it: it is done, somebody switched the amplifier off, or arms.
  end() {
    this.#run += 1;
    this.#going = false;
    alarm('');
  }

  #unsent() {
    this.#going = false;
    show(null);
    say('refused', `STOP could not be sent: no connection to the rig. ${BY_HAND}`, 'stop');
    alarm(`STOP could not be sent: no connection to the rig. ${BY_HAND}`);
  }

  // What the driver says of itself, while no STOP of this page goes on.
  #hear(rig, zero) {
    if (this.#going) return;
    show(rig === 'armed' ? null : zero ?? null);
    this.#off &&= zero === 'unreachable';
    alarm(rig !== 'armed' && zero === 'unreachable' && !this.#off ? `The coils may carry current. ${BY_HAND}` : '');
  }
}

function show(zero) {
  byId('stop').dataset.zero = zero ?? '';
  setText(byId('zero'), ZERO[zero] ?? '');
}

function alarm(text) {
  byId('alarm').hidden = !text;
  setText(byId('alarm-words'), text);
}
