// What happened since the cockpit's node began: when, from which page or node, in whole sentences.

import { byId, keyed, make } from '../dom.js';
import { MARKS, remedy } from '../messages.js';

export function eventsPanel(link) {
  let kept = [];
  const wanted = ({ origin, level, text }) => {
    const part = byId('event-filter').value.trim().toLowerCase();
    return (!byId('event-wrong').checked || '✕!'.includes(MARKS[level]))
      && `${origin} ${text}`.toLowerCase().includes(part);
  };
  const show = () => byId('event-list').replaceChildren(...kept.filter(wanted).map(row).reverse());
  byId('event-filter').oninput = show;
  byId('event-wrong').onchange = show;
  byId('event-download').onclick = () => {
    const lines = kept.filter(wanted).map((one) => [new Date(1000 * one.time_s).toISOString(),
      one.origin, one.level, one.text, one.cause, one.cure].map(quoted).join());
    const url = URL.createObjectURL(new Blob([`time,origin,level,text,cause,cure\n${lines.join('\n')}\n`]));
    make('a', { href: url, download: 'events.csv' }).click();
    setTimeout(() => URL.revokeObjectURL(url), 1000);
  };
  link.on('events', ({ events }) => {
    kept = [...kept, ...events].slice(-1000);
    byId('event-list').prepend(...events.filter(wanted).map(row).reverse());
  });
  link.on('lost', () => { kept = []; show(); });
}

function row(one) {
  return make('li', { class: one.level, 'data-level': one.level },
    make('time', {}, new Date(1000 * one.time_s).toTimeString().slice(0, 8)),
    make('span', { class: 'mark', 'aria-hidden': 'true' }, MARKS[one.level]),
    make('span', {}, make('b', {}, one.origin), ` ${one.text}`, ...remedy(one)));
}

const quoted = (text) => `"${String(text ?? '').replaceAll('"', '""')}"`;

// Above the parts, whichever is in view, while a fault stands.
export function whyPanel(link) {
  link.on('state', ({ why, rig, sentence, fault }) => {
    byId('why').hidden = rig !== 'fault';
    keyed(byId('why'), rig === 'fault' ? [{ sentence, ...fault, ...why }] : [], (one) => JSON.stringify(one), (one) => {
      byId('panels').scrollTop = 0;
      return make('span', {}, make('b', {}, `${one.reason ?? one.sentence}.`), one.detail ? ` ${one.detail}.` : '', ...remedy(one));
    });
  });
}
