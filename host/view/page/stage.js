// Renderer, camera and lights: draws when something has changed, at the quality that the machine can do.
// Entry point: `Stage`.

import * as THREE from 'three';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';
import { environment, probe } from './lamps.js';
import { Stereo } from './stereo.js';

/** @typedef {'lean' | 'wet' | 'full'} Quality */

/** Names of renderers without a graphics card. */
const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;
/** `lean` draws at a smaller size until it takes at most this long [ms]: 24 a second, with a fifth left for the rest. */
const LEAN_MS = 33;
/** Below this, `lean` does not go. */
const SMALLEST = { width: 480, height: 270 };
/** Pictures after which a renderer that did not call itself software is judged by its speed. */
const TRIAL = 10;
const TRIAL_MS = 60;
const BACKGROUND = 0x11151a;

export const VIEWS = /** @type {const} */ ({
  home: [0.62, -1, 0.62],
  front: [0, -1, 0],
  back: [0, 1, 0],
  left: [-1, 0, 0],
  right: [1, 0, 0],
  top: [0, -1e-4, 1],
  bottom: [0, -1e-4, -1],
});

/** @typedef {keyof typeof VIEWS} ViewName */

export class Stage extends EventTarget {
  /**
   * @param {HTMLElement} element the canvas is put into it, first
   * @throws if there is no WebGL
   */
  constructor(element) {
    super();
    this.element = element;
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color(BACKGROUND);
    this.camera = new THREE.PerspectiveCamera(32, 1, 0.001, 10);
    this.camera.up.set(0, 0, 1);
    this.head = new THREE.DirectionalLight(0xffffff, 1);
    this.sky = new THREE.HemisphereLight(0xe8f0ff, 0x4a3f3c, 1);
    this.probe = probe();
    // Glints at the far side, which a probe has not.
    this.rim = new THREE.DirectionalLight(0xdfeaff, 0.5);
    this.rim.position.set(-0.7, 1, 0.55);
    this.scene.add(this.head, this.head.target, this.sky, this.probe, this.rim);
    /** @type {Quality} */
    this.quality = 'lean';
    this.reason = '';
    /** Over the element's size, of what is drawn. */
    this.resolution = 1;
    this.size = { width: 1, height: 1 };
    this.radius = 0.05;
    this.centre = new THREE.Vector3();
    /** What `home` and the views show: the tissue, and tools beside it. */
    this.shown = new THREE.Sphere(new THREE.Vector3(), this.radius);
    this.dirty = true;
    this.lost = false;
    this.drawn = 0;
    this.cost_ms = 0;
    this.colours = false;
    /** @type {THREE.WebGLRenderTarget | null} */
    this.surroundings = null;
    this.antialias = false;
    this.renderer = this.makeRenderer(false);
    this.software = SOFTWARE.test(this.rendererName);
    this.stereo = new Stereo(this.renderer);
    this.controls = new OrbitControls(this.camera, element);
    this.controls.addEventListener('change', () => this.request());
    this.choose(
      this.software ? 'lean' : 'full',
      this.software ? `no graphics card: ${this.rendererName}` : `graphics card: ${this.rendererName}`,
    );
    this.look('home');
    new ResizeObserver(() => this.resize()).observe(element);
    this.resize();
    const frame = () => {
      requestAnimationFrame(frame);
      if (this.dirty && !this.lost && !document.hidden) this.draw();
    };
    requestAnimationFrame(frame);
  }

  /** @param {boolean} antialias */
  makeRenderer(antialias) {
    const canvas = document.createElement('canvas');
    canvas.className = 'scene';
    const renderer = new THREE.WebGLRenderer({ canvas, antialias, powerPreference: 'high-performance' });
    renderer.localClippingEnabled = true;
    renderer.outputColorSpace = THREE.SRGBColorSpace;
    canvas.addEventListener('webglcontextlost', () => this.contextLost());
    canvas.addEventListener('webglcontextrestored', () => this.contextRestored());
    this.antialias = antialias;
    this.element.prepend(canvas);
    return renderer;
  }

  get rendererName() {
    const gl = this.renderer.getContext();
    const info = gl.getExtension('WEBGL_debug_renderer_info');
    return String(gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  }

  contextLost() {
    this.lost = true;
    this.dispatchEvent(new Event('lost'));
  }

  contextRestored() {
    this.lost = false;
    // Render targets come back empty.
    this.stereo.drop();
    this.dropSurroundings();
    this.light();
    this.request();
    this.dispatchEvent(new Event('restored'));
  }

  /** Something has changed: draw with the next frame. */
  request() {
    this.dirty = true;
  }

  /** @param {Quality} quality @param {string} reason */
  choose(quality, reason) {
    this.quality = quality;
    this.reason = reason;
    this.drawn = 0;
    const antialias = quality !== 'lean' && !this.software;
    if (antialias !== this.antialias) {
      const { mode, separation } = this.stereo;
      this.stereo.drop();
      this.dropSurroundings();
      this.renderer.dispose();
      this.renderer.domElement.remove();
      this.renderer = this.makeRenderer(antialias);
      this.stereo = new Stereo(this.renderer);
      Object.assign(this.stereo, { mode, separation });
    }
    this.resolution = 1;
    this.light();
    this.resize();
    this.dispatchEvent(new Event('quality'));
  }

  /** Lights, tone mapping and environment of the quality. */
  light() {
    const lean = this.quality === 'lean';
    const full = this.quality === 'full';
    this.sky.visible = lean;
    this.sky.intensity = 1.35;
    this.probe.visible = this.quality === 'wet';
    this.probe.intensity = 0.55;
    this.rim.visible = this.quality === 'wet';
    this.head.intensity = lean ? 1.9 : full ? 1.7 : 1.1;
    this.head.castShadow = full;
    this.renderer.shadowMap.enabled = full;
    this.toneMap();
    if (full && !this.surroundings) this.surroundings = environment(this.renderer);
    if (!full) this.dropSurroundings();
    this.scene.environment = this.surroundings?.texture ?? null;
    this.scene.environmentRotation.set(Math.PI / 2, 0, 0);
    this.scene.environmentIntensity = 0.35;
  }

  /** Colours that a legend explains are shown as they are. @param {boolean} [colours] */
  toneMap(colours = this.colours) {
    this.colours = colours;
    const mapped = this.quality !== 'lean' && !colours;
    this.renderer.toneMapping = mapped ? THREE.NeutralToneMapping : THREE.NoToneMapping;
  }

  dropSurroundings() {
    this.surroundings?.dispose();
    this.surroundings = null;
    this.scene.environment = null;
  }

  /** @param {[number[], number[]]} bounds corners [m] */
  frame(bounds) {
    const box = new THREE.Box3(new THREE.Vector3(...bounds[0]), new THREE.Vector3(...bounds[1]));
    box.getCenter(this.centre);
    this.radius = Math.max(box.getSize(new THREE.Vector3()).length() / 2, 1e-4);
    this.shown.set(this.centre, this.radius);
    this.camera.near = this.radius / 50;
    this.camera.far = this.radius * 60;
    this.controls.minDistance = this.radius / 8;
    this.controls.maxDistance = this.radius * 25;
    const shadow = this.head.shadow;
    Object.assign(shadow.camera, {
      left: -1.5 * this.radius, right: 1.5 * this.radius, top: 1.5 * this.radius, bottom: -1.5 * this.radius,
      near: this.radius, far: 7 * this.radius,
    });
    shadow.camera.updateProjectionMatrix();
    shadow.mapSize.set(1024, 1024);
    shadow.bias = -0.0005;
    shadow.normalBias = this.radius / 200;
    shadow.radius = 4;
  }

  /** Views show this, too, but not at any size of the tissue. @param {THREE.Box3} box [m] */
  include(box) {
    const most = new THREE.Box3().setFromCenterAndSize(this.centre, new THREE.Vector3().setScalar(4 * this.radius));
    for (const corner of [box.min, box.max]) this.shown.expandByPoint(corner.clone().clamp(most.min, most.max));
  }

  /** @param {ViewName} name */
  look(name) {
    const direction = new THREE.Vector3(...VIEWS[name]).normalize();
    const half = THREE.MathUtils.degToRad(this.camera.fov / 2);
    const narrow = Math.min(half, Math.atan(Math.tan(half) * this.camera.aspect));
    const { center, radius } = this.shown;
    this.controls.target.copy(center);
    this.camera.position.copy(center).addScaledVector(direction, (0.94 * radius) / Math.sin(narrow));
    this.controls.update();
    this.request();
  }

  /** Where the camera is, to be kept. @returns {number[]} position, target, field of view */
  get pose() {
    return [...this.camera.position.toArray(), ...this.controls.target.toArray(), this.camera.fov];
  }

  set pose(pose) {
    this.camera.position.fromArray(pose, 0);
    this.controls.target.fromArray(pose, 3);
    this.camera.fov = pose[6];
    this.camera.updateProjectionMatrix();
    this.controls.update();
    this.request();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (width === 0 || height === 0) return;
    this.size = { width, height };
    const least = Math.min(1, Math.max(SMALLEST.width / width, SMALLEST.height / height));
    this.resolution = Math.max(Math.min(this.resolution, 1), least);
    const ratio = this.quality === 'lean' || this.software ? 1 : Math.min(devicePixelRatio, 2);
    this.renderer.setPixelRatio(ratio);
    const drawn = { width: Math.round(width * this.resolution), height: Math.round(height * this.resolution) };
    this.renderer.setSize(drawn.width, drawn.height, false);
    this.stereo.resize(drawn.width, drawn.height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.request();
  }

  /** Pixels of a metre at the camera's target. */
  get pixelsPerMetre() {
    const distance = this.camera.position.distanceTo(this.controls.target);
    return this.size.height / (2 * distance * Math.tan(THREE.MathUtils.degToRad(this.camera.fov / 2)));
  }

  draw() {
    const start = performance.now();
    this.dirty = false;
    this.render();
    // A software renderer draws after the call; what it costs is known when a pixel can be read.
    if (this.software) this.waitForPixels();
    const cost = performance.now() - start;
    this.drawn += 1;
    this.cost_ms = this.drawn <= 2 ? cost : this.cost_ms + 0.2 * (cost - this.cost_ms);
    this.adapt();
    this.dispatchEvent(new Event('drawn'));
  }

  /** Draws now; the canvas can be read until the script ends. */
  render() {
    const target = this.controls.target;
    this.head.position.copy(this.camera.position).sub(target).normalize().multiplyScalar(4 * this.radius).add(target);
    // From above the viewer's shoulder: a lamp at the eye shows no shape. Moisture shines where it is nearer.
    this.head.position.z += (this.quality === 'lean' ? 1.6 : 0.7) * this.radius;
    this.head.target.position.copy(target);
    this.dispatchEvent(new Event('draw'));
    this.stereo.render(this.scene, this.camera, this.camera.position.distanceTo(target));
  }

  waitForPixels() {
    const gl = this.renderer.getContext();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  }

  adapt() {
    if (this.quality === 'lean') {
      if (this.drawn % 5 !== 0) return;
      const before = this.resolution;
      if (this.cost_ms > LEAN_MS) this.resolution *= Math.max(0.6, Math.sqrt(LEAN_MS / this.cost_ms));
      else if (this.cost_ms < 0.5 * LEAN_MS && this.resolution < 1) this.resolution = Math.min(1, this.resolution * 1.15);
      if (this.resolution !== before) this.resize();
    } else if (this.drawn === TRIAL && this.cost_ms > TRIAL_MS && this.reason.startsWith('graphics card')) {
      this.choose('lean', `the first pictures took ${Math.round(this.cost_ms)} ms each`);
    }
  }
}
