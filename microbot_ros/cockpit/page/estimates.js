// v and φ of the chosen particle, with their uncertainty, as numbers and curves.

import { Curve } from './curves.js';
import { byId, keyed, make, offer, setText } from './dom.js';
import { measured, withUnit } from './numbers.js';

const EVERY_S = 0.25;

export class Estimates {
  // `chosen(id)` is told when another particle is chosen.
  constructor(link, tracks, chosen) {
    Object.assign(this, { tracks, chosen, id: null, heard: [], last: 0 });
    this.v = new Curve(byId('plot-v'), '--blue');
    this.phi = new Curve(byId('plot-phi'), '--orange');
    byId('particle').onchange = () => this.choose(Number(byId('particle').value));
    link.on('state', ({ estimates }) => this.#hear(estimates ?? []));
  }

  choose(id) {
    if (id === this.id) return;
    this.id = id;
    this.v.clear();
    this.phi.clear();
    byId('particle').value = String(id);
    setText(byId('goal-particle'), String(id));
    this.#show();
    this.chosen(id);
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
  }

  // At once where another is chosen: its numbers are not to be those of the one before.
  #show() {
    const one = this.heard.find(({ id }) => id === this.id) ?? {};
    const v = measured(one.v_um_s, one.v_std_um_s, 'µm/s');
    const phi = measured(one.phi_deg, one.phi_std_deg, '°');
    readings(byId('readings'), [['speed v', v], ['offset φ', phi],
      ['diffusion D', withUnit(one.d_um2_s, 3, 'µm²/s')], ['force F', withUnit(one.force_fn, 1, 'fN')]]);
    byId('plot-v').setAttribute('aria-label', `Speed over the last minute, now ${v}`);
    byId('plot-phi').setAttribute('aria-label', `Offset over the last minute, now ${phi}`);
    const now = performance.now() / 1000;
    if (now - this.last < EVERY_S) return;
    this.last = now;
    this.v.add(now, one.v_um_s, one.v_std_um_s);
    this.phi.add(now, one.phi_deg, one.phi_std_deg);
  }
}

// A list of names and values: [[name, text], …].
export function readings(list, rows) {
  keyed(list, rows, ([name]) => name,
    ([name]) => make('div', {}, make('dt', {}, name), make('dd')),
    (node, [, value]) => setText(node.lastChild, value));
}
