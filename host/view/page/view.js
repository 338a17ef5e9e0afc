// How the scene is looked at: what of it is shown, cut plane and stereo, what is written over it, and all of that as a link has it.
// Entry point: `View`.

import { drawOverlay } from './overlay.js';
import { element } from './words.js';
import { words } from './units.js';

/**
 * @typedef {object} Scene
 * @property {import('./stage.js').Stage} stage
 * @property {import('./tissue.js').Tissue} tissue
 * @property {import('./instruments.js').Instruments} instruments
 */

export class View {
  /**
   * @param {Scene} scene
   * @param {import('./colouring.js').Colouring} colouring
   * @param {() => void} changed the picture is to be shown again
   */
  constructor({ stage, tissue, instruments }, colouring, changed) {
    this.stage = stage;
    this.tissue = tissue;
    this.instruments = instruments;
    this.colouring = colouring;
    this.changed = changed;
    /** What is shown. @type {import('./decode.js').Picture | null} */
    this.picture = null;
  }

  /** @param {string} name @param {boolean | number} value */
  setLook(name, value) {
    const { tissue, instruments } = this;
    if (name in tissue.options) Object.assign(tissue.options, { [name]: value });
    if (name in instruments.options) Object.assign(instruments.options, { [name]: value });
    if (name === 'xray') instruments.xray = value === true;
    tissue.apply();
    this.changed();
  }

  /** @param {import('./tissue.js').Tissue['cut']} cut */
  setCut(cut) {
    this.tissue.cut = cut;
    this.tissue.apply();
  }

  /** @param {import('./stereo.js').StereoMode} mode */
  setStereo(mode) {
    this.stage.stereo.mode = mode;
    this.stage.request();
  }

  /** @param {number} separation */
  setSeparation(separation) {
    this.stage.stereo.separation = separation;
    this.stage.request();
  }

  /** As a link has it. @param {import('./address.js').View} view @param {import('./panel.js').Panel} panel */
  apply(view, panel) {
    this.stage.pose = view.camera;
    this.colouring.range.fixed = view.range;
    for (const name of /** @type {const} */ (['xray', 'wireframe'])) {
      if (panel.checks) panel.checks[name].checked = view[name];
      this.setLook(name, view[name]);
    }
    panel.opacity?.set(view.opacity);
    this.setLook('opacity', view.opacity);
    panel.setCut(view.cut);
    if (panel.stereo) panel.stereo.value = view.stereo;
    this.stage.stereo.mode = /** @type {import('./stereo.js').StereoMode} */ (view.stereo);
  }

  /** For a link. @returns {import('./address.js').View} */
  get now() {
    const { stage, tissue, colouring } = this;
    const { xray, opacity, wireframe } = tissue.options;
    return { camera: stage.pose, scalar: colouring.scalar, range: colouring.range.fixed, cut: tissue.cut, xray, opacity, wireframe, stereo: stage.stereo.mode };
  }

  /** Writes over what has been drawn. */
  drawOver() {
    const { stage } = this;
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
    const { stage, instruments, tissue, colouring, picture } = this;
    const { hello } = colouring;
    if (!hello) return;
    const scalar = tissue.coloured ? colouring.chosen : undefined;
    const { mode } = stage.stereo;
    const halves = mode === 'side-by-side' || mode === 'swapped' ? 2 : 1;
    const what = {
      title: `${hello.scene}, ${hello.tissue}`,
      time: picture?.time ?? null,
      legend: scalar ? { ...scalar, name: words(scalar.name), range: colouring.range.ends, at: colouring.under } : null,
      scales: {
        contact: instruments.options.contacts && (picture?.contacts.vertices.length ?? 0) > 0 ? instruments.scales.contact : 0,
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
}
