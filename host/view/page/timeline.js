// The row below the picture: pause, steps and speed of a session, and its last 30 s; of a recording, its whole time line
// with marks. Entry point: `TimeLine`.

import { button } from './controls.js';
import { element } from './words.js';
import { fixed } from './units.js';

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
const MARKS = /** @type {Record<string, string>} */ ({
  armed: '#7ee787', disarmed: '#8b96a5', decay: '#ffb86b', fault: '#ff6b61', puncture: '#d2a8ff', lost: '#ff6b61', overload: '#ffb86b',
});

/** What was found when a recording was run again, in short. */
const BADGES = /** @type {Record<string, string>} */ ({
  running: 'is run again', identical: 'identical to the bit', close: 'the same but for rounding', diverged: 'diverges', none: 'not run again',
  back: 'looking back; the session goes on',
});

/**
 * @typedef {object} TimeActions
 * @property {(command: {do: string, [key: string]: unknown}) => void} command
 * @property {(time: number | null) => void} back looks at the picture of then; `null`: live
 * @property {import('./player.js').Player} player
 */

export class TimeLine {
  /** @param {TimeActions} actions */
  constructor(actions) {
    this.actions = actions;
    this.box = element('time-line');
    this.recording = false;
    this.paused = false;
    /** @type {{time_s: number, what: string, text: string}[]} */
    this.events = [];
    /** Where one looks back to; `null`: live [s]. @type {number | null} */
    this.looking = null;
    /** @type {[number, number]} [s] */
    this.span = [0, 1];
    this.begin(false, [], null);
  }

  /**
   * @param {boolean} recording
   * @param {string[]} can commands of this session
   * @param {import('./link.js').TimeLine | null} line
   */
  begin(recording, can, line) {
    this.recording = recording;
    this.events = [];
    this.looking = null;
    const { command, player } = this.actions;
    this.play = button(recording ? 'Play' : 'Pause', () => {
      if (recording) player.play(!player.playing);
      else command({ do: this.paused ? 'resume' : 'pause' });
    });
    this.play.id = 'play';
    this.slider = document.createElement('input');
    Object.assign(this.slider, { type: 'range', min: '0', max: '1000', step: '1', value: '1000' });
    this.slider.setAttribute('aria-label', recording ? 'Time of the recording' : 'The last 30 s');
    this.slider.addEventListener('input', () => this.slid());
    this.canvas = document.createElement('canvas');
    const track = document.createElement('div');
    track.className = 'track';
    track.append(this.slider, this.canvas);
    this.now = document.createElement('span');
    this.now.className = 'now';
    this.badge = document.createElement('span');
    this.badge.className = 'badge';
    const items = recording ? this.recordingItems(track) : this.liveItems(track, can);
    this.box.replaceChildren(...items);
    this.setBadge(line?.badge ?? '', line?.badge_text ?? '');
    if (line) this.span = [line.from_s, line.to_s];
  }

  /** @param {HTMLElement} track @param {string[]} can */
  liveItems(track, can) {
    const { command } = this.actions;
    const list = [];
    if (can.includes('pause')) list.push(/** @type {HTMLElement} */ (this.play));
    if (can.includes('step')) {
      list.push(button('+ tick', () => command({ do: 'step', ticks: 1 }), 'One tick further, and pause'));
      list.push(button('+ solve', () => command({ do: 'step', solves: 1 }), 'One solve further, and pause'));
    }
    if (can.includes('speed')) list.push(speeds((factor) => command({ do: 'speed', factor })));
    this.live = button('Live', () => this.lookBack(null), 'The newest picture');
    return [...list, track, /** @type {HTMLElement} */ (this.now), this.live, /** @type {HTMLElement} */ (this.badge)];
  }

  /** @param {HTMLElement} track */
  recordingItems(track) {
    const { player } = this.actions;
    const step = (/** @type {number} */ count) => () => {
      player.play(false);
      player.to(player.time + count / player.hz);
    };
    const mark = button('Loop A–B', () => {
      if (player.loop) player.loop = null;
      else if (this.marks) player.loop = this.marks;
      mark.setAttribute('aria-pressed', String(player.loop !== null));
    }, 'Repeats between the marks A and B of the plots: click there, then with Shift');
    return [
      /** @type {HTMLElement} */ (this.play),
      button('− picture', step(-1)),
      button('+ picture', step(1)),
      speeds((factor) => (player.rate = factor)),
      mark,
      track,
      /** @type {HTMLElement} */ (this.now),
      /** @type {HTMLElement} */ (this.badge),
    ];
  }

  slid() {
    const part = Number(this.slider?.value) / 1000;
    const time = this.span[0] + part * (this.span[1] - this.span[0]);
    if (this.recording) {
      this.actions.player.play(false);
      this.actions.player.to(time);
    } else {
      this.lookBack(part >= 0.999 ? null : time);
    }
  }

  /** @param {number | null} time [s] */
  lookBack(time) {
    this.looking = time;
    this.actions.back(time);
    this.setBadge(time === null ? '' : 'back', '');
  }

  /** @param {string} badge @param {string} text */
  setBadge(badge, text) {
    if (!this.badge) return;
    this.badge.hidden = !badge;
    this.badge.dataset.badge = badge;
    this.badge.textContent = BADGES[badge] ?? badge;
    this.badge.title = text;
  }

  /** @param {boolean} paused of the session */
  setPaused(paused) {
    this.paused = paused;
    if (!this.recording && this.play) this.play.textContent = paused ? 'Resume' : 'Pause';
  }

  /** @param {{time_s: number, what: string, text: string}} event */
  addEvent(event) {
    this.events.push(event);
  }

  /** Marks to loop between. @param {number | null} a @param {number | null} b */
  setMarks(a, b) {
    this.marks = a !== null && b !== null ? /** @type {[number, number]} */ ([Math.min(a, b), Math.max(a, b)]) : null;
  }

  /** @param {[number, number]} span @param {number} at @param {number} ready [s] */
  update(span, at, ready) {
    this.span = span;
    const length = span[1] - span[0];
    if (this.slider && document.activeElement !== this.slider) {
      this.slider.value = String(length > 0 ? Math.round((1000 * (at - span[0])) / length) : 1000);
    }
    const { player } = this.actions;
    if (this.recording && this.play) this.play.textContent = player.playing ? 'Stop' : 'Play';
    if (this.now) {
      const end = this.recording ? ` / ${fixed(span[1], 2)} s` : ' s';
      this.now.textContent = `${fixed(at, 2)}${end}`;
    }
    this.live?.setAttribute('aria-pressed', String(this.looking === null));
    this.draw(ready);
  }

  /** @param {number} ready [s] */
  draw(ready) {
    if (!this.canvas) return;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (this.canvas.width !== width * devicePixelRatio) {
      this.canvas.width = width * devicePixelRatio;
      this.canvas.height = height * devicePixelRatio;
    }
    const context = this.canvas.getContext('2d');
    if (!context) return;
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    context.clearRect(0, 0, width, height);
    const [from, to] = this.span;
    // The slider's knob does not reach the ends of its box.
    const x = (/** @type {number} */ time) => 8 + ((width - 16) * (time - from)) / (to - from || 1);
    if (this.recording && ready < to) {
      context.fillStyle = 'rgb(14 18 22 / 70%)';
      context.fillRect(x(ready), height / 2 - 4, x(to) - x(ready), 8);
    }
    for (const event of this.events) {
      if (!MARKS[event.what] || event.time_s < from || event.time_s > to) continue;
      context.fillStyle = MARKS[event.what];
      context.fillRect(x(event.time_s) - 1, 0, 2, 7);
    }
  }
}

/** @param {(factor: number) => void} choose */
function speeds(choose) {
  const select = document.createElement('select');
  select.setAttribute('aria-label', 'Speed');
  for (const factor of SPEEDS) select.append(new Option(`${factor} ×`, String(factor), factor === 1, factor === 1));
  select.addEventListener('change', () => choose(Number(select.value)));
  return select;
}
