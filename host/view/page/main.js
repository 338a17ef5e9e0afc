// The page: what comes from the host goes to the scene, the bar, the plots and the panel, and what people do goes to the host.

import * as THREE from 'three';
import { address, readAddress } from './address.js';
import { Bar } from './bar.js';
import { Range } from './colours.js';
import { MODES } from './decode.js';
import { Drag } from './drag.js';
import { Film, fileName, picture as exported, save } from './export.js';
import { Instruments } from './instruments.js';
import { CommandError, Link } from './link.js';
import { drawOverlay } from './overlay.js';
import { Panel } from './panel.js';
import { Past } from './past.js';
import { Player } from './player.js';
import { Plots } from './plots.js';
import { Stage, VIEWS } from './stage.js';
import { KEPT_S, Telemetry, csv } from './telemetry.js';
import { TimeLine } from './timeline.js';
import { Tissue } from './tissue.js';
import { fixed, words } from './units.js';
import { Alerts, element, toast } from './words.js';

/** Pictures a second that are asked for. */
const PICTURE_HZ = 30;
/** Silent for so long, the host counts as gone [s]. */
const SILENCE_S = 2;
/** Events that are told in words; the others are marks on the time line. */
const TOLD = ['fault', 'lost', 'back', 'overload', 'reset', 'switch', 'saved', 'control', 'ended'];
/** The scalar that follows from a picture's displacements. */
const DISPLACEMENT = 'displacement';

class Page {
  constructor() {
    const { key, view } = readAddress();
    this.link = new Link(key);
    /** How the link says to look, until it has been done. */
    this.view = view;
    /** @type {import('./link.js').Hello | null} */
    this.hello = null;
    /** @type {import('./link.js').Gauges | null} */
    this.gauges = null;
    /** @type {Telemetry | null} */
    this.telemetry = null;
    /** What is shown. @type {import('./decode.js').Picture | null} */
    this.picture = null;
    /** The newest that has come. @type {import('./decode.js').Picture | null} */
    this.newest = null;
    this.session = -1;
    this.geometry = -1;
    /** Of the scene that the camera looks at. */
    this.bounds = '';
    this.unframed = false;
    /** @type {string | null} */
    this.scalar = view?.scalar ?? null;
    this.range = new Range();
    this.values = new Float32Array(0);
    this.past = new Past();
    /** Value under the pointer. @type {number | null} */
    this.under = null;
    this.shown = /** @type {number[]} */ ([]);
    this.alerts = new Alerts();
    this.bar = new Bar({
      stop: () => this.stop(),
      arm: () => this.command({ do: 'arm' }),
      clear: () => this.command({ do: 'clear_fault' }),
    });
    this.player = new Player((time_s) => this.link.ask({ do: 'seek', time_s }), () => {});
    this.plots = new Plots(element('plots'), (a, b) => this.setMarks(a, b));
    this.timeLine = new TimeLine({ command: (command) => this.command(command), back: (time) => this.lookBack(time), player: this.player });
    this.panel = new Panel(this.panelActions());
    this.stage = this.makeStage();
    if (this.stage) this.wireStage(this.stage);
    this.plotTools();
    this.listen();
    if (key) this.link.connect();
    else this.alerts.set('link', 'This address has no key.', 'Open the address that sutura printed: it ends with #key=…');
    const frame = () => {
      requestAnimationFrame(frame);
      this.frame();
    };
    requestAnimationFrame(frame);
    setInterval(() => this.slow(), 250);
  }

  makeStage() {
    try {
      return new Stage(element('stage'));
    } catch {
      element('no-webgl').hidden = false;
      element('views').hidden = true;
      return null;
    }
  }

  /** @param {Stage} stage */
  wireStage(stage) {
    this.tissue = new Tissue(stage);
    this.instruments = new Instruments(stage);
    this.drag = new Drag(stage, this.instruments, () => this.grip());
    this.film = new Film(stage, (context, size) => this.overlay(context, size));
    this.drag.addEventListener('target', (event) => {
      this.command({ do: 'drag', to_m: /** @type {CustomEvent} */ (event).detail });
      this.showSpring();
    });
    stage.addEventListener('drawn', () => {
      this.shown.push(performance.now());
      this.drawOver();
    });
    stage.addEventListener('quality', () => {
      this.tissue?.apply();
      this.instruments?.apply();
      this.panel.showQuality(stage);
    });
    stage.addEventListener('lost', () => this.alerts.set('context', 'The graphics card has dropped the picture.', 'It comes back by itself, or by reloading the page.', 'warn'));
    stage.addEventListener('restored', () => this.alerts.set('context', ''));
    stage.element.addEventListener('pointermove', (event) => this.look(event));
    const views = element('views');
    for (const name of /** @type {import('./stage.js').ViewName[]} */ (Object.keys(VIEWS))) {
      const button = document.createElement('button');
      button.type = 'button';
      button.textContent = name;
      button.addEventListener('click', () => stage.look(name));
      views.append(button);
    }
    this.panel.showQuality(stage);
  }

  plotTools() {
    const tools = element('plot-tools');
    this.pauseButton = document.createElement('button');
    this.pauseButton.type = 'button';
    this.pauseButton.textContent = 'Hold plots';
    this.pauseButton.title = 'Wheel: zoom. Click: mark A. Shift and click: mark B, and differences. Double click: follow.';
    this.pauseButton.addEventListener('click', () => this.plots.pause(!this.plots.paused));
    this.marks = document.createElement('span');
    tools.append(this.marks, this.pauseButton);
  }

  listen() {
    const on = (/** @type {string} */ name, /** @type {(detail: any) => void} */ take) =>
      this.link.addEventListener(name, (event) => take(/** @type {CustomEvent} */ (event).detail));
    on('hello', (hello) => this.takeHello(hello));
    on('geometry', (geometry) => this.takeGeometry(geometry));
    on('picture', (picture) => this.takePicture(picture));
    on('ticks', (block) => block.session === this.session && this.telemetry?.addTicks(block));
    on('solves', (block) => block.session === this.session && this.telemetry?.addSolves(block));
    on('gauges', (gauges) => this.takeGauges(gauges));
    on('event', (event) => this.takeEvent(event));
    on('closed', () => this.showGone());
  }

  /** @param {import('./link.js').Hello} hello */
  takeHello(hello) {
    const again = hello.session === this.session;
    this.hello = hello;
    this.alerts.set('link', '');
    document.title = `${hello.scene} – Sutura`;
    this.bar.setSession(hello);
    this.showFaults(hello.faults);
    this.panel.setSession(hello, this.scalar);
    this.ask({ do: 'picture_hz', hz: this.stage ? PICTURE_HZ : 0 });
    this.ask({ do: 'scalar', name: hello.scalars.some((one) => one.name === this.scalar) ? this.scalar : null });
    if (again) return;
    this.startSession(hello);
  }

  /** @param {import('./link.js').Hello} hello */
  startSession(hello) {
    const first = this.session === -1;
    const elsewhere = String(hello.bounds_m) !== this.bounds;
    this.bounds = String(hello.bounds_m);
    this.session = hello.session;
    this.geometry = -1;
    this.picture = this.newest = null;
    this.past.clear();
    this.drag?.forget();
    this.restartRange();
    this.alerts.set('badge', '');
    const line = hello.time_line;
    const seconds = line ? line.to_s - line.from_s : KEPT_S;
    this.telemetry = new Telemetry(hello.stages, hello.needles.length, hello.threads.length, seconds, hello.tick_hz);
    this.plots.whole = line ? [line.from_s, line.to_s] : null;
    this.plots.play_s = null;
    this.plots.start(this.telemetry);
    this.timeLine.begin(hello.source === 'recording', hello.role === 'control' ? hello.do : [], line);
    const why = line && !line.solvable ? (line.why ?? '') : '';
    element('no-tissue').hidden = !why || !this.stage;
    /** @type {HTMLElement} */ (element('no-tissue').lastElementChild).textContent = why;
    if (this.stage) {
      this.stage.frame(hello.bounds_m);
      this.tissue?.clear();
      this.instruments?.setScene(hello);
      if (elsewhere) this.stage.look('home');
      // Where tools are the first picture says.
      this.unframed = elsewhere && !(first && this.view);
      if (first) this.applyView();
    }
    if (line) this.player.start(line);
  }

  /** @param {import('./decode.js').Geometry} geometry */
  takeGeometry(geometry) {
    if (geometry.session !== this.session) return;
    this.geometry = geometry.id;
    this.tissue?.setGeometry(geometry);
    this.values = new Float32Array(geometry.positions.length / 3);
  }

  /** @param {import('./decode.js').Picture} picture */
  takePicture(picture) {
    if (picture.geometry !== this.geometry) return;
    this.newest = picture;
    if (this.hello?.source === 'live') this.past.add(picture);
    if (this.timeLine.looking === null) this.show(picture);
  }

  /** @param {import('./decode.js').Picture} picture */
  show(picture) {
    this.picture = picture;
    const { stage, tissue, instruments } = this;
    if (!stage || !tissue || !instruments) return;
    tissue.move(picture.displacement, picture.displacementScale);
    this.colour(picture);
    instruments.setPicture(picture, (vertex, into) => this.place(vertex, into));
    this.showSpring();
    if (this.unframed) {
      this.unframed = false;
      const box = instruments.bounds();
      if (!box.isEmpty()) stage.include(box);
      stage.look('home');
    }
    stage.request();
  }

  /** Where a vertex of the tissue is in the picture. @param {number} vertex @param {THREE.Vector3} into */
  place(vertex, into) {
    const positions = this.tissue?.geometry?.positions;
    if (!positions || 3 * vertex >= positions.length) return false;
    into.fromArray(positions, 3 * vertex);
    const { displacement, displacementScale } = /** @type {import('./decode.js').Picture} */ (this.picture);
    if (displacement) into.addScaledVector(new THREE.Vector3().fromArray(displacement, 3 * vertex), displacementScale / 32767);
    return true;
  }

  /** @param {import('./decode.js').Picture} picture */
  colour(picture) {
    const scalar = this.hello?.scalars.find((one) => one.name === this.scalar);
    const has = this.hello?.scalars[picture.scalar - 1]?.name ?? null;
    this.panel.sayScalar(this.scalar && has !== this.scalar && this.scalar !== DISPLACEMENT && picture.recorded ? `The pictures of this recording have ${has ? words(has) : 'no value'}.` : '');
    if (!scalar || !this.readValues(picture, has)) {
      this.tissue?.colour(null, [0, 1], false);
      return;
    }
    this.range.see(this.values);
    this.tissue?.colour(this.values, this.range.ends, scalar.signed);
    this.panel.showRange(this.range.ends, this.range.fixed !== null);
  }

  /** Values at the geometry's vertices, if the picture has what is asked for. @param {import('./decode.js').Picture} picture @param {string | null} has */
  readValues(picture, has) {
    const { values } = this;
    const { displacement, scalars } = picture;
    if (scalars && has === this.scalar) {
      const step = (picture.scalarHigh - picture.scalarLow) / 65535;
      for (let i = 0; i < values.length; i += 1) values[i] = picture.scalarLow + scalars[i] * step;
      return true;
    }
    // Every picture has this one.
    if (this.scalar !== DISPLACEMENT || !displacement) return false;
    const metres = picture.displacementScale / 32767;
    for (let i = 0; i < values.length; i += 1) {
      values[i] = metres * Math.hypot(displacement[3 * i], displacement[3 * i + 1], displacement[3 * i + 2]);
    }
    return true;
  }

  restartRange() {
    this.range.restart(this.hello?.scalars.find((one) => one.name === this.scalar)?.signed ?? false);
  }

  /** @param {import('./link.js').Gauges} gauges */
  takeGauges(gauges) {
    this.gauges = gauges;
    this.bar.setGauges(gauges);
    if (this.hello?.source === 'live') this.bar.setMode(gauges.mode);
    this.timeLine.setPaused(gauges.paused);
    this.showFaults(gauges.faults);
    this.alerts.set('console', gauges.connected || this.hello?.source === 'recording' ? '' : 'The console is gone.', 'Its values are crossed out. Look at its cable and power; the session goes on when it is back.');
    this.warnOfLateness(gauges);
    this.panel.showCounters(this.counters(gauges));
  }

  /** @param {import('./link.js').Gauges} gauges */
  warnOfLateness(gauges) {
    const age = gauges.age_us?.now?.p50 ?? 0;
    const horizon = 1000 * (this.hello?.horizon_ms ?? Infinity);
    const late = this.hello?.pace === 'real-time' && gauges.mode === 'armed' && age > horizon;
    const local = ['127.0.0.1', 'localhost', '[::1]'].includes(location.hostname);
    const port = location.port || '80';
    this.alerts.set('late', late ? 'The host lacks time: forces are older than their horizon.' : '', local ? `Watch from another PC (ssh -L ${port}:127.0.0.1:${port} THIS_PC), or choose the quality “lean”.` : 'Ask for a coarser mesh, or a simpler tissue.', 'warn');
  }

  /** @param {import('./link.js').Gauges} gauges @returns {[string, string][]} */
  counters(gauges) {
    const status = this.picture?.status;
    const whole = (/** @type {number | null | undefined} */ value) => (value?.toLocaleString('en') ?? '–');
    const ms = (/** @type {import('./link.js').Percentiles | undefined} */ both) => (both ? `${fixed(both.p50 / 1000, 2)} / ${fixed(both.p99 / 1000, 2)} ms` : '–');
    const withheld = Object.entries(gauges.withheld).filter(([, count]) => count > 0);
    const word = status ? (this.hello?.statuses[status.word] ?? '–') : '–';
    return [
      ['Solver', word],
      ['Vertices touched', whole(status?.rows)],
      ['Touching tissue, pairs', whole(status?.pairs)],
      ['Newton iterations', whole(status?.iterations)],
      ['Residual', status ? status.residual.toExponential(1).replace('-', '−') : '–'],
      ['Largest thread tension', status && Number.isFinite(status.tension) ? `${fixed(status.tension, 3)} N` : '–'],
      ['Longest span', status && Number.isFinite(status.span) ? fixed(status.span, 3) : '–'],
      ['Latency, session p50 / p99', ms(gauges.latency_us?.all)],
      ['Step, session p50 / p99', ms(gauges.step_us?.all)],
      ['Round trip p50 / p99', ms(gauges.rtt_us?.now ?? gauges.rtt_us?.all)],
      ['Least energy', gauges.energy_min_j === null ? '–' : `${fixed(1000 * gauges.energy_min_j, 3)} mJ`],
      ['Ticks late', whole(gauges.ticks_late)],
      ['Tick overruns', whole(gauges.tick_overruns)],
      ['Frames lost', whole(gauges.frames.lost)],
      ['Frames rejected', whole(gauges.frames.rejected)],
      ['Frames too late', whole(gauges.frames.late)],
      ['Frames superseded', whole(gauges.frames.superseded)],
      ...withheld.map(([name, count]) => /** @type {[string, string]} */ ([`Withheld: ${name}`, whole(count)])),
      ['Pictures made / sent', `${whole(gauges.pictures.made)} / ${whole(gauges.pictures.sent)}`],
      ['A picture takes', `${fixed(gauges.picture_us / 1000, 2)} ms`],
      ['Clients', whole(gauges.clients)],
    ];
  }

  /** @param {string[]} faults */
  showFaults(faults) {
    for (const name of faults) {
      const fix = this.hello?.fixes[name];
      this.alerts.set(`fault-${name}`, fix?.message ?? `Fault: ${name}`, fix?.help ?? '');
    }
    this.alerts.only('fault-', faults.map((name) => `fault-${name}`));
  }

  /** @param {import('./link.js').SessionEvent} event */
  takeEvent(event) {
    if (event.what === 'ready') {
      this.player.setReady(event.time_s);
    } else if (event.what === 'verified') {
      this.timeLine.setBadge(event.badge ?? '', event.text);
      if (event.badge === 'diverged') this.alerts.set('badge', 'This recording could not be verified.', event.text, 'warn');
    } else {
      if (this.hello?.source === 'live' && TOLD.includes(event.what)) toast(event.help ? `${event.text} ${event.help}` : event.text, event.what === 'fault' || event.what === 'lost');
      this.plots.events.push(event);
      this.timeLine.addEvent(event);
    }
  }

  /** Says what has gone, and crosses out its values. */
  showGone() {
    const live = this.hello?.source === 'live';
    // Of a recording nothing comes that nobody has asked for.
    const gone = !this.link.open || (live && this.link.silence > SILENCE_S);
    this.bar.setGone(gone, live && this.gauges?.connected === false);
    element('view').classList.toggle('stale', gone && this.session !== -1);
    if (this.link.final) this.alerts.set('link', 'The host has closed the connection.', this.link.final);
    else if (gone && this.link.key) this.alerts.set('link', `No connection to the host, last seen ${Math.floor(this.link.silence)} s ago.`, 'Trying again. Is sutura still running? A console stops by itself when its host is silent.');
    else if (this.link.key) this.alerts.set('link', '');
  }

  /** Sends a command; an error is shown in the host's words. @param {{do: string, [key: string]: unknown}} command */
  command(command) {
    this.ask(command).catch(() => {});
  }

  /** @param {{do: string, [key: string]: unknown}} command */
  async ask(command) {
    try {
      return await this.link.ask(command);
    } catch (error) {
      if (error instanceof CommandError) toast(`${error.message}${error.help ? `: ${error.help}` : ''}`, true);
      return undefined;
    }
  }

  stop() {
    this.drag?.forget();
    if (!this.link.tell({ id: 0, do: 'safe_stop' })) toast('Safe stop was not sent: there is no connection. Use the emergency stop.', true);
    else toast('Safe stop sent');
  }

  grip() {
    const can = this.hello?.do.includes('drag') && this.hello.role === 'control' && this.timeLine.looking === null;
    const grip = this.newest?.status?.grip;
    return can && grip ? new THREE.Vector3().fromArray(grip) : null;
  }

  showSpring() {
    const grip = this.picture?.status?.grip;
    if (grip) this.instruments?.showSpring(this.drag?.target ?? null, new THREE.Vector3().fromArray(grip));
    this.stage?.request();
  }

  /** @param {number | null} time [s] */
  lookBack(time) {
    const picture = time === null ? this.newest : this.past.at(time);
    if (time !== null) this.drag?.forget();
    if (picture) this.show(picture);
  }

  /** @param {number | null} a @param {number | null} b [s] */
  setMarks(a, b) {
    this.timeLine?.setMarks(a, b);
    if (!this.marks) return;
    const difference = a !== null && b !== null ? `, Δ ${fixed(b - a, 4)} s` : '';
    this.marks.textContent = a === null ? '' : `A ${fixed(a, 3)} s${b === null ? '' : `, B ${fixed(b, 3)} s`}${difference}`;
  }

  /** The value under the pointer. @param {PointerEvent} event */
  look(event) {
    const { stage, tissue } = this;
    if (!stage || !tissue?.surface || !tissue.coloured || event.buttons !== 0) return;
    const box = stage.element.getBoundingClientRect();
    const pointer = new THREE.Vector2((2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height);
    const caster = new THREE.Raycaster();
    caster.setFromCamera(pointer, stage.camera);
    tissue.buffers.boundingSphere = null;
    tissue.buffers.boundingBox = null;
    const hit = caster.intersectObject(tissue.skin)[0];
    const before = this.under;
    this.under = hit?.uv ? this.valueAt(hit.uv.x) : null;
    if (this.under !== before) this.drawOver();
  }

  /** @param {number} u of the colour map's texture */
  valueAt(u) {
    const [low, high] = this.range.ends;
    return low + ((u - 0.5 / 256) / (255 / 256)) * (high - low);
  }

  drawOver() {
    const { stage } = this;
    if (!stage) return;
    const canvas = /** @type {HTMLCanvasElement} */ (element('overlay'));
    const { width, height } = stage.size;
    canvas.width = width * devicePixelRatio;
    canvas.height = height * devicePixelRatio;
    const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext('2d'));
    context.scale(devicePixelRatio, devicePixelRatio);
    this.overlay(context, stage.size);
  }

  /** @param {CanvasRenderingContext2D} context @param {{width: number, height: number}} size */
  overlay(context, size) {
    const { stage, instruments, tissue, hello } = this;
    if (!stage || !instruments || !hello) return;
    const scalar = tissue?.coloured ? hello.scalars.find((one) => one.name === this.scalar) : undefined;
    const { mode } = stage.stereo;
    const halves = mode === 'side-by-side' || mode === 'swapped' ? 2 : 1;
    const what = {
      title: `${hello.scene}, ${hello.tissue}`,
      time: this.picture?.time ?? null,
      legend: scalar ? { ...scalar, name: words(scalar.name), range: this.range.ends, at: this.under } : null,
      scales: {
        contact: instruments.options.contacts && (this.picture?.contacts.vertices.length ?? 0) > 0 ? instruments.scales.contact : 0,
        wrench: instruments.options.wrench ? instruments.scales.wrench : 0,
      },
      pixelsPerMetre: stage.pixelsPerMetre,
      narrow: halves === 2,
      camera: stage.camera.quaternion,
      note: mode.startsWith('anaglyph') ? 'red-cyan: left eye red' : '',
    };
    for (let half = 0; half < halves; half += 1) {
      context.save();
      context.translate((half * size.width) / halves, 0);
      drawOverlay(context, { width: size.width / halves, height: size.height }, what);
      context.restore();
    }
  }

  /** @returns {import('./panel.js').PanelActions} */
  panelActions() {
    return {
      command: (command) => this.command(command),
      scalar: (name) => this.setScalar(name),
      range: (ends) => this.setRange(ends),
      quality: (quality) => this.stage?.choose(quality, 'chosen by hand'),
      look: (name, value) => this.setLook(name, value),
      cut: (cut) => {
        if (!this.tissue) return;
        this.tissue.cut = cut;
        this.tissue.apply();
      },
      stereo: (mode) => {
        if (!this.stage) return;
        this.stage.stereo.mode = mode;
        this.stage.request();
      },
      separation: (separation) => {
        if (!this.stage) return;
        this.stage.stereo.separation = separation;
        this.stage.request();
      },
      keep: (keep) => {
        if (this.drag) this.drag.keep = keep;
      },
      save: (what) => this.save(what).catch((error) => toast(String(error.message ?? error), true)),
    };
  }

  /** @param {string | null} name */
  setScalar(name) {
    this.scalar = name;
    this.range.fixed = null;
    this.restartRange();
    this.under = null;
    this.ask({ do: 'scalar', name });
    if (this.picture) this.show(this.picture);
    // A picture that has been shown does not come again by itself.
    if (this.hello?.source === 'recording') this.player.again();
  }

  /** @param {[number, number] | null} ends */
  setRange(ends) {
    this.range.fixed = ends;
    if (this.picture) this.show(this.picture);
  }

  /** @param {string} name @param {boolean | number} value */
  setLook(name, value) {
    const { tissue, instruments } = this;
    if (!tissue || !instruments) return;
    if (name in tissue.options) Object.assign(tissue.options, { [name]: value });
    if (name in instruments.options) Object.assign(instruments.options, { [name]: value });
    if (name === 'xray') instruments.xray = value === true;
    tissue.apply();
    if (this.picture) this.show(this.picture);
  }

  /** What the address says. */
  applyView() {
    const { view, stage, tissue, panel } = this;
    if (!view || !stage || !tissue) return;
    this.view = null;
    stage.pose = view.camera;
    this.range.fixed = view.range;
    for (const name of /** @type {const} */ (['xray', 'wireframe'])) {
      if (panel.checks) panel.checks[name].checked = view[name];
      this.setLook(name, view[name]);
    }
    panel.opacity?.set(view.opacity);
    this.setLook('opacity', view.opacity);
    panel.setCut(view.cut);
    if (panel.stereo) panel.stereo.value = view.stereo;
    stage.stereo.mode = /** @type {import('./stereo.js').StereoMode} */ (view.stereo);
  }

  /** @returns {import('./address.js').View | null} */
  currentView() {
    const { stage, tissue } = this;
    if (!stage || !tissue) return null;
    const { xray, opacity, wireframe } = tissue.options;
    return { camera: stage.pose, scalar: this.scalar, range: this.range.fixed, cut: tissue.cut, xray, opacity, wireframe, stereo: stage.stereo.mode };
  }

  /** @param {'png' | 'png2' | 'film' | 'link' | 'csv' | 'csv-all' | 'plots'} what */
  async save(what) {
    const name = (/** @type {string} */ ending) => fileName(this.hello?.scene ?? '', this.picture?.time ?? null, ending);
    const text = (/** @type {string} */ content) => new Blob([content], { type: 'text/csv' });
    if (what === 'csv' || what === 'csv-all') {
      if (!this.telemetry) throw new Error('nothing has come yet');
      const { ticks, solves } = this.telemetry;
      const [from, to] = what === 'csv' ? this.plots.range() : [-Infinity, Infinity];
      save(text(csv(ticks, Object.keys(ticks.columns), from, to)), name('ticks.csv'));
      if (what === 'csv-all') save(text(csv(solves, this.telemetry.solveNames, from, to)), name('solves.csv'));
    } else if (what === 'plots') {
      save(await png(this.plots.canvas()), name('plots.png'));
    } else if (!this.stage || !this.film) {
      throw new Error('there is no picture');
    } else if (what === 'link') {
      const view = this.currentView();
      if (view) await navigator.clipboard.writeText(address(view));
      toast('Link copied: whoever has it and reaches this host can control the session');
    } else if (what === 'film') {
      await this.toggleFilm(this.film);
    } else {
      save(await png(exported(this.stage, (context, size) => this.overlay(context, size), what === 'png2' ? 2 : 1)), name('png'));
    }
  }

  /** @param {Film} film */
  async toggleFilm(film) {
    const button = this.panel.film;
    if (film.running) {
      const blob = await film.stop();
      save(blob, fileName(this.hello?.scene ?? '', this.picture?.time ?? null, blob.type.includes('mp4') ? 'mp4' : 'webm'));
    } else {
      film.start();
    }
    if (button) button.textContent = film.running ? 'Stop and save' : 'Record film';
    button?.setAttribute('aria-pressed', String(film.running));
  }

  /** With every frame. */
  frame() {
    if (this.hello?.source === 'recording') {
      this.player.advance();
      this.plots.play_s = this.player.time;
      this.timeLine.update(this.player.span, this.player.time, this.player.ready);
      this.showForceAt(this.player.time);
    } else {
      const span = this.past.span;
      this.timeLine.update(span, this.timeLine.looking ?? span[1], span[1]);
      this.showForceAt(this.telemetry?.ticks.newest ?? null);
    }
    this.plots.redraw();
  }

  /** @param {number | null} time [s] */
  showForceAt(time) {
    const ticks = this.telemetry?.ticks;
    const now = performance.now();
    if (!ticks || time === null || now - (this.figures_ms ?? 0) < 100) return;
    this.figures_ms = now;
    this.bar.set('force', fixed(ticks.value('force_n', time), 2), 'N');
    const age = ticks.value('age_ms', time);
    const horizon = this.hello?.horizon_ms ?? Infinity;
    this.bar.set('age', fixed(age, 1), 'ms', age > horizon);
    const mode = MODES[ticks.value('mode', time)];
    if (this.hello?.source === 'recording' && mode) this.bar.setMode(mode);
  }

  /** A few times a second. */
  slow() {
    this.showGone();
    const now = performance.now();
    this.shown = this.shown.filter((time) => now - time < 1000);
    const wanted = this.gauges?.paused || this.hello?.source === 'recording' ? '' : ` of ${PICTURE_HZ}`;
    this.bar.set('shown', this.stage ? `${this.shown.length}${wanted}` : 'none', this.stage ? '/s' : '');
    if (this.pauseButton) this.pauseButton.setAttribute('aria-pressed', String(this.plots.paused));
  }
}

/** @param {HTMLCanvasElement} canvas @returns {Promise<Blob>} */
function png(canvas) {
  return new Promise((resolve, reject) => {
    canvas.toBlob((blob) => (blob ? resolve(blob) : reject(new Error('the picture is too large for this browser'))), 'image/png');
  });
}

// For the browser's console and the tests.
Object.assign(window, { sutura: new Page() });
