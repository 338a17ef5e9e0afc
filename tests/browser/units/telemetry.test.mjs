import assert from 'node:assert/strict';
import test from 'node:test';
import { Ring, Telemetry, csv, reduce } from '../../../host/view/page/telemetry.js';

function filled(capacity, rows, value) {
  const ring = new Ring(capacity, ['a']);
  for (let i = 0; i < rows; i += 1) ring.columns.a[ring.push(i / 1000)] = value(i);
  return ring;
}

test('a full ring loses its oldest rows', () => {
  const ring = filled(100, 250, (i) => i);
  assert.deepEqual([ring.length, ring.oldest, ring.newest], [100, 0.15, 0.249]);
  assert.equal(ring.value('a', 0.2), 200);
  assert.equal(ring.lower(0.2), 50);
  assert.equal(ring.lower(9), 100);
});

test('reduction keeps every extreme and their order', () => {
  const ring = filled(10_000, 10_000, (i) => (i === 4321 ? 50 : i === 4323 ? -70 : Math.sin(i / 300)));
  const [times, values] = reduce(ring, ['a'], 0, 10, 200);
  assert.ok(times.length <= 400);
  assert.equal(Math.max(...values), 50);
  assert.equal(Math.min(...values), -70);
  assert.ok(values.indexOf(50) < values.indexOf(-70));
  times.forEach((time, i) => assert.ok(i === 0 || time >= times[i - 1]));
});

test('few rows are all there, and a gap is nothing', () => {
  const ring = filled(100, 10, (i) => i);
  ring.gap(0.02);
  ring.columns.a[ring.push(0.021)] = 5;
  const [times, values] = reduce(ring, ['a'], 0, 1, 300);
  assert.equal(times.length, 12);
  assert.deepEqual(values.slice(-3), [9, null, 5]);
});

test('a window takes one row beyond each end, so that lines reach it', () => {
  const [times] = reduce(filled(100, 100, (i) => i), ['a'], 0.02, 0.03, 300);
  assert.deepEqual([times[0], times.at(-1)], [0.019, 0.03]);
});

test('a table has names with units, and the rows of its time', () => {
  assert.equal(csv(filled(100, 10, (i) => i), ['a'], 0.002, 0.003), 'time_s,a\n0.002000,2\n0.003000,3\n');
});

test('stages and rest add up to the step', () => {
  const telemetry = new Telemetry(['one', 'two'], 1, 0, 1, 1000);
  telemetry.addSolves({
    kind: 'solves', session: 1, gap: false, rows: 1, stageCount: 2, time: Float64Array.of(1), status: Uint8Array.of(0), step: Float32Array.of(100),
    stages: Float32Array.of(20, 30), touched: Uint32Array.of(4), gapTo: Float32Array.of(Infinity), wrench: new Float32Array(6), iterations: Uint32Array.of(1),
    energy: Float32Array.of(0.002), axial: Float32Array.of(0.5), tension: new Float32Array(0),
  });
  const { columns } = telemetry.solves;
  assert.deepEqual([columns.one_us[0], columns.two_us[0], columns.rest_us[0]], [20, 30, 50]);
  assert.deepEqual(telemetry.stack.map((name) => Number(columns[name][0].toFixed(6))), [0.02, 0.05, 0.1]);
  assert.equal(columns.needle_0_axial_n[0], 0.5);
});

test('a solve that comes again takes the place of what was there', () => {
  const telemetry = new Telemetry(['one'], 0, 0, 1, 1000);
  const block = (/** @type {number[]} */ time, /** @type {number[]} */ step) => ({
    kind: /** @type {const} */ ('solves'), session: 1, gap: false, rows: time.length, stageCount: 1, time: Float64Array.from(time), status: new Uint8Array(time.length), step: Float32Array.from(step),
    stages: Float32Array.from(step, (us) => us / 2), touched: new Uint32Array(time.length), gapTo: new Float32Array(time.length), wrench: new Float32Array(6 * time.length), iterations: new Uint32Array(time.length),
    energy: new Float32Array(time.length), axial: new Float32Array(0), tension: new Float32Array(0),
  });
  telemetry.addSolves(block([0.1, 0.2, 0.3], [0, 0, 0]));
  telemetry.addSolves(block([0.2], [80]));
  telemetry.addSolves(block([0.3, 0.4], [60, 40]));
  const { solves } = telemetry;
  assert.deepEqual([...solves.time.slice(0, solves.length)], [0.1, 0.2, 0.3, 0.4]);
  assert.deepEqual([...solves.columns.step_us.slice(0, 4)], [0, 80, 60, 40]);
  assert.deepEqual([...solves.columns.rest_us.slice(0, 4)], [0, 40, 30, 20]);
  // After a gap rows are new ones, at the same time as the gap.
  telemetry.addSolves({ ...block([0.6], [20]), gap: true });
  assert.deepEqual([...solves.columns.step_us.slice(4, 6)], [NaN, 20]);
});

test('a force that there is not has no age', () => {
  const telemetry = new Telemetry([], 0, 0, 1, 1000);
  telemetry.addTicks({
    kind: 'ticks', session: 1, gap: false, rows: 1, time: Float64Array.of(0), tick: Uint32Array.of(1), position: new Float32Array(3), velocity: new Float32Array(3),
    force: Float32Array.of(3, 0, 4), age: Uint32Array.of(4294967295), applied: Uint32Array.of(2500), mode: Uint8Array.of(2), faults: Uint16Array.of(0),
  });
  assert.ok(Number.isNaN(telemetry.ticks.columns.age_ms[0]));
  assert.deepEqual([telemetry.ticks.columns.latency_ms[0], telemetry.ticks.columns.force_n[0]], [2.5, 5]);
  const block = (/** @type {number} */ mode) => ({
    kind: /** @type {const} */ ('ticks'), session: 1, gap: false, rows: 1, time: Float64Array.of(1), tick: Uint32Array.of(2), position: new Float32Array(3), velocity: new Float32Array(3),
    force: new Float32Array(3), age: Uint32Array.of(4000), applied: Uint32Array.of(0), mode: Uint8Array.of(mode), faults: Uint16Array.of(0),
  });
  telemetry.addTicks(block(2));
  telemetry.addTicks(block(1));
  assert.deepEqual([...telemetry.ticks.columns.age_ms.slice(1, 3)], [4, NaN]);
});
