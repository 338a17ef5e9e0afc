// The tissue's surface: shaded by region, or in colours of a value. Entry point: `Tissue`.

import * as THREE from 'three';
import { STEPS, colourTable } from './colours.js';
import { displace, shade, split } from './surface.js';

/** Of regions, from 0, again and again. */
const REGIONS = [0xe37769, 0xd9a066, 0xc65b72, 0xe8c39e, 0xa8566a, 0xcf8a5b];
const INSIDE = 0x7c2f35;
/** Drawn first when see-through, so that what lies behind can be told from what lies in front by its depth. */
const ORDER = { tissue: 1, lines: 2 };

export class Tissue {
  /** @param {import('./stage.js').Stage} stage */
  constructor(stage) {
    this.stage = stage;
    this.group = new THREE.Group();
    stage.scene.add(this.group);
    this.plane = new THREE.Plane(new THREE.Vector3(0, 0, -1), 0);
    this.options = { opacity: 1, xray: false, wireframe: false, outline: true, visible: true };
    /** @type {{axis: 'x' | 'y' | 'z', at: number, flip: boolean} | null} [m] */
    this.cut = null;
    this.signed = false;
    this.coloured = false;
    /** @type {import('./decode.js').Geometry | null} */
    this.geometry = null;
    /** @type {import('./surface.js').Surface | null} */
    this.surface = null;
    this.buffers = new THREE.BufferGeometry();
    this.lineBuffers = new THREE.BufferGeometry();
    this.map = new THREE.DataTexture(colourTable(false), STEPS, 1);
    this.map.colorSpace = THREE.SRGBColorSpace;
    this.map.minFilter = this.map.magFilter = THREE.LinearFilter;
    this.map.needsUpdate = true;
    const clippingPlanes = /** @type {THREE.Plane[]} */ ([]);
    const offset = { polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 };
    this.materials = {
      lean: new THREE.MeshLambertMaterial({ vertexColors: true, ...offset }),
      wet: new THREE.MeshPhysicalMaterial({
        color: 0xd6c2be, vertexColors: true, roughness: 0.5, metalness: 0, clearcoat: 1, clearcoatRoughness: 0.18, ...offset,
      }),
      // Unlit and not tone mapped, or no legend fits.
      colours: new THREE.MeshBasicMaterial({ map: this.map, toneMapped: false, ...offset }),
      inside: new THREE.MeshBasicMaterial({ color: INSIDE, side: THREE.BackSide, toneMapped: false }),
      wires: new THREE.MeshBasicMaterial({ color: 0x1a0c0a, wireframe: true, transparent: true, opacity: 0.35 }),
      outline: new THREE.LineBasicMaterial({ color: 0x1a0c0a, transparent: true, opacity: 0.45 }),
    };
    this.clippingPlanes = clippingPlanes;
    for (const material of Object.values(this.materials)) material.clippingPlanes = clippingPlanes;
    /** @type {THREE.Mesh<THREE.BufferGeometry, THREE.Material>} */
    this.skin = new THREE.Mesh(this.buffers, this.materials.lean);
    this.back = new THREE.Mesh(this.buffers, this.materials.inside);
    this.wires = new THREE.Mesh(this.buffers, this.materials.wires);
    this.outline = new THREE.LineSegments(this.lineBuffers, this.materials.outline);
    this.skin.receiveShadow = true;
    for (const mesh of [this.back, this.skin, this.wires, this.outline]) {
      // Bounds would have to be found anew for every picture.
      mesh.frustumCulled = false;
      this.group.add(mesh);
    }
    this.skin.renderOrder = this.back.renderOrder = ORDER.tissue;
    this.wires.renderOrder = this.outline.renderOrder = ORDER.lines;
    this.group.visible = false;
    this.apply();
  }

  /** Triangles that are there to be drawn. */
  get triangles() {
    return this.surface ? this.surface.index.length / 3 : 0;
  }

  /** @param {import('./decode.js').Geometry} geometry */
  setGeometry(geometry) {
    this.geometry = geometry;
    const surface = split(geometry.positions, geometry.triangles, geometry.regions);
    this.surface = surface;
    const count = surface.source.length;
    this.buffers.dispose();
    this.lineBuffers.dispose();
    this.buffers = new THREE.BufferGeometry();
    const dynamic = (/** @type {number} */ size) =>
      new THREE.BufferAttribute(new Float32Array(size * count), size).setUsage(THREE.DynamicDrawUsage);
    this.positions = dynamic(3);
    this.normals = dynamic(3);
    this.values = dynamic(2);
    this.buffers.setAttribute('position', this.positions);
    this.buffers.setAttribute('normal', this.normals);
    this.buffers.setAttribute('uv', this.values);
    this.buffers.setAttribute('color', new THREE.BufferAttribute(regionColours(surface.region), 3));
    this.buffers.setIndex(new THREE.BufferAttribute(surface.index, 1));
    this.lineBuffers = new THREE.BufferGeometry();
    this.lineBuffers.setAttribute('position', this.positions);
    this.lineBuffers.setIndex(new THREE.BufferAttribute(surface.creases, 1));
    this.skin.geometry = this.back.geometry = this.wires.geometry = this.buffers;
    this.outline.geometry = this.lineBuffers;
    this.move(null, 0);
    this.apply();
  }

  clear() {
    this.geometry = null;
    this.surface = null;
    this.group.visible = false;
  }

  /** @param {Int16Array | null} displacement @param {number} scale */
  move(displacement, scale) {
    if (!this.geometry || !this.surface || !this.positions || !this.normals) return;
    const positions = /** @type {Float32Array} */ (this.positions.array);
    displace(this.geometry.positions, displacement, scale, this.surface.source, positions);
    shade(positions, this.surface.index, /** @type {Float32Array} */ (this.normals.array));
    this.positions.needsUpdate = true;
    this.normals.needsUpdate = true;
  }

  /**
   * Shows values at the geometry's vertices, or regions.
   * @param {Float32Array | null} values
   * @param {[number, number]} range
   * @param {boolean} signed
   */
  colour(values, range, signed) {
    if (signed !== this.signed) {
      this.signed = signed;
      /** @type {Uint8Array} */ (this.map.image.data).set(colourTable(signed));
      this.map.needsUpdate = true;
    }
    if (this.coloured !== (values !== null)) {
      this.coloured = values !== null;
      this.apply();
    }
    if (!values || !this.surface || !this.values) return;
    const [low, high] = range;
    // Values 0 and 1 are the centres of the first and last texel.
    const factor = (STEPS - 1) / STEPS / (high - low || 1);
    const { source } = this.surface;
    const into = this.values.array;
    for (let i = 0; i < source.length; i += 1) {
      into[2 * i] = 0.5 / STEPS + (values[source[i]] - low) * factor;
      into[2 * i + 1] = 0.5;
    }
    this.values.needsUpdate = true;
  }

  /** Makes materials and planes what the options and the quality say. */
  apply() {
    const { opacity, xray, wireframe, outline, visible } = this.options;
    const quality = this.stage.quality === 'lean' ? this.materials.lean : this.materials.wet;
    const skin = this.coloured ? this.materials.colours : quality;
    const alpha = xray ? Math.min(opacity, 0.35) : opacity;
    skin.transparent = alpha < 1;
    skin.opacity = alpha;
    skin.needsUpdate = true;
    this.skin.material = skin;
    this.group.visible = visible && this.geometry !== null;
    this.wires.visible = wireframe;
    this.outline.visible = outline;
    this.back.visible = this.cut !== null && alpha === 1;
    this.clippingPlanes.length = 0;
    if (this.cut) {
      const sign = this.cut.flip ? 1 : -1;
      this.plane.normal.set(0, 0, 0)[this.cut.axis] = sign;
      this.plane.constant = -sign * this.cut.at;
      this.clippingPlanes.push(this.plane);
    }
    for (const material of Object.values(this.materials)) material.needsUpdate = true;
    this.stage.toneMap(this.coloured);
    this.stage.request();
  }
}

/** @param {Int32Array} regions of vertices */
function regionColours(regions) {
  const order = [...new Set(regions)].sort((a, b) => a - b);
  const palette = new Map(order.map((region, i) => [region, new THREE.Color(REGIONS[i % REGIONS.length])]));
  const colours = new Float32Array(3 * regions.length);
  regions.forEach((region, i) => palette.get(region)?.toArray(colours, 3 * i));
  return colours;
}
