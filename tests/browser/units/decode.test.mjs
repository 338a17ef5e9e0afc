import assert from 'node:assert/strict';
import { existsSync, readFileSync, readdirSync } from 'node:fs';
import test from 'node:test';
import { decode } from '../../../host/view/page/decode.js';
import { geometryBytes, pictureBytes, solvesBytes, ticksBytes } from '../encode.mjs';

/** @param {Buffer} bytes */
const whole = (bytes) => bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);

const geometry = () => geometryBytes({ id: 7, session: 3, positions: [0, 0, 0, 1, 0, 0, 0, 1, 0], triangles: [0, 1, 2], regions: [-4] });
const tool = { id: 2, driven: true, position: [1, 2, 3], orientation: [0, 0, 0, 1], wrench: [1, 2, 3, 4, 5, 6], touched: 9 };
const picture = () =>
  pictureBytes({
    sequence: 12, time: 1.25, geometry: 7, displacement: [0.001, 0, -0.002, 0, 0, 0, 0, 0, 0.0005], scalar: 1, values: [1, 2, 3],
    tools: [tool], needles: [{ id: 1, position: [1, 2, 3], orientation: [0, 0, 0, 1], axial: 0.25 }],
    threads: [{ id: 0, points: [[0, 0, 0], [0.01, 0.02, -0.03]] }], contacts: [{ vertex: 2, force: [0, 0, -1] }],
    grip: [4, 5, 6], energy: 0.5, touching: true,
  });

test('a geometry comes back as it was', () => {
  const found = decode(whole(geometry()));
  assert.equal(found.kind, 'geometry');
  assert.deepEqual([found.id, found.session, ...found.triangles, ...found.regions], [7, 3, 0, 1, 2, -4]);
  assert.deepEqual([...found.positions], [0, 0, 0, 1, 0, 0, 0, 1, 0]);
});

test('a picture comes back within its quantisation', () => {
  const found = decode(whole(picture()));
  const metres = found.displacementScale / 32767;
  const wanted = [0.001, 0, -0.002, 0, 0, 0, 0, 0, 0.0005];
  [...found.displacement].forEach((value, i) => assert.ok(Math.abs(value * metres - wanted[i]) <= (1.00001 * found.displacementScale) / 65534));
  assert.deepEqual([found.scalar, found.scalarLow, found.scalarHigh, ...found.scalars], [1, 1, 3, 0, 32768, 65535]);
  assert.deepEqual([...found.tools[0].wrench], [1, 2, 3, 4, 5, 6]);
  assert.equal(found.tools[0].gap, Infinity);
  assert.equal(found.needles[0].axial, 0.25);
  assert.ok(Math.abs(found.threads[0].points[5] + 0.03) < 1e-6);
  assert.deepEqual([...found.contacts.vertices, ...found.contacts.forces], [2, 0, 0, -1]);
  assert.deepEqual([...found.status.grip], [4, 5, 6]);
  assert.ok(Number.isNaN(found.status.tension) && found.status.touching);
});

test('ticks and solves come back row by row', () => {
  const row = { time: 0.5, tick: 500, grip: [1, 2, 3], force: [4, 5, 6], age: 7, applied: 8, mode: 2 };
  const ticks = decode(whole(ticksBytes(1, [row, { ...row, tick: 501 }], true)));
  assert.deepEqual([ticks.kind, ticks.gap, ...ticks.tick, ...ticks.mode], ['ticks', true, 500, 501, 2, 2]);
  assert.deepEqual([...ticks.force], [4, 5, 6, 4, 5, 6]);
  const solves = decode(whole(solvesBytes(1, 2, [{ time: 1, step: 10, stages: [3, 4], energy: 0.1, touched: 5 }], 1, 1, false)));
  assert.deepEqual([solves.kind, solves.gap, ...solves.stages, ...solves.touched], ['solves', false, 3, 4, 5]);
});

test('a section with an unknown tag is skipped, an unknown kind is nothing', () => {
  const bytes = geometry();
  const count = bytes.readUInt16LE(24);
  bytes.writeUInt16LE(count + 1, 24);
  const more = Buffer.alloc(16, 1);
  more.writeUInt16LE(999, 0);
  more.writeUInt32LE(5, 4);
  assert.equal(decode(whole(Buffer.concat([bytes, more]))).id, 7);
  const other = geometry();
  other[0] = 77;
  assert.equal(decode(whole(other)), null);
});

test('broken bytes are an error in words, never a picture', () => {
  const format = picture();
  format[1] = 2;
  assert.throws(() => decode(whole(format)), /format 2, this page speaks 1/);
  const bytes = picture();
  for (let length = 0; length < bytes.length; length += 1) {
    assert.throws(() => decode(whole(bytes.subarray(0, length))), RangeError, `${length} of ${bytes.length} bytes`);
  }
  const counted = geometry();
  counted.writeUInt32LE(4, 8);
  assert.throws(() => decode(whole(counted)), /section 1 has 9 elements, not 12/);
});

const golden = new URL('../../golden/view/', import.meta.url);

test('the host\'s golden bytes', { skip: !existsSync(new URL('golden.json', golden)) }, () => {
  const wanted = JSON.parse(readFileSync(new URL('golden.json', golden), 'utf8'));
  const files = readdirSync(golden).filter((name) => name.endsWith('.bin'));
  assert.ok(files.length >= 4);
  for (const name of files) {
    const found = decode(whole(readFileSync(new URL(name, golden))));
    assert.equal(found?.kind, name.replace('.bin', ''), name);
    assert.ok(wanted[found.kind], `golden.json has ${found.kind}`);
  }
});
