import assert from 'node:assert/strict';
import test from 'node:test';
import { Range, colourAt, colourTable } from '../../../host/view/page/colours.js';
import { round125, scaleFor, short } from '../../../host/view/page/units.js';

test('ends of the maps, and white at zero', () => {
  assert.deepEqual(colourAt(false, 0), [68, 1, 84]);
  assert.deepEqual(colourAt(false, 2), [253, 231, 37]);
  assert.deepEqual(colourAt(true, 0.5), [247, 247, 247]);
  assert.deepEqual([...colourTable(true).slice(-4)], [103, 0, 31, 255]);
});

test('lightness of viridis grows all the way', () => {
  let before = -1;
  for (let i = 0; i <= 100; i += 1) {
    const [r, g, b] = colourAt(false, i / 100);
    const light = 0.2126 * r + 0.7152 * g + 0.0722 * b;
    assert.ok(light > before, `at ${i}`);
    before = light;
  }
});

test('a held range grows and does not shrink; one outlier in a hundred does not count', () => {
  const range = new Range();
  range.restart(true);
  range.see(Float32Array.from({ length: 100 }, (_, i) => (i === 99 ? 1000 : -1)));
  assert.deepEqual(range.ends, [-1, 1]);
  range.see(new Float32Array(100).fill(0.5));
  assert.deepEqual(range.ends, [-1, 1]);
  range.fixed = [2, 3];
  assert.deepEqual(range.ends, [2, 3]);
});

test('numbers as people read them', () => {
  assert.deepEqual([short(1234), short(1.234), short(0.01234), short(-20), short(0)], ['1234', '1.23', '0.0123', '−20.0', '0']);
  assert.deepEqual([round125(0.034), round125(7), round125(1000)].map((value) => Number(value.toPrecision(3))), [0.02, 5, 1000]);
  assert.deepEqual(scaleFor(5340, 'Pa'), { factor: 1000, unit: 'kPa' });
  assert.deepEqual(scaleFor(0.004, 'm'), { factor: 0.001, unit: 'mm' });
});
