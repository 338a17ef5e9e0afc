// What the program writes, read without it: VTU files of ParaView, and recordings (MCAP without compression).

import { readFile } from 'node:fs/promises';

/** Numbers of a VTU's array. @param {string} text @param {string} name */
function numbers(text, name) {
  const found = new RegExp(`Name="${name}"[^>]*>([^<]*)<`).exec(text);
  if (!found) throw new Error(`no ${name}`);
  return found[1].trim().split(/\s+/).map(Number);
}

/**
 * Displacements of nodes [m] and, of each tetrahedron, its nodes and von Mises stress [Pa].
 * @param {string} file
 */
export async function vtu(file) {
  const text = await readFile(file, 'utf8');
  const [connectivity, offsets, types, stress] = ['connectivity', 'offsets', 'types', 'von_mises_pa'].map((name) => numbers(text, name));
  const cells = offsets.map((end, i) => ({ nodes: connectivity.slice(offsets[i - 1] ?? 0, end), type: types[i], stress: stress[i] }));
  return { displacement: numbers(text, 'displacement_m'), cells: cells.filter((cell) => cell.type === 10) };
}

/** Times and files of a series. @param {string} file */
export async function series(file) {
  const text = await readFile(file, 'utf8');
  return [...text.matchAll(/timestep="([^"]+)" file="([^"]+)"/g)].map(([, time, name]) => ({ time: Number(time), name }));
}

const [CHANNEL, MESSAGE, CHUNK] = [4, 5, 6];

/** JSON messages of a recording's topic. @param {string} file @param {string} topic */
export async function messages(file, topic) {
  const bytes = await readFile(file);
  const channels = new Map();
  const found = [];
  const records = (from, to) => {
    for (let at = from; at + 9 <= to; ) {
      const [kind, length] = [bytes[at], Number(bytes.readBigUInt64LE(at + 1))];
      const start = at + 9;
      if (kind === CHUNK) {
        const words = bytes.readUInt32LE(start + 28);
        if (words !== 0) throw new Error('a chunk is compressed');
        records(start + 40, start + length);
      } else if (kind === CHANNEL) {
        const size = bytes.readUInt32LE(start + 4);
        channels.set(bytes.readUInt16LE(start), bytes.toString('utf8', start + 8, start + 8 + size));
      } else if (kind === MESSAGE && channels.get(bytes.readUInt16LE(start)) === topic) {
        found.push(JSON.parse(bytes.toString('utf8', start + 22, start + length)));
      }
      at = start + length;
    }
  };
  records(8, bytes.length - 8);
  return found;
}
