// Words at the picture when the driven tool has slipped into the tissue, with the button that takes it out. Entry point: `Slipped`.

import { element } from './words.js';

/** The solver's words for a tool that is in the tissue and touches nothing, and for one so deep that no balance is found. */
const INSIDE = 'inside';
const TOO_DEEP = 'not-converged';
/** The words go when the tool has been outside for so long [s of the session]. */
const OUTSIDE_S = 0.5;
/** Names of shapes in the words. */
const NAMES = /** @type {Record<string, string>} */ ({ sphere: 'ball', capsule: 'rod', punch: 'punch', box: 'box' });

/** Whether the driven tool is in the tissue in a picture. @param {import('./decode.js').Picture} picture @param {import('./link.js').Hello | null} hello */
export function isInside(picture, hello) {
  return hasWord(picture, hello, INSIDE);
}

/** @param {import('./decode.js').Picture} picture @param {import('./link.js').Hello | null} hello @param {string} word */
function hasWord(picture, hello, word) {
  return picture.status !== null && picture.status !== undefined && hello?.statuses[picture.status.word] === word;
}

export class Slipped {
  /** @param {() => void} takeOut */
  constructor(takeOut) {
    this.box = element('slipped');
    this.button = element('take-out');
    this.button.addEventListener('click', takeOut);
    /** @type {import('./link.js').Hello | null} */
    this.hello = null;
    /** Time of the newest picture with the tool inside [s]; `null`: it is outside. @type {number | null} */
    this.since = null;
    /** Whether the newest picture has no balance. */
    this.tooDeep = false;
    this.mode = '';
  }

  /** @param {import('./link.js').Hello} hello @param {boolean} again whether the session goes on */
  setSession(hello, again) {
    this.hello = hello;
    if (!again) {
      this.since = null;
      this.tooDeep = false;
    }
    this.button.hidden = !(hello.do.includes('take_out') && hello.role === 'control');
    this.setMode(hello.mode);
  }

  /** @param {string} mode of the console */
  setMode(mode) {
    this.mode = mode;
    this.apply();
  }

  /** Takes note of the newest picture. @param {import('./decode.js').Picture} picture */
  take(picture) {
    if (isInside(picture, this.hello)) this.since = picture.time;
    else if (this.since !== null && picture.time > this.since + OUTSIDE_S) this.since = null;
    this.tooDeep = hasWord(picture, this.hello, TOO_DEEP);
    this.apply();
  }

  apply() {
    const driven = this.hello?.tools.find((tool) => tool.driven);
    const name = NAMES[driven?.shape ?? ''] ?? 'tool';
    // Steps without a balance are a matter of moments, unless the console has let go of them.
    const gone = this.since === null && this.tooDeep && this.mode === 'idle' && driven !== undefined && driven.shape !== 'grip';
    const [strong, rest] = this.box.querySelectorAll('strong, span');
    const words = gone ? `The ${name} is pressed in so deep that no balance is found.` : `The ${name} has slipped into the tissue.`;
    // Writes changes alone: a screen reader would read the same words again.
    if (strong.textContent !== words) strong.textContent = words;
    const help = `Press less deep, or give the tool friction.${this.button.hidden ? ' Take it out, then arm.' : ''}`;
    if (rest.textContent !== help) rest.textContent = help;
    this.box.hidden = (this.since === null && !gone) || this.hello?.source !== 'live';
  }
}
