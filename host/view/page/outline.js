// The outline of a tool, dashed where it lies behind something else. Entry point: `Outline`.

import * as THREE from 'three';
import { LineMaterial } from 'three/addons/lines/LineMaterial.js';
import { LineSegments2 } from 'three/addons/lines/LineSegments2.js';
import { LineSegmentsGeometry } from 'three/addons/lines/LineSegmentsGeometry.js';

/** Width, dash and gap [px]. */
const WIDTH = 2;
const DASH = 7;
const GAP = 5;

/**
 * An edge between two triangles.
 * @typedef {object} Edge
 * @property {number} a vertex
 * @property {number} b
 * @property {number[]} sides the triangles, one or two
 */

/** Edges of a surface whose coincident vertices count as one. */
export class Edges {
  /** @param {ArrayLike<number>} positions (v x 3) [m] @param {ArrayLike<number> | null} index (3 f), or consecutive vertices */
  constructor(positions, index) {
    const size = Math.max(...Array.from(positions, Math.abs), 1e-9);
    /** @type {Map<string, number>} */
    const known = new Map();
    /** @type {THREE.Vector3[]} */
    this.points = [];
    const vertex = (/** @type {number} */ i) => {
      const at = new THREE.Vector3(positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]);
      const key = at.toArray().map((value) => Math.round((1e5 * value) / size)).join();
      const found = known.get(key) ?? this.points.push(at) - 1;
      known.set(key, found);
      return found;
    };
    /** Normal and a point of each triangle. @type {THREE.Plane[]} */
    this.planes = [];
    /** @type {Map<string, Edge>} */
    const edges = new Map();
    const corners = index?.length ?? positions.length / 3;
    for (let i = 0; i + 2 < corners; i += 3) {
      const [a, b, c] = [0, 1, 2].map((corner) => vertex(index ? index[i + corner] : i + corner));
      // A sphere has triangles without area at its poles.
      if (a === b || b === c || c === a) continue;
      const number = this.planes.push(new THREE.Plane().setFromCoplanarPoints(this.points[a], this.points[b], this.points[c])) - 1;
      for (const [from, to] of [[a, b], [b, c], [c, a]]) {
        const key = `${Math.min(from, to)} ${Math.max(from, to)}`;
        const edge = edges.get(key);
        if (edge) edge.sides.push(number);
        else edges.set(key, { a: from, b: to, sides: [number] });
      }
    }
    this.list = [...edges.values()];
  }

  /**
   * Edges between what looks at a point and what looks away, one after the other along the outline.
   * @param {THREE.Vector3} eye in the frame of the surface
   * @returns {[number, number][]} pairs of vertices
   */
  outline(eye) {
    const faces = this.planes.map((plane) => plane.distanceToPoint(eye) > 0);
    /** @type {Map<number, Edge[]>} */
    const at = new Map();
    const left = new Set(this.list.filter(({ sides }) => sides.length === 1 || faces[sides[0]] !== faces[sides[1]]));
    for (const edge of left) for (const end of [edge.a, edge.b]) at.set(end, [...(at.get(end) ?? []), edge]);
    /** @type {[number, number][]} */
    const chain = [];
    for (const first of left) {
      left.delete(first);
      chain.push([first.a, first.b]);
      for (let end = first.b; ;) {
        const next = at.get(end)?.find((edge) => left.has(edge));
        if (!next) break;
        left.delete(next);
        const other = next.a === end ? next.b : next.a;
        chain.push([end, other]);
        end = other;
      }
    }
    return chain;
  }
}

export class Outline {
  /** @param {THREE.Mesh} mesh @param {number} colour @param {number} order in which it is drawn, before the mesh */
  constructor(mesh, colour, order) {
    this.mesh = mesh;
    this.edges = new Edges(mesh.geometry.getAttribute('position').array, mesh.geometry.getIndex()?.array ?? null);
    this.material = new LineMaterial({ color: colour, linewidth: WIDTH, dashed: true, toneMapped: false });
    Object.assign(this.material, { depthFunc: THREE.GreaterDepth, depthWrite: false, transparent: true, opacity: 0.95 });
    this.places = new Float32Array(6 * this.edges.list.length);
    this.line = new LineSegments2(new LineSegmentsGeometry().setPositions(this.places), this.material);
    this.line.frustumCulled = false;
    this.line.visible = false;
    this.line.renderOrder = order;
  }

  /** Finds it anew, for where the camera is. @param {THREE.Camera} camera @param {number} pixels of a metre */
  draw(camera, pixels) {
    if (!this.line.visible) return;
    this.line.position.copy(this.mesh.position);
    this.line.quaternion.copy(this.mesh.quaternion);
    this.line.updateMatrixWorld();
    const chain = this.edges.outline(this.line.worldToLocal(camera.position.clone()));
    chain.forEach((pair, i) => pair.forEach((point, end) => this.edges.points[point].toArray(this.places, 6 * i + 3 * end)));
    const start = /** @type {THREE.InterleavedBufferAttribute} */ (this.line.geometry.getAttribute('instanceStart'));
    start.data.array.set(this.places);
    start.data.needsUpdate = true;
    this.line.geometry.instanceCount = chain.length;
    this.line.computeLineDistances();
    this.material.dashSize = DASH / pixels;
    this.material.gapSize = GAP / pixels;
  }

  dispose() {
    this.line.geometry.dispose();
    this.material.dispose();
  }
}
