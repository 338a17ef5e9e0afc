// Numbers as people read them: with a prefix where that shortens them, and always as many digits.

const PREFIXES = /** @type {[number, string][]} */ ([
  [1e9, 'G'], [1e6, 'M'], [1e3, 'k'], [1, ''], [1e-3, 'm'], [1e-6, 'µ'], [1e-9, 'n'],
]);

/**
 * Factor and unit in which values up to `largest` are read.
 * @param {number} largest
 * @param {string} unit
 * @returns {{factor: number, unit: string}}
 */
export function scaleFor(largest, unit) {
  const size = Math.abs(largest);
  if (!(size > 0) || !Number.isFinite(size)) return { factor: 1, unit };
  const [factor, prefix] = PREFIXES.find(([least]) => size >= least * 0.9999) ?? PREFIXES[PREFIXES.length - 1];
  return { factor, unit: prefix + unit };
}

/** @param {number | null | undefined} value @param {number} digits after the point */
export function fixed(value, digits) {
  if (value === null || value === undefined || !Number.isFinite(value)) return '–';
  const text = value.toFixed(digits);
  return Number(text) === 0 ? text.replace('-', '') : text.replace('-', '−');
}

/** Words for a name that the host uses in its commands. @param {string} name */
export function words(name) {
  return name.replace(/[-_]/g, ' ').replace(/\bhz\b/, 'Hz').replace(/\bmises\b/, 'Mises').replace(/\byoungs\b/, 'Young\'s');
}

/** Three significant digits. @param {number} value */
export function short(value) {
  if (!Number.isFinite(value)) return '–';
  if (value === 0) return '0';
  const digits = Math.max(0, 2 - Math.floor(Math.log10(Math.abs(value))));
  return fixed(value, Math.min(digits, 6));
}

/** The largest of 1, 2, 5 times a power of ten that is not above `value`. @param {number} value */
export function round125(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  const step = [5, 2, 1].find((one) => one * power <= value * 1.0001) ?? 1;
  return step * power;
}
