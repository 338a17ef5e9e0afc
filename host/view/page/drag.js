// The probe under the pointer: grabbed, it moves in the plane that faces the camera; the wheel, or Shift, moves it along the
// view. With keys it goes in steps. Entry point: `Drag`.

import * as THREE from 'three';

/** Targets are sent at most so often [ms]. */
const EVERY_MS = 16;
/** One step of a key, over the scene's radius. */
const KEY_STEP = 0.01;
const KEYS = /** @type {Record<string, [number, number, number]>} */ ({
  KeyA: [-1, 0, 0], KeyD: [1, 0, 0], KeyW: [0, 1, 0], KeyS: [0, -1, 0], KeyE: [0, 0, 1], KeyQ: [0, 0, -1],
});

export class Drag extends EventTarget {
  /**
   * @param {import('./stage.js').Stage} stage
   * @param {import('./instruments.js').Instruments} instruments
   * @param {() => THREE.Vector3 | null} grip where it is now [m]; none if it cannot be moved
   */
  constructor(stage, instruments, grip) {
    super();
    this.stage = stage;
    this.instruments = instruments;
    this.grip = grip;
    /** Where the grip is drawn to [m]. @type {THREE.Vector3 | null} */
    this.target = null;
    this.held = false;
    /** Stays where it was let go. */
    this.keep = false;
    this.sent = 0;
    this.pending = false;
    this.plane = new THREE.Plane();
    this.start = new THREE.Vector3();
    this.from = new THREE.Vector3();
    const element = stage.element;
    // Before the camera's controls, which would turn.
    element.addEventListener('pointerdown', (event) => this.down(event), { capture: true });
    element.addEventListener('pointermove', (event) => this.move(event), { capture: true });
    for (const name of /** @type {const} */ (['pointerup', 'pointercancel'])) {
      element.addEventListener(name, (event) => this.up(event), { capture: true });
    }
    element.addEventListener('wheel', (event) => this.wheel(event), { capture: true, passive: false });
    element.addEventListener('keydown', (event) => this.key(event));
  }

  /** @param {PointerEvent} event */
  ray(event) {
    const box = this.stage.element.getBoundingClientRect();
    const caster = new THREE.Raycaster();
    const x = (2 * (event.clientX - box.left)) / box.width - 1;
    const y = 1 - (2 * (event.clientY - box.top)) / box.height;
    caster.setFromCamera(new THREE.Vector2(x, y), this.stage.camera);
    return caster;
  }

  /** The driven tool under the pointer. @param {PointerEvent} event */
  hit(event) {
    const driven = [...this.instruments.tools.values()].map(({ mesh }) => mesh).filter((mesh) => mesh.userData.driven && mesh.visible);
    return this.ray(event).intersectObjects(driven, true)[0] ?? null;
  }

  /** @param {PointerEvent} event */
  down(event) {
    const grip = this.grip();
    if (event.button !== 0 || !grip) return;
    const hit = this.hit(event);
    if (!hit) return;
    event.stopImmediatePropagation();
    this.held = true;
    this.stage.element.setPointerCapture(event.pointerId);
    this.stage.element.classList.add('grabbing');
    const away = this.stage.camera.getWorldDirection(new THREE.Vector3());
    this.plane.setFromNormalAndCoplanarPoint(away, hit.point);
    this.from.copy(hit.point);
    this.start.copy(this.target ?? grip);
    this.send(this.start.clone());
  }

  /** @param {PointerEvent} event */
  move(event) {
    if (!this.held) {
      if (event.buttons === 0) this.stage.element.classList.toggle('grab', this.grip() !== null && this.hit(event) !== null);
      return;
    }
    event.stopImmediatePropagation();
    if (event.shiftKey) {
      this.deepen(-event.movementY / this.stage.pixelsPerMetre);
      return;
    }
    const point = this.ray(event).ray.intersectPlane(this.plane, new THREE.Vector3());
    if (point) this.send(this.start.clone().add(point).sub(this.from));
  }

  /** Along the view. @param {number} metres away from the camera */
  deepen(metres) {
    if (!this.target) return;
    const step = this.stage.camera.getWorldDirection(new THREE.Vector3()).multiplyScalar(metres);
    this.start.add(step);
    this.send(this.target.clone().add(step));
  }

  /** @param {PointerEvent} event */
  up(event) {
    if (!this.held) return;
    event.stopImmediatePropagation();
    this.held = false;
    this.stage.element.classList.remove('grabbing');
    if (!this.keep) this.release();
  }

  /** @param {WheelEvent} event */
  wheel(event) {
    if (!this.held) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    this.deepen((event.deltaY > 0 ? -1 : 1) * KEY_STEP * 2 * this.stage.radius);
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    const step = KEYS[event.code];
    const grip = this.grip();
    if (event.ctrlKey || event.metaKey || event.altKey || !grip) return;
    if (event.code === 'KeyR' && this.target) {
      this.release();
    } else if (step) {
      event.preventDefault();
      const [right, up, away] = step.map((value) => value * KEY_STEP * this.stage.radius);
      const moved = new THREE.Vector3(right, up, -away).applyQuaternion(this.stage.camera.quaternion);
      this.send((this.target ?? grip).clone().add(moved));
    }
  }

  /** @param {THREE.Vector3} target */
  send(target) {
    this.target = target;
    if (this.pending) return;
    this.pending = true;
    setTimeout(() => {
      this.pending = false;
      this.sent = performance.now();
      if (this.target) this.dispatchEvent(new CustomEvent('target', { detail: this.target.toArray() }));
    }, Math.max(0, this.sent + EVERY_MS - performance.now()));
  }

  release() {
    this.target = null;
    this.dispatchEvent(new CustomEvent('target', { detail: null }));
  }

  /** Forgets the target; nothing is sent. */
  forget() {
    this.target = null;
    this.held = false;
    this.stage.element.classList.remove('grabbing', 'grab');
  }
}
