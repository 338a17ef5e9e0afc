// The address's fragment: the session's key, and how the scene is looked at, so that a figure can be made again.

/**
 * @typedef {object} View
 * @property {number[]} camera position, target [m], field of view [deg]
 * @property {string | null} scalar
 * @property {[number, number] | null} range fixed
 * @property {{axis: 'x' | 'y' | 'z', at: number, flip: boolean} | null} cut [m]
 * @property {boolean} xray
 * @property {number} opacity
 * @property {boolean} wireframe
 * @property {string} stereo
 */

/** @returns {{key: string, view: View | null}} */
export function readAddress() {
  const parameters = new URLSearchParams(location.hash.slice(1));
  const text = parameters.get('view');
  let view = null;
  try {
    view = text ? checked(JSON.parse(text)) : null;
  } catch {
    // A fragment that somebody has mistyped: the page opens as it would without.
  }
  return { key: parameters.get('key') ?? '', view };
}

/** @param {View} view */
export function address(view) {
  const parameters = new URLSearchParams(location.hash.slice(1));
  parameters.set('view', JSON.stringify(view));
  return `${location.origin}/#${parameters}`;
}

/** @param {any} view @returns {View | null} */
function checked(view) {
  const camera = view?.camera;
  const isCamera = Array.isArray(camera) && camera.length === 7 && camera.every((value) => Number.isFinite(value));
  return isCamera ? view : null;
}
