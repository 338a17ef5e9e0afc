// Which value is shown in colours, in what range, and what it is under the pointer. Entry point: `Colouring`.

import * as THREE from 'three';
import { Range } from './colours.js';
import { words } from './units.js';

/** The scalar that follows from a picture's displacements. */
const DISPLACEMENT = 'displacement';

/**
 * @typedef {object} ColouringParts
 * @property {import('./panel.js').Panel} panel
 * @property {(command: {do: string, [key: string]: unknown}) => void} ask
 * @property {() => void} changed the picture is to be shown again
 * @property {() => void} pointed the value under the pointer is another one
 */

export class Colouring {
  /** @param {ColouringParts} parts @param {string | null} scalar */
  constructor(parts, scalar) {
    this.parts = parts;
    this.scalar = scalar;
    this.range = new Range();
    /** At the geometry's vertices. */
    this.values = new Float32Array(0);
    /** Value under the pointer. @type {number | null} */
    this.under = null;
    /** @type {import('./link.js').Hello | null} */
    this.hello = null;
    /** @type {import('./tissue.js').Tissue | null} */
    this.tissue = null;
  }

  /** What is chosen, in the host's words. */
  get chosen() {
    return this.hello?.scalars.find((one) => one.name === this.scalar);
  }

  /** Tells the host what is chosen. Of a recording that cannot be run again there are no values. @param {import('./link.js').Hello} hello */
  setSession(hello) {
    this.hello = hello;
    this.tell();
  }

  /** @param {number} vertices of the geometry */
  setVertices(vertices) {
    this.values = new Float32Array(vertices);
  }

  tell() {
    if (this.hello?.do.includes('scalar')) this.parts.ask({ do: 'scalar', name: this.chosen?.name ?? null });
  }

  restartRange() {
    this.range.restart(this.chosen?.signed ?? false);
  }

  /** @param {string | null} name */
  choose(name) {
    this.scalar = name;
    this.range.fixed = null;
    this.restartRange();
    this.under = null;
    this.tell();
    this.parts.changed();
  }

  /** @param {[number, number] | null} ends of the range; `null`: held */
  fix(ends) {
    this.range.fixed = ends;
    this.parts.changed();
  }

  /** @param {import('./decode.js').Picture} picture */
  show(picture) {
    const { chosen, tissue } = this;
    const { panel } = this.parts;
    panel.sayScalar(chosen && this.lacks(picture) ? `The recording is run again for pictures of ${words(chosen.name)}.` : '');
    if (!chosen || !this.read(picture)) {
      tissue?.colour(null, [0, 1], false);
      return;
    }
    this.range.see(this.values);
    tissue?.colour(this.values, this.range.ends, chosen.signed);
    panel.showRange(this.range.ends, this.range.fixed !== null);
  }

  /** The value that a picture has. @param {import('./decode.js').Picture} picture */
  has(picture) {
    return this.hello?.scalars[picture.scalar - 1]?.name ?? null;
  }

  /** Whether a recording's picture has another value than what is asked for. @param {import('./decode.js').Picture} picture */
  lacks(picture) {
    return picture.recorded && this.scalar !== null && this.scalar !== DISPLACEMENT && this.has(picture) !== this.scalar;
  }

  /** Values at the geometry's vertices, if the picture has what is asked for. @param {import('./decode.js').Picture} picture */
  read(picture) {
    const { values } = this;
    const { displacement, scalars } = picture;
    if (scalars && this.has(picture) === this.scalar) {
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

  /** Finds the value under the pointer. @param {PointerEvent} event @param {import('./stage.js').Stage} stage */
  point(event, stage) {
    const { tissue } = this;
    if (!tissue?.surface || !tissue.coloured || event.buttons !== 0) return;
    const box = stage.element.getBoundingClientRect();
    const pointer = new THREE.Vector2((2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height);
    const caster = new THREE.Raycaster();
    caster.setFromCamera(pointer, stage.camera);
    tissue.buffers.boundingSphere = null;
    tissue.buffers.boundingBox = null;
    const hit = caster.intersectObject(tissue.skin)[0];
    const before = this.under;
    this.under = hit?.uv ? this.valueAt(hit.uv.x) : null;
    if (this.under !== before) this.parts.pointed();
  }

  /** @param {number} u of the colour map's texture */
  valueAt(u) {
    const [low, high] = this.range.ends;
    return low + ((u - 0.5 / 256) / (255 / 256)) * (high - low);
  }
}
