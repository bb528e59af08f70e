// The one connection to the cockpit's node: newest values in, verbs out, nothing kept for later.

// `state` comes ten times a second: seven missed ones in a row are no hiccup. A hidden page draws
// no pictures, and is told less.
const SILENCE_MS = 700;
const HIDDEN_SILENCE_MS = 3000;
const OPENING_MS = 3000;
const AGAIN_MS = 500;
// What the network does not take at once would be late: a page on a bad line sends less.
const BACKLOG_BYTES = 4096;

export class Link {
  constructor(url) {
    this.url = url;
    this.listeners = new Map();
    this.asked = new Map();
    this.lastId = 0;
    this.up = false;
    this.#open();
    setInterval(() => this.#watch(), 100);
    setInterval(() => {
      if (document.visibilityState === 'visible') this.tell('heartbeat');
    }, 1000);
  }

  // `listener` hears the messages of a kind, `state` with all its parts, whichever of them came;
  // and of this object 'picture' {stamp, jpeg}, 'asked' {verb, fields}, 'up', 'lost',
  // 'refused' and the reason.
  on(kind, listener) {
    if (!this.listeners.has(kind)) this.listeners.set(kind, []);
    this.listeners.get(kind).push(listener);
  }

  // Send a verb; resolves to the node's {ok, reason}, to STOP also {zero}; at once where nothing can
  // be sent.
  ask(verb, fields = {}) {
    if (!this.up) return Promise.resolve({ ok: false, reason: 'no connection to the rig' });
    const id = ++this.lastId;
    this.#say('asked', { verb, fields });
    return new Promise((resolve) => {
      this.asked.set(id, resolve);
      this.socket.send(JSON.stringify({ verb, id, ...fields }));
    });
  }

  // Send a verb that has no answer, unless it would have to wait in line.
  tell(verb, fields = {}) {
    if (!this.up || this.socket.bufferedAmount > BACKLOG_BYTES) return;
    this.socket.send(JSON.stringify({ verb, ...fields }));
  }

  #open() {
    const socket = new WebSocket(this.url);
    socket.binaryType = 'arraybuffer';
    socket.onmessage = (event) => this.#heard(socket, event.data);
    socket.onclose = () => this.#lose(socket);
    this.socket = socket;
    this.state = {};
    this.heard = performance.now();
  }

  #heard(socket, data) {
    if (socket !== this.socket) return;
    this.heard = performance.now();
    if (!this.up) {
      this.up = true;
      this.#say('up');
    }
    if (typeof data === 'string') {
      const message = JSON.parse(data);
      if (message.kind === 'answer') this.#answered(message);
      else if (message.kind === 'state') this.#say('state', Object.assign(this.state, message));
      else this.#say(message.kind, message);
    } else {
      const stamp = new DataView(data).getBigUint64(0).toString();
      this.#say('picture', { stamp, jpeg: data.slice(8) });
    }
  }

  // What could not be read as a verb is answered to nobody in particular: 'refused'.
  #answered({ to, ok, reason, zero, cause, cure }) {
    if (to === null) this.#say('refused', reason);
    this.asked.get(to)?.({ ok, reason, zero, cause, cure });
    this.asked.delete(to);
  }

  #watch() {
    const hidden = document.visibilityState === 'hidden';
    const silence = this.up ? (hidden ? HIDDEN_SILENCE_MS : SILENCE_MS) : OPENING_MS;
    if (this.socket && performance.now() - this.heard > silence) this.#lose(this.socket);
  }

  #lose(socket) {
    if (socket !== this.socket) return;
    const wasUp = this.up;
    this.up = false;
    if (wasUp) this.#say('lost');
    for (const resolve of this.asked.values()) {
      resolve({ ok: false, reason: 'the connection was lost before the answer arrived' });
    }
    this.asked.clear();
    this.socket = null;
    socket.close();
    setTimeout(() => this.#open(), AGAIN_MS);
  }

  #say(kind, message) {
    for (const listener of this.listeners.get(kind) ?? []) listener(message);
  }
}
