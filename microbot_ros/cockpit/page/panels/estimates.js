// v and φ of the chosen particle, with their uncertainty, as numbers and curves.

import { Curve } from './curves.js';
import { byId, keyed, make, offer, setText } from '../dom.js';
import { known, measured } from '../numbers.js';

const EVERY_S = 0.25;
const KEPT = 240;

export class Estimates {
  // `chosen(id)` is told when another particle is chosen.
  constructor(link, tracks, chosen) {
    Object.assign(this, { tracks, chosen, id: null, heard: [], last: 0, past: new Map() });
    this.v = new Curve(byId('plot-v'), '--blue');
    this.phi = new Curve(byId('plot-phi'), '--orange');
    byId('particle').onchange = () => this.choose(Number(byId('particle').value));
    link.on('history', ({ curves }) => {
      const now = performance.now() / 1000;
      this.past = new Map(Object.entries(curves).map(([id, rows]) => [Number(id),
        rows.map(([ago, ...rest]) => [now + ago, ...rest])]));
      this.#draw();
    });
    link.on('state', ({ estimates }) => this.#hear(estimates ?? []));
  }

  choose(id) {
    if (id === this.id) return;
    this.id = id;
    byId('particle').value = String(id);
    setText(byId('goal-particle'), String(id));
    this.#draw();
    this.#show();
    this.chosen(id);
  }

  #draw() {
    const rows = this.past.get(this.id) ?? [];
    this.v.fill(rows.map(([t, v, std]) => [t, v, std]));
    this.phi.fill(rows.map(([t, , , phi, std]) => [t, phi, std]));
  }

  #hear(estimates) {
    this.heard = estimates;
    const ids = [...new Set([...this.tracks.newest, ...estimates].map(({ id }) => id))]
      .sort((a, b) => a - b);
    offer(byId('particle'), ids);
    if (this.id === null && ids.length) this.choose(ids[0]);
    if (ids.includes(this.id)) byId('particle').value = String(this.id);
    const kind = this.tracks.newest.find(({ id }) => id === this.id)?.kind;
    setText(byId('particle-kind'), kind || '');
    this.#show();
    const now = performance.now() / 1000;
    if (now - this.last < EVERY_S) return;
    this.last = now;
    for (const one of estimates) {
      const rows = this.past.get(one.id) ?? [];
      rows.push([now, one.v_um_s, one.v_std_um_s, one.phi_deg, one.phi_std_deg]);
      this.past.set(one.id, rows.slice(-KEPT));
    }
    this.#draw();
  }

  // At once where another is chosen: its numbers are not to be those of the one before.
  #show() {
    const one = this.heard.find(({ id }) => id === this.id) ?? {};
    const v = measured(one.v_um_s, one.v_std_um_s, 'µm/s');
    const phi = measured(one.phi_deg, one.phi_std_deg, '°');
    readings(byId('readings'), [['speed v', v], ['offset φ', phi],
      ['diffusion D', measured(one.d_um2_s, one.d_std_um2_s, 'µm²/s')],
      ['force F', measured(one.force_pn, one.force_std_pn, 'pN')]]);
    setText(byId('unknown-why'), one.id == null || known(one.v_um_s) ? ''
      : `Speed and offset are not known: ${one.reason ?? 'arm, and let the field turn for some seconds'}.`);
    byId('plot-v').setAttribute('aria-label', `Speed over the last minute, now ${v}`);
    byId('plot-phi').setAttribute('aria-label', `Offset over the last minute, now ${phi}`);
  }
}

// A list of names and values: [[name, text], …].
export function readings(list, rows) {
  keyed(list, rows, ([name]) => name,
    ([name]) => make('div', {}, make('dt', {}, name), make('dd')),
    (node, [, value]) => setText(node.lastChild, value));
}
