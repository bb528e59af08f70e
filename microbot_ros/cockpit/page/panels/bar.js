// The line that is always in view: state of the rig, ages, recording, control, link.

import { byId, setText } from '../dom.js';
import { age, clock, withUnit } from '../numbers.js';
import { ZERO } from '../input/stop.js';

const CHIPS = { armed: '◆ armed', disarmed: '◇ disarmed', fault: '✕ fault', unknown: '? unknown' };

export function stateBar(link) {
  let lostAt = performance.now();
  link.on('state', show);
  link.on('lost', () => {
    lostAt = performance.now();
    showLost(0);
  });
  setInterval(() => {
    if (!link.up) showLost((performance.now() - lostAt) / 1000);
  }, 1000);
}

function show(state) {
  const rig = CHIPS[state.rig] ? state.rig : 'unknown';
  byId('rig-chip').dataset.state = rig;
  setText(byId('rig-chip'), CHIPS[rig] + (state.attended ? ', attended' : ''));
  // Of a fault the whole stands above the parts.
  setText(byId('rig-sentence'), rig === 'fault' && state.fault ? `${state.fault.reason}${ZERO[state.zero] ? `; ${ZERO[state.zero]}` : ''}` : state.sentence ?? 'The coil driver has not reported yet.');
  setText(byId('fact-latency'), withUnit(state.latency_ms, 1, 'ms'));
  setText(byId('fact-picture'), state.picture_age_ms == null ? '–' : `${age(state.picture_age_ms)} old`);
  setText(byId('fact-recording'), recording(state.recording));
  setText(byId('fact-control'), control(state.control));
  setText(byId('fact-link'), state.link?.age_ms == null ? 'up' : `${age(state.link.age_ms)} ago`);
  document.title = `${CHIPS[rig]} · cockpit`;
}

function showLost(seconds) {
  byId('rig-chip').dataset.state = 'unknown';
  setText(byId('rig-chip'), CHIPS.unknown);
  setText(byId('rig-sentence'), 'No connection to the cockpit’s node: the page shows old data and cannot send.');
  setText(byId('fact-link'), `lost for ${age(seconds * 1000)}`);
  document.title = 'no connection · cockpit';
}

const recording = (now) => (now?.on ? `${clock(now.seconds)}, ${now.lost ?? 0} lost` : 'off');

function control(now) {
  if (!now) return '–';
  const pages = now.pages > 1 ? `, ${now.pages} pages` : '';
  if (now.mine) return `yours${pages}`;
  return (now.holder == null ? 'nobody’s' : 'another page’s') + pages;
}
