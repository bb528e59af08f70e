// What the rig answered, in its own words: the last few, newest first.

import { byId, make } from './dom.js';

const KEPT = 4;
export const MARKS = { ok: '✓', refused: '✕', error: '✕', warning: '!', note: '·' };

// Of those about one `topic` only the last stays.
export function say(level, text, topic = null) {
  const list = byId('messages');
  if (topic) list.querySelector(`[data-topic=${topic}]`)?.remove();
  const time = new Date().toTimeString().slice(0, 8);
  list.prepend(make('li', { class: level, ...(topic && { 'data-topic': topic }) },
    make('span', { class: 'mark', 'aria-hidden': 'true' }, MARKS[level]),
    make('span', {}, text), make('time', {}, time)));
  while (list.children.length > KEPT) list.lastChild.remove();
}

// Ask the rig and tell its answer: `what` says what was asked for, as 'Goal' or 'Arm'.
export async function order(link, what, verb, fields) {
  const { ok, reason, cure } = await link.ask(verb, fields);
  if (ok) say('ok', reason ? `${what}: ${reason}` : `${what}: done`);
  else say('refused', `${what}: ${reason}${cure ? `. ${cure.replaceAll('`', '')}` : ''}`);
  return ok;
}
