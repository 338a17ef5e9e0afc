// The tissue's surface as it is drawn: vertices are split at edges that are sharp at rest and between regions, so that
// neither shading nor colour runs around a rim. Pure functions on typed arrays.

/** Edges between faces that turn by more than this are sharp [rad]. */
const CREASE = Math.PI / 4;

/**
 * @typedef {object} Surface
 * @property {Uint32Array} index of the split vertices, (f x 3)
 * @property {Uint32Array} source the geometry's vertex of each split one
 * @property {Int32Array} region of each split vertex
 * @property {Uint32Array} creases pairs of split vertices along sharp edges
 */

/**
 * @param {Float32Array} positions unloaded, (v x 3)
 * @param {Uint32Array} triangles (f x 3)
 * @param {Int32Array} regions of each triangle
 * @returns {Surface}
 */
export function split(positions, triangles, regions) {
  const faces = triangles.length / 3;
  const normals = faceNormals(positions, triangles);
  // Corners of faces that share a smooth edge at one vertex become one vertex.
  const parent = Uint32Array.from({ length: 3 * faces }, (_, i) => i);
  const root = (/** @type {number} */ corner) => {
    while (parent[corner] !== corner) corner = parent[corner] = parent[parent[corner]];
    return corner;
  };
  /** @type {Map<number, number>} corner at which each edge was met first */
  const edges = new Map();
  const vertices = positions.length / 3;
  /** @type {number[]} */
  const sharp = [];
  for (let corner = 0; corner < 3 * faces; corner += 1) {
    const next = after(corner);
    const [a, b] = [triangles[corner], triangles[next]];
    const edge = Math.min(a, b) * vertices + Math.max(a, b);
    const other = edges.get(edge);
    if (other === undefined) {
      edges.set(edge, corner);
      continue;
    }
    const [here, there] = [Math.floor(corner / 3), Math.floor(other / 3)];
    if (regions[here] !== regions[there] || turns(normals, here, there)) {
      sharp.push(corner, next);
      continue;
    }
    for (const mine of [corner, next]) {
      const theirs = triangles[mine] === triangles[other] ? other : after(other);
      parent[root(mine)] = root(theirs);
    }
  }
  const index = new Uint32Array(3 * faces);
  const numbers = new Map();
  const source = [];
  const region = [];
  for (let corner = 0; corner < 3 * faces; corner += 1) {
    const group = root(corner);
    let number = numbers.get(group);
    if (number === undefined) {
      number = source.length;
      numbers.set(group, number);
      source.push(triangles[corner]);
      region.push(regions.length > 0 ? regions[Math.floor(corner / 3)] : 0);
    }
    index[corner] = number;
  }
  const creases = Uint32Array.from(sharp, (corner) => index[corner]);
  return { index, source: Uint32Array.from(source), region: Int32Array.from(region), creases };
}

/** The next corner of the same face. @param {number} corner */
function after(corner) {
  return corner % 3 === 2 ? corner - 2 : corner + 1;
}

/** @param {Float32Array} positions @param {Uint32Array} triangles */
function faceNormals(positions, triangles) {
  const normals = new Float32Array(triangles.length);
  for (let face = 0; face < triangles.length; face += 3) {
    const [a, b, c] = [3 * triangles[face], 3 * triangles[face + 1], 3 * triangles[face + 2]];
    const [ux, uy, uz] = [positions[b] - positions[a], positions[b + 1] - positions[a + 1], positions[b + 2] - positions[a + 2]];
    const [vx, vy, vz] = [positions[c] - positions[a], positions[c + 1] - positions[a + 1], positions[c + 2] - positions[a + 2]];
    const [x, y, z] = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
    const length = Math.hypot(x, y, z) || 1;
    normals.set([x / length, y / length, z / length], face);
  }
  return normals;
}

/** @param {Float32Array} normals @param {number} a @param {number} b */
function turns(normals, a, b) {
  const dot = normals[3 * a] * normals[3 * b] + normals[3 * a + 1] * normals[3 * b + 1] + normals[3 * a + 2] * normals[3 * b + 2];
  return dot < Math.cos(CREASE);
}

/**
 * Positions of the split vertices, displaced.
 * @param {Float32Array} unloaded (v x 3)
 * @param {Int16Array | null} displacement (v x 3)
 * @param {number} scale [m] of 32767
 * @param {Uint32Array} source
 * @param {Float32Array} into (split x 3)
 */
export function displace(unloaded, displacement, scale, source, into) {
  const metres = scale / 32767;
  for (let i = 0; i < source.length; i += 1) {
    const from = 3 * source[i];
    for (let axis = 0; axis < 3; axis += 1) {
      into[3 * i + axis] = unloaded[from + axis] + (displacement ? displacement[from + axis] * metres : 0);
    }
  }
}

/**
 * Normals of the split vertices, faces weighted by area.
 * @param {Float32Array} positions (split x 3)
 * @param {Uint32Array} index
 * @param {Float32Array} into (split x 3)
 */
export function shade(positions, index, into) {
  into.fill(0);
  for (let face = 0; face < index.length; face += 3) {
    const a = 3 * index[face];
    const b = 3 * index[face + 1];
    const c = 3 * index[face + 2];
    const ux = positions[b] - positions[a];
    const uy = positions[b + 1] - positions[a + 1];
    const uz = positions[b + 2] - positions[a + 2];
    const vx = positions[c] - positions[a];
    const vy = positions[c + 1] - positions[a + 1];
    const vz = positions[c + 2] - positions[a + 2];
    const x = uy * vz - uz * vy;
    const y = uz * vx - ux * vz;
    const z = ux * vy - uy * vx;
    into[a] += x;
    into[a + 1] += y;
    into[a + 2] += z;
    into[b] += x;
    into[b + 1] += y;
    into[b + 2] += z;
    into[c] += x;
    into[c + 1] += y;
    into[c + 2] += z;
  }
  for (let i = 0; i < into.length; i += 3) {
    const length = Math.hypot(into[i], into[i + 1], into[i + 2]) || 1;
    into[i] /= length;
    into[i + 1] /= length;
    into[i + 2] /= length;
  }
}
