// Tools, needles, threads and arrows of forces. Entry point: `Instruments`.

import * as THREE from 'three';
import { Line2 } from 'three/addons/lines/Line2.js';
import { LineGeometry } from 'three/addons/lines/LineGeometry.js';
import { LineMaterial } from 'three/addons/lines/LineMaterial.js';
import { Outline } from './outline.js';
import { needleGeometry, toolGeometry } from './shapes.js';
import { round125 } from './units.js';

const STEEL = 0xb9c4cf;
const DRIVEN = 0x8fb4d8;
const NEEDLE = 0xdde5ee;
const THREAD = 0x5b8ff5;
const CONTACT = 0xf7e26b;
const REACTION = 0x6fe3a5;
/** Thinnest line that can still be followed [px]. */
const THINNEST = 1.6;
/** Arrows are at most this long, over the scene's radius. */
const LONGEST = 0.45;
const MOST_ARROWS = 1024;
/** Order of what is drawn last. */
const DASHES = 3;
/** What a point is behind which a thread ends. */
const LOOSE_END = 6;
const AFTER_DASHES = 4;

export class Instruments {
  /** @param {import('./stage.js').Stage} stage */
  constructor(stage) {
    this.stage = stage;
    this.group = new THREE.Group();
    stage.scene.add(this.group);
    this.options = { tools: true, contacts: true, wrench: true };
    this.xray = false;
    /** @type {Map<number, {mesh: THREE.Object3D, offset: THREE.Vector3}>} */
    this.tools = new Map();
    /** Outline of the driven tool, if it has a surface. @type {Outline | null} */
    this.outline = null;
    /** Whether the driven tool is in the tissue. */
    this.inside = false;
    /** @type {Map<number, {mesh: THREE.Mesh, hidden: Thread}>} */
    this.needles = new Map();
    /** @type {Map<number, {seen: Thread, hidden: Thread}>} */
    this.threads = new Map();
    this.arrows = new Arrows(CONTACT, MOST_ARROWS, 0.012);
    this.wrench = new Arrows(REACTION, 1, 0.02);
    this.spring = new Line2(new LineGeometry(), new LineMaterial({ color: 0xffd166, linewidth: 2, toneMapped: false }));
    this.spring.frustumCulled = false;
    this.spring.visible = false;
    this.group.add(this.arrows.group, this.wrench.group, this.spring);
    /** Lengths of arrows [m/N]; they shrink at once and do not grow back in a session. */
    this.scales = { contact: 0, wrench: 0 };
    this.steel = { lean: metal('lean', STEEL), wet: metal('wet', STEEL), full: metal('full', STEEL) };
    this.handle = { lean: metal('lean', DRIVEN), wet: metal('wet', DRIVEN), full: metal('full', DRIVEN) };
    this.bright = { lean: metal('lean', NEEDLE), wet: metal('wet', NEEDLE), full: metal('full', NEEDLE) };
    stage.addEventListener('draw', () => this.widths());
  }

  /** @param {import('./link.js').Hello} hello */
  setScene(hello) {
    for (const { mesh } of this.tools.values()) this.remove(mesh);
    for (const { mesh, hidden } of this.needles.values()) {
      this.remove(mesh);
      hidden.remove();
    }
    for (const { seen, hidden } of this.threads.values()) {
      seen.remove();
      hidden.remove();
    }
    if (this.outline) this.group.remove(this.outline.line);
    this.outline?.dispose();
    this.outline = null;
    this.tools.clear();
    this.needles.clear();
    this.threads.clear();
    this.forget();
    for (const tool of hello.tools) {
      const geometry = toolGeometry(tool);
      const mesh = geometry ? new THREE.Mesh(geometry) : gripMark(this.stage.radius);
      mesh.userData = { tool: tool.id, driven: tool.driven };
      mesh.castShadow = true;
      mesh.visible = false;
      this.group.add(mesh);
      this.tools.set(tool.id, { mesh, offset: new THREE.Vector3(...tool.offset_m) });
      if (tool.driven && geometry) {
        this.outline = new Outline(mesh, DRIVEN, DASHES);
        this.group.add(this.outline.line);
      }
    }
    for (const needle of hello.needles) {
      const mesh = new THREE.Mesh(needleGeometry(needle.points_m, needle.thickness_m));
      mesh.castShadow = true;
      mesh.visible = false;
      this.group.add(mesh);
      const hidden = new Thread(this.group, needle.thickness_m / 2, NEEDLE, true);
      hidden.local = Float32Array.from(needle.points_m.flat());
      this.needles.set(needle.id, { mesh, hidden });
    }
    for (const thread of hello.threads) {
      this.threads.set(thread.id, {
        seen: new Thread(this.group, thread.radius_m, THREAD, false),
        hidden: new Thread(this.group, thread.radius_m, THREAD, true),
      });
    }
    this.apply();
  }

  /** @param {THREE.Object3D} object */
  remove(object) {
    this.group.remove(object);
    if (object instanceof THREE.Mesh) object.geometry.dispose();
  }

  /** The next picture sets the lengths of arrows anew. */
  forget() {
    this.scales = { contact: 0, wrench: 0 };
  }

  /** Around tools and needles as they are. */
  bounds() {
    const box = new THREE.Box3();
    const meshes = [...this.tools.values(), ...this.needles.values()].map(({ mesh }) => mesh);
    for (const mesh of meshes) if (mesh.visible) box.expandByObject(mesh);
    return box;
  }

  /** Materials of the quality, and what is shown. */
  apply() {
    const { quality } = this.stage;
    for (const { mesh } of this.tools.values()) {
      if (mesh instanceof THREE.Mesh) mesh.material = (mesh.userData.driven ? this.handle : this.steel)[quality];
    }
    for (const { mesh } of this.needles.values()) mesh.material = this.bright[quality];
    this.stage.request();
  }

  /**
   * @param {import('./decode.js').Picture} picture
   * @param {(vertex: number, into: THREE.Vector3) => boolean} place of a vertex of the tissue
   * @param {boolean} inside whether the driven tool is in the tissue
   */
  setPicture(picture, place, inside) {
    this.inside = inside;
    for (const tool of picture.tools) this.moveTool(tool);
    for (const needle of picture.needles) this.moveNeedle(needle);
    for (const thread of picture.threads) {
      const lines = this.threads.get(thread.id);
      for (const line of lines ? [lines.seen, lines.hidden] : []) {
        line.place(thread.points, thread.what);
      }
      if (lines) lines.hidden.line.visible = this.xray;
    }
    this.showContacts(picture.contacts, place);
    this.showWrench(picture.tools.find((tool) => tool.driven));
  }

  /** @param {import('./decode.js').ToolPicture} tool */
  moveTool(tool) {
    const mesh = this.tools.get(tool.id)?.mesh;
    if (!mesh) return;
    mesh.position.fromArray(tool.position);
    mesh.quaternion.fromArray(tool.orientation);
    mesh.visible = this.options.tools;
    if (!this.outline || mesh !== this.outline.mesh) return;
    this.outline.line.visible = this.options.tools && this.inside;
    // Drawn after its outline, so that dashes are only where tissue hides it.
    /** @type {THREE.Material} */ (this.outline.mesh.material).transparent = this.inside;
    mesh.renderOrder = this.inside ? AFTER_DASHES : 0;
  }

  /** @param {import('./decode.js').NeedlePicture} needle */
  moveNeedle(needle) {
    const found = this.needles.get(needle.id);
    if (!found) return;
    const { mesh, hidden } = found;
    mesh.position.fromArray(needle.position);
    mesh.quaternion.fromArray(needle.orientation);
    mesh.visible = true;
    // In x-ray it is drawn after its dashes: these are then only where it lies behind the tissue, not behind itself.
    /** @type {THREE.Material} */ (mesh.material).transparent = this.xray;
    mesh.renderOrder = this.xray ? AFTER_DASHES : 0;
    hidden.line.position.copy(mesh.position);
    hidden.line.quaternion.copy(mesh.quaternion);
    hidden.line.visible = this.xray;
    if (hidden.local) {
      hidden.place(hidden.local);
      hidden.local = null;
    }
  }

  /**
   * @param {import('./decode.js').Picture['contacts']} contacts
   * @param {(vertex: number, into: THREE.Vector3) => boolean} place
   */
  showContacts({ vertices, forces }, place) {
    this.arrows.group.visible = this.options.contacts;
    this.arrows.clear();
    const start = new THREE.Vector3();
    const force = new THREE.Vector3();
    this.scales.contact = this.scaleOf(this.scales.contact, largest(forces));
    for (let i = 0; i < vertices.length; i += 1) {
      force.fromArray(forces, 3 * i).multiplyScalar(this.scales.contact);
      // The arrow pushes: its head is where the force acts.
      if (place(vertices[i], start)) this.arrows.add(start.sub(force), force);
    }
    this.arrows.done(this.stage.radius);
  }

  /** @param {import('./decode.js').ToolPicture | undefined} tool */
  showWrench(tool) {
    this.wrench.group.visible = this.options.wrench && tool !== undefined;
    if (!tool) return;
    this.wrench.clear();
    const force = new THREE.Vector3().fromArray(tool.wrench);
    this.scales.wrench = this.scaleOf(this.scales.wrench, force.length());
    this.wrench.add(new THREE.Vector3().fromArray(tool.position), force.multiplyScalar(this.scales.wrench));
    this.wrench.done(this.stage.radius);
  }

  /** @param {number} before [m/N] @param {number} force [N] */
  scaleOf(before, force) {
    if (!(force > 1e-6)) return before;
    const longest = LONGEST * this.stage.radius;
    return before === 0 || force * before > longest ? round125((0.6 * longest) / force) : before;
  }

  /** From the hand to the grip that it draws along. @param {THREE.Vector3 | null} from @param {THREE.Vector3} to */
  showSpring(from, to) {
    this.spring.visible = from !== null;
    if (!from) return;
    const turns = 9;
    const steps = 8 * turns;
    const along = to.clone().sub(from);
    const across = new THREE.Vector3(along.y, -along.x, 0);
    if (across.lengthSq() < 1e-16) across.set(1, 0, 0);
    across.setLength(0.02 * this.stage.radius);
    const up = new THREE.Vector3().crossVectors(along, across).setLength(0.02 * this.stage.radius);
    const points = [];
    for (let i = 0; i <= steps; i += 1) {
      const part = i / steps;
      const round = 2 * Math.PI * turns * part;
      const reach = part < 0.1 || part > 0.9 ? 0 : 1;
      const point = from.clone().addScaledVector(along, part);
      point.addScaledVector(across, reach * Math.cos(round)).addScaledVector(up, reach * Math.sin(round));
      points.push(point.x, point.y, point.z);
    }
    this.spring.geometry.dispose();
    this.spring.geometry = new LineGeometry().setPositions(points);
  }

  /** Lines have the width of what they stand for, unless that is too thin to see. */
  widths() {
    const pixels = this.stage.pixelsPerMetre * this.stage.resolution;
    for (const { seen, hidden } of this.threads.values()) {
      seen.widen(pixels);
      hidden.widen(pixels);
    }
    for (const { hidden } of this.needles.values()) hidden.widen(pixels);
    this.outline?.draw(this.stage.camera, pixels);
  }
}


/** A line of known radius; or, dashed, what of it lies behind something. */
class Thread {
  /** @param {THREE.Group} group @param {number} radius [m] @param {number} colour @param {boolean} hidden */
  constructor(group, radius, colour, hidden) {
    this.group = group;
    this.radius = radius;
    this.hidden = hidden;
    /** @type {Float32Array | null} points that are placed with the first picture */
    this.local = null;
    this.material = new LineMaterial({ color: colour, linewidth: THINNEST, dashed: hidden, toneMapped: false });
    if (hidden) {
      Object.assign(this.material, { depthFunc: THREE.GreaterDepth, depthWrite: false, transparent: true, opacity: 0.95 });
    }
    this.line = new Line2(new LineGeometry(), this.material);
    this.line.frustumCulled = false;
    this.line.visible = false;
    this.line.renderOrder = hidden ? DASHES : 0;
    this.capacity = 0;
    group.add(this.line);
  }

  /** @param {Float32Array} points (p x 3) @param {Uint8Array} [what] each of them is */
  place(points, what) {
    if (points.length < 6) {
      this.line.visible = false;
      return;
    }
    // Places for more points than there are: a thread gains and loses some at every puncture.
    if (points.length > this.capacity) {
      this.capacity = 2 * points.length;
      this.line.geometry.dispose();
      this.line.geometry = new LineGeometry().setPositions(new Float32Array(this.capacity));
    }
    const start = /** @type {THREE.InterleavedBufferAttribute} */ (this.line.geometry.getAttribute('instanceStart'));
    const data = /** @type {Float32Array} */ (start.data.array);
    const segments = points.length / 3 - 1;
    for (let i = 0; i < segments; i += 1) {
      data.set(points.subarray(3 * i, 3 * i + 6), 6 * i);
      // Nothing from a loose end to the next piece.
      if (what?.[i] === LOOSE_END) data.copyWithin(6 * i + 3, 6 * i, 6 * i + 3);
    }
    start.data.needsUpdate = true;
    this.line.geometry.instanceCount = segments;
    if (this.hidden) this.line.computeLineDistances();
    this.line.visible = true;
  }

  /** @param {number} pixels of a metre */
  widen(pixels) {
    const width = Math.max(THINNEST, 2 * this.radius * pixels);
    this.material.linewidth = width;
    if (!this.hidden) return;
    this.material.dashSize = (5 + width) / pixels;
    this.material.gapSize = (3 + width) / pixels;
  }

  remove() {
    this.group.remove(this.line);
    this.line.geometry.dispose();
    this.material.dispose();
  }
}

/** Arrows of one colour: shafts and heads, each drawn at once. */
class Arrows {
  /** @param {number} colour @param {number} most @param {number} thickness over the scene's radius */
  constructor(colour, most, thickness) {
    // Over everything: what presses lies inside the tool.
    const material = new THREE.MeshBasicMaterial({ color: colour, toneMapped: false, depthTest: false, transparent: true, opacity: 0.9 });
    this.shafts = new THREE.InstancedMesh(new THREE.CylinderGeometry(0.5, 0.5, 1, 8).translate(0, 0.5, 0), material, most);
    this.heads = new THREE.InstancedMesh(new THREE.ConeGeometry(1.4, 1, 12).translate(0, -0.5, 0), material, most);
    this.thickness = thickness;
    this.group = new THREE.Group();
    /** @type {{start: THREE.Vector3, along: THREE.Vector3}[]} */
    this.list = [];
    for (const mesh of [this.shafts, this.heads]) {
      mesh.frustumCulled = false;
      mesh.renderOrder = 4;
      mesh.count = 0;
      this.group.add(mesh);
    }
  }

  clear() {
    this.list.length = 0;
  }

  /** @param {THREE.Vector3} start @param {THREE.Vector3} along [m] */
  add(start, along) {
    if (this.list.length < this.shafts.instanceMatrix.count) this.list.push({ start: start.clone(), along: along.clone() });
  }

  /** @param {number} radius of the scene [m] */
  done(radius) {
    const width = this.thickness * radius;
    const up = new THREE.Vector3(0, 1, 0);
    const turn = new THREE.Quaternion();
    const matrix = new THREE.Matrix4();
    const size = new THREE.Vector3();
    let count = 0;
    for (const { start, along } of this.list) {
      const length = along.length();
      if (!(length > 0.002 * radius)) continue;
      turn.setFromUnitVectors(up, along.clone().divideScalar(length));
      const head = Math.min(3.5 * width, 0.6 * length);
      this.shafts.setMatrixAt(count, matrix.compose(start, turn, size.set(width, length - 0.9 * head, width)));
      this.heads.setMatrixAt(count, matrix.compose(start.clone().add(along), turn, size.set((width * head) / (3.5 * width), head, (width * head) / (3.5 * width))));
      count += 1;
    }
    for (const mesh of [this.shafts, this.heads]) {
      mesh.count = count;
      mesh.instanceMatrix.needsUpdate = true;
    }
  }
}

/** @param {Float32Array} vectors (n x 3) */
function largest(vectors) {
  let found = 0;
  for (let i = 0; i < vectors.length; i += 3) found = Math.max(found, Math.hypot(vectors[i], vectors[i + 1], vectors[i + 2]));
  return found;
}

/** @param {import('./stage.js').Quality} quality @param {number} colour */
function metal(quality, colour) {
  if (quality === 'lean') return new THREE.MeshLambertMaterial({ color: colour });
  // Without an environment a metal has nothing to reflect.
  return new THREE.MeshPhysicalMaterial({ color: colour, metalness: quality === 'full' ? 0.85 : 0.15, roughness: 0.32 });
}

/** Where a grip is, if nothing of it touches: a ring. @param {number} radius of the scene [m] */
function gripMark(radius) {
  return new THREE.Mesh(new THREE.TorusGeometry(0.05 * radius, 0.008 * radius, 10, 36));
}
