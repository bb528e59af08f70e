// What the rig answered, in its own words: the last few, newest first. Beside STOP there is room for
// three lines: what is longer, or has a cure, stands in whole above the parts until the next answer.

import { byId, make } from './dom.js';

const KEPT = 4;
export const MARKS = { ok: '✓', refused: '✕', error: '✕', warning: '!', note: '·' };

const plain = (text) => text.replaceAll('`', '');

// Cause and cure, a line each, where they are known.
export function remedy({ cause, cure } = {}) {
  return [cause && make('span', { class: 'remedy' }, `Cause: ${plain(cause)}`),
    cure && make('span', { class: 'remedy cure' }, `What to do: ${plain(cure)}`)].filter(Boolean);
}

// Of those about one `topic` only the last stays.
export function say(level, text, topic = null, help = {}) {
  const list = byId('messages');
  if (topic) list.querySelector(`[data-topic=${topic}]`)?.remove();
  const time = new Date().toTimeString().slice(0, 8);
  list.prepend(make('li', { class: level, ...(topic && { 'data-topic': topic }) },
    make('span', { class: 'mark', 'aria-hidden': 'true' }, MARKS[level]),
    make('span', {}, text), make('time', {}, time)));
  while (list.children.length > KEPT) list.lastChild.remove();
  if (level === 'note') return;
  const { scrollHeight, clientHeight } = list.firstChild;
  byId('answer').hidden = !help.cure && scrollHeight <= clientHeight;
  byId('answer-words').replaceChildren(...(byId('answer').hidden ? [] : [text, ...remedy(help)]));
  if (!byId('answer').hidden) byId('panels').scrollTop = 0;
}

// Ask the rig and tell its answer: `what` says what was asked for, as 'Goal' or 'Arm'.
export async function order(link, what, verb, fields) {
  const { ok, reason, ...help } = await link.ask(verb, fields);
  say(ok ? 'ok' : 'refused', `${what}: ${reason || 'done'}`, null, help);
  return ok;
}
