// Small helpers for the document.

export const byId = (id) => document.getElementById(id);

const SVG = 'http://www.w3.org/2000/svg';

function filled(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  node.append(...children);
  return node;
}

export const make = (tag, attributes = {}, ...children) =>
  filled(document.createElement(tag), attributes, children);

export const makeSvg = (tag, attributes = {}, ...children) =>
  filled(document.createElementNS(SVG, tag), attributes, children);

// Screen readers and the style engine are told only of what has changed.
export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

export const words = (name) => (name ? String(name).replaceAll('_', ' ') : '–');

// One child for each item of `items`, in their order, kept by its key: `create(item)` makes,
// `update(node, item)` fills it in. Nodes of keys that are gone are removed.
export function keyed(parent, items, keyOf, create, update = () => {}) {
  const known = (parent.known ??= new Map());
  const present = new Set();
  items.forEach((item, index) => {
    const key = keyOf(item);
    present.add(key);
    if (!known.has(key)) known.set(key, create(item));
    const node = known.get(key);
    if (parent.children[index] !== node) parent.insertBefore(node, parent.children[index] ?? null);
    update(node, item);
  });
  for (const [key, node] of known) {
    if (present.has(key)) continue;
    node.remove();
    known.delete(key);
  }
}

// Offer `values` in a <select>, keeping what is chosen as long as it is offered.
export function offer(select, values, nameOf = String) {
  const wanted = values.map(String).join('\n');
  if (select.dataset.offered === wanted) return;
  select.dataset.offered = wanted;
  const chosen = select.value;
  select.replaceChildren(...values.map((value) => make('option', { value }, nameOf(value))));
  if (values.map(String).includes(chosen)) select.value = chosen;
}
