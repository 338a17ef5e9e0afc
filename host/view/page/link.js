// The line to the host: first words, reconnection, commands and their answers. Entry point: `Link`.

import { FORMAT, decode } from './decode.js';

/**
 * @typedef {object} Needle @property {number} id @property {number[][]} points_m @property {number} thickness_m
 * @typedef {object} ThreadShape @property {number} id @property {number} needle @property {number} radius_m @property {number} length_m
 * @typedef {object} NumberSetting @property {string} name @property {boolean} at_once @property {string} unit @property {number} value @property {number} low @property {number} high @property {number} step
 * @typedef {object} WordSetting @property {string} name @property {boolean} at_once @property {string} value @property {string[]} choices
 * @typedef {NumberSetting | WordSetting} Setting
 * @typedef {object} Scalar @property {string} name @property {string} unit @property {boolean} signed @property {boolean} [available]
 * @typedef {object} TimeLine
 * @property {number} from_s @property {number} to_s @property {number} ready_s @property {number} hz @property {boolean} solvable
 * @property {string | null} why @property {string} badge @property {string} badge_text
 * @property {number | null} [at_s] where it is opened
 */

/**
 * @typedef {object} Hello
 * @property {number} session
 * @property {string} version
 * @property {'live' | 'recording'} source
 * @property {string} pace
 * @property {string} scene
 * @property {string} tissue
 * @property {string} rendering
 * @property {string} device
 * @property {string} console
 * @property {number} tick_hz
 * @property {number} host_hz
 * @property {number | null} [board_rows_hz]
 * @property {number | null} horizon_ms
 * @property {number} nodes
 * @property {number} cells
 * @property {[number[], number[]]} bounds_m
 * @property {'control' | 'watch'} role
 * @property {boolean} motors
 * @property {string[]} do
 * @property {string} mode
 * @property {string[]} faults
 * @property {string[]} stages
 * @property {string[]} statuses
 * @property {Scalar[]} scalars
 * @property {import('./shapes.js').ToolShape[]} tools
 * @property {Needle[]} needles
 * @property {ThreadShape[]} threads
 * @property {Setting[]} settings
 * @property {string[]} scenes
 * @property {string[]} tissues
 * @property {Record<string, {message: string, help: string}>} fixes
 * @property {TimeLine | null} time_line
 */

/** @typedef {{p50: number, p99: number} | null} Percentiles */
/**
 * @typedef {object} Gauges
 * @property {number} time_s
 * @property {number} tick
 * @property {string} mode
 * @property {string[]} faults
 * @property {{now: Percentiles, all: Percentiles}} latency_us
 * @property {{now: Percentiles, all: Percentiles}} age_us
 * @property {{now: Percentiles, all: Percentiles}} step_us
 * @property {{now: Percentiles, all: Percentiles} | null} rtt_us
 * @property {number | null} ticks_late
 * @property {number | null} tick_overruns
 * @property {Record<'lost' | 'rejected' | 'late' | 'superseded', number | null | undefined>} frames
 * @property {Record<string, number>} withheld
 * @property {Record<string, number | null> | null} [ticks_limited] ticks in which a limit of the device took a part of the force away, by limit
 * @property {number | null} energy_j
 * @property {number | null} energy_min_j
 * @property {number | null} force_n
 * @property {number | null} host_hz
 * @property {number | null} [wall_hz] solves a second of the wall
 * @property {Percentiles} [wall_latency_us] latency by the clock on the wall
 * @property {string | null} [stopped_by] who asked for the safe stop that holds the console at rest
 * @property {number | null} [rows_hz]
 * @property {number | null} speed
 * @property {boolean} paused
 * @property {number} wanted_speed
 * @property {boolean | null} [recording] whether all of it is written to a file; `null`: pages have no say in it
 * @property {{wanted: number, made: number, sent: number}} pictures
 * @property {number} picture_hz
 * @property {number} picture_us
 * @property {number} clients
 * @property {boolean} controller
 * @property {boolean} connected
 */

/** @typedef {{what: string, time_s: number, text: string, help?: string | null, badge?: string | null}} SessionEvent */

/** Codes with which the host closes for good, and what to do. */
const FINAL = new Map([
  [4401, 'The key of this address is not this session\'s: open the address that sutura printed last.'],
  [4400, 'The host did not understand this page: reload it.'],
  [4406, 'The host speaks another format than this page: reload it.'],
]);

/** Pauses between attempts to connect [ms]. */
const PAUSES = [250, 500, 1000, 2000, 4000];

export class CommandError extends Error {
  /** @param {{message: string, help?: string}} error */
  constructor(error) {
    super(error.message);
    this.help = error.help ?? '';
  }
}

export class Link extends EventTarget {
  /** @param {string} key */
  constructor(key) {
    super();
    this.key = key;
    /** @type {WebSocket | null} */
    this.socket = null;
    this.open = false;
    this.attempt = 0;
    this.next = 1;
    this.seen = performance.now();
    this.bytes = 0;
    this.final = '';
    /** @type {Map<number, {resolve: (value: unknown) => void, reject: (error: Error) => void}>} */
    this.waiting = new Map();
  }

  connect() {
    const socket = new WebSocket(`${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}/ws`);
    socket.binaryType = 'arraybuffer';
    this.socket = socket;
    socket.addEventListener('open', () => socket.send(JSON.stringify({ key: this.key, control: true, format: FORMAT })));
    socket.addEventListener('message', (event) => this.take(event.data));
    socket.addEventListener('close', (event) => this.closed(event.code, event.reason));
  }

  /** @param {string | ArrayBuffer} data */
  take(data) {
    this.seen = performance.now();
    if (typeof data === 'string') {
      this.bytes += data.length;
      this.takeText(JSON.parse(data));
      return;
    }
    this.bytes += data.byteLength;
    const message = decode(data);
    if (!message) return;
    // Taken, not drawn: how many are drawn is this page's to say.
    if (message.kind === 'picture') this.tell({ do: 'ack', sequence: message.sequence });
    this.emit(message.kind, message);
  }

  /** @param {any} message */
  takeText(message) {
    if (message.re !== undefined) {
      const waiting = this.waiting.get(message.re);
      this.waiting.delete(message.re);
      if (message.error) waiting?.reject(new CommandError(message.error));
      else waiting?.resolve(message.value);
      return;
    }
    if (message.kind === 'hello') {
      this.open = true;
      this.attempt = 0;
    }
    this.emit(message.kind, message);
  }

  /** @param {number} code @param {string} reason */
  closed(code, reason) {
    this.open = false;
    for (const { reject } of this.waiting.values()) {
      reject(new CommandError({ message: 'the connection was lost before the answer came' }));
    }
    this.waiting.clear();
    this.final = FINAL.get(code) ?? '';
    this.emit('closed', { code, reason });
    if (this.final) return;
    const pause = PAUSES[Math.min(this.attempt, PAUSES.length - 1)];
    this.attempt += 1;
    setTimeout(() => this.connect(), pause);
  }

  /** @param {string} name @param {unknown} detail */
  emit(name, detail) {
    this.dispatchEvent(new CustomEvent(name, { detail }));
  }

  /**
   * A command whose answer comes, or an error in the host's words.
   * @param {{do: string, [key: string]: unknown}} command
   * @returns {Promise<unknown>}
   */
  ask(command) {
    const id = this.next;
    this.next += 1;
    return new Promise((resolve, reject) => {
      if (!this.tell({ id, ...command })) {
        reject(new CommandError({ message: 'no connection to the host' }));
        return;
      }
      this.waiting.set(id, { resolve, reject });
    });
  }

  /** Sends and expects no answer; `false` if that cannot be. @param {object} message */
  tell(message) {
    if (this.socket?.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  /** Seconds since anything was heard. */
  get silence() {
    return (performance.now() - this.seen) / 1000;
  }
}
