// A quantity and its ± σ over the last minute, drawn by uPlot.

import { known } from '../numbers.js';

const SPAN_S = 60;
const HEIGHT = 120;

export class Curve {
  constructor(node, colour) {
    this.node = node;
    this.colour = colour;
    this.data = [[], [], [], []];
    new ResizeObserver(() => this.#make()).observe(node);
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.#make());
  }

  // Rows of [seconds on the page's clock, value, σ]; a value that is not known leaves a gap.
  fill(rows) {
    const shown = rows.filter(([t]) => t >= rows.at(-1)[0] - SPAN_S);
    const bound = (sign) => shown.map(([, value, std]) => (
      known(value) ? value + sign * (known(std) ? std : 0) : null));
    this.data = [shown.map(([t]) => t), bound(0), bound(-1), bound(1)];
    if (this.node.offsetParent) this.#show();
  }

  // Seconds before the newest.
  #show() {
    const [t, ...columns] = this.data;
    this.plot?.setData([t.map((one) => one - t.at(-1)), ...columns]);
  }

  #make() {
    const width = this.node.clientWidth;
    if (!width || (this.plot?.width === width && this.dark === isDark())) return;
    this.dark = isDark();
    this.plot?.destroy();
    this.plot = new uPlot(this.#options(width), [[], [], [], []], this.node);
    this.#show();
  }

  #options(width) {
    const style = getComputedStyle(document.body);
    const ink = style.getPropertyValue('--quiet');
    const line = style.getPropertyValue(this.colour);
    const axis = { stroke: ink, grid: { stroke: style.getPropertyValue('--line'), width: 1 },
      ticks: { show: false }, font: '12px system-ui, sans-serif' };
    const side = { stroke: line, width: 0.5, points: { show: false } };
    return {
      width, height: HEIGHT, legend: { show: false }, cursor: { show: false },
      scales: { x: { time: false, range: [-SPAN_S, 0] }, y: { range: room } },
      axes: [{ ...axis, size: 24, values: (_, ticks) => ticks.map(ago) },
        { ...axis, size: 48, space: 24 }],
      series: [{}, { stroke: line, width: 2, points: { show: false } }, side, side],
      bands: [{ series: [3, 2], fill: `color-mix(in srgb, ${line} 18%, transparent)` }],
    };
  }
}

const isDark = () => matchMedia('(prefers-color-scheme: dark)').matches;

const ago = (tick) => `${tick} s`.replace('-', '−');

// Some air above and below, also where nothing moves.
function room(_, low, high) {
  if (low == null) return [0, 1];
  const air = Math.max(0.15 * (high - low), 0.02 * Math.abs(high), 0.01);
  return [low - air, high + air];
}
