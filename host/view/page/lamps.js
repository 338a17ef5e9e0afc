// What lights wet tissue: a dark room with two rings of lamps, one above and a dim one below, and a head lamp. Once as lamps of a scene that is filtered to
// an environment, once as a light probe of nine coefficients, which costs nothing to draw with.

import * as THREE from 'three';

/** Lamps in a ring. */
const RING = 6;
/** Height of the rings over their radius, half width of a lamp over its distance, and its radiance. */
const RINGS = [
  { height: 0.75, size: 0.2, radiance: 11 },
  { height: -0.5, size: 0.14, radiance: 5 },
];

/**
 * Direction, half width over distance, and radiance of each lamp; z is up.
 * @returns {{direction: THREE.Vector3, size: number, radiance: number}[]}
 */
function lamps() {
  const rings = RINGS.flatMap(({ height, size, radiance }) =>
    Array.from({ length: RING }, (_, i) => {
      const angle = (2 * Math.PI * (i + 0.5)) / RING;
      return { direction: new THREE.Vector3(Math.cos(angle), Math.sin(angle), height).normalize(), size, radiance };
    }),
  );
  return [...rings, { direction: new THREE.Vector3(0.05, -0.1, 1).normalize(), size: 0.28, radiance: 12 }];
}

/** Radiance of walls and floor, of the lower and the upper half. */
const WALLS = [0.1, 0.24];

/** The room's reflections, filtered. It takes a graphics card milliseconds, and software many seconds. @param {THREE.WebGLRenderer} renderer */
export function environment(renderer) {
  const room = new THREE.Scene();
  const wall = (/** @type {number} */ radiance, /** @type {number} */ from) =>
    new THREE.Mesh(
      new THREE.SphereGeometry(10, 32, 16, 0, 2 * Math.PI, from, Math.PI / 2),
      new THREE.MeshBasicMaterial({ side: THREE.BackSide, color: new THREE.Color(radiance, radiance, radiance * 1.05) }),
    );
  // The renderer looks at environments with y up; they are turned into the scene's frame by `environmentRotation`.
  room.add(wall(WALLS[1], 0), wall(WALLS[0], Math.PI / 2));
  for (const { direction, size, radiance } of lamps()) {
    const lamp = new THREE.Mesh(
      new THREE.CircleGeometry(5 * size, 24),
      new THREE.MeshBasicMaterial({ color: new THREE.Color(radiance, radiance, radiance * 0.97) }),
    );
    lamp.position.set(direction.x, direction.z, -direction.y).multiplyScalar(5);
    lamp.lookAt(0, 0, 0);
    room.add(lamp);
  }
  const generator = new THREE.PMREMGenerator(renderer);
  const target = generator.fromScene(room, 0.02);
  generator.dispose();
  room.traverse((object) => {
    if (!(object instanceof THREE.Mesh)) return;
    object.geometry.dispose();
    object.material.dispose();
  });
  return target;
}

/** The same room as a light probe. */
export function probe() {
  const light = new THREE.LightProbe();
  const [low, high] = WALLS;
  const basis = new Array(9).fill(0);
  const add = (/** @type {THREE.Vector3} */ direction, /** @type {number} */ flux) => {
    THREE.SphericalHarmonics3.getBasisAt(direction, basis);
    light.sh.coefficients.forEach((coefficient, i) => coefficient.addScalar(basis[i] * flux));
  };
  for (const { direction, size, radiance } of lamps()) add(direction, radiance * Math.PI * size * size);
  // The walls, by 200 even directions.
  const count = 200;
  for (let i = 0; i < count; i += 1) {
    const z = 1 - (2 * i + 1) / count;
    const angle = Math.PI * (1 + Math.sqrt(5)) * i;
    const across = Math.sqrt(1 - z * z);
    add(new THREE.Vector3(across * Math.cos(angle), across * Math.sin(angle), z), ((z > 0 ? high : low) * 4 * Math.PI) / count);
  }
  return light;
}
