// Macros: what this page asked for, with the pauses between, kept in this browser and asked for again.

import { byId, offer, setText } from '../dom.js';
import { order } from '../messages.js';

const KEY = 'microbot macros';
// Arming is done by hand, by a person who looks.
const NEVER = ['arm', 'stop', 'take_control'];

export function macrosPanel(link) {
  let steps = null;
  let last = 0;
  let turn = 0;
  const end = () => { turn += 1; };
  const say = (text) => setText(byId('macro-now'), text);
  const show = () => offer(byId('macro'), Object.keys(read()));
  const change = (name, value) => {
    localStorage.setItem(KEY, JSON.stringify({ ...read(), [name]: value }));
    show();
  };
  const play = async (name, macro) => {
    const mine = ++turn;
    for (const [index, [pause_s, verb, fields]] of macro.entries()) {
      const step = `“${name}”, step ${index + 1} of ${macro.length}`;
      say(`${step}, in ${pause_s.toFixed(1)} s.`);
      await new Promise((resolve) => { setTimeout(resolve, 1000 * pause_s); });
      if (mine !== turn) return say(`${step}, was not sent: ended by STOP, a fault or another macro.`);
      if (!await order(link, `Macro ${name}`, verb, fields)) return say(`${step}, was refused: the macro ends.`);
    }
    return say(`“${name}” is done.`);
  };

  byId('macro-form').onsubmit = (event) => {
    event.preventDefault();
    play(byId('macro').value, read()[byId('macro').value] ?? []);
  };
  byId('macro-delete').onclick = () => change(byId('macro').value);
  byId('keep-form').onsubmit = (event) => {
    event.preventDefault();
    if (steps?.length) change(byId('macro-name').value.trim(), steps);
    say(steps ? `${steps.length} steps kept.` : 'All commands from now on are kept, with their pauses.');
    steps = steps ? null : [];
    last = performance.now();
    setText(byId('macro-keep'), steps ? 'Save macro' : 'Record commands');
  };
  link.on('asked', ({ verb, fields }) => {
    if (verb === 'stop' || verb === 'disarm') end();
    if (!steps || NEVER.includes(verb)) return;
    steps.push([(performance.now() - last) / 1000, verb, fields]);
    last = performance.now();
  });
  let before = '';
  link.on('state', ({ rig }) => {
    if (before === 'armed' && rig !== 'armed') end();
    before = rig;
  });
  link.on('lost', end);
  window.addEventListener('storage', show);
  show();
}

const read = () => JSON.parse(localStorage.getItem(KEY) ?? '{}');
