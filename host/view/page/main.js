// The page: what comes from the host goes to the scene, the bar, the plots and the panel, and what people do goes to the host.

import * as THREE from 'three';
import { readAddress } from './address.js';
import { Bar } from './bar.js';
import { Colouring } from './colouring.js';
import { counters } from './counters.js';
import { MODES } from './decode.js';
import { Drag } from './drag.js';
import { Instruments } from './instruments.js';
import { CommandError, Link } from './link.js';
import { Notices } from './notices.js';
import { Panel } from './panel.js';
import { Past } from './past.js';
import { Player } from './player.js';
import { Plots } from './plots.js';
import { Saving } from './saving.js';
import { Slipped, isInside } from './slipped.js';
import { Stage, VIEWS } from './stage.js';
import { KEPT_S, Telemetry } from './telemetry.js';
import { TimeLine } from './timeline.js';
import { Tissue } from './tissue.js';
import { fixed } from './units.js';
import { View } from './view.js';
import { element, toast } from './words.js';

/** Pictures a second that are asked for. */
const PICTURE_HZ = 30;
/** Events that are told in words; the others are marks on the time line. */
const TOLD = ['fault', 'lost', 'back', 'overload', 'reset', 'switch', 'saved', 'control', 'ended'];

class Page {
  constructor() {
    const { key, view } = readAddress();
    this.link = new Link(key);
    /** How the address says to look, until it has been done. */
    this.asked = view;
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
    /** Whether the picture that was asked for is still to come: another stands in for it. */
    this.awaited = false;
    this.past = new Past();
    this.shown = /** @type {number[]} */ ([]);
    this.bar = new Bar({
      stop: () => this.stop(),
      arm: () => this.command({ do: 'arm' }),
      clear: () => this.command({ do: 'clear_fault' }),
    });
    this.notices = new Notices(this.link, this.bar);
    this.slipped = new Slipped(() => this.takeOut());
    this.player = new Player((time_s) => this.link.ask({ do: 'seek', time_s }), () => {});
    this.plots = new Plots(element('plots'), (a, b) => this.setMarks(a, b));
    this.timeLine = new TimeLine({ command: (command) => this.command(command), back: (time) => this.lookBack(time), player: this.player });
    this.panel = new Panel(this.panelActions());
    const changed = () => this.showAgain();
    this.colouring = new Colouring({ panel: this.panel, ask: (command) => this.ask(command), changed, pointed: () => this.view?.drawOver() }, view?.scalar ?? null);
    this.saving = new Saving(() => ({ scene: this.hello?.scene ?? '', time: this.picture?.time ?? null, telemetry: this.telemetry }), this.plots, this.panel);
    this.stage = this.makeStage();
    if (this.stage) this.wireStage(this.stage);
    this.plotTools();
    this.listen();
    if (key) this.link.connect();
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
    this.view = new View({ stage, tissue: this.tissue, instruments: this.instruments }, this.colouring, () => this.showAgain());
    this.colouring.tissue = this.tissue;
    this.saving.setView(this.view);
    this.drag.addEventListener('target', (event) => {
      // Lets go of the probe if the host takes no target.
      this.link.ask({ do: 'drag', to_m: /** @type {CustomEvent} */ (event).detail }).catch((error) => {
        this.letGo();
        this.tellRefused(error);
      });
      this.showSpring();
    });
    stage.addEventListener('drawn', () => {
      this.shown.push(performance.now());
      this.tellDrawn();
      this.view?.drawOver();
    });
    stage.addEventListener('quality', () => {
      this.tissue?.apply();
      this.instruments?.apply();
      this.panel.showQuality(stage);
    });
    stage.addEventListener('lost', () => this.notices.showLost(true));
    stage.addEventListener('restored', () => this.notices.showLost(false));
    stage.element.addEventListener('pointermove', (event) => this.colouring.point(event, stage));
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

  /** Says which picture is drawn, to whoever takes one of the page. */
  tellDrawn() {
    const { dataset } = element('stage');
    if (this.picture) dataset.drawnS = String(this.picture.time);
    else delete dataset.drawnS;
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
    on('closed', () => this.notices.showGone(this.gauges, this.session !== -1));
  }

  /** @param {import('./link.js').Hello} hello */
  takeHello(hello) {
    const again = hello.session === this.session;
    const sameRole = this.hello?.role === hello.role;
    this.hello = hello;
    // Another setting: whoever holds a slider goes on holding it.
    if (again && sameRole) return this.panel.showSettings(hello);
    document.title = `${hello.scene} – Sutura`;
    this.bar.setSession(hello);
    this.notices.setSession(hello);
    this.slipped.setSession(hello, again);
    this.panel.setSession(hello, this.colouring.scalar);
    this.ask({ do: 'picture_hz', hz: this.stage ? PICTURE_HZ : 0 });
    this.colouring.setSession(hello);
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
    if (this.view) this.view.picture = null;
    this.past.clear();
    this.drag?.forget();
    this.colouring.restartRange();
    this.notices.showVerdict('', '');
    const line = hello.time_line;
    const seconds = line ? line.to_s - line.from_s : KEPT_S;
    this.telemetry = new Telemetry(hello.stages, hello.needles.length, hello.threads.length, seconds, hello.tick_hz);
    this.plots.whole = line ? [line.from_s, line.to_s] : null;
    this.plots.play_s = null;
    // A recording in lockstep says no times on the wall.
    this.plots.start(this.telemetry, hello.source === 'recording' && hello.pace === 'lockstep');
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
      this.unframed = elsewhere && !(first && this.asked);
      this.awaited = true;
      if (first && this.asked) this.view?.apply(this.asked, this.panel);
      this.asked = null;
    }
    if (line) this.player.start(line);
  }

  /** @param {import('./decode.js').Geometry} geometry */
  takeGeometry(geometry) {
    if (geometry.session !== this.session) return;
    this.geometry = geometry.id;
    this.tissue?.setGeometry(geometry);
    this.colouring.setVertices(geometry.positions.length / 3);
  }

  /** @param {import('./decode.js').Picture} picture */
  takePicture(picture) {
    if (picture.geometry !== this.geometry) return;
    this.newest = picture;
    this.slipped.take(picture);
    if (this.hello?.source === 'live') this.past.add(picture);
    if (this.timeLine.looking === null) this.show(picture);
  }

  /** @param {import('./decode.js').Picture} picture */
  show(picture) {
    this.picture = picture;
    const { stage, tissue, instruments, view } = this;
    if (!stage || !tissue || !instruments || !view) return;
    view.picture = picture;
    tissue.move(picture.displacement, picture.displacementScale);
    this.colouring.show(picture);
    if (this.awaited) instruments.forget();
    instruments.setPicture(picture, (vertex, into) => this.place(vertex, into), isInside(picture, this.hello));
    this.showSpring();
    // What is seen of a recording at a time does not depend on the pictures that stood in for it.
    const came = this.hello?.source !== 'recording' || Math.abs(picture.time - this.player.time) < 1.5 / this.player.hz;
    if (came) this.awaited = false;
    if (this.unframed) {
      this.unframed = !came;
      this.frameAll();
    }
    stage.request();
  }

  /** Frames the tissue, and the tools where they are. */
  frameAll() {
    const { stage, instruments, hello } = this;
    if (!stage || !instruments || !hello) return;
    stage.frame(hello.bounds_m);
    const box = instruments.bounds();
    if (!box.isEmpty()) stage.include(box);
    stage.look('home');
  }

  showAgain() {
    if (this.picture) this.show(this.picture);
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

  /** @param {import('./link.js').Gauges} gauges */
  takeGauges(gauges) {
    this.gauges = gauges;
    this.bar.setGauges(gauges);
    if (this.hello?.source === 'live') this.bar.setMode(gauges.mode);
    this.slipped.setMode(gauges.mode);
    this.timeLine.setPaused(gauges.paused);
    this.panel.showRecording(gauges.recording === true);
    this.notices.setGauges(gauges);
    this.panel.showCounters(counters(gauges, this.picture?.status, this.hello?.statuses ?? [], this.hello?.board_rows_hz));
  }

  /** @param {import('./link.js').SessionEvent} event */
  takeEvent(event) {
    if (event.what === 'ready') {
      this.player.setReady(event.time_s);
      // Pictures are made anew, too, where another value was chosen.
      if (this.picture && this.colouring.lacks(this.picture)) this.player.again();
    } else if (event.what === 'verified') {
      this.timeLine.setBadge(event.badge ?? '', event.text);
      this.notices.showVerdict(event.badge ?? '', event.text);
    } else {
      // Nobody holds a grip that rests: its target is none any more.
      if (event.what === 'disarmed') this.letGo();
      if (this.hello?.source === 'live' && TOLD.includes(event.what)) toast(event.help ? `${event.text} ${event.help}` : event.text, event.what === 'fault' || event.what === 'lost');
      this.plots.events.push(event);
      this.timeLine.addEvent(event);
    }
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
      this.tellRefused(error);
      return undefined;
    }
  }

  /** @param {unknown} error of a command */
  tellRefused(error) {
    if (error instanceof CommandError) toast(`${error.message}${error.help ? `: ${error.help}` : ''}`, true);
  }

  /** Forgets where the probe was dragged to. */
  letGo() {
    this.drag?.forget();
    this.showSpring();
  }

  takeOut() {
    this.letGo();
    this.command({ do: 'take_out' });
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

  /** @returns {import('./panel.js').PanelActions} */
  panelActions() {
    return {
      command: (command) => this.command(command),
      scalar: (name) => this.choose(name),
      range: (ends) => this.colouring.fix(ends),
      quality: (quality) => this.stage?.choose(quality, 'chosen by hand'),
      look: (name, value) => this.view?.setLook(name, value),
      cut: (cut) => this.view?.setCut(cut),
      stereo: (mode) => this.view?.setStereo(mode),
      separation: (separation) => this.view?.setSeparation(separation),
      keep: (keep) => {
        if (this.drag) this.drag.keep = keep;
      },
      save: (what) => this.saving.save(what).catch((error) => toast(String(error.message ?? error), true)),
    };
  }

  /** @param {string | null} name of a value */
  choose(name) {
    this.colouring.choose(name);
    // A picture that has been shown does not come again by itself.
    if (this.hello?.source === 'recording') this.player.again();
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
    this.notices.showGone(this.gauges, this.session !== -1);
    const now = performance.now();
    this.shown = this.shown.filter((time) => now - time < 1000);
    const wanted = this.gauges?.paused || this.hello?.source === 'recording' ? '' : ` of ${PICTURE_HZ}`;
    this.bar.set('shown', this.stage ? `${this.shown.length}${wanted}` : 'none', this.stage ? '/s' : '');
    if (this.pauseButton) this.pauseButton.setAttribute('aria-pressed', String(this.plots.paused));
  }
}

// For the browser's console and the tests.
Object.assign(window, { sutura: new Page() });
