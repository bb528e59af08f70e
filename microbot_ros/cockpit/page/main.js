// Puts the parts of the page together.

import { armButton } from './panels/arm.js';
import { stateBar } from './panels/bar.js';
import { Control } from './panels/control.js';
import { discoveryPanel } from './panels/discovery.js';
import { byId, make } from './dom.js';
import { Drive } from './panels/drive.js';
import { Estimates } from './panels/estimates.js';
import { eventsPanel, whyPanel } from './panels/events.js';
import { fieldPanel } from './panels/field.js';
import { Gamepads } from './input/gamepad.js';
import { healthPanel } from './panels/health.js';
import { Keys } from './input/keys.js';
import { lookPanel } from './picture/look.js';
import { macrosPanel } from './panels/macros.js';
import { say } from './messages.js';
import { Overlay } from './picture/overlay.js';
import { Picture } from './picture/picture.js';
import { Pointing } from './input/pointing.js';
import { recordingPanel } from './panels/recording.js';
import { Link } from './socket.js';
import { Sticks } from './input/sticks.js';
import { Stopper } from './input/stop.js';
import { tabs } from './tabs.js';
import { Touch } from './input/touch.js';
import { Tracks } from './picture/tracks.js';
import { View } from './picture/view.js';

tabs();
const scheme = location.protocol === 'https:' ? 'wss' : 'ws';
const link = new Link(`${scheme}://${location.host}/socket`);

const view = new View(byId('frame'));
const tracks = new Tracks();
const overlay = new Overlay(view, tracks);
const picture = new Picture(link, tracks, (stamp) => {
  if (view.cover()) tracks.clear();
  overlay.show(stamp);
});

new Drive(link);
fieldPanel(link);
const estimates = new Estimates(link, tracks, (id) => overlay.choose(id));
recordingPanel(link);
macrosPanel(link);
discoveryPanel(link);
healthPanel(link);
eventsPanel(link);
whyPanel(link);
lookPanel(link, view);
stateBar(link);

const control = new Control(link);
new Pointing({ link, control, view, overlay, picture, choose: (id) => estimates.choose(id) });
const sticks = new Sticks(link, control, view);
const stopper = new Stopper(link, sticks);
armButton(link, () => stopper.end());
new Keys(byId('stick'), sticks);
new Touch(byId('stick'), sticks);
new Gamepads(sticks, () => stopper.stop());

link.on('hello', ({ camera, kinds }) => {
  if (view.use(camera)) tracks.clear();
  byId('kinds').replaceChildren(...(kinds ?? []).map((value) => make('option', { value })));
});
link.on('particles', (message) => {
  tracks.take({ ...message, particles: view.place(message.particles) });
  overlay.show(view.camera ? picture.stamp : message.stamp);
});
link.on('state', (state) => overlay.hear(state));
byId('answer-close').onclick = () => { byId('answer').hidden = true; };
link.on('lost', () => say('refused', 'The connection to the cockpit’s node is lost.', 'link'));
link.on('refused', (reason) => say('refused', reason));
link.on('up', () => say('note', 'Connected to the cockpit’s node.', 'link'));
