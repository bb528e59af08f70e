// Recording, with a title, and notes while it runs; the recordings there are.

import { byId, keyed, make, setText } from '../dom.js';
import { order } from '../messages.js';
import { clock, withUnit } from '../numbers.js';

export function recordingPanel(link) {
  let on = false;
  byId('record-form').onsubmit = (event) => {
    event.preventDefault();
    order(link, on ? 'Stop recording' : 'Record', 'record', { on: !on, title: byId('title').value.trim() });
  };
  byId('note-form').onsubmit = async (event) => {
    event.preventDefault();
    const text = byId('note').value.trim();
    if (text && await order(link, 'Note', 'note', { text })) byId('note').value = '';
  };
  link.on('state', ({ recording }) => {
    if (on !== Boolean(recording?.on)) {
      if (recording?.title) byId('title').value = recording.title;
      list();
    }
    on = Boolean(recording?.on);
    setText(byId('record'), on ? 'Stop recording' : 'Record');
    byId('title').readOnly = on;
    setText(byId('recording-now'), said(recording));
  });
  byId('tab-recording').addEventListener('click', list);
  link.on('up', list);
}

function said(recording) {
  if (!recording) return 'The recorder has not reported yet.';
  if (!recording.on) return 'Not recording.';
  const title = recording.title ? ` “${recording.title}”` : '';
  return `● Recording${title} for ${clock(recording.seconds)}, ${recording.lost ?? 0} messages lost.`;
}

async function list() {
  const found = await fetch('/recordings').then((answer) => answer.json()).catch(() => null);
  if (!found) return;
  setText(byId('recordings-now'), found.length ? '' : 'No recordings in the folder of this cockpit yet.');
  keyed(byId('recordings'), found, (one) => JSON.stringify(one), row);
}

function row({ name, title, notes, files, bytes, began_s, seconds }) {
  const at = `/recordings/${encodeURIComponent(name)}`;
  const when = new Date(1000 * began_s).toLocaleString([], { dateStyle: 'short', timeStyle: 'short' });
  const length = seconds === null ? 'not finished' : `${clock(seconds)} min`;
  return make('li', {}, make('p', {}, make('b', {}, title || name), ` ${when}, ${length}, ${withUnit(bytes / 1e6, 1, 'MB')}`),
    make('p', { class: 'hint' }, notes), make('a', { href: `${at}/film.mp4`, target: '_blank' }, 'Replay'),
    ...files.map((file) => make('a', { href: `${at}/${encodeURIComponent(file)}`, download: '' },
      files.length > 1 ? file : 'Download')));
}
