// What is written over the picture: legend, scale bar, axes, scales of arrows, time. Drawn on a canvas, so that exported
// pictures have it too. Entry point: `drawOverlay`.

import * as THREE from 'three';
import { colourAt } from './colours.js';
import { fixed, round125, scaleFor, short } from './units.js';

const TEXT = '#dfe6ee';
const DIM = '#a4afbc';
const FONT = '12px system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif';
const AXES = /** @type {[string, string, THREE.Vector3][]} */ ([
  ['x', '#ff7b72', new THREE.Vector3(1, 0, 0)],
  ['y', '#7ee787', new THREE.Vector3(0, 1, 0)],
  ['z', '#79c0ff', new THREE.Vector3(0, 0, 1)],
]);

/**
 * @typedef {object} Overlay
 * @property {string} title
 * @property {number | null} time [s]
 * @property {{name: string, unit: string, signed: boolean, range: [number, number], at: number | null} | null} legend
 * @property {{contact: number, wrench: number}} scales [m/N], 0: not shown
 * @property {number} pixelsPerMetre
 * @property {THREE.Quaternion} camera
 * @property {string} note of the stereo mode
 * @property {boolean} narrow half of the page: what would not fit is left out
 */

/**
 * @param {CanvasRenderingContext2D} context
 * @param {{width: number, height: number}} size [CSS px]
 * @param {Overlay} what
 */
export function drawOverlay(context, size, what) {
  context.font = FONT;
  context.textBaseline = 'alphabetic';
  context.lineWidth = 1;
  shadow(context, true);
  axes(context, { x: 46, y: size.height - 50 }, what.camera);
  scaleBar(context, { x: 100, y: size.height - 22 }, what.pixelsPerMetre, size.width);
  caption(context, size, what);
  if (what.legend) legend(context, size, what.legend);
  shadow(context, false);
}

/** Keeps text readable over bright tissue. @param {CanvasRenderingContext2D} context @param {boolean} on */
function shadow(context, on) {
  context.shadowColor = on ? 'rgba(8, 10, 13, 0.9)' : 'transparent';
  context.shadowBlur = on ? 4 : 0;
}

/** @param {CanvasRenderingContext2D} context @param {{x: number, y: number}} centre @param {THREE.Quaternion} camera */
function axes(context, centre, camera) {
  const inverse = camera.clone().invert();
  const seen = AXES.map(([name, colour, direction]) => ({ name, colour, to: direction.clone().applyQuaternion(inverse) }));
  seen.sort((a, b) => a.to.z - b.to.z);
  context.textAlign = 'center';
  for (const { name, colour, to } of seen) {
    const [x, y] = [centre.x + 26 * to.x, centre.y - 26 * to.y];
    context.strokeStyle = context.fillStyle = colour;
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(centre.x, centre.y);
    context.lineTo(x, y);
    context.stroke();
    context.fillText(name, centre.x + 36 * to.x, centre.y - 36 * to.y + 4);
  }
  context.lineWidth = 1;
}

/** @param {CanvasRenderingContext2D} context @param {{x: number, y: number}} at @param {number} pixelsPerMetre @param {number} width */
function scaleBar(context, at, pixelsPerMetre, width) {
  const length = round125(Math.min(120, 0.2 * width) / pixelsPerMetre);
  const pixels = length * pixelsPerMetre;
  context.strokeStyle = context.fillStyle = TEXT;
  context.lineWidth = 2;
  context.beginPath();
  context.moveTo(at.x, at.y - 4);
  context.lineTo(at.x, at.y);
  context.lineTo(at.x + pixels, at.y);
  context.lineTo(at.x + pixels, at.y - 4);
  context.stroke();
  context.lineWidth = 1;
  context.textAlign = 'left';
  context.fillText(`${short(length * 1000)} mm`, at.x + pixels + 8, at.y + 2);
}

/** @param {CanvasRenderingContext2D} context @param {{width: number, height: number}} size @param {Overlay} what */
function caption(context, size, what) {
  context.textAlign = 'right';
  context.fillStyle = TEXT;
  const time = what.time === null ? '' : `  ${fixed(what.time, 2)} s`;
  context.fillText(`${what.title}${time}`, size.width - 14, size.height - 20);
  if (what.narrow) return;
  const lines = [];
  if (what.scales.wrench > 0) lines.push(['#6fe3a5', `force on the tool: ${short(what.scales.wrench * 1000)} mm per N`]);
  if (what.scales.contact > 0) lines.push(['#f7e26b', `contact on tissue: ${short(what.scales.contact * 1000)} mm per N`]);
  if (what.note) lines.push([DIM, what.note]);
  lines.forEach(([colour, line], i) => {
    const y = size.height - 38 - 17 * i;
    context.fillStyle = DIM;
    context.fillText(line, size.width - 14, y);
    context.fillStyle = colour;
    context.fillRect(size.width - 14 - context.measureText(line).width - 16, y - 8, 10, 8);
  });
}

/** @param {CanvasRenderingContext2D} context @param {{width: number, height: number}} size @param {NonNullable<Overlay['legend']>} legend */
function legend(context, size, { name, unit, signed, range, at }) {
  const [low, high] = range;
  const scaled = scaleFor(Math.max(Math.abs(low), Math.abs(high)), unit);
  const height = Math.min(220, size.height - 150);
  const box = { x: size.width - 86, y: 62, width: 14, height };
  context.textAlign = 'right';
  context.fillStyle = TEXT;
  context.fillText(`${name} [${scaled.unit}]`, size.width - 14, box.y - 14);
  shadow(context, false);
  for (let row = 0; row < box.height; row += 1) {
    const [r, g, b] = colourAt(signed, 1 - row / (box.height - 1));
    context.fillStyle = `rgb(${r}, ${g}, ${b})`;
    context.fillRect(box.x, box.y + row, box.width, 1);
  }
  context.strokeStyle = 'rgba(223, 230, 238, 0.5)';
  context.strokeRect(box.x - 0.5, box.y - 0.5, box.width + 1, box.height + 1);
  shadow(context, true);
  context.textAlign = 'left';
  for (let i = 0; i <= 4; i += 1) {
    const y = box.y + (box.height * i) / 4;
    context.fillStyle = TEXT;
    context.fillRect(box.x + box.width, y - 0.5, 4, 1);
    context.fillText(short((high + ((low - high) * i) / 4) / scaled.factor), box.x + box.width + 8, y + 4);
  }
  if (at === null || !Number.isFinite(at)) return;
  const y = box.y + box.height * (1 - Math.min(Math.max((at - low) / (high - low), 0), 1));
  context.fillStyle = TEXT;
  context.beginPath();
  context.moveTo(box.x - 2, y);
  context.lineTo(box.x - 9, y - 5);
  context.lineTo(box.x - 9, y + 5);
  context.fill();
  context.textAlign = 'right';
  context.fillText(short(at / scaled.factor), box.x - 13, y + 4);
}
