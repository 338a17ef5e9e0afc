// Colour maps and the range that they span. Colours are sRGB, 0 to 255.

/** Viridis (CC0) at 16 even places. */
const VIRIDIS = [
  [68, 1, 84], [72, 26, 108], [71, 47, 125], [65, 68, 135], [57, 86, 140], [49, 104, 142], [42, 120, 142], [35, 136, 142],
  [31, 152, 139], [34, 168, 132], [53, 183, 121], [84, 197, 104], [122, 209, 81], [165, 219, 54], [210, 226, 27], [253, 231, 37],
];

/** Blue, white, red: white is 0. */
const SIGNED = [
  [5, 48, 97], [33, 102, 172], [67, 147, 195], [146, 197, 222], [247, 247, 247], [244, 165, 130], [214, 96, 77], [178, 24, 43],
  [103, 0, 31],
];

/** Colours in a map's texture. */
export const STEPS = 256;

/**
 * Colour at `x` from 0 to 1.
 * @param {boolean} signed
 * @param {number} x
 * @returns {[number, number, number]}
 */
export function colourAt(signed, x) {
  const points = signed ? SIGNED : VIRIDIS;
  const place = Math.min(Math.max(x, 0), 1) * (points.length - 1);
  const below = Math.min(Math.floor(place), points.length - 2);
  const part = place - below;
  const mixed = points[below].map((value, i) => Math.round(value + part * (points[below + 1][i] - value)));
  return [mixed[0], mixed[1], mixed[2]];
}

/** All colours of a map, red, green, blue, 255. @param {boolean} signed */
export function colourTable(signed) {
  const table = new Uint8Array(4 * STEPS);
  for (let i = 0; i < STEPS; i += 1) table.set([...colourAt(signed, i / (STEPS - 1)), 255], 4 * i);
  return table;
}

/** What values the ends of the map stand for: fixed by hand, or the largest 98th percentile so far. */
export class Range {
  constructor() {
    /** @type {[number, number] | null} */
    this.fixed = null;
    this.held = 0;
    this.signed = false;
    this.scratch = new Float32Array(0);
  }

  /** @param {boolean} signed */
  restart(signed) {
    this.held = 0;
    this.signed = signed;
  }

  /** Takes a picture's values into account. @param {Float32Array} values */
  see(values) {
    if (this.fixed || values.length === 0) return;
    if (this.scratch.length !== values.length) this.scratch = new Float32Array(values.length);
    for (let i = 0; i < values.length; i += 1) this.scratch[i] = Math.abs(values[i]);
    this.scratch.sort();
    const percentile = this.scratch[Math.floor(0.98 * (values.length - 1))];
    if (Number.isFinite(percentile)) this.held = Math.max(this.held, percentile);
  }

  /** @returns {[number, number]} */
  get ends() {
    if (this.fixed) return this.fixed;
    const high = this.held || 1e-12;
    return [this.signed ? -high : 0, high];
  }
}
