// Steering by finger or mouse: dragging the knob of the page's stick.

// Of the stick's half width: where the knob is all the way out.
const REACH = 0.7;

export class Touch {
  constructor(node, sticks) {
    this.node = node;
    this.pointer = null;
    this.at = [0, 0];
    node.addEventListener('pointerdown', (event) => {
      if (event.button !== 0 || this.pointer !== null) return;
      this.pointer = event.pointerId;
      node.setPointerCapture(event.pointerId);
      this.#follow(event);
    });
    node.addEventListener('pointermove', (event) => {
      if (event.pointerId === this.pointer) this.#follow(event);
    });
    for (const type of ['pointerup', 'pointercancel', 'lostpointercapture']) {
      node.addEventListener(type, (event) => {
        if (event.pointerId !== this.pointer) return;
        this.forget();
        sticks.settle();
      });
    }
    sticks.add(this);
  }

  value() {
    return this.at;
  }

  // The finger may lie where it is: only the next one that comes down is followed.
  forget() {
    this.pointer = null;
    this.at = [0, 0];
  }

  #follow({ clientX, clientY }) {
    const box = this.node.getBoundingClientRect();
    const half = REACH * box.width / 2;
    const right = (clientX - box.left - box.width / 2) / half;
    const up = -(clientY - box.top - box.height / 2) / half;
    const length = Math.max(Math.hypot(right, up), 1);
    this.at = [right / length, up / length];
  }
}
