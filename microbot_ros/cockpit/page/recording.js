// Recording, with a title, and notes while it runs.

import { byId, setText } from './dom.js';
import { order } from './messages.js';
import { clock } from './numbers.js';

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
    if (on !== Boolean(recording?.on) && recording?.title) byId('title').value = recording.title;
    on = Boolean(recording?.on);
    setText(byId('record'), on ? 'Stop recording' : 'Record');
    byId('title').readOnly = on;
    setText(byId('recording-now'), said(recording));
  });
}

function said(recording) {
  if (!recording) return 'Nothing was heard from the recorder yet.';
  if (!recording.on) return 'Not recording.';
  const title = recording.title ? ` “${recording.title}”` : '';
  return `● Recording${title} for ${clock(recording.seconds)}, ${recording.lost ?? 0} messages lost.`;
}
