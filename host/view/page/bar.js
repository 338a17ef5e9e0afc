// The top bar: safe stop, mode, and the figures that are always in sight. Entry point: `Bar`.

import { element } from './words.js';
import { fixed } from './units.js';

/** With motors, arming is held so long [ms]. */
const HOLD_MS = 1000;

/** Session time in a second of the wall below which a session counts as slower than that [s]. */
const SLOW = 0.9;

const METRICS = /** @type {[string, string, string, boolean][]} */ ([
  ['force', 'Force', 'On the grip, newest tick', false],
  ['age', 'Age', 'Of the contact that the force is made from; red beyond its horizon', false],
  ['latency', 'Latency p50 / p99', 'From a state to the force made from it, last second', false],
  ['step', 'Step p50 / p99', 'Wall-clock time of a solve, last second', true],
  ['hz', 'Solves', 'Reached in the last second', false],
  ['speed', 'Speed', 'Seconds of the session in a second of the wall', false],
  ['energy', 'Energy', 'That the grip has put into the virtual tissue; below zero it has given some out', true],
  ['shown', 'Pictures', 'Drawn by this page, of those it asks for', true],
]);

export class Bar {
  /** @param {{stop: () => void, arm: () => void, clear: () => void}} actions */
  constructor(actions) {
    this.mode = element('mode');
    this.armButton = /** @type {HTMLButtonElement} */ (element('arm'));
    this.clearButton = /** @type {HTMLButtonElement} */ (element('clear'));
    this.motors = false;
    /** @type {Record<string, {box: HTMLElement, value: HTMLElement}>} */
    this.metrics = {};
    const list = element('metrics');
    for (const [name, label, title, lesser] of METRICS) {
      const box = document.createElement('div');
      box.title = title;
      box.dataset.metric = name;
      box.classList.toggle('lesser', lesser);
      const term = document.createElement('dt');
      term.textContent = label;
      const value = document.createElement('dd');
      value.textContent = '–';
      box.append(term, value);
      list.append(box);
      this.metrics[name] = { box, value };
    }
    element('stop').addEventListener('click', () => actions.stop());
    this.clearButton.addEventListener('click', () => actions.clear());
    this.holdToArm(actions.arm);
    // In the capture phase: nothing on the page can keep a stop from happening.
    window.addEventListener('keydown', (event) => stopKey(event, actions.stop), { capture: true });
  }

  /** @param {() => void} arm */
  holdToArm(arm) {
    const button = this.armButton;
    let timer = 0;
    const begin = () => {
      if (!this.motors || timer) return;
      button.classList.add('holding');
      timer = window.setTimeout(() => {
        end();
        arm();
      }, HOLD_MS);
    };
    const end = () => {
      clearTimeout(timer);
      timer = 0;
      button.classList.remove('holding');
    };
    button.addEventListener('pointerdown', begin);
    button.addEventListener('keydown', (event) => {
      if (event.key === 'Enter' || event.key === ' ') begin();
    });
    for (const name of ['pointerup', 'pointerleave', 'pointercancel', 'keyup', 'blur']) button.addEventListener(name, end);
    button.addEventListener('click', () => {
      if (!this.motors) arm();
    });
  }

  /** @param {import('./link.js').Hello} hello */
  setSession(hello) {
    this.motors = hello.motors;
    this.armButton.textContent = hello.motors ? 'Hold to arm' : 'Arm';
    this.canArm = hello.do.includes('arm') && hello.role === 'control';
    this.canClear = hello.do.includes('clear_fault') && hello.role === 'control';
    element('console').textContent = hello.source === 'recording' ? 'recording' : `${hello.console} console · ${hello.device}`;
    const role = hello.role === 'control' ? 'you control' : 'you watch';
    element('role').textContent = hello.source === 'recording' ? hello.device : role;
    this.setMode(hello.mode);
  }

  /** @param {string} mode */
  setMode(mode) {
    this.mode.textContent = mode;
    this.mode.dataset.mode = mode;
    this.armButton.hidden = !(this.canArm && mode === 'idle');
    this.clearButton.hidden = !(this.canClear && mode === 'fault');
  }

  /** @param {string} name @param {string} value @param {string} [unit] @param {boolean} [alarm] */
  set(name, value, unit = '', alarm = false) {
    const { box, value: target } = this.metrics[name];
    const text = unit ? `${value} ${unit}` : value;
    if (target.dataset.text !== text) {
      target.dataset.text = text;
      const small = document.createElement('small');
      small.textContent = unit ? ` ${unit}` : '';
      target.replaceChildren(value, small);
    }
    box.classList.toggle('alarm', alarm);
  }

  /** @param {import('./link.js').Gauges} gauges */
  setGauges(gauges) {
    const pair = (/** @type {import('./link.js').Percentiles | undefined} */ both) =>
      both ? `${fixed(both.p50 / 1000, 1)} / ${fixed(both.p99 / 1000, 1)}` : '–';
    // A session slower than the wall clock is shown by the wall clock: a person waits by that.
    const slow = !gauges.paused && gauges.speed !== null && gauges.speed < SLOW && gauges.wall_hz !== undefined;
    this.set('latency', pair(slow ? gauges.wall_latency_us : gauges.latency_us.now), 'ms');
    this.set('step', pair(gauges.step_us.now), 'ms');
    const hz = slow ? gauges.wall_hz : gauges.host_hz;
    this.set('hz', fixed(hz, (hz ?? 0) < 10 ? 1 : 0), 'Hz');
    for (const name of ['latency', 'hz']) {
      const { box } = this.metrics[name];
      const by = slow ? `, by the clock on the wall: the session runs at ${fixed(gauges.speed, 2)} ×` : '';
      box.title = `${METRICS.find(([one]) => one === name)?.[2]}${by}`;
      box.dataset.clock = slow ? 'wall' : 'session';
    }
    this.set('speed', gauges.paused ? 'paused' : fixed(gauges.speed, 2), gauges.paused ? '' : '×');
    const energy = gauges.energy_j;
    this.set('energy', fixed(energy === null ? null : 1000 * energy, 2), 'mJ');
  }

  /** Crosses out values whose source has gone. @param {boolean} host @param {boolean} console_ */
  setGone(host, console_) {
    for (const [name, { box }] of Object.entries(this.metrics)) {
      const fromConsole = name === 'force' || name === 'age' || name === 'latency';
      box.classList.toggle('gone', name !== 'shown' && (host || (fromConsole && console_)));
    }
    this.mode.classList.toggle('gone', host || console_);
  }
}

/** Esc stops always; Space unless it operates the control that has the focus. @param {KeyboardEvent} event @param {() => void} stop */
function stopKey(event, stop) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const at = event.target instanceof HTMLElement ? event.target : document.body;
  const operates = at.matches('button, input, select, summary, textarea');
  if (event.key !== 'Escape' && !(event.key === ' ' && !operates)) return;
  event.preventDefault();
  stop();
}
