// The other side of host/view/page/decode.js, for the mock host: messages of docs/src/view-format.md as bytes.

const FORMAT = 1;

/** Header, then sections of `[tag, typed array or buffer]`. */
function message(header, countAt, sections) {
  const parts = [header];
  header.writeUInt16LE(sections.length, countAt);
  for (const [tag, content] of sections) {
    const bytes = Buffer.isBuffer(content) ? content : Buffer.from(content.buffer, content.byteOffset, content.byteLength);
    const head = Buffer.alloc(8);
    head.writeUInt16LE(tag, 0);
    head.writeUInt32LE(bytes.length, 4);
    parts.push(head, bytes, Buffer.alloc((8 - (bytes.length % 8)) % 8));
  }
  return Buffer.concat(parts);
}

function floats(buffer, at, values) {
  values.forEach((value, i) => buffer.writeFloatLE(value, at + 4 * i));
}

export function geometryBytes({ id, session, positions, triangles, regions }) {
  const header = Buffer.alloc(32);
  header.set([1, FORMAT]);
  header.writeUInt32LE(id, 4);
  header.writeUInt32LE(positions.length / 3, 8);
  header.writeUInt32LE(triangles.length / 3, 12);
  header.writeUInt32LE(positions.length / 3, 16);
  header.writeUInt32LE(session, 20);
  return message(header, 24, [
    [1, Float32Array.from(positions)],
    [2, Uint32Array.from(triangles)],
    [3, Int32Array.from(regions)],
    [4, new Uint8Array(positions.length / 3)],
    [5, Uint32Array.from({ length: positions.length / 3 }, (_, i) => i)],
  ]);
}

export function pictureBytes(picture) {
  const { displacement, values } = picture;
  const header = Buffer.alloc(56);
  header.set([2, FORMAT]);
  header.writeUInt16LE(picture.recorded ? 1 : 0, 2);
  header.writeUInt32LE(picture.sequence, 4);
  header.writeDoubleLE(picture.time, 8);
  header.writeUInt32LE(picture.geometry, 28);
  header.writeUInt32LE(displacement.length / 3, 32);
  // As the message has it, and not less than what it scales.
  const scale = Math.fround(1.0000001 * Math.max(1e-9, ...displacement.map(Math.abs)));
  header.writeFloatLE(scale, 36);
  const [low, high] = values ? [Math.min(...values), Math.max(...values)] : [0, 0];
  header.writeFloatLE(low, 40);
  header.writeFloatLE(high, 44);
  header.writeUInt8(picture.scalar, 48);
  const sections = [[1, Int16Array.from(displacement, (value) => Math.round((value / scale) * 32767))]];
  if (values) sections.push([2, Uint16Array.from(values, (value) => Math.round(((value - low) / (high - low || 1)) * 65535))]);
  sections.push([3, Buffer.concat(picture.tools.map(toolBytes))]);
  sections.push([4, Buffer.concat(picture.needles.map(needleBytes))]);
  for (const thread of picture.threads) sections.push([5, threadBytes(thread)]);
  sections.push([6, Buffer.concat(picture.contacts.map(contactBytes))], [7, statusBytes(picture)]);
  return message(header, 50, sections);
}

function toolBytes({ id, driven, position, orientation, wrench, touched }) {
  const bytes = Buffer.alloc(64);
  bytes.set([id, driven ? 1 : 0]);
  floats(bytes, 4, [...position, ...orientation, ...wrench, Infinity]);
  bytes.writeUInt32LE(touched, 60);
  return bytes;
}

function needleBytes({ id, position, orientation, axial }) {
  const bytes = Buffer.alloc(56);
  bytes.set([id, 2, 255]);
  floats(bytes, 4, [...position, ...orientation]);
  floats(bytes, 40, [axial, 0, 0.28]);
  return bytes;
}

function threadBytes({ id, points }) {
  const bytes = Buffer.alloc(24 + 12 * points.length);
  bytes.set([id, 1]);
  bytes.writeUInt32LE(points.length, 4);
  const scale = Math.max(...points.flat().map(Math.abs));
  floats(bytes, 8, [0, 0, 0, scale]);
  points.forEach((point, i) => {
    point.forEach((value, axis) => bytes.writeInt16LE(Math.round((value / scale) * 32767), 24 + 12 * i + 2 * axis));
    bytes.writeFloatLE(0.1, 24 + 12 * i + 8);
  });
  return bytes;
}

function contactBytes({ vertex, force }) {
  const bytes = Buffer.alloc(16);
  bytes.writeUInt32LE(vertex, 0);
  floats(bytes, 4, force);
  return bytes;
}

function statusBytes({ contacts, grip, energy, touching, word = 0 }) {
  const bytes = Buffer.alloc(48);
  bytes.set([word, touching ? 1 : 0]);
  bytes.writeUInt32LE(contacts.length, 4);
  bytes.writeUInt32LE(3, 12);
  floats(bytes, 16, [1e-9, energy, NaN, NaN, ...grip]);
  return bytes;
}

function rowsHeader(kind, session, rows, stages, gap) {
  const header = Buffer.alloc(24);
  header.set([kind, FORMAT, gap ? 1 : 0]);
  header.writeUInt32LE(session, 4);
  header.writeUInt32LE(rows, 8);
  header.writeUInt32LE(stages, 12);
  return header;
}

export function ticksBytes(session, rows, gap) {
  const zeros = new Float32Array(3 * rows.length);
  return message(rowsHeader(3, session, rows.length, 0, gap), 16, [
    [1, Float64Array.from(rows, (row) => row.time)],
    [2, Uint32Array.from(rows, (row) => row.tick)],
    [3, Float32Array.from(rows.flatMap((row) => row.grip))],
    [4, zeros],
    [5, Float32Array.from(rows.flatMap((row) => row.force))],
    [6, Uint32Array.from(rows, (row) => row.age)],
    [7, Uint32Array.from(rows, (row) => row.applied)],
    [8, Uint8Array.from(rows, (row) => row.mode)],
    [9, new Uint8Array(rows.length)],
    [10, new Uint16Array(rows.length)],
  ]);
}

export function solvesBytes(session, stages, rows, needles, threads, gap) {
  const count = rows.length;
  return message(rowsHeader(4, session, count, stages, gap), 16, [
    [1, Float64Array.from(rows, (row) => row.time)],
    [2, new Uint8Array(count)],
    [3, Float32Array.from(rows, (row) => row.step)],
    [4, Float32Array.from(Array.from({ length: stages }, (_, stage) => rows.map((row) => row.stages[stage])).flat())],
    [5, Uint32Array.from(rows, (row) => row.touched)],
    [6, Float32Array.from(rows, () => Infinity)],
    [7, new Float32Array(6 * count)],
    [8, new Uint32Array(count).fill(3)],
    [9, Float32Array.from(rows, (row) => row.energy)],
    [10, new Float32Array(needles * count).fill(0.2)],
    [11, new Float32Array(2 * threads * count).fill(0.1)],
  ]);
}
