// Plots of telemetry below the picture. Entry point: `Plots`.

import uPlot from 'uplot';
import { reduce } from './telemetry.js';
import { fixed } from './units.js';

/** Redrawn at most so often [ms]. */
const EVERY_MS = 100;
const WINDOWS = { shortest: 0.2, longest: 60 };
const AXES = { x: '#ff7b72', y: '#7ee787', z: '#79c0ff', all: '#e6edf3' };
const STAGES = ['#4e79a7', '#76b7b2', '#59a14f', '#edc948', '#f28e2b', '#e15759', '#b07aa1', '#9c755f', '#ff9da7'];
const REST = '#8b96a5';
const LINES = ['#79c0ff', '#ffb86b', '#7ee787', '#d2a8ff', '#ff7b72', '#f2cc60'];
const EVENTS = /** @type {Record<string, string>} */ ({
  armed: '#7ee787', disarmed: '#8b96a5', decay: '#ffb86b', fault: '#ff6b61', puncture: '#d2a8ff', lost: '#ff6b61', back: '#7ee787',
  overload: '#ffb86b',
});

/**
 * @typedef {object} Series
 * @property {string} name column
 * @property {string} label
 * @property {string} colour
 */

/**
 * @typedef {object} Panel
 * @property {string} title with the unit
 * @property {(telemetry: import('./telemetry.js').Telemetry) => import('./telemetry.js').Ring} ring
 * @property {Series[]} series
 * @property {number} digits
 * @property {boolean} stacked
 * @property {number} [top] of what is shown of a stack
 */

/** @param {import('./telemetry.js').Telemetry} telemetry @param {boolean} again whether times of steps are those of running them again @returns {Panel[]} */
function panels(telemetry, again) {
  const ticks = (/** @type {import('./telemetry.js').Telemetry} */ all) => all.ticks;
  const solves = (/** @type {import('./telemetry.js').Telemetry} */ all) => all.solves;
  /** @type {Panel[]} */
  const found = [
    {
      title: 'Force on the grip [N]', ring: ticks, digits: 2, stacked: false,
      series: [
        { name: 'force_x_n', label: 'x', colour: AXES.x },
        { name: 'force_y_n', label: 'y', colour: AXES.y },
        { name: 'force_z_n', label: 'z', colour: AXES.z },
        { name: 'force_n', label: '|F|', colour: AXES.all },
      ],
    },
    {
      title: 'Age and latency [ms]', ring: ticks, digits: 1, stacked: false,
      series: [
        { name: 'age_ms', label: 'age', colour: '#f2cc60' },
        { name: 'latency_ms', label: 'latency', colour: '#79c0ff' },
      ],
    },
    {
      title: 'Stored energy [mJ]', ring: solves, digits: 3, stacked: false,
      series: [{ name: 'energy_mj', label: 'elastic', colour: '#7ee787' }],
    },
    {
      title: again ? 'Step by stage, run again [ms]' : 'Step by stage [ms]', ring: solves, digits: 2, stacked: true,
      series: [...telemetry.stages, 'rest'].map((stage, i) => ({
        name: telemetry.stack[i], label: stage, colour: stage === 'rest' ? REST : STAGES[i % STAGES.length],
      })),
    },
  ];
  const seam = [
    ...telemetry.needleColumns.map((name, i) => ({ name, label: telemetry.needles > 1 ? `needle ${i}` : 'needle' })),
    ...telemetry.threadColumns.map((name, i) => ({ name, label: i % 2 === 0 ? 'tail' : 'head' })),
  ];
  if (seam.length > 0) {
    found.push({
      title: 'Needle and thread [N]', ring: solves, digits: 2, stacked: false,
      series: seam.map((one, i) => ({ ...one, colour: LINES[i % LINES.length] })),
    });
  }
  return found;
}

export class Plots {
  /** @param {HTMLElement} element @param {(a: number | null, b: number | null) => void} onMarks */
  constructor(element, onMarks) {
    this.element = element;
    this.onMarks = onMarks;
    /** @type {{panel: Panel, plot: uPlot, values: HTMLElement[], box: HTMLElement, title: HTMLElement}[]} */
    this.list = [];
    /** @type {import('./telemetry.js').Telemetry | null} */
    this.telemetry = null;
    this.window_s = 10;
    /** What is shown while it does not follow [s]. @type {[number, number] | null} */
    this.held = null;
    /** Of a recording: all of it. @type {[number, number] | null} */
    this.whole = null;
    /** Where the time line stands [s]. @type {number | null} */
    this.play_s = null;
    /** @type {{a: number | null, b: number | null}} marks to be compared [s] */
    this.marks = { a: null, b: null };
    /** @type {{time_s: number, what: string}[]} */
    this.events = [];
    this.drawn = 0;
    /** Newest time that has been drawn [s]. @type {number | null} */
    this.newest = null;
    /** What has been drawn: nothing else is drawn for it again. */
    this.shown = '';
    this.sync = uPlot.sync('plots');
    new ResizeObserver(() => this.resize()).observe(element);
  }

  /** @param {import('./telemetry.js').Telemetry} telemetry @param {boolean} again whether times of steps are those of running them again */
  start(telemetry, again) {
    for (const { plot } of this.list) plot.destroy();
    this.element.replaceChildren();
    this.telemetry = telemetry;
    this.held = null;
    this.events = [];
    this.newest = null;
    this.mark(null, null);
    this.list = panels(telemetry, again).map((panel) => this.make(panel));
    this.resize();
  }

  /** @param {Panel} panel */
  make(panel) {
    const box = document.createElement('figure');
    box.className = 'plot';
    box.classList.toggle('stacked', panel.stacked);
    const caption = document.createElement('figcaption');
    const title = document.createElement('span');
    title.className = 'title';
    title.textContent = panel.title;
    caption.append(title);
    const values = panel.series.map((series) => {
      const label = document.createElement('span');
      label.className = 'value';
      label.title = series.label;
      const swatch = document.createElement('i');
      swatch.style.background = series.colour;
      const text = document.createElement('b');
      label.append(swatch, `${series.label} `, text);
      caption.append(label);
      return text;
    });
    box.append(caption);
    this.element.append(box);
    const plot = new uPlot(this.options(panel), [[], ...panel.series.map(() => [])], box);
    plot.over.addEventListener('wheel', (event) => this.wheel(event, plot), { passive: false });
    plot.over.addEventListener('click', (event) => this.click(event, plot));
    plot.over.addEventListener('dblclick', () => this.follow());
    return { panel, plot, values, box, title };
  }

  /** @param {Panel} panel @returns {uPlot.Options} */
  options(panel) {
    const axis = { stroke: '#a4afbc', grid: { stroke: '#242b34', width: 1 }, ticks: { stroke: '#242b34', width: 1, size: 4 }, font: '11px system-ui, "DejaVu Sans", sans-serif' };
    // Of a stack, the highest first: what is drawn later covers it.
    const series = panel.series.map((one) => ({
      label: one.label, stroke: one.colour, width: panel.stacked ? 0 : 1.25, points: { show: false }, spanGaps: false,
      fill: panel.stacked ? one.colour : undefined,
    }));
    return {
      width: 300, height: 150, legend: { show: false }, pxAlign: 0,
      cursor: { sync: { key: 'plots' }, drag: { x: false, y: false }, points: { show: false } },
      scales: { x: { time: false, range: () => this.range() }, y: { range: (_, low, high) => limits(low, panel.top ?? high, panel.stacked) } },
      series: [{}, ...(panel.stacked ? series.reverse() : series)],
      axes: [
        { ...axis, size: 24, space: 60, values: (_, ticks) => ticks.map((tick) => `${Number(tick.toFixed(3))}`) },
        { ...axis, size: 42, space: 26 },
      ],
      hooks: { draw: [(plot) => this.drawMarks(plot)], setCursor: [() => this.showValues()] },
    };
  }

  /** @returns {[number, number]} [s] */
  range() {
    if (this.held) return this.held;
    if (this.whole) return this.whole;
    const newest = Math.max(this.telemetry?.ticks.newest ?? 0, this.telemetry?.solves.newest ?? 0);
    return [Math.max(0, newest - this.window_s), Math.max(newest, this.window_s)];
  }

  /** Follows the session again. */
  follow() {
    this.held = null;
    this.redraw(true);
  }

  get paused() {
    return this.held !== null;
  }

  /** @param {boolean} paused */
  pause(paused) {
    this.held = paused ? this.range() : null;
    this.redraw(true);
  }

  /** Redraws if there is something new, it is time to and anybody can see it. @param {boolean} [now] */
  redraw(now = false) {
    const time = performance.now();
    if (!this.telemetry || (!now && time - this.drawn < EVERY_MS) || document.hidden) return;
    const [from, to] = this.range();
    const shown = [from, to, this.play_s, this.events.length, this.telemetry.blocks].join();
    if (!now && shown === this.shown) {
      this.showValues();
      return;
    }
    this.shown = shown;
    this.drawn = time;
    for (const { panel, plot, title } of this.list) {
      const ring = panel.ring(this.telemetry);
      const names = panel.series.map((series) => series.name);
      if (panel.stacked) names.reverse();
      const pixels = Math.max(50, Math.floor(plot.over.clientWidth));
      const data = reduce(ring, names, from, to, pixels);
      if (panel.stacked) this.cutPeaks(panel, title, data[1]);
      plot.setData(/** @type {uPlot.AlignedData} */ (data));
    }
    this.newest = this.telemetry.ticks.newest;
    this.showValues();
  }

  /**
   * One late step in a thousand would leave nothing to see of all others: it is cut off, and its height is said.
   * @param {Panel} panel
   * @param {HTMLElement} title
   * @param {(number | null)[]} totals
   */
  cutPeaks(panel, title, totals) {
    const sorted = totals.filter((value) => value !== null).sort((a, b) => a - b);
    const peak = sorted[sorted.length - 1] ?? 0;
    const usual = sorted[Math.floor(0.95 * (sorted.length - 1))] ?? 0;
    const cut = usual > 0 && peak > 4 * usual;
    panel.top = cut ? 4 * usual : undefined;
    title.textContent = cut ? `${panel.title}, peak ${fixed(peak, 1)}` : panel.title;
  }

  /** Values at the cursor, or the newest; with two marks, their difference. */
  showValues() {
    if (!this.telemetry) return;
    const { a, b } = this.marks;
    for (const { panel, plot, values } of this.list) {
      const ring = panel.ring(this.telemetry);
      const left = plot.cursor.left ?? -1;
      const time = left >= 0 ? plot.posToVal(left, 'x') : (this.play_s ?? this.held?.[1] ?? ring.newest ?? 0);
      panel.series.forEach((series, i) => {
        const below = panel.stacked && i > 0 ? panel.series[i - 1].name : null;
        const at = (/** @type {number} */ when) => ring.value(series.name, when) - (below ? ring.value(below, when) : 0);
        const value = a !== null && b !== null ? at(b) - at(a) : at(time);
        values[i].textContent = (a !== null && b !== null ? 'Δ' : '') + fixed(value, panel.digits);
      });
    }
  }

  /** @param {uPlot} plot */
  drawMarks(plot) {
    const { ctx, bbox } = plot;
    const line = (/** @type {number} */ time, /** @type {string} */ colour, /** @type {number[]} */ dash) => {
      const x = plot.valToPos(time, 'x', true);
      if (x < bbox.left || x > bbox.left + bbox.width) return;
      ctx.strokeStyle = colour;
      ctx.setLineDash(dash);
      ctx.beginPath();
      ctx.moveTo(x, bbox.top);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
    };
    ctx.save();
    ctx.lineWidth = devicePixelRatio;
    for (const event of this.events) if (EVENTS[event.what]) line(event.time_s, EVENTS[event.what], [2, 3]);
    if (this.marks.a !== null) line(this.marks.a, '#ffffff', []);
    if (this.marks.b !== null) line(this.marks.b, '#ffffff', [6, 3]);
    if (this.play_s !== null) line(this.play_s, '#5aa9e6', []);
    ctx.restore();
  }

  /** @param {WheelEvent} event @param {uPlot} plot */
  wheel(event, plot) {
    event.preventDefault();
    const factor = event.deltaY > 0 ? 1.25 : 0.8;
    const [from, to] = this.range();
    const length = Math.min(Math.max((to - from) * factor, WINDOWS.shortest), WINDOWS.longest);
    if (this.held || this.whole) {
      const at = plot.posToVal(plot.cursor.left ?? 0, 'x');
      const part = (at - from) / (to - from);
      this.held = [at - part * length, at + (1 - part) * length];
    } else {
      this.window_s = length;
    }
    this.redraw(true);
  }

  /** A click marks A; with Shift, B. @param {MouseEvent} event @param {uPlot} plot */
  click(event, plot) {
    const time = plot.posToVal(event.offsetX, 'x');
    if (event.shiftKey) this.mark(this.marks.a, time);
    else this.mark(time, null);
    if (!this.held && !this.whole) this.pause(true);
    this.redraw(true);
  }

  /** @param {number | null} a @param {number | null} b [s] */
  mark(a, b) {
    this.marks = { a, b };
    this.onMarks(a, b);
  }

  resize() {
    for (const { plot, box } of this.list) {
      const caption = box.firstElementChild instanceof HTMLElement ? box.firstElementChild.offsetHeight : 0;
      const height = Math.max(60, this.element.clientHeight - caption - 2);
      plot.setSize({ width: Math.max(80, box.clientWidth - 6), height });
    }
    this.redraw(true);
  }

  /** All plots on one canvas. */
  canvas() {
    const ratio = devicePixelRatio;
    const { clientWidth: width, clientHeight: height } = this.element;
    const canvas = document.createElement('canvas');
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext('2d'));
    context.fillStyle = '#161b21';
    context.fillRect(0, 0, canvas.width, canvas.height);
    const origin = this.element.getBoundingClientRect();
    for (const { panel, plot } of this.list) {
      const from = plot.root.getBoundingClientRect();
      const x = (from.left - origin.left) * ratio;
      context.drawImage(plot.ctx.canvas, x, (from.top - origin.top) * ratio);
      context.font = `${12 * ratio}px system-ui, "DejaVu Sans", sans-serif`;
      context.fillStyle = '#dfe6ee';
      context.fillText(panel.title, x + 8 * ratio, 14 * ratio);
      let at = x + 8 * ratio + context.measureText(panel.title).width + 12 * ratio;
      for (const series of panel.series) {
        context.fillStyle = series.colour;
        context.fillText(series.label, at, 14 * ratio);
        at += context.measureText(series.label).width + 8 * ratio;
      }
    }
    return canvas;
  }
}

/** @param {number | null} low @param {number | null} high @param {boolean} fromZero @returns {[number, number]} */
function limits(low, high, fromZero) {
  if (low === null || high === null || !Number.isFinite(low) || !Number.isFinite(high)) return [0, 1];
  const bottom = fromZero ? 0 : Math.min(low, 0);
  const top = Math.max(high, 0);
  const room = (top - bottom || 1) * 0.08;
  return [bottom < 0 ? bottom - room : bottom, top + room];
}
