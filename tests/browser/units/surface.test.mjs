import assert from 'node:assert/strict';
import test from 'node:test';
import { displace, shade, split } from '../../../host/view/page/surface.js';

/** Two squares that meet along the y axis, folded by `angle`. */
function folded(angle, regions = [0, 0, 0, 0]) {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const positions = Float32Array.from([-1, 0, 0, 0, 0, 0, 0, 1, 0, -1, 1, 0, c, 0, s, c, 1, s]);
  const triangles = Uint32Array.from([0, 1, 2, 0, 2, 3, 1, 4, 5, 1, 5, 2]);
  return split(positions, triangles, Int32Array.from(regions));
}

test('a gentle fold is smooth, a sharp one is split along its edge', () => {
  assert.equal(folded(0.6).source.length, 6);
  assert.equal(folded(0.6).creases.length, 0);
  const sharp = folded(1);
  assert.equal(sharp.source.length, 8);
  assert.deepEqual([...sharp.creases].map((vertex) => sharp.source[vertex]).sort(), [1, 2]);
});

test('regions do not share vertices', () => {
  const surface = folded(0, [0, 0, 1, 1]);
  assert.equal(surface.source.length, 8);
  surface.index.forEach((vertex, corner) => assert.equal(surface.region[vertex], corner < 6 ? 0 : 1));
});

test('faces stay where they were', () => {
  const triangles = [0, 1, 2, 0, 2, 3, 1, 4, 5, 1, 5, 2];
  for (const angle of [0, 0.6, 1, 2]) {
    const { index, source } = folded(angle);
    assert.deepEqual([...index].map((vertex) => source[vertex]), triangles);
  }
});

test('normals of a sharp fold are its faces\', of a smooth one between them', () => {
  for (const [angle, wanted] of [[1, 0], [0.6, 0.3]]) {
    const { index, source } = folded(angle);
    const unloaded = Float32Array.from([-1, 0, 0, 0, 0, 0, 0, 1, 0, -1, 1, 0, Math.cos(angle), 0, Math.sin(angle), Math.cos(angle), 1, Math.sin(angle)]);
    const positions = new Float32Array(3 * source.length);
    displace(unloaded, null, 0, source, positions);
    const normals = new Float32Array(positions.length);
    shade(positions, index, normals);
    const vertex = index[1];
    assert.ok(Math.abs(Math.atan2(-normals[3 * vertex], normals[3 * vertex + 2]) - wanted) < 0.17, `fold ${angle}`);
  }
});

test('displacements are scaled', () => {
  const into = new Float32Array(3);
  displace(Float32Array.from([1, 2, 3]), Int16Array.from([32767, -32767, 0]), 0.5, Uint32Array.from([0]), into);
  assert.deepEqual([...into], [1.5, 1.5, 3]);
});
