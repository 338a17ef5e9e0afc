// Two eyes: parallel axes and off-axis frusta, zero parallax at the camera's target. Entry point: `Stereo`.

import * as THREE from 'three';
import { AnaglyphEffect } from 'three/addons/effects/AnaglyphEffect.js';
import { StereoEffect } from 'three/addons/effects/StereoEffect.js';

/** @typedef {'mono' | 'side-by-side' | 'swapped' | 'anaglyph' | 'anaglyph-grey'} StereoMode */

/** Largest separation of the eyes over the distance to the target. */
export const LARGEST_SEPARATION = 1 / 15;

/** Each eye's luminance in its own channels alone (Rec. 709). */
const GREY = {
  left: [0.2126, 0, 0, 0.7152, 0, 0, 0.0722, 0, 0],
  right: [0, 0.2126, 0.2126, 0, 0.7152, 0.7152, 0, 0.0722, 0.0722],
};

export class Stereo {
  /** @param {THREE.WebGLRenderer} renderer */
  constructor(renderer) {
    this.renderer = renderer;
    /** @type {StereoMode} */
    this.mode = 'mono';
    /** Of the eyes, over the distance to the target. */
    this.separation = 1 / 30;
    this.sideBySide = new StereoEffect(renderer);
    /** @type {{grey: boolean, effect: AnaglyphEffect} | null} made when first asked for: two render targets */
    this.anaglyph = null;
    this.size = new THREE.Vector2();
  }

  /**
   * @param {THREE.Scene} scene
   * @param {THREE.PerspectiveCamera} camera without a parent: the effects read its position
   * @param {number} convergence distance of zero parallax [m]
   */
  render(scene, camera, convergence) {
    const separation = convergence * this.separation;
    camera.focus = convergence;
    if (this.mode === 'side-by-side' || this.mode === 'swapped') {
      this.sideBySide.setEyeSeparation(this.mode === 'swapped' ? -separation : separation);
      this.sideBySide.render(scene, camera);
      this.renderer.getSize(this.size);
      this.renderer.setViewport(0, 0, this.size.x, this.size.y);
      this.renderer.setScissor(0, 0, this.size.x, this.size.y);
    } else if (this.mode === 'mono') {
      this.renderer.render(scene, camera);
    } else {
      const effect = this.red(this.mode === 'anaglyph-grey');
      effect.eyeSep = separation;
      effect.planeDistance = convergence;
      effect.render(scene, camera);
    }
  }

  /** @param {boolean} grey */
  red(grey) {
    if (this.anaglyph && this.anaglyph.grey !== grey) this.drop();
    if (!this.anaglyph) {
      this.renderer.getSize(this.size);
      const effect = new AnaglyphEffect(this.renderer, this.size.x, this.size.y);
      if (grey) {
        effect.colorMatrixLeft.fromArray(GREY.left);
        effect.colorMatrixRight.fromArray(GREY.right);
      }
      this.anaglyph = { grey, effect };
      this.resize(this.size.x, this.size.y);
    }
    return this.anaglyph.effect;
  }

  /** @param {number} width @param {number} height */
  resize(width, height) {
    const canvas = this.renderer.domElement;
    this.anaglyph?.effect.setSize(width, height);
    // The effect sets the element's size, which is the layout's.
    canvas.style.width = '';
    canvas.style.height = '';
  }

  drop() {
    this.anaglyph?.effect.dispose();
    this.anaglyph = null;
  }
}
