// The search for what the model lacks: what it found, how sure it is, what it does next.

import { byId, keyed, make, setText, words } from '../dom.js';
import { readings } from './estimates.js';
import { order } from '../messages.js';
import { clock, known, measured, withUnit } from '../numbers.js';

const VERDICTS = {
  consistent: 'Consistent: no effect was found.', named: 'Named.', unnamed: 'Unnamed: an effect is missing that is not in the library.',
};

export function discoveryPanel(link) {
  let running = false;
  byId('discover-form').onsubmit = (event) => {
    event.preventDefault();
    order(link, running ? 'Stop discovery' : 'Discovery', 'discover',
      { on: !running, minutes: Number(byId('minutes').value) });
  };
  link.on('state', ({ discovery }) => {
    running = Boolean(discovery?.running);
    setText(byId('discover'), running ? 'Stop' : 'Start');
    byId('minutes').readOnly = running;
    show(discovery ?? {});
    where(discovery ?? {});
  });
}

function show(now) {
  byId('verdict').dataset.verdict = now.verdict ?? '';
  setText(byId('verdict'), headline(now));
  const sizes = (now.sizes ?? []).map(({ name, value, half, unit }) => [`${words(name)}, 95 %`, measured(value, half, unit)]);
  readings(byId('findings'), [['effect', words(now.effect)], ...sizes, ['gap', withUnit(now.gap_um, 3, 'µm')],
    ['decided', words(now.decided)], ['time', withUnit(now.minutes, 1, 'min')]]);
  const odds = Object.entries(now.odds ?? {}).filter(([, share]) => known(share))
    .sort(([, a], [, b]) => b - a).slice(0, 6);
  keyed(byId('odds'), odds, ([name]) => name, oddsRow, (node, [, share]) => {
    node.querySelector('meter').value = share;
    setText(node.lastChild, withUnit(100 * share, share > 0.1 ? 0 : 1, '%'));
  });
  const learned = (now.learned ?? []).map(({ sentence }) => sentence).filter(Boolean);
  setText(byId('next'), [...learned, now.next && `Next: ${now.next}`].filter(Boolean).join(' '));
}

function where({ running, left_s, of_s, folder, report }) {
  byId('discover-progress').hidden = !running;
  byId('discover-progress').value = running ? 1 - left_s / of_s : 0;
  const text = `${running ? left_s ? `At most ${clock(left_s)} left. ` : 'Evaluating. ' : ''}${folder ? `Results in ${folder}. ` : ''}`;
  keyed(byId('discover-where'), [text + report], String, () => make('span', {}, text, ...(report
    ? [make('a', { href: report, target: '_blank', rel: 'noopener' }, 'Open the report')] : [])));
}

function headline({ verdict, sentence, running }) {
  if (sentence) return VERDICTS[verdict] && !running ? `${VERDICTS[verdict]} ${sentence}` : sentence;
  return VERDICTS[verdict] ?? (running ? 'Asking the rig.' : 'No requests yet.');
}

function oddsRow([name]) {
  return make('div', { class: 'odds' }, make('span', {}, words(name || 'no effect')),
    make('meter', { min: 0, max: 1, 'aria-label': `odds of ${words(name || 'no effect')}` }), make('span', { class: 'number' }));
}
