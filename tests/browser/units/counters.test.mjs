import assert from 'node:assert/strict';
import test from 'node:test';
import { counters } from '../../../host/view/page/counters.js';

const GAUGES = { withheld: {}, frames: {}, pictures: {}, rows_hz: 189.7, energy_min_j: null };
const NAME = 'Frames of rows, sent / board takes';

/** @param {object} gauges @param {number | null} [boardRowsHz] */
function shown(gauges, boardRowsHz) {
  return new Map(counters({ ...GAUGES, ...gauges }, undefined, [], boardRowsHz)).get(NAME);
}

test('rows are shown beside what the board takes', () => {
  assert.equal(shown({}, 200), '190 Hz / 200 Hz');
  assert.equal(shown({ rows_hz: 0 }, 200), '0 Hz / 200 Hz');
});

test('ticks that the device has cut are shown by their limit', () => {
  const rows = (/** @type {object} */ gauges) => counters({ ...GAUGES, ...gauges }, undefined, [], null).filter(([name]) => name.startsWith('Ticks cut'));
  assert.deepEqual(rows({ ticks_limited: { force: 1200, power: 0, slew: 3 } }), [
    ["Ticks cut by the device's largest force", '1,200'],
    ["Ticks cut by the device's slew", '3'],
  ]);
  assert.deepEqual(rows({ ticks_limited: { force: 0 } }), []);
  assert.deepEqual(rows({ ticks_limited: null }), []);
  assert.deepEqual(rows({}), []);
});

test('what nobody says is no number', () => {
  assert.equal(shown({}), '190 Hz / –');
  assert.equal(shown({ rows_hz: null }, null), '– / –');
});
