// The parts of the cockpit: one in view, the tabs of all above it.

import { byId, make } from './dom.js';

export function tabs() {
  const panels = [...document.querySelectorAll('[data-tab]')];
  const buttons = panels.map((panel) => make('button', { type: 'button', role: 'tab',
    id: `tab-${panel.id}`, 'aria-controls': panel.id }, panel.dataset.tab));
  let current = 0;

  const show = (index, focus = false) => {
    current = (index + panels.length) % panels.length;
    panels.forEach((panel, at) => {
      panel.hidden = at !== current;
      panel.setAttribute('role', 'tabpanel');
      panel.setAttribute('aria-labelledby', `tab-${panel.id}`);
      buttons[at].setAttribute('aria-selected', at === current);
      buttons[at].tabIndex = at === current ? 0 : -1;
    });
    byId('panels').scrollTop = 0;
    history.replaceState(null, '', `#${panels[current].id}`);
    if (focus) buttons[current].focus();
  };

  buttons.forEach((button, index) => { button.onclick = () => show(index); });
  byId('tabs').append(...buttons);
  byId('tabs').onkeydown = ({ key }) => {
    if (key === 'ArrowRight') show(current + 1, true);
    if (key === 'ArrowLeft') show(current - 1, true);
  };
  show(Math.max(panels.findIndex(({ id }) => `#${id}` === location.hash), 0));
}
