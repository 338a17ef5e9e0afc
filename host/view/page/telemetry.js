// Ticks and solves of the last while, in arrays that are allocated once, and their reduction to what a plot has pixels
// for. Pure: no page is needed. Entry points: `Ring`, `reduce`.

import { MODES, NO_AGE } from './decode.js';

/** Modes in which the console renders a force. */
const RENDERS = ['armed', 'decaying'];

/** Of a live session [s]. */
export const KEPT_S = 60;

/** Rows in the order of their time; the oldest go when it is full. */
export class Ring {
  /** @param {number} capacity rows @param {string[]} names of the columns besides time */
  constructor(capacity, names) {
    this.capacity = capacity;
    this.time = new Float64Array(capacity);
    /** @type {Record<string, Float32Array>} */
    this.columns = {};
    for (const name of names) this.columns[name] = new Float32Array(capacity);
    this.length = 0;
    this.start = 0;
  }

  clear() {
    this.length = 0;
    this.start = 0;
  }

  /** Where row `i` is, from the oldest. @param {number} i */
  at(i) {
    const place = this.start + i;
    return place < this.capacity ? place : place - this.capacity;
  }

  /** Place of a new row. @param {number} time [s] */
  push(time) {
    if (this.length === this.capacity) this.start = this.at(1);
    else this.length += 1;
    const place = this.at(this.length - 1);
    this.time[place] = time;
    return place;
  }

  /** Place of the row of this time, or of a new one. @param {number} time [s] */
  row(time) {
    if (this.newest === null || time > this.newest) return this.push(time);
    const row = this.lower(time);
    return this.time[this.at(row)] === time ? this.at(row) : this.push(time);
  }

  /** A row of nothing, at which lines break. @param {number} time [s] */
  gap(time) {
    const place = this.push(time);
    for (const column of Object.values(this.columns)) column[place] = NaN;
  }

  get newest() {
    return this.length === 0 ? null : this.time[this.at(this.length - 1)];
  }

  get oldest() {
    return this.length === 0 ? null : this.time[this.at(0)];
  }

  /** The first row that is not before `time`. @param {number} time [s] */
  lower(time) {
    let low = 0;
    let high = this.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.time[this.at(middle)] < time) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** Value of a column at the row nearest to `time`; NaN if there is none. @param {string} name @param {number} time */
  value(name, time) {
    if (this.length === 0) return NaN;
    const after = this.lower(time);
    const before = Math.max(after - 1, 0);
    const last = Math.min(after, this.length - 1);
    const nearest = time - this.time[this.at(before)] <= this.time[this.at(last)] - time ? before : last;
    return this.columns[name][this.at(nearest)];
  }
}

/**
 * Columns between two times: every row if they are few, else least and largest of every pixel, in the order in which
 * they came. Nothing (`null`) breaks a line.
 * @param {Ring} ring
 * @param {string[]} names
 * @param {number} from [s]
 * @param {number} to [s]
 * @param {number} pixels
 * @returns {[number[], ...(number | null)[][]]} times, then each column
 */
export function reduce(ring, names, from, to, pixels) {
  const first = Math.max(ring.lower(from) - 1, 0);
  const last = Math.min(ring.lower(to) + 1, ring.length);
  /** @type {number[]} */
  const times = [];
  const values = names.map(() => /** @type {(number | null)[]} */ ([]));
  if (last - first <= 2 * pixels) {
    for (let i = first; i < last; i += 1) {
      const place = ring.at(i);
      times.push(ring.time[place]);
      names.forEach((name, n) => values[n].push(known(ring.columns[name][place])));
    }
    return [times, ...values];
  }
  const width = (to - from) / pixels;
  let row = first;
  for (let pixel = 0; pixel < pixels && row < last; pixel += 1) {
    const begin = row;
    const end_s = pixel === pixels - 1 ? Infinity : from + (pixel + 1) * width;
    while (row < last && ring.time[ring.at(row)] < end_s) row += 1;
    if (row === begin) continue;
    const middle = ring.at(begin + ((row - begin) >> 1));
    times.push(ring.time[ring.at(begin)], ring.time[middle]);
    names.forEach((name, n) => extremes(ring, ring.columns[name], begin, row, values[n]));
  }
  return [times, ...values];
}

/** @param {Ring} ring @param {Float32Array} column @param {number} begin @param {number} end @param {(number | null)[]} into */
function extremes(ring, column, begin, end, into) {
  let [low, high] = [Infinity, -Infinity];
  let [lowAt, highAt] = [0, 0];
  let broken = false;
  for (let i = begin; i < end; i += 1) {
    const value = column[ring.at(i)];
    if (!Number.isFinite(value)) {
      broken = true;
      continue;
    }
    if (value < low) [low, lowAt] = [value, i];
    if (value > high) [high, highAt] = [value, i];
  }
  if (low > high) into.push(null, null);
  else if (broken && low === high) into.push(low, null);
  else if (lowAt <= highAt) into.push(low, high);
  else into.push(high, low);
}

/** @param {number} value */
function known(value) {
  return Number.isFinite(value) ? value : null;
}

/**
 * As text with a line for each row; units are in the names.
 * @param {Ring} ring
 * @param {string[]} names
 * @param {number} from [s]
 * @param {number} to [s]
 */
export function csv(ring, names, from, to) {
  const lines = [['time_s', ...names].join(',')];
  const last = ring.lower(to + 1e-9);
  for (let i = ring.lower(from - 1e-9); i < last; i += 1) {
    const place = ring.at(i);
    const cells = names.map((name) => String(ring.columns[name][place]));
    lines.push([ring.time[place].toFixed(6), ...cells].join(','));
  }
  return `${lines.join('\n')}\n`;
}

const TICK_COLUMNS = [
  'tick', 'x_m', 'y_m', 'z_m', 'force_x_n', 'force_y_n', 'force_z_n', 'force_n', 'age_ms', 'latency_ms', 'mode', 'faults',
];

/** What the host has said about ticks and solves of this session. */
export class Telemetry {
  /**
   * @param {string[]} stages
   * @param {number} needles
   * @param {number} threads
   * @param {number} seconds
   * @param {number} tick_hz
   */
  constructor(stages, needles, threads, seconds, tick_hz) {
    this.stages = stages;
    this.needles = needles;
    this.threads = threads;
    /** Blocks that have come. */
    this.blocks = 0;
    const rows = Math.ceil(Math.min(seconds * tick_hz, 1e6)) + 64;
    this.ticks = new Ring(rows, TICK_COLUMNS);
    this.stageColumns = stages.map((stage) => `${stage}_us`);
    this.needleColumns = Array.from({ length: needles }, (_, i) => `needle_${i}_axial_n`);
    this.threadColumns = Array.from({ length: threads }, (_, i) => [`thread_${i}_tail_n`, `thread_${i}_head_n`]).flat();
    // What is drawn as a stack: each stage with all before it, the rest on top.
    this.stack = [...stages, 'rest'].map((stage) => `upto_${stage}_ms`);
    this.solves = new Ring(rows, [
      'status', 'step_us', ...this.stageColumns, 'rest_us', ...this.stack, 'rows', 'iterations', 'energy_mj', 'gap_mm',
      ...this.needleColumns, ...this.threadColumns,
    ]);
  }

  /** @param {import('./decode.js').Ticks} block */
  addTicks(block) {
    this.blocks += 1;
    const { columns } = this.ticks;
    if (block.gap && block.rows > 0 && this.ticks.length > 0) this.ticks.gap(block.time[0]);
    for (let i = 0; i < block.rows; i += 1) {
      const place = this.ticks.push(block.time[i]);
      const [x, y, z] = block.force.subarray(3 * i, 3 * i + 3);
      columns.tick[place] = block.tick[i];
      columns.x_m[place] = block.position[3 * i];
      columns.y_m[place] = block.position[3 * i + 1];
      columns.z_m[place] = block.position[3 * i + 2];
      columns.force_x_n[place] = x;
      columns.force_y_n[place] = y;
      columns.force_z_n[place] = z;
      columns.force_n[place] = Math.hypot(x, y, z);
      // Where no force is rendered, none has an age.
      columns.age_ms[place] = block.age[i] === NO_AGE || !RENDERS.includes(MODES[block.mode[i]]) ? NaN : block.age[i] / 1000;
      columns.latency_ms[place] = block.applied[i] === NO_AGE ? NaN : block.applied[i] / 1000;
      columns.mode[place] = block.mode[i];
      columns.faults[place] = block.faults[i];
    }
  }

  /**
   * Rows that are there already are written over: a recording in lockstep says no times, and is timed when it is run again.
   * @param {import('./decode.js').Solves} block
   */
  addSolves(block) {
    this.blocks += 1;
    const { columns } = this.solves;
    if (block.gap && block.rows > 0 && this.solves.length > 0) this.solves.gap(block.time[0]);
    for (let i = 0; i < block.rows; i += 1) {
      const place = block.gap ? this.solves.push(block.time[i]) : this.solves.row(block.time[i]);
      columns.status[place] = block.status[i];
      columns.step_us[place] = block.step[i];
      columns.rows[place] = block.touched[i];
      columns.iterations[place] = block.iterations[i];
      columns.energy_mj[place] = 1000 * block.energy[i];
      columns.gap_mm[place] = 1000 * block.gapTo[i];
      this.addStages(block, i, place);
      this.needleColumns.forEach((name, n) => {
        columns[name][place] = block.axial[n * block.rows + i] ?? NaN;
      });
      this.threadColumns.forEach((name, n) => {
        columns[name][place] = block.tension[n * block.rows + i] ?? NaN;
      });
    }
  }

  /** @param {import('./decode.js').Solves} block @param {number} i @param {number} place */
  addStages(block, i, place) {
    const { columns } = this.solves;
    let sum = 0;
    this.stageColumns.forEach((name, stage) => {
      // Solves of a recording may have none.
      const value = block.stages[stage * block.rows + i] || 0;
      columns[name][place] = value;
      sum += value;
      columns[this.stack[stage]][place] = sum / 1000;
    });
    columns.rest_us[place] = block.step[i] - sum;
    columns[this.stack[this.stack.length - 1]][place] = Math.max(block.step[i], sum) / 1000;
  }

  /** Names of columns that are the host's, in the order of a table. */
  get solveNames() {
    return Object.keys(this.solves.columns).filter((name) => !this.stack.includes(name));
  }
}
