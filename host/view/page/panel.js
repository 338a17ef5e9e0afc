// The panel at the right: scene, tissue and settings of the session; colours, look and stereo of the page; export and
// counters. Entry point: `Panel`.

import { button, check, choice, hint, row, section, select, slider } from './controls.js';
import { LARGEST_SEPARATION } from './stereo.js';
import { element } from './words.js';
import { fixed, short, words } from './units.js';

const capital = (/** @type {string} */ text) => text.charAt(0).toUpperCase() + text.slice(1);

/**
 * @typedef {object} PanelActions
 * @property {(command: {do: string, [key: string]: unknown}) => void} command
 * @property {(name: string | null) => void} scalar
 * @property {(fixed: [number, number] | null) => void} range
 * @property {(quality: import('./stage.js').Quality) => void} quality
 * @property {(name: string, value: boolean | number) => void} look
 * @property {(cut: {axis: 'x' | 'y' | 'z', at: number, flip: boolean} | null) => void} cut
 * @property {(mode: import('./stereo.js').StereoMode) => void} stereo
 * @property {(separation: number) => void} separation
 * @property {(keep: boolean) => void} keep
 * @property {(what: import('./saving.js').Saved) => void} save
 */

export class Panel {
  /** @param {PanelActions} actions */
  constructor(actions) {
    this.actions = actions;
    const panel = element('panel');
    this.session = section(panel, 'Session', true);
    this.colours = section(panel, 'Colours', true);
    this.looks = section(panel, 'Look', true);
    const stereo = section(panel, 'Stereo', false);
    const files = section(panel, 'Export', false);
    this.figures = section(panel, 'Counters', false);
    /** @type {[number[], number[]]} [m] */
    this.bounds = [[0, 0, 0], [1, 1, 1]];
    /** @type {{axis: 'x' | 'y' | 'z' | 'off', part: number, flip: boolean}} */
    this.cut = { axis: 'off', part: 0.5, flip: false };
    /** What shows a setting's value, by name. @type {Map<string, (value: number | string) => void>} */
    this.settings = new Map();
    /** Whether the host writes the session to a file. */
    this.recording = false;
    this.fillLooks();
    this.fillStereo(stereo);
    this.fillFiles(files);
    this.fillCounters();
  }

  /** What depends on the session. @param {import('./link.js').Hello} hello @param {string | null} scalar */
  setSession(hello, scalar) {
    this.bounds = hello.bounds_m;
    this.fillSession(hello);
    this.fillColours(hello, scalar);
    this.sendCut();
  }

  /** @param {import('./link.js').Hello} hello */
  fillSession(hello) {
    const rows = this.session;
    const { command } = this.actions;
    rows.replaceChildren();
    this.settings.clear();
    const can = (/** @type {string} */ name) => hello.do.includes(name) && hello.role === 'control';
    if (hello.role === 'watch' && hello.source === 'live') {
      hint(rows, 'Somebody else controls this session.');
      rows.append(button('Take control', () => command({ do: 'take_control' })));
    }
    const options = (/** @type {string[]} */ names, /** @type {string} */ now) =>
      /** @type {[string, string][]} */ ([...new Set([now, ...names])].sort().map((name) => [name, words(name)]));
    const scene = select(options(can('scene') ? hello.scenes : [], hello.scene), hello.scene, (name) => command({ do: 'scene', name }));
    scene.disabled = !can('scene');
    row(rows, 'Scene', scene);
    const tissue = select(options(can('tissue') ? hello.tissues : [], hello.tissue), hello.tissue, (name) => command({ do: 'tissue', name }));
    tissue.disabled = !can('tissue');
    row(rows, 'Tissue', tissue);
    if (!hello.settings.some((setting) => setting.name === 'rendering')) row(rows, 'Rendering', plain(words(hello.rendering)));
    row(rows, 'Mesh', plain(`${hello.nodes} nodes, ${hello.cells} cells`));
    for (const setting of hello.settings) this.addSetting(rows, setting, can('set'));
    if (can('hand')) {
      const both = document.createElement('div');
      both.className = 'pair';
      both.append(
        button('Run the scene\'s hand', () => command({ do: 'hand', way: 'scene' }), 'The scene\'s way points, from their start'),
        button('Let go', () => command({ do: 'hand', way: 'none' })),
      );
      rows.append(both, button('Do my drag again', () => command({ do: 'hand', way: 'recorded' }), 'As the probe was dragged last, from where it was taken'));
    }
    if (can('drag')) {
      const box = document.createElement('div');
      box.className = 'checks one';
      this.keep = check(box, 'Keep the probe where I let go', this.keep?.checked ?? false, (on) => this.actions.keep(on));
      rows.append(box);
      hint(rows, 'Drag the probe in the picture. Shift or the wheel moves it along the view.');
    }
    if (can('jaws')) {
      const both = document.createElement('div');
      both.className = 'pair';
      both.append(
        button('Close the jaws', () => command({ do: 'jaws', closed: true }), 'They take hold of what is between them'),
        button('Open', () => command({ do: 'jaws', closed: false })),
      );
      rows.append(both);
    }
    if (can('reset')) rows.append(button('Start again', () => command({ do: 'reset' }), 'A new solver, from the start'));
    this.record = can('record') ? button('Start again and record', () => command({ do: 'record', on: !this.recording })) : null;
    if (this.record) rows.append(this.record);
    this.showRecording(this.recording);
    if (can('save_last')) rows.append(button('Save the last 30 s', () => command({ do: 'save_last' }), 'A recording on the host: forces and events, without tissue'));
  }

  /** Whether the host writes all of the session to a file. @param {boolean} recording */
  showRecording(recording) {
    this.recording = recording;
    if (!this.record) return;
    this.record.textContent = recording ? 'End the recording' : 'Start again and record';
    this.record.title = recording ? 'The file on the host is complete; the session goes on' : 'To a file on the host, from the start, so that it can be run again';
    this.record.setAttribute('aria-pressed', String(recording));
  }

  /** @param {HTMLElement} rows @param {import('./link.js').Setting} setting @param {boolean} can */
  addSetting(rows, setting, can) {
    const set = (/** @type {number | string} */ value) => this.actions.command({ do: 'set', name: setting.name, value });
    const title = setting.at_once ? 'At once' : 'A new solver, made while this session goes on';
    if ('choices' in setting) {
      const names = /** @type {[string, string][]} */ (setting.choices.map((name) => [name, words(name)]));
      const chosen = row(rows, capital(words(setting.name)), select(names, setting.value, set));
      Object.assign(chosen, { disabled: !can, title });
      this.settings.set(setting.name, (value) => { chosen.value = String(value); });
      return;
    }
    const text = (/** @type {number} */ value) => `${short(value)} ${setting.unit}`;
    const control = slider(setting, text, set, true);
    Object.assign(control.input, { disabled: !can, title });
    row(rows, capital(words(setting.name)), control.box, control.input);
    this.settings.set(setting.name, (value) => control.set(Number(value)));
  }

  /** Settings of the same session that are others now. @param {import('./link.js').Hello} hello */
  showSettings(hello) {
    for (const setting of hello.settings) this.settings.get(setting.name)?.(setting.value);
  }

  /** @param {import('./link.js').Hello} hello @param {string | null} chosen */
  fillColours(hello, chosen) {
    const rows = this.colours;
    rows.replaceChildren();
    const names = /** @type {[string, string][]} */ ([['', 'none: by region'], ...hello.scalars.filter((scalar) => scalar.available !== false).map((scalar) => [scalar.name, `${words(scalar.name)} [${scalar.unit}]`])]);
    this.scalar = row(rows, 'Value', select(names, chosen ?? '', (name) => this.actions.scalar(name || null)));
    this.scalarHint = hint(rows, '');
    this.sayScalar('');
    this.rangeChoice = choice([['held', 'held'], ['fixed', 'fixed']], 'held', (kind) => this.sendRange(kind));
    row(rows, 'Range', this.rangeChoice.box);
    const both = document.createElement('div');
    both.className = 'pair';
    this.ends = ['Low', 'High'].map((name) => {
      const input = document.createElement('input');
      Object.assign(input, { type: 'number', step: 'any', disabled: true });
      input.setAttribute('aria-label', `${name} end of the range, in the value's unit`);
      input.addEventListener('change', () => this.sendRange('fixed'));
      both.append(input);
      return input;
    });
    row(rows, 'From, to', both);
    hint(rows, 'Held: the largest 98th percentile so far. Choose the value again to begin anew.');
  }

  /** Why the value that was chosen is not shown. @param {string} text */
  sayScalar(text) {
    if (!this.scalarHint || this.scalarHint.textContent === text) return;
    this.scalarHint.textContent = text;
    this.scalarHint.hidden = !text;
  }

  /** @param {string} kind */
  sendRange(kind) {
    for (const input of this.ends ?? []) input.disabled = kind !== 'fixed';
    const [low, high] = (this.ends ?? []).map((input) => (input.value === '' ? NaN : Number(input.value)));
    this.actions.range(kind === 'fixed' && high > low ? [low, high] : null);
  }

  /** Ends that are held, or were fixed. @param {[number, number]} ends @param {boolean} fixed_ */
  showRange(ends, fixed_) {
    if (!this.ends || this.ends.some((input) => input === document.activeElement)) return;
    if (fixed_) this.rangeChoice?.set('fixed');
    this.ends.forEach((input, i) => {
      const text = String(Number(ends[i].toPrecision(4)));
      input.disabled = this.rangeChoice?.box.querySelector('[aria-pressed="true"]')?.textContent !== 'fixed';
      if (input.value !== text && (input.disabled || fixed_)) input.value = text;
    });
  }

  fillLooks() {
    const rows = this.looks;
    const { look } = this.actions;
    this.quality = choice([['lean', 'lean'], ['wet', 'wet'], ['full', 'full']], 'lean', (quality) =>
      this.actions.quality(/** @type {import('./stage.js').Quality} */ (quality)),
    );
    row(rows, 'Quality', this.quality.box);
    this.reason = hint(rows, '');
    const checks = document.createElement('div');
    checks.className = 'checks';
    this.checks = {
      outline: check(checks, 'Outline', true, (on) => look('outline', on)),
      wireframe: check(checks, 'Wireframe', false, (on) => look('wireframe', on)),
      xray: check(checks, 'X-ray', false, (on) => look('xray', on)),
      visible: check(checks, 'Tissue', true, (on) => look('visible', on)),
      tools: check(checks, 'Tools', true, (on) => look('tools', on)),
      contacts: check(checks, 'Contact forces', true, (on) => look('contacts', on)),
      wrench: check(checks, 'Force on tool', true, (on) => look('wrench', on)),
    };
    rows.append(checks);
    this.opacity = slider({ low: 0.1, high: 1, step: 0.05, value: 1 }, (value) => `${Math.round(100 * value)} %`, (value) => look('opacity', value));
    row(rows, 'Opacity', this.opacity.box, this.opacity.input);
    this.cutAxis = choice([['off', 'off'], ['x', 'x'], ['y', 'y'], ['z', 'z']], 'off', (axis) => {
      this.cut.axis = /** @type {'x' | 'y' | 'z' | 'off'} */ (axis);
      this.sendCut();
    });
    row(rows, 'Cut plane', this.cutAxis.box);
    this.cutAt = slider({ low: 0, high: 1, step: 0.005, value: 0.5 }, () => this.cutText(), (part) => {
      this.cut.part = part;
      this.sendCut();
    });
    row(rows, 'Cut at', this.cutAt.box, this.cutAt.input);
    const flip = document.createElement('div');
    flip.className = 'checks';
    this.cutFlip = check(flip, 'Other side', false, (on) => {
      this.cut.flip = on;
      this.sendCut();
    });
    rows.append(flip);
  }

  /** Where the plane is along its axis [m]. */
  get cutPlace() {
    const axis = Math.max('xyz'.indexOf(this.cut.axis), 0);
    const [low, high] = [this.bounds[0][axis], this.bounds[1][axis]];
    return low + (high - low) * this.cut.part;
  }

  cutText() {
    return this.cut.axis === 'off' ? 'off' : `${fixed(1000 * this.cutPlace, 1)} mm`;
  }

  sendCut() {
    const { axis, flip } = this.cut;
    this.cutAt?.set(this.cut.part);
    this.actions.cut(axis === 'off' ? null : { axis, at: this.cutPlace, flip });
  }

  /** As a link has it. @param {{axis: 'x' | 'y' | 'z', at: number, flip: boolean} | null} cut */
  setCut(cut) {
    if (cut) {
      const axis = 'xyz'.indexOf(cut.axis);
      const [low, high] = [this.bounds[0][axis], this.bounds[1][axis]];
      this.cut = { axis: cut.axis, part: (cut.at - low) / (high - low), flip: cut.flip };
      if (this.cutFlip) this.cutFlip.checked = cut.flip;
    } else {
      this.cut.axis = 'off';
    }
    this.cutAxis?.set(this.cut.axis);
    this.sendCut();
  }

  /** @param {import('./stage.js').Stage} stage */
  showQuality(stage) {
    this.quality?.set(stage.quality);
    if (this.reason) this.reason.textContent = `${stage.quality}: ${stage.reason}`;
  }

  /** @param {HTMLElement} rows */
  fillStereo(rows) {
    const modes = /** @type {[string, string][]} */ ([
      ['mono', 'off'], ['side-by-side', 'side by side'], ['swapped', 'side by side, swapped'],
      ['anaglyph', 'red-cyan, Dubois'], ['anaglyph-grey', 'red-cyan, grey'],
    ]);
    this.stereo = row(rows, 'Eyes', select(modes, 'mono', (mode) => this.actions.stereo(/** @type {import('./stereo.js').StereoMode} */ (mode))));
    const separation = slider({ low: 0, high: LARGEST_SEPARATION, step: 0.001, value: 1 / 30 }, (value) => (value > 0 ? `1 / ${Math.round(1 / value)}` : '0'), this.actions.separation);
    row(rows, 'Separation', separation.box, separation.input);
    hint(rows, 'Over the distance to the point that the camera turns about, which lies in the screen.');
  }

  /** @param {HTMLElement} rows */
  fillFiles(rows) {
    const box = document.createElement('div');
    box.className = 'buttons';
    const { save } = this.actions;
    this.film = button('Record film', () => save('film'), 'WebM or MP4, of what is drawn');
    box.append(
      button('Picture', () => save('png'), 'PNG, with legend, scale and time'),
      button('Picture, 2 ×', () => save('png2'), 'PNG at twice the size'),
      this.film,
      button('Copy link', () => save('link'), 'Address with camera, colours, range and cut plane, and with this session\'s key'),
      button('CSV, as plotted', () => save('csv'), 'Ticks of the time that the plots show'),
      button('CSV, all', () => save('csv-all'), 'Ticks and solves that the page has'),
      button('Plots', () => save('plots'), 'PNG of all plots'),
    );
    rows.append(box);
  }

  fillCounters() {
    const table = document.createElement('table');
    this.table = table.createTBody();
    this.figures.append(table);
  }

  /** @param {[string, string][]} list names and values */
  showCounters(list) {
    if (!this.table || this.figures.clientHeight === 0) return;
    const { rows } = this.table;
    while (rows.length > list.length) this.table.deleteRow(-1);
    list.forEach(([name, value], i) => {
      let line = rows[i];
      if (!line) {
        line = /** @type {HTMLTableSectionElement} */ (this.table).insertRow();
        const head = document.createElement('th');
        head.scope = 'row';
        line.append(head);
        line.insertCell();
      }
      if (line.cells[0].textContent !== name) line.cells[0].textContent = name;
      if (line.cells[1].textContent !== value) line.cells[1].textContent = value;
    });
  }
}

/** @param {string} text */
function plain(text) {
  const made = document.createElement('div');
  made.textContent = text;
  return made;
}
