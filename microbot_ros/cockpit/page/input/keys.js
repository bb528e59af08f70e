// Steering by arrow keys or W A S D while the stick of the page is focused.

const AXES = {
  ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1],
  KeyA: [-1, 0], KeyD: [1, 0], KeyW: [0, 1], KeyS: [0, -1],
};

export class Keys {
  constructor(node, sticks) {
    this.pressed = new Set();
    node.addEventListener('keydown', (event) => {
      if (!AXES[event.code] || event.ctrlKey || event.altKey || event.metaKey) return;
      event.preventDefault();
      // What the keyboard repeats was pressed before something interrupted: no new press.
      if (!event.repeat) this.pressed.add(event.code);
    });
    window.addEventListener('keyup', (event) => {
      if (this.pressed.delete(event.code)) sticks.settle();
    }, true);
    node.addEventListener('blur', () => {
      this.forget();
      sticks.settle();
    });
    sticks.add(this);
  }

  value() {
    const codes = [...this.pressed];
    return [0, 1].map((axis) => codes.reduce((sum, code) => sum + AXES[code][axis], 0));
  }

  forget() {
    this.pressed.clear();
  }
}
