// What the nodes say of themselves, in their sentences; what is not well comes first.

import { byId, make, setText } from './dom.js';
import { remedy } from './events.js';

const LEVELS = { error: '✕ error', stale: '… silent', warn: '! warning', ok: '✓ well' };

export function healthPanel(link) {
  link.on('state', ({ health }) => {
    const order = Object.keys(LEVELS);
    const rows = (health ?? []).toSorted((a, b) =>
      order.indexOf(a.level) - order.indexOf(b.level) || a.name.localeCompare(b.name));
    const wrong = rows.filter(({ level }) => level !== 'ok').length;
    byId('tab-health').dataset.wrong = wrong || '';
    setText(byId('fact-health'), health ? wrong ? `! ${wrong} of ${rows.length}` : 'all well' : '–');
    const list = byId('health-list');
    while (list.children.length > Math.max(rows.length, 1)) list.lastChild.remove();
    while (list.children.length < rows.length) {
      list.append(make('li', {}, make('span', { class: 'level' }), make('strong'), make('span')));
    }
    rows.forEach(({ name, level, sentence, ...help }, index) => {
      const row = list.children[index];
      row.dataset.level = level;
      [LEVELS[level] ?? level, name, sentence].forEach((text, part) => setText(row.children[part], text ?? ''));
      const known = `${help.cause} ${help.cure}`;
      if (row.dataset.help === known) return;
      row.dataset.help = known;
      row.querySelectorAll('.remedy').forEach((node) => node.remove());
      row.append(...remedy(help));
    });
  });
}
