// A host that speaks the page's format about tissue that is made up: for working on the page without a solver, and for what a
// session cannot be brought to show at will. `node tests/browser/mock-server.mjs [slab|tube|recording]` prints an address.

import { createHash } from 'node:crypto';
import { readFile } from 'node:fs/promises';
import http from 'node:http';
import path from 'node:path';
import { fileURLToPath } from 'node:url';
import { WebSocketServer } from 'ws';
import { geometryBytes, pictureBytes, solvesBytes, ticksBytes } from './encode.mjs';

const VIEW = fileURLToPath(new URL('../../host/view/', import.meta.url));
const TYPES = { '.js': 'text/javascript', '.css': 'text/css', '.svg': 'image/svg+xml', '.html': 'text/html' };
const STAGES = ['approach', 'tissue', 'detect', 'columns', 'solve', 'field', 'reduce', 'look'];
const SCALARS = [
  { name: 'displacement', unit: 'm', signed: false },
  { name: 'largest-principal', unit: 'Pa', signed: true },
];
export const KEY = 'mock';
const TICK_S = 0.001;

/** A grid of a box's or a tube's surface. `place` turns two parameters into a point. */
function grid(columns, rows, place, wrap) {
  const positions = [];
  const triangles = [];
  for (let j = 0; j <= rows; j += 1) for (let i = 0; i <= columns; i += 1) positions.push(...place(i / columns, j / rows));
  const at = (i, j) => j * (columns + 1) + (wrap ? i % columns : i);
  for (let j = 0; j < rows; j += 1) {
    for (let i = 0; i < columns; i += 1) {
      triangles.push(at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j), at(i + 1, j + 1), at(i, j + 1));
    }
  }
  return { positions, triangles };
}

function joined(parts) {
  const keys = new Map();
  const positions = [];
  const triangles = [];
  const regions = [];
  parts.forEach(({ positions: points, triangles: faces, region = 0 }) => {
    const numbers = [];
    for (let i = 0; i < points.length; i += 3) {
      const key = `${region}:${points.slice(i, i + 3).map((value) => Math.round(value * 1e7)).join()}`;
      if (!keys.has(key)) {
        keys.set(key, positions.length / 3);
        positions.push(...points.slice(i, i + 3));
      }
      numbers.push(keys.get(key));
    }
    for (let i = 0; i < faces.length; i += 3) {
      const face = faces.slice(i, i + 3).map((vertex) => numbers[vertex]);
      if (new Set(face).size === 3) {
        triangles.push(...face);
        regions.push(region);
      }
    }
  });
  return { positions, triangles, regions };
}

function slab() {
  const [x, y, z] = [0.08, 0.08, 0.03];
  const side = (origin, u, v, columns, rows) =>
    grid(columns, rows, (a, b) => [0, 1, 2].map((axis) => origin[axis] + a * u[axis] + b * v[axis]), false);
  const [left, front, bottom] = [-x / 2, -y / 2, -z];
  return joined([
    side([left, front, 0], [x, 0, 0], [0, y, 0], 20, 20),
    side([left, front, bottom], [0, y, 0], [x, 0, 0], 20, 20),
    side([left, front, bottom], [x, 0, 0], [0, 0, z], 20, 8),
    side([-left, -front, bottom], [-x, 0, 0], [0, 0, z], 20, 8),
    side([left, -front, bottom], [0, -y, 0], [0, 0, z], 20, 8),
    side([-left, front, bottom], [0, y, 0], [0, 0, z], 20, 8),
  ]);
}

function tube() {
  const round = (radius, from, to, inward, region) => ({
    region,
    ...grid(32, 10, (a, b) => {
      const angle = (inward ? -1 : 1) * 2 * Math.PI * a;
      return [radius * Math.cos(angle), radius * Math.sin(angle), from + (to - from) * b];
    }, false),
  });
  const rim = (inner, outer, z, up, region) => ({
    region,
    ...grid(32, 2, (a, b) => {
      const radius = up ? outer + (inner - outer) * b : inner + (outer - inner) * b;
      return [radius * Math.cos(2 * Math.PI * a), radius * Math.sin(2 * Math.PI * a), z];
    }, false),
  });
  const part = (inner, outer, from, to, region) => [
    round(outer, from, to, false, region), round(inner, from, to, true, region), rim(inner, outer, to, true, region), rim(inner, outer, from, false, region),
  ];
  return joined([...part(0.008, 0.011, 0.001, 0.03, 0), ...part(0.009, 0.012, -0.03, -0.001, 1)]);
}

function arc(radius, angle, count) {
  return Array.from({ length: count }, (_, i) => {
    const at = (angle * i) / (count - 1);
    return [radius * Math.sin(at), radius * (1 - Math.cos(at)), 0];
  });
}

const SCENES = {
  slab: {
    geometry: slab, bounds: [[-0.04, -0.04, -0.03], [0.04, 0.04, 0]],
    tools: [{ id: 0, driven: true, shape: 'sphere', radius_m: 0.014, length_m: null, fillet_m: null, size_m: null, offset_m: [0, 0, 0], axis: [0, 0, -1], side: [1, 0, 0], points_m: null, triangles: null }],
    needles: [], threads: [],
  },
  tube: {
    geometry: tube, bounds: [[-0.012, -0.012, -0.03], [0.012, 0.012, 0.03]],
    tools: [
      { id: 0, driven: true, shape: 'capsule', radius_m: 0.0015, length_m: 0.02, fillet_m: null, size_m: null, offset_m: [0, 0, 0], axis: [0, 0, -1], side: [1, 0, 0], points_m: null, triangles: null },
      { id: 1, driven: false, shape: 'box', radius_m: null, length_m: null, fillet_m: 0.0005, size_m: [0.004, 0.003, 0.01], offset_m: [0, 0, 0], axis: [0, 0, -1], side: [1, 0, 0], points_m: null, triangles: null },
      { id: 2, driven: false, shape: 'punch', radius_m: 0.002, length_m: 0.01, fillet_m: 0.0006, size_m: null, offset_m: [0, 0, 0], axis: [0, 0, -1], side: [1, 0, 0], points_m: null, triangles: null },
    ],
    needles: [{ id: 0, shape: 'arc', length_m: 0.0192, radius_m: 0.0061, angle_rad: Math.PI, thickness_m: 0.0006, points_m: arc(0.0061, Math.PI, 25) }],
    threads: [{ id: 0, needle: 0, radius_m: 0.00015, length_m: 0.4 }],
  },
};

/** One made-up session, which all clients see. */
class Mock {
  constructor(name) {
    this.recording = name === 'recording';
    this.session = 1;
    this.begin(this.recording ? 'slab' : name);
    this.clients = new Set();
    this.controller = null;
    this.connected = true;
    this.faults = [];
    /** Whether the tool has slipped in. */
    this.inside = false;
    /** Whether no balance is found. */
    this.tooDeep = false;
    this.stoppedBy = null;
    /** Solves and latency by the clock on the wall. */
    this.wall = { wall_hz: 249.6, wall_latency_us: { p50: 5200, p99: 6100 } };
    this.realSpeed = 0.99;
    /** End of a recording's pictures [s]. */
    this.ready = 5;
    this.at = null;
  }

  begin(name) {
    this.name = name;
    this.scene = SCENES[name];
    this.mesh = this.scene.geometry();
    this.time = 0;
    this.tick = 0;
    this.sequence = 0;
    this.mode = 'armed';
    this.paused = false;
    this.speed = 1;
    this.target = null;
    this.home = name === 'slab' ? [0, 0, 0.02] : [0.016, 0, 0.006];
    this.grip = [...this.home];
    this.force = [0, 0, 0];
    this.recorded = false;
    this.saved = 0;
    this.hand = 'scene';
    this.settings = [
      { name: 'rendering', at_once: true, unit: '', value: 'rows', choices: ['hold', 'tangent', 'rows'] },
      { name: 'host-hz', at_once: true, unit: 'Hz', value: 250, low: 25, high: 1000, step: 25 },
      { name: 'youngs-modulus', at_once: false, unit: 'Pa', value: 15000, low: 1000, high: 100000, step: 1000 },
    ];
  }

  hello(client) {
    const can = this.recording
      ? ['seek', 'scalar']
      : ['scalar', 'safe_stop', 'arm', 'clear_fault', 'pause', 'resume', 'step', 'speed', 'reset', 'scene', 'tissue', 'set', 'drag', 'hand', 'record', 'save_last', 'take_control', 'take_out'];
    return {
      kind: 'hello', format: 1, version: '0.0.0', session: this.session, source: this.recording ? 'recording' : 'live', pace: 'lockstep',
      scene: this.name, tissue: 'linear', rendering: 'rows', device: 'cartesian-bench', console: 'virtual', tick_hz: 1000, host_hz: 250, board_rows_hz: 200, horizon_ms: 20,
      nodes: 3969, cells: 16000, bounds_m: this.scene.bounds, role: client === this.controller ? 'control' : 'watch', motors: client.motors ?? false, do: can,
      mode: this.mode, faults: this.faults, stages: STAGES, statuses: ['ok', 'not-finite', 'inside', 'not-converged'], scalars: SCALARS, tools: this.scene.tools,
      needles: this.scene.needles, threads: this.scene.threads, settings: this.settings, scenes: ['slab', 'tube'], tissues: ['linear', 'corotational'],
      fixes: { e_stop: { message: 'The emergency stop is pressed.', help: 'Release it, then clear the fault and arm.' } },
      time_line: this.recording
        ? { from_s: 0, to_s: 5, ready_s: this.ready, at_s: this.at, hz: 30, solvable: true, why: null, badge: 'identical', badge_text: 'run again: identical to the bit' }
        : null,
    };
  }

  /** Grip and force at the session's time. */
  advance(seconds) {
    const ticks = Math.round((seconds * this.speed) / TICK_S);
    const rows = [];
    for (let i = 0; i < ticks; i += 1) {
      this.tick += 1;
      this.time = this.tick * TICK_S;
      this.move(this.target ?? this.way(this.time), 1 - Math.exp(-TICK_S / 0.04));
      rows.push(this.row());
    }
    return rows;
  }

  way(time) {
    if (this.name !== 'slab') return [this.home[0] - 0.004 * Math.max(0, Math.sin(time)), this.home[1], this.home[2]];
    return [0.01 * Math.sin(0.7 * time), 0, 0.013 - 0.008 * Math.sin(1.9 * time)];
  }

  move(target, part) {
    this.grip = this.grip.map((value, axis) => value + part * (target[axis] - value));
    const depth = this.depth();
    const pressed = this.mode === 'armed' ? 350 * depth + 8000 * depth * depth : 0;
    this.force = this.name === 'slab' ? [0, 0.02 * pressed, pressed] : [pressed, 0, 0];
  }

  depth() {
    return this.name === 'slab' ? Math.max(0, 0.014 - this.grip[2]) : Math.max(0, 0.0135 - this.grip[0]);
  }

  row() {
    const mode = ['boot', 'idle', 'armed', 'decaying', 'fault'].indexOf(this.mode);
    return { time: this.time, tick: this.tick, grip: [...this.grip], force: [...this.force], age: 4000 + 1000 * (this.tick % 4), applied: 5200, mode };
  }

  solveRow(time) {
    const step = 380 + 60 * Math.sin(7 * time);
    return { time, step, stages: STAGES.map((_, i) => (step * 0.9 * (i + 1)) / 36), energy: 0.5 * this.depth() * Math.hypot(...this.force), touched: Math.round(4000 * this.depth()) };
  }

  /** Displacement of a vertex [m]. */
  displaced(x, y, z) {
    const depth = this.inside ? 0 : this.depth();
    if (this.name === 'slab') {
      const reach = Math.exp(-((x - this.grip[0]) ** 2 + (y - this.grip[1]) ** 2) / 0.012 ** 2) * Math.max(0, 1 + z / 0.03);
      return [0, 0, -depth * reach];
    }
    const reach = Math.exp(-((y - this.grip[1]) ** 2 + (z - this.grip[2]) ** 2) / 0.005 ** 2) * (x > 0 ? 1 : 0);
    return [-depth * reach, 0, 0];
  }

  picture(scalar) {
    this.sequence += 1;
    const { positions } = this.mesh;
    const displacement = [];
    for (let i = 0; i < positions.length; i += 3) displacement.push(...this.displaced(...positions.slice(i, i + 3)));
    const values = scalar === 0 ? null : [];
    for (let i = 0; values && i < displacement.length; i += 3) {
      const size = Math.hypot(...displacement.slice(i, i + 3));
      values.push(scalar === 1 ? size : 3e6 * (size - 0.0015));
    }
    return pictureBytes({
      sequence: this.sequence, time: this.time, geometry: this.session, displacement, scalar, values,
      tools: this.scene.tools.map((tool) => this.tool(tool)), needles: this.needles(), threads: this.threads(), contacts: this.contacts(displacement),
      grip: this.grip, energy: 0.5 * this.depth() * Math.hypot(...this.force), touching: this.depth() > 0 && !this.inside, word: this.inside ? 2 : this.tooDeep ? 3 : 0, recorded: this.recording,
    });
  }

  tool(tool) {
    if (tool.driven) {
      const turn = this.name === 'slab' ? [0, 0, 0, 1] : [0, Math.SQRT1_2, 0, Math.SQRT1_2];
      return { id: tool.id, driven: true, position: this.grip, orientation: turn, wrench: [...this.force, 0, 0, 0], touched: 12 };
    }
    return { id: tool.id, driven: false, position: [0.004 * tool.id, 0.018, 0.012], orientation: [0, 0, 0, 1], wrench: [0, 0, 0, 0, 0, 0], touched: 0 };
  }

  needles() {
    // Through both walls and the gap between them: towards the axis, and up.
    return this.scene.needles.map(({ id }) => ({ id, position: [0.0155, -0.0015, -0.0061], orientation: [0, Math.SQRT1_2, Math.SQRT1_2, 0], axial: 0.2 }));
  }

  threads() {
    return this.scene.threads.map(({ id }) => {
      const points = [];
      for (let i = 0; i <= 160; i += 1) {
        const angle = i * 0.35;
        const wave = Math.sin(i * 1.2);
        points.push([(0.0105 + 0.002 * wave) * Math.cos(angle / 6), (0.0105 + 0.002 * wave) * Math.sin(angle / 6), 0.004 * Math.cos(i * 1.2)]);
      }
      return { id, points };
    });
  }

  contacts(displacement) {
    const found = [];
    const { positions } = this.mesh;
    for (let i = 0; i < positions.length; i += 3) {
      const size = Math.hypot(...displacement.slice(i, i + 3));
      if (size > 0.0004 && size > 0.55 * this.depth()) found.push(i / 3);
    }
    const share = 1 / Math.max(found.length, 1);
    return found.map((vertex) => ({ vertex, force: this.force.map((value) => -value * share) }));
  }

  gauges(client) {
    const both = { p50: 5200, p99: 6100 };
    return {
      kind: 'gauges', session: this.session, time_s: this.time, tick: this.tick, mode: this.mode, faults: this.faults,
      latency_us: { now: both, all: both }, age_us: { now: { p50: 5500, p99: 7000 }, all: both }, step_us: { now: { p50: 380, p99: 450 }, all: { p50: 380, p99: 470 } },
      rtt_us: { now: { p50: 900, p99: 1200 }, all: both }, ticks_late: 0, tick_overruns: 0, frames: { lost: 0, rejected: 0, late: 0, superseded: 3 },
      withheld: { waiting: 3 }, energy_j: 0.0012, energy_min_j: -1e-5, force_n: Math.hypot(...this.force), host_hz: 249.6, ...this.wall, stopped_by: this.stoppedBy, rows_hz: 190.4, speed: this.paused ? 0 : this.realSpeed, paused: this.paused,
      wanted_speed: this.speed, recording: this.recorded, pictures: { wanted: 100, made: 99, sent: 98 }, picture_hz: 30, picture_us: 900, clients: this.clients.size,
      controller: this.controller === client, connected: this.connected,
    };
  }
}

/** What a client is sent, and what it does. */
class Client {
  constructor(socket, mock) {
    this.socket = socket;
    this.mock = mock;
    this.hz = 0;
    this.scalar = 0;
    this.underway = 0;
    this.due = 0;
  }

  say(message) {
    this.socket.send(JSON.stringify(message));
  }

  greet() {
    const { mock } = this;
    this.say(mock.hello(this));
    const { positions, triangles, regions } = mock.mesh;
    this.socket.send(geometryBytes({ id: mock.session, session: mock.session, positions, triangles, regions }));
    this.underway = 0;
    this.sendPicture();
    if (mock.recording) this.sendWhole();
  }

  sendPicture() {
    if (this.underway >= 2) return;
    this.underway += 1;
    this.socket.send(this.mock.picture(this.scalar));
  }

  /** All ticks and solves of a recording, and back to its start. */
  sendWhole() {
    const { mock } = this;
    mock.begin(mock.name);
    const rows = mock.advance(5);
    this.socket.send(ticksBytes(mock.session, rows, true));
    mock.begin(mock.name);
    const solves = [];
    for (let i = 0; i < 1250; i += 1) {
      mock.advance(0.004);
      solves.push(mock.solveRow(mock.time));
    }
    this.socket.send(solvesBytes(mock.session, STAGES.length, solves, mock.scene.needles.length, mock.scene.threads.length, true));
    mock.begin(mock.name);
  }

  /** The made-up motion up to a time, then its picture. */
  seek(time) {
    const { mock } = this;
    mock.begin(mock.name);
    mock.advance(Math.min(time, mock.ready));
    this.underway = 0;
    this.sendPicture();
  }

  /** Another session, for all. @param {string} name */
  again(name) {
    const { mock } = this;
    mock.session += 1;
    mock.begin(name);
    for (const client of mock.clients) client.greet();
  }

  take(text) {
    const command = JSON.parse(text);
    const { mock } = this;
    switch (command.do) {
      case 'ack':
        this.underway = Math.max(0, this.underway - 1);
        return;
      case 'picture_hz':
        this.hz = command.hz;
        break;
      case 'scalar':
        this.scalar = command.name ? 1 + SCALARS.findIndex((one) => one.name === command.name) : 0;
        break;
      case 'safe_stop':
        mock.mode = 'idle';
        mock.stoppedBy = 'the page that controls';
        break;
      case 'arm':
        if (mock.faults.length > 0) {
          this.say({ re: command.id, error: { message: 'there is a latched fault', help: 'clear it first' } });
          return;
        }
        mock.mode = 'armed';
        mock.stoppedBy = null;
        break;
      case 'take_out':
        mock.target = null;
        mock.inside = mock.tooDeep = false;
        mock.mode = 'armed';
        break;
      case 'clear_fault':
        mock.faults = [];
        mock.mode = 'idle';
        break;
      case 'drag':
        if (mock.mode !== 'armed') {
          this.say({ re: command.id, error: { message: 'nobody holds a grip whose motors are off', help: 'arm first' } });
          return;
        }
        mock.target = command.to_m;
        break;
      case 'pause':
      case 'resume':
        mock.paused = command.do === 'pause';
        break;
      case 'step':
        mock.paused = true;
        mock.publish(command.ticks ? 0.001 * command.ticks : 0.004 * command.solves);
        break;
      case 'speed':
        mock.speed = command.factor;
        break;
      case 'seek':
        this.seek(command.time_s);
        break;
      case 'scene':
      case 'reset':
        this.again(command.name ?? mock.name);
        break;
      case 'record':
        if (command.on) this.again(mock.name);
        mock.recorded = command.on;
        break;
      case 'save_last':
        mock.saved += 1;
        for (const client of mock.clients) client.say({ kind: 'event', session: mock.session, time_s: mock.time, what: 'saved', text: 'the last seconds are in sutura-last.mcap (0.1 MB)', help: '' });
        break;
      case 'take_control':
        mock.controller = this;
        for (const client of mock.clients) client.say(mock.hello(client));
        break;
      case 'hand':
        mock.hand = command.way;
        break;
      case 'set': {
        const setting = mock.settings.find((one) => one.name === command.name);
        setting.value = command.value;
        if (setting.at_once) for (const client of mock.clients) client.say(mock.hello(client));
        break;
      }
      case 'tissue':
        break;
      default:
        this.say({ re: command.id, error: { message: `no command ${command.do}`, help: '' } });
        return;
    }
    this.say({ re: command.id, ok: true });
  }
}

/** Sends what has come about in `seconds` to all. */
Mock.prototype.publish = function publish(seconds) {
  const rows = this.advance(seconds);
  if (rows.length === 0) return;
  const ticks = ticksBytes(this.session, rows, false);
  const every = rows.filter((row) => row.tick % 4 === 0).map((row) => this.solveRow(row.time));
  const solves = solvesBytes(this.session, STAGES.length, every, this.scene.needles.length, this.scene.threads.length, false);
  for (const { socket } of this.clients) {
    socket.send(ticks);
    socket.send(solves);
  }
};

async function serve(request, response) {
  const { pathname } = new URL(request.url, 'http://mock');
  const index = await readFile(path.join(VIEW, 'page/index.html'), 'utf8');
  const map = /<script type="importmap">([^]*?)<\/script>/.exec(index)?.[1] ?? '';
  const hash = createHash('sha256').update(map).digest('base64');
  response.setHeader('Content-Security-Policy', `default-src 'none'; script-src 'self' 'sha256-${hash}'; style-src 'self'; connect-src 'self'; img-src 'self' blob: data:; media-src blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'`);
  response.setHeader('Cache-Control', 'no-store');
  const file = pathname === '/' ? 'page/index.html' : pathname.slice(1);
  const known = /^(page\/[\w.-]+|vendor\/[\w./-]+)$/.test(file) && !file.includes('..');
  const bytes = known ? await readFile(path.join(VIEW, file)).catch(() => null) : null;
  if (!bytes) {
    response.writeHead(404).end();
    return;
  }
  response.setHeader('Content-Type', TYPES[path.extname(file)] ?? 'application/octet-stream');
  response.end(bytes);
}

/**
 * @param {{scene?: 'slab' | 'tube' | 'recording', port?: number, motors?: boolean, hz?: number, ready?: number, at?: number}} options
 *   `hz`: pictures a second, few enough for a browser that draws in software to do other things, too; of a recording, `ready`: pictures
 *   are there up to then at first [s], `at`: where a page opens it [s]
 */
export async function start({ scene = 'slab', port = 0, motors = false, hz = 10, ready = 5, at = null } = {}) {
  const mock = new Mock(scene);
  Object.assign(mock, { ready, at });
  const server = http.createServer((request, response) => serve(request, response));
  const sockets = new WebSocketServer({ server, path: '/ws' });
  sockets.on('connection', (socket) => {
    const client = new Client(socket, mock);
    client.motors = motors;
    socket.once('message', (first) => {
      if (JSON.parse(String(first)).key !== KEY) {
        socket.close(4401, 'wrong key');
        return;
      }
      mock.clients.add(client);
      mock.controller ??= client;
      client.greet();
      socket.on('message', (text) => client.take(String(text)));
    });
    socket.on('close', () => {
      mock.clients.delete(client);
      if (mock.controller === client) mock.controller = null;
    });
  });
  const timers = mock.recording ? [] : [
    setInterval(() => !mock.paused && mock.connected && mock.publish(0.05), 50),
    setInterval(() => {
      for (const client of mock.clients) if (client.hz > 0) client.sendPicture();
    }, 1000 / hz),
  ];
  // Of a recording the host says nothing by itself.
  if (!mock.recording) {
    timers.push(setInterval(() => {
      for (const client of mock.clients) client.say(mock.gauges(client));
    }, 500));
  }
  await new Promise((resolve) => server.listen(port, '127.0.0.1', resolve));
  const served = server.address().port;
  return {
    mock,
    port: served,
    url: `http://127.0.0.1:${served}/#key=${KEY}`,
    tell: (message) => {
      for (const client of mock.clients) client.say({ kind: 'event', session: mock.session, time_s: mock.time, ...message });
    },
    close: async () => {
      timers.forEach(clearInterval);
      for (const socket of sockets.clients) socket.terminate();
      sockets.close();
      await new Promise((resolve) => {
        server.close(resolve);
        server.closeAllConnections();
      });
    },
  };
}

if (process.argv[1] === fileURLToPath(import.meta.url)) {
  const { url } = await start({ scene: process.argv[2] ?? 'slab', port: 8421, hz: 30 });
  console.log(url);
}
