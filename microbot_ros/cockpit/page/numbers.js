// Numbers as people read them, with their units; null is a dash.

export const known = (value) => typeof value === 'number' && Number.isFinite(value);

export const fixed = (value, digits) => (known(value) ? value.toFixed(digits).replace('-', '−') : '–');

export const withUnit = (value, digits, unit) =>
  (known(value) ? `${fixed(value, digits)}\u00a0${unit}` : '–');

// `value` ± `std` with as many digits as the uncertainty has.
export function measured(value, std, unit) {
  if (!known(value)) return '–';
  if (!known(std)) return withUnit(value, 2, unit);
  const digits = std > 0 ? Math.min(Math.max(1 - Math.floor(Math.log10(std)), 0), 4) : 2;
  return `${fixed(value, digits)} ± ${fixed(std, digits)}\u00a0${unit}`;
}

// An age: milliseconds up to two seconds, then seconds.
export const age = (ms) => (ms < 2000 ? withUnit(ms, 0, 'ms') : withUnit(ms / 1000, 0, 's'));

export function clock(seconds) {
  if (!known(seconds)) return '–';
  const whole = Math.floor(seconds);
  const two = (n) => String(n).padStart(2, '0');
  return `${two(Math.floor(whole / 60))}:${two(whole % 60)}`;
}
