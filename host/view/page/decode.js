// The binary messages of the host, format 1: see docs/src/view-format.md. Entry point: `decode`.
// What it returns are views of the message's bytes; nothing is copied but what is small.

/** The format that this page speaks. */
export const FORMAT = 1;

export const KIND = { geometry: 1, picture: 2, ticks: 3, solves: 4 };
export const MODES = ['boot', 'idle', 'armed', 'decaying', 'fault'];
/** Age of a force that there is not yet. */
export const NO_AGE = 4294967295;

/**
 * @typedef {object} Geometry
 * @property {'geometry'} kind
 * @property {number} id
 * @property {number} session
 * @property {number} nodes
 * @property {Float32Array} positions unloaded [m], (v x 3)
 * @property {Uint32Array} triangles (f x 3)
 * @property {Int32Array} regions of each triangle's cell
 * @property {Uint8Array} fixed of each vertex
 * @property {Uint32Array} nodeOf of each vertex
 */

/**
 * @typedef {object} ToolPicture
 * @property {number} id
 * @property {boolean} driven
 * @property {Float32Array} position [m], of the shape's own point
 * @property {Float32Array} orientation x, y, z, w
 * @property {Float32Array} wrench force [N], moment about the grip [N m]
 * @property {number} gap [m]
 * @property {number} touched vertices
 */

/**
 * @typedef {object} NeedlePicture
 * @property {number} id
 * @property {number} tip 0 outside, 1 holding, 2 inside, 3 waiting
 * @property {number} holder tool, 255: none
 * @property {Float32Array} position [m], of its end
 * @property {Float32Array} orientation x, y, z, w
 * @property {number} crossings
 * @property {number} punctures
 * @property {number} axial [N]
 * @property {number} tipForce [N]
 * @property {number} punctureForce [N]
 */

/**
 * @typedef {object} ThreadPicture
 * @property {number} id
 * @property {number} state 0 slack, 1 taut
 * @property {Float32Array} points [m], (p x 3)
 * @property {Uint8Array} what 0 end, 1 inside, 2 enters, 3 leaves, 4 wraps
 * @property {Float32Array} tension [N], up to the next point
 */

/**
 * @typedef {object} StatusPicture
 * @property {number} word of the solver
 * @property {boolean} touching
 * @property {number} rows
 * @property {number} pairs
 * @property {number} iterations
 * @property {number} residual
 * @property {number} energy [J]
 * @property {number} tension [N], largest; NaN without threads
 * @property {number} span over its unloaded length, longest; NaN without parts
 * @property {Float32Array} grip [m]
 */

/**
 * @typedef {object} Picture
 * @property {'picture'} kind
 * @property {boolean} recorded
 * @property {boolean} withheld
 * @property {number} sequence
 * @property {number} time [s]
 * @property {number} solves
 * @property {number} geometry
 * @property {number} vertices
 * @property {number} displacementScale [m] of 32767
 * @property {Int16Array | null} displacement (v x 3)
 * @property {number} scalar its number, 0: none
 * @property {number} scalarLow
 * @property {number} scalarHigh
 * @property {Uint16Array | null} scalars
 * @property {ToolPicture[]} tools
 * @property {NeedlePicture[]} needles
 * @property {ThreadPicture[]} threads
 * @property {{vertices: Uint32Array, forces: Float32Array}} contacts forces on the tissue [N]
 * @property {StatusPicture | null} status
 */

/**
 * @typedef {object} Ticks
 * @property {'ticks'} kind
 * @property {number} session
 * @property {boolean} gap something is missing before this block
 * @property {number} rows
 * @property {Float64Array} time [s]
 * @property {Uint32Array} tick
 * @property {Float32Array} position [m]
 * @property {Float32Array} velocity [m/s]
 * @property {Float32Array} force [N]
 * @property {Uint32Array} age [us]
 * @property {Uint32Array} applied [us]
 * @property {Uint8Array} mode
 * @property {Uint16Array} faults
 */

/**
 * @typedef {object} Solves
 * @property {'solves'} kind
 * @property {number} session
 * @property {boolean} gap
 * @property {number} rows
 * @property {number} stageCount
 * @property {Float64Array} time [s]
 * @property {Uint8Array} status
 * @property {Float32Array} step [us]
 * @property {Float32Array} stages [us], (stages x rows)
 * @property {Uint32Array} touched
 * @property {Float32Array} gapTo [m]
 * @property {Float32Array} wrench (rows x 6)
 * @property {Uint32Array} iterations
 * @property {Float32Array} energy [J]
 * @property {Float32Array} axial (needles x rows) [N]
 * @property {Float32Array} tension tails and heads (threads x 2 x rows) [N]
 */

/** @typedef {{tag: number, start: number, bytes: number}} Section */

/**
 * A message, or `null` if its kind is not known.
 * @param {ArrayBuffer} buffer
 * @returns {Geometry | Picture | Ticks | Solves | null}
 */
export function decode(buffer) {
  const view = new DataView(buffer);
  if (buffer.byteLength < 24) throw new RangeError(`a message of ${buffer.byteLength} bytes has no header`);
  const format = view.getUint8(1);
  if (format !== FORMAT) throw new RangeError(`format ${format}, this page speaks ${FORMAT}: reload it`);
  switch (view.getUint8(0)) {
    case KIND.geometry:
      return geometry(view);
    case KIND.picture:
      return picture(view);
    case KIND.ticks:
      return ticks(view);
    case KIND.solves:
      return solves(view);
    default:
      return null;
  }
}

/**
 * @param {DataView} view
 * @param {number} header bytes
 * @param {number} count sections
 * @returns {Section[]}
 */
function sections(view, header, count) {
  const found = [];
  let at = header;
  for (let i = 0; i < count; i += 1) {
    if (at + 8 > view.byteLength) throw new RangeError(`section ${i} of ${count} is missing`);
    const bytes = view.getUint32(at + 4, true);
    const start = at + 8;
    if (start + bytes > view.byteLength) throw new RangeError(`section ${i} ends after the message`);
    found.push({ tag: view.getUint16(at, true), start, bytes });
    at = start + Math.ceil(bytes / 8) * 8;
  }
  return found;
}

/**
 * The elements of the first section with this tag; none if there is no such section.
 * @template {Int8Array | Uint8Array | Int16Array | Uint16Array | Int32Array | Uint32Array | Float32Array | Float64Array} T
 * @param {{new (buffer: ArrayBuffer, start: number, length: number): T, BYTES_PER_ELEMENT: number}} type
 * @param {DataView} view
 * @param {Section[]} all
 * @param {number} tag
 * @param {number} [wanted] elements
 * @returns {T}
 */
function array(type, view, all, tag, wanted) {
  const buffer = /** @type {ArrayBuffer} */ (view.buffer);
  const section = all.find((one) => one.tag === tag);
  if (!section) return new type(buffer, 0, 0);
  const length = section.bytes / type.BYTES_PER_ELEMENT;
  if (wanted !== undefined && length !== wanted) throw new RangeError(`section ${tag} has ${length} elements, not ${wanted}`);
  return new type(buffer, section.start, length);
}

/** @param {DataView} view @param {number} at @param {number} length */
function floats(view, at, length) {
  return new Float32Array(/** @type {ArrayBuffer} */ (view.buffer), at, length);
}

/** @param {DataView} view @returns {Geometry} */
function geometry(view) {
  const vertices = view.getUint32(8, true);
  const faces = view.getUint32(12, true);
  const all = sections(view, 32, view.getUint16(24, true));
  return {
    kind: 'geometry',
    id: view.getUint32(4, true),
    session: view.getUint32(20, true),
    nodes: view.getUint32(16, true),
    positions: array(Float32Array, view, all, 1, 3 * vertices),
    triangles: array(Uint32Array, view, all, 2, 3 * faces),
    regions: array(Int32Array, view, all, 3, faces),
    fixed: array(Uint8Array, view, all, 4, vertices),
    nodeOf: array(Uint32Array, view, all, 5, vertices),
  };
}

/** @param {DataView} view @returns {Picture} */
function picture(view) {
  const vertices = view.getUint32(32, true);
  const all = sections(view, 56, view.getUint16(50, true));
  const has = (/** @type {number} */ tag) => all.some((one) => one.tag === tag);
  const status = all.find((one) => one.tag === 7);
  return {
    kind: 'picture',
    recorded: (view.getUint16(2, true) & 1) !== 0,
    withheld: (view.getUint16(2, true) & 2) !== 0,
    sequence: view.getUint32(4, true),
    time: view.getFloat64(8, true),
    solves: view.getUint32(24, true),
    geometry: view.getUint32(28, true),
    vertices,
    displacementScale: view.getFloat32(36, true),
    displacement: has(1) ? array(Int16Array, view, all, 1, 3 * vertices) : null,
    scalar: view.getUint8(48),
    scalarLow: view.getFloat32(40, true),
    scalarHigh: view.getFloat32(44, true),
    scalars: has(2) ? array(Uint16Array, view, all, 2, vertices) : null,
    tools: each(all, 3, 64, (at) => tool(view, at)),
    needles: each(all, 4, 56, (at) => needle(view, at)),
    threads: all.filter((one) => one.tag === 5).map((one) => thread(view, one)),
    contacts: contacts(view, all),
    status: status ? statusOf(view, status.start) : null,
  };
}

/**
 * @template T
 * @param {Section[]} all
 * @param {number} tag
 * @param {number} bytes of each
 * @param {(at: number) => T} read
 */
function each(all, tag, bytes, read) {
  const section = all.find((one) => one.tag === tag);
  return Array.from({ length: section ? Math.floor(section.bytes / bytes) : 0 }, (_, i) =>
    read(/** @type {Section} */ (section).start + i * bytes),
  );
}

/** @param {DataView} view @param {number} at @returns {ToolPicture} */
function tool(view, at) {
  return {
    id: view.getUint8(at),
    driven: view.getUint8(at + 1) === 1,
    position: floats(view, at + 4, 3),
    orientation: floats(view, at + 16, 4),
    wrench: floats(view, at + 32, 6),
    gap: view.getFloat32(at + 56, true),
    touched: view.getUint32(at + 60, true),
  };
}

/** @param {DataView} view @param {number} at @returns {NeedlePicture} */
function needle(view, at) {
  return {
    id: view.getUint8(at),
    tip: view.getUint8(at + 1),
    holder: view.getUint8(at + 2),
    position: floats(view, at + 4, 3),
    orientation: floats(view, at + 16, 4),
    crossings: view.getUint32(at + 32, true),
    punctures: view.getUint32(at + 36, true),
    axial: view.getFloat32(at + 40, true),
    tipForce: view.getFloat32(at + 44, true),
    punctureForce: view.getFloat32(at + 48, true),
  };
}

/** @param {DataView} view @param {Section} section @returns {ThreadPicture} */
function thread(view, section) {
  const at = section.start;
  const count = view.getUint32(at + 4, true);
  if (section.bytes < 24 + 12 * count) throw new RangeError(`a thread of ${count} points in ${section.bytes} bytes`);
  const scale = view.getFloat32(at + 20, true) / 32767;
  const points = new Float32Array(3 * count);
  const what = new Uint8Array(count);
  const tension = new Float32Array(count);
  for (let i = 0; i < count; i += 1) {
    const point = at + 24 + 12 * i;
    for (let axis = 0; axis < 3; axis += 1) {
      points[3 * i + axis] = view.getFloat32(at + 8 + 4 * axis, true) + view.getInt16(point + 2 * axis, true) * scale;
    }
    what[i] = view.getUint8(point + 6);
    tension[i] = view.getFloat32(point + 8, true);
  }
  return { id: view.getUint8(at), state: view.getUint8(at + 1), points, what, tension };
}

/** @param {DataView} view @param {Section[]} all */
function contacts(view, all) {
  const section = all.find((one) => one.tag === 6);
  const count = section ? Math.floor(section.bytes / 16) : 0;
  const vertices = new Uint32Array(count);
  const forces = new Float32Array(3 * count);
  for (let i = 0; i < count; i += 1) {
    const at = /** @type {Section} */ (section).start + 16 * i;
    vertices[i] = view.getUint32(at, true);
    forces.set(floats(view, at + 4, 3), 3 * i);
  }
  return { vertices, forces };
}

/** @param {DataView} view @param {number} at @returns {StatusPicture} */
function statusOf(view, at) {
  return {
    word: view.getUint8(at),
    touching: view.getUint8(at + 1) === 1,
    rows: view.getUint32(at + 4, true),
    pairs: view.getUint32(at + 8, true),
    iterations: view.getUint32(at + 12, true),
    residual: view.getFloat32(at + 16, true),
    energy: view.getFloat32(at + 20, true),
    tension: view.getFloat32(at + 24, true),
    span: view.getFloat32(at + 28, true),
    grip: floats(view, at + 32, 3),
  };
}

/** @param {DataView} view @returns {Ticks} */
function ticks(view) {
  const rows = view.getUint32(8, true);
  const all = sections(view, 24, view.getUint16(16, true));
  return {
    kind: 'ticks',
    session: view.getUint32(4, true),
    gap: (view.getUint16(2, true) & 1) !== 0,
    rows,
    time: array(Float64Array, view, all, 1, rows),
    tick: array(Uint32Array, view, all, 2, rows),
    position: array(Float32Array, view, all, 3, 3 * rows),
    velocity: array(Float32Array, view, all, 4, 3 * rows),
    force: array(Float32Array, view, all, 5, 3 * rows),
    age: array(Uint32Array, view, all, 6, rows),
    applied: array(Uint32Array, view, all, 7, rows),
    mode: array(Uint8Array, view, all, 8, rows),
    faults: array(Uint16Array, view, all, 10, rows),
  };
}

/** @param {DataView} view @returns {Solves} */
function solves(view) {
  const rows = view.getUint32(8, true);
  const stageCount = view.getUint32(12, true);
  const all = sections(view, 24, view.getUint16(16, true));
  return {
    kind: 'solves',
    session: view.getUint32(4, true),
    gap: (view.getUint16(2, true) & 1) !== 0,
    rows,
    stageCount,
    time: array(Float64Array, view, all, 1, rows),
    status: array(Uint8Array, view, all, 2, rows),
    step: array(Float32Array, view, all, 3, rows),
    stages: array(Float32Array, view, all, 4),
    touched: array(Uint32Array, view, all, 5, rows),
    gapTo: array(Float32Array, view, all, 6, rows),
    wrench: array(Float32Array, view, all, 7, 6 * rows),
    iterations: array(Uint32Array, view, all, 8, rows),
    energy: array(Float32Array, view, all, 9, rows),
    axial: array(Float32Array, view, all, 10),
    tension: array(Float32Array, view, all, 11),
  };
}
