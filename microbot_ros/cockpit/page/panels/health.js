// What the nodes say of themselves, in their sentences; what is not well comes first.

import { byId, keyed, make, setText } from '../dom.js';
import { remedy } from '../messages.js';

const LEVELS = { error: '✕ error', stale: '… silent', warn: '! warning', ok: '✓ well' };

export function healthPanel(link) {
  link.on('state', ({ health }) => {
    const order = Object.keys(LEVELS);
    const rows = (health ?? []).toSorted((a, b) =>
      order.indexOf(a.level) - order.indexOf(b.level) || a.name.localeCompare(b.name));
    const wrong = rows.filter(({ level }) => level !== 'ok').length;
    byId('tab-health').dataset.wrong = wrong || '';
    setText(byId('fact-health'), health ? wrong ? `! ${wrong} of ${rows.length}` : 'all well' : '–');
    keyed(byId('health-list'), rows, (one) => JSON.stringify(one), ({ name, level, sentence, ...help }) => make('li',
      { 'data-level': level }, make('span', { class: 'level' }, LEVELS[level] ?? level),
      make('strong', {}, name), make('span', {}, sentence ?? ''), ...remedy(help)));
  });
}
