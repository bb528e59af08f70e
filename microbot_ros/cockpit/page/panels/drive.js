// The controller: which one, and its parameters as their descriptors say.

import { byId, keyed, make, offer, setText, words } from '../dom.js';
import { order } from '../messages.js';
import { fixed, known } from '../numbers.js';

// As a limit it means none.
const LARGEST = 2 ** 31 - 1;

export class Drive {
  constructor(link) {
    this.link = link;
    byId('controller-form').onsubmit = (event) => {
      event.preventDefault();
      const name = byId('controller').value;
      order(link, `Switch to ${words(name)}`, 'switch_controller', { name });
    };
    link.on('state', ({ controller, rig }) => this.#hear(controller, rig === 'armed'));
  }

  #hear(controller, armed) {
    if (!controller) return;
    const { name, available, parameters, takes } = controller;
    const summaries = new Map((available ?? []).map((one) => [one.name, one.summary]));
    offer(byId('controller'), [...summaries.keys()], (one) => `${summaries.get(one).replace(/\.$/, '')}: ${words(one)}`);
    if (name !== this.name) {
      this.name = name;
      byId('controller').value = name;
    }
    setText(byId('controller-about'), byId('controller').value === name ? '' : summaries.get(byId('controller').value) ?? '');
    setText(byId('controller-now'),
      name ? `At work: ${words(name)}. ${summaries.get(name) ?? ''}` : 'No controller has reported yet.');
    setText(byId('stick-hint'), takes?.includes('joystick')
      ? 'Drag, or focus it and hold arrow keys or W A S D. A gamepad’s left stick steers too, its buttons stop. Let go, and the field goes to zero.'
      : 'This controller does not use the stick: switch to teleop first.');
    const { distance_um, done, driven, goal, sentence } = controller;
    const left = armed && known(distance_um) ? `${fixed(distance_um, 1)} µm to ${goal == null ? 'go' : `goal ${goal + 1}`}.` : sentence && `Status: ${sentence}.`;
    setText(byId('going'), [driven?.length && `Drives particle ${driven.join(', ')}.`, done ? 'Arrived.' : left].filter(Boolean).join(' '));
    const all = (parameters ?? []).toSorted((a, b) => Boolean(a.read_only) - Boolean(b.read_only));
    const basic = (one) => !one.read_only && one.name.startsWith(`${name}.`);
    for (const [place, rows] of [['parameters', all.filter(basic)], ['parameters-all', all.filter((one) => !basic(one))]]) {
      keyed(byId(place), rows, (one) => `${name} ${one.name} ${one.type}`, (one) => this.#row(one), update);
    }
  }

  #row(parameter) {
    const { name, description, read_only } = parameter;
    const input = field(parameter);
    input.disabled = Boolean(read_only);
    const id = `parameter-${name}`;
    input.id = id;
    input.setAttribute('aria-describedby', `${id}-about`);
    input.oninput = () => { row.dataset.draft = 'yes'; };
    const row = make('form', { class: 'parameter', novalidate: '' },
      make('label', { for: id, title: name }, label(parameter)),
      input.type === 'checkbox' ? make('label', { class: 'tick' }, input) : input,
      make('button', { type: 'submit' }, 'Set'),
      make('p', { class: 'hint', id: `${id}-about` }, description ?? '', read_only ? ' Fixed at start-up.' : '', make('span', { class: 'limits' }, limits(parameter))));
    row.querySelector('button').hidden = Boolean(read_only);
    row.onsubmit = async (event) => {
      event.preventDefault();
      const value = valueOf(input, row.parameter);
      delete row.dataset.draft;
      await order(this.link, `Set ${name}`, 'set', { name, value });
      update(row, row.parameter);
    };
    return row;
  }
}

// 'waypoint.stop_within_um' in µm is 'stop within [µm]'.
function label({ name, unit }) {
  const last = name.slice(name.lastIndexOf('.') + 1);
  if (!unit) return words(last);
  const spelt = unit.replace('µ', 'u').replace('°', 'deg').replace('²', '2').replace(/[/·\s]+/g, '_(per_)?');
  return `${words(last.replace(new RegExp(`_${spelt}$`, 'i'), ''))} [${unit}]`;
}

function field({ type, minimum, maximum, choices }) {
  if (choices) return make('select', {}, ...choices.map((one) => make('option', {}, one)));
  if (type === 'boolean') return make('input', { type: 'checkbox' });
  if (type !== 'integer' && type !== 'number') return make('input', { type: 'text' });
  const input = make('input', { type: 'number', step: type === 'integer' ? '1' : 'any' });
  if (minimum != null) input.min = minimum;
  if (maximum != null) input.max = maximum;
  return input;
}

function limits({ minimum, maximum }) {
  if (maximum >= LARGEST) return ` At least ${minimum}.`;
  return minimum != null && maximum != null ? ` From ${minimum} to ${maximum}.` : '';
}

// What is being typed stays; everything else shows the value that is in force.
function update(row, parameter) {
  row.parameter = parameter;
  const input = row.querySelector('input, select');
  if (row.dataset.draft || (parameter.value ?? null) === null) return;
  if (input.type === 'checkbox') input.checked = parameter.value;
  else if (input.value !== text(parameter.value)) input.value = text(parameter.value);
}

const text = (value) => (Array.isArray(value) ? value.join(', ') : String(value));

// The node checks it: a number that is none goes out as the text that was typed.
function valueOf(input, { type }) {
  if (input.type === 'checkbox') return input.checked;
  if (input.type === 'number') return input.value === '' ? '' : Number(input.value);
  if (type !== 'numbers' && type !== 'texts') return input.value;
  const parts = input.value.split(',').map((part) => part.trim()).filter(Boolean);
  return type === 'texts' ? parts : parts.map((part) => (Number.isFinite(Number(part)) ? Number(part) : part));
}
