// Who may do what now: everything that needs control is off for viewers and without a link.

import { byId } from '../dom.js';
import { order } from '../messages.js';

export class Control {
  constructor(link) {
    this.link = link;
    this.mine = false;
    this.steering = false;
    byId('take-control').onclick = () => order(link, 'Control', 'take_control');
    link.on('state', (state) => this.#hear(state));
    link.on('lost', () => this.#hear({}));
    this.#apply();
  }

  #hear({ control, controller }) {
    this.mine = Boolean(control?.mine);
    this.steering = this.mine && Boolean(controller?.takes?.includes('joystick'));
    byId('take-control').hidden = !control || this.mine;
    this.#apply();
  }

  #apply() {
    document.body.classList.toggle('lost', !this.link.up);
    document.body.classList.toggle('viewer', this.link.up && !this.mine);
    for (const node of document.querySelectorAll('[data-needs]')) {
      const allowed = node.dataset.needs === 'steering' ? this.steering : this.mine;
      if (node.disabled === allowed) node.disabled = !allowed;
    }
  }
}
