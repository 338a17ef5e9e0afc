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

test('what nobody says is no number', () => {
  assert.equal(shown({}), '190 Hz / –');
  assert.equal(shown({ rows_hz: null }, null), '– / –');
});
