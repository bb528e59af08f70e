// A gamepad: its left stick steers, any button but those of the cross stops.

const DEAD = 0.15;
const CROSS = new Set([12, 13, 14, 15]);

export class Gamepads {
  constructor(sticks, stop) {
    // By index: pads that were at rest since they came or were interrupted.
    this.rested = new Set();
    this.buttons = new Map();
    setInterval(() => this.#watchButtons(stop), 20);
    sticks.add(this);
  }

  value() {
    let first = [0, 0];
    const here = pads();
    for (const index of this.rested) {
      if (!here.some((pad) => pad.index === index)) this.rested.delete(index);
    }
    for (const { index, axes: [right = 0, down = 0] } of here) {
      const atRest = !(Math.hypot(right, down) > DEAD);
      if (atRest) this.rested.add(index);
      else if (this.rested.has(index) && !first.some(Boolean)) first = [right, -down];
    }
    return first;
  }

  forget() {
    this.rested.clear();
  }

  #watchButtons(stop) {
    for (const { index, buttons } of pads()) {
      const down = buttons.some(({ pressed }, button) => pressed && !CROSS.has(button));
      if (down && !this.buttons.get(index)) stop();
      this.buttons.set(index, down);
    }
  }
}

const pads = () => [...navigator.getGamepads()].filter((pad) => pad?.connected);
