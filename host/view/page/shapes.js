// Shapes of tools and needles as the host describes them, as triangles in their own frame.

import * as THREE from 'three';
import { displace, shade, split } from './surface.js';

/**
 * @typedef {object} ToolShape as in `hello`
 * @property {number} id
 * @property {boolean} driven
 * @property {'sphere' | 'capsule' | 'punch' | 'box' | 'mesh' | 'grip'} shape
 * @property {number | null} radius_m
 * @property {number | null} length_m
 * @property {number | null} fillet_m
 * @property {number[] | null} size_m along side, across both, along the axis
 * @property {number[]} offset_m
 * @property {number[]} axis where the front looks
 * @property {number[]} side
 * @property {number[][] | null} points_m
 * @property {number[][] | null} triangles
 */

/** Segments of a quarter circle. */
const QUARTER = 8;

/**
 * The tool around its own point, in the frame of the grip; `null` if nothing of it touches.
 * @param {ToolShape} tool
 * @returns {THREE.BufferGeometry | null}
 */
export function toolGeometry(tool) {
  const geometry = inOwnFrame(tool);
  // Own frame: x along the side, z against the axis.
  const x = new THREE.Vector3(...tool.side);
  const z = new THREE.Vector3(...tool.axis).negate();
  const y = new THREE.Vector3().crossVectors(z, x);
  geometry?.applyMatrix4(new THREE.Matrix4().makeBasis(x, y, z));
  return geometry;
}

/** @param {ToolShape} tool */
function inOwnFrame(tool) {
  const radius = tool.radius_m ?? 0;
  const length = tool.length_m ?? 0;
  const fillet = tool.fillet_m ?? 0;
  switch (tool.shape) {
    case 'sphere':
      return new THREE.SphereGeometry(radius, 6 * QUARTER, 3 * QUARTER).rotateX(Math.PI / 2);
    case 'capsule':
      return new THREE.CapsuleGeometry(radius, length, QUARTER, 4 * QUARTER).rotateX(Math.PI / 2).translate(0, 0, length / 2);
    case 'punch':
      return punch(radius, fillet, length);
    case 'box':
      return box(tool.size_m ?? [0, 0, 0], fillet);
    case 'mesh':
      return mesh(tool.points_m ?? [], tool.triangles ?? [], fillet);
    default:
      return null;
  }
}

/** A cylinder behind a flat front at z = 0 with a rounded rim. @param {number} radius @param {number} fillet @param {number} length */
function punch(radius, fillet, length) {
  const profile = [new THREE.Vector2(0, 0)];
  for (let i = 0; i <= QUARTER; i += 1) {
    const angle = ((i / QUARTER) * Math.PI) / 2;
    profile.push(new THREE.Vector2(radius - fillet + fillet * Math.sin(angle), fillet - fillet * Math.cos(angle)));
  }
  profile.push(new THREE.Vector2(radius, length), new THREE.Vector2(0, length));
  return creased(new THREE.LatheGeometry(profile, 6 * QUARTER).rotateX(Math.PI / 2));
}

/** A box behind z = 0. @param {number[]} size @param {number} fillet */
function box([x, y, z], fillet) {
  const outline = new THREE.Shape();
  const [a, b] = [x / 2 - fillet, y / 2 - fillet];
  outline.moveTo(-a, -b).lineTo(a, -b).lineTo(a, b).lineTo(-a, b).lineTo(-a, -b);
  if (!(fillet > 0)) return new THREE.BoxGeometry(x, y, z).translate(0, 0, z / 2);
  return new THREE.ExtrudeGeometry(outline, {
    depth: Math.max(z - 2 * fillet, 1e-9), bevelEnabled: true, bevelThickness: fillet, bevelSize: fillet, bevelSegments: QUARTER,
  }).translate(0, 0, fillet);
}

/** A closed mesh, larger by `fillet` along the normals of its points. @param {number[][]} points @param {number[][]} triangles @param {number} fillet */
function mesh(points, triangles, fillet) {
  const indexed = new THREE.BufferGeometry();
  indexed.setAttribute('position', new THREE.Float32BufferAttribute(points.flat(), 3));
  indexed.setIndex(triangles.flat());
  indexed.computeVertexNormals();
  const positions = indexed.getAttribute('position');
  const normals = indexed.getAttribute('normal');
  for (let i = 0; i < positions.count; i += 1) {
    positions.setXYZ(
      i,
      positions.getX(i) + fillet * normals.getX(i),
      positions.getY(i) + fillet * normals.getY(i),
      positions.getZ(i) + fillet * normals.getZ(i),
    );
  }
  return creased(indexed);
}

/** The same faces with normals that are smooth but at sharp edges; points in one place are one. @param {THREE.BufferGeometry} geometry */
function creased(geometry) {
  const points = geometry.getAttribute('position');
  /** @type {Map<string, number>} */
  const places = new Map();
  /** @type {number[]} */
  const positions = [];
  const numbers = Array.from({ length: points.count }, (_, i) => {
    const point = [points.getX(i), points.getY(i), points.getZ(i)];
    const key = point.map((value) => Math.round(value * 1e8)).join();
    const number = places.get(key) ?? places.size;
    if (number === places.size) {
      places.set(key, number);
      positions.push(...point);
    }
    return number;
  });
  const index = /** @type {THREE.BufferAttribute} */ (geometry.getIndex());
  const triangles = [];
  for (let face = 0; face < index.count; face += 3) {
    const corners = [0, 1, 2].map((corner) => numbers[index.getX(face + corner)]);
    if (new Set(corners).size === 3) triangles.push(...corners);
  }
  geometry.dispose();
  const unloaded = Float32Array.from(positions);
  const surface = split(unloaded, Uint32Array.from(triangles), new Int32Array(triangles.length / 3));
  const placed = new Float32Array(3 * surface.source.length);
  const normals = new Float32Array(placed.length);
  displace(unloaded, null, 0, surface.source, placed);
  shade(placed, surface.index, normals);
  const made = new THREE.BufferGeometry();
  made.setAttribute('position', new THREE.BufferAttribute(placed, 3));
  made.setAttribute('normal', new THREE.BufferAttribute(normals, 3));
  made.setIndex(new THREE.BufferAttribute(surface.index, 1));
  return made;
}

/**
 * A needle around its centre line, from its end to its tip, which is pointed.
 * @param {number[][]} points [m]
 * @param {number} thickness [m]
 */
export function needleGeometry(points, thickness) {
  const around = 12;
  const along = Math.max(24, 2 * points.length);
  const curve = new THREE.CatmullRomCurve3(points.map((point) => new THREE.Vector3(...point)));
  const tube = new THREE.TubeGeometry(curve, along, thickness / 2, around);
  const positions = tube.getAttribute('position');
  const taper = Math.min(0.2, (4 * thickness) / Math.max(curve.getLength(), 1e-9));
  const centre = new THREE.Vector3();
  const point = new THREE.Vector3();
  for (let ring = 0; ring <= along; ring += 1) {
    const to_tip = (1 - ring / along) / taper;
    if (to_tip >= 1) continue;
    curve.getPointAt(ring / along, centre);
    for (let i = 0; i <= around; i += 1) {
      const at = ring * (around + 1) + i;
      point.fromBufferAttribute(positions, at).sub(centre).multiplyScalar(to_tip).add(centre);
      positions.setXYZ(at, point.x, point.y, point.z);
    }
  }
  return tube;
}
