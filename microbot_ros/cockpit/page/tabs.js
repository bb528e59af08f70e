// On wide screens all parts stand below one another; on narrow ones they are tabs.

import { byId, make } from './dom.js';

export function tabs() {
  const narrow = matchMedia('(max-width: 1099px)');
  const panels = [...document.querySelectorAll('[data-tab]')];
  const buttons = panels.map((panel) => make('button', { type: 'button', role: 'tab',
    id: `tab-${panel.id}`, 'aria-controls': panel.id }, panel.dataset.tab));
  let current = 0;

  const show = (index, focus = false) => {
    current = (index + panels.length) % panels.length;
    panels.forEach((panel, at) => {
      panel.hidden = narrow.matches && at !== current;
      panel.setAttribute('role', narrow.matches ? 'tabpanel' : 'region');
      panel.setAttribute('aria-labelledby', `tab-${panel.id}`);
      buttons[at].setAttribute('aria-selected', at === current);
      buttons[at].tabIndex = at === current ? 0 : -1;
    });
    if (focus) buttons[current].focus();
  };

  buttons.forEach((button, index) => { button.onclick = () => show(index); });
  byId('tabs').append(...buttons);
  byId('tabs').onkeydown = ({ key }) => {
    if (key === 'ArrowRight') show(current + 1, true);
    if (key === 'ArrowLeft') show(current - 1, true);
  };
  narrow.addEventListener('change', () => show(current));
  show(0);
}
