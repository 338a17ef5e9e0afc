import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
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
  const solve = { time: 1, step: 10, stages: [3, 4], energy: 0.1, touched: 5 };
  const solves = decode(whole(solvesBytes(1, 2, [solve, { ...solve, stages: [5, 6] }], 1, 1, false)));
  assert.deepEqual([solves.kind, solves.gap, ...solves.stages, ...solves.touched], ['solves', false, 3, 5, 4, 6, 5, 5]);
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
const wanted = JSON.parse(readFileSync(new URL('golden.json', golden), 'utf8'));
/** @param {string} name */
const read = (name) => decode(whole(readFileSync(new URL(name, golden))));
/** As JSON has numbers that it cannot write. */
const number = (value) => (value === 'infinity' ? Infinity : (value ?? NaN));

function same(found, values, within = 1e-6) {
  const flat = values.flat(Infinity).map(number);
  assert.equal(found.length, flat.length);
  flat.forEach((value, i) => {
    const isSame = Object.is(found[i], value) || Math.abs(found[i] - value) <= within * Math.max(1, Math.abs(value));
    assert.ok(isSame, `element ${i} is ${found[i]}, not ${value}`);
  });
}

test('the host\'s geometry', () => {
  const [found, host] = [read('geometry.bin'), wanted['geometry.bin']];
  assert.deepEqual([found.id, found.session, found.nodes], [host.geometry, host.session, host.mesh_nodes]);
  same(found.positions, host.points_m);
  same(found.triangles, host.triangles);
  same(found.regions, host.regions);
  same(found.nodeOf, host.nodes);
  same(found.fixed, host.fixed.map(Number));
});

test('the host\'s picture', () => {
  const [found, host] = [read('picture.bin'), wanted['picture.bin']];
  assert.deepEqual(
    [found.sequence, found.time, found.solves, found.geometry, found.scalar, found.recorded, found.withheld],
    [host.sequence, host.time_s, host.solves, host.geometry, host.scalar, host.recorded, host.withheld],
  );
  const metres = found.displacementScale / 32767;
  same([...found.displacement].map((value) => value * metres), host.displacement_m, host.displacement_scale_m / 65534);
  const step = (found.scalarHigh - found.scalarLow) / 65535;
  same([...found.scalars].map((value) => found.scalarLow + value * step), host.scalar_values, step);
  found.tools.forEach((tool, i) => {
    const { id, driven, position_m, orientation, wrench, gap_m, rows } = host.tools[i];
    assert.deepEqual([tool.id, tool.driven, tool.touched, tool.gap], [id, driven, rows, number(gap_m)]);
    same([...tool.position, ...tool.orientation, ...tool.wrench], [position_m, orientation, wrench]);
  });
  found.needles.forEach((needle, i) => {
    const { id, tip, held_by, position_m, orientation, crossings, punctures, axial_n, hold_n, puncture_n } = host.needles[i];
    assert.deepEqual([needle.id, needle.tip, needle.holder, needle.crossings, needle.punctures], [id, tip, held_by ?? 255, crossings, punctures]);
    same([...needle.position, ...needle.orientation, needle.axial, needle.tipForce, needle.punctureForce], [position_m, orientation, axial_n, hold_n, puncture_n]);
  });
  found.threads.forEach((thread, i) => {
    const { id, state, points } = host.threads[i];
    assert.deepEqual([thread.id, thread.state, ...thread.what], [id, state, ...points.map((point) => point.what)]);
    same(thread.points, points.map((point) => point.at_m), 3e-5);
    same(thread.tension, points.map((point) => point.tension_n));
  });
  assert.deepEqual([found.tools.length, found.needles.length, found.threads.length], [host.tools.length, host.needles.length, host.threads.length]);
  same(found.contacts.vertices, host.contacts.map((contact) => contact.vertex));
  same(found.contacts.forces, host.contacts.map((contact) => contact.force_n));
  const { word, touches, rows, touching, iterations, residual, energy_j, tension_n, bridge_ratio, grip_m } = host.status;
  const { status } = found;
  assert.deepEqual([status.word, status.touching, status.rows, status.pairs, status.iterations], [word, touches, rows, touching, iterations]);
  same([status.residual, status.energy, status.tension, status.span, ...status.grip], [residual, energy_j, tension_n, bridge_ratio, grip_m]);
});

test('the host\'s ticks and solves', () => {
  const [ticks, said] = [read('ticks.bin'), wanted['ticks.bin']];
  assert.deepEqual([ticks.session, ticks.rows, ticks.gap, ...ticks.tick, ...ticks.mode], [said.session, said.count, said.gap, ...said.tick, ...said.mode]);
  same([...ticks.time, ...ticks.position, ...ticks.velocity, ...ticks.force], [said.time_s, said.position_m, said.velocity_m_per_s, said.force_n]);
  same([...ticks.age, ...ticks.applied, ...ticks.faults], [said.age_us, said.applied_age_us, said.faults]);
  const [solves, host] = [read('solves.bin'), wanted['solves.bin']];
  assert.deepEqual([solves.session, solves.rows, solves.stageCount, ...solves.status], [host.session, host.count, host.stages, ...host.status]);
  same([...solves.time, ...solves.step, ...solves.stages, ...solves.energy], [host.time_s, host.step_us, host.stages_us, host.energy_j]);
  same([...solves.gapTo, ...solves.wrench, ...solves.axial, ...solves.tension], [host.gap_m, host.wrench, host.axial_n, host.tension_n]);
});
