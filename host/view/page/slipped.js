// Words at the picture when the driven tool has slipped into the tissue, with the button that takes it out. Entry point: `Slipped`.

import { element } from './words.js';

/** The solver's word for a tool that is in the tissue and touches nothing. */
const INSIDE = 'inside';
/** The words go when the tool has been outside for so long [s of the session]. */
const OUTSIDE_S = 0.5;
/** Names of shapes in the words. */
const NAMES = /** @type {Record<string, string>} */ ({ sphere: 'ball', capsule: 'rod', punch: 'punch', box: 'box' });

/** Whether the driven tool is in the tissue in a picture. @param {import('./decode.js').Picture} picture @param {import('./link.js').Hello | null} hello */
export function isInside(picture, hello) {
  return picture.status !== null && picture.status !== undefined && hello?.statuses[picture.status.word] === INSIDE;
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
  }

  /** @param {import('./link.js').Hello} hello @param {boolean} again whether the session goes on */
  setSession(hello, again) {
    this.hello = hello;
    if (!again) this.since = null;
    const name = NAMES[hello.tools.find((tool) => tool.driven)?.shape ?? ''] ?? 'tool';
    const can = hello.do.includes('take_out') && hello.role === 'control';
    const [strong, rest] = this.box.querySelectorAll('strong, span');
    strong.textContent = `The ${name} has slipped into the tissue.`;
    rest.textContent = `Press less deep, or give the tool friction.${can ? '' : ' Take it out, then arm.'}`;
    this.button.hidden = !can;
    this.apply();
  }

  /** Takes note of the newest picture. @param {import('./decode.js').Picture} picture */
  take(picture) {
    if (isInside(picture, this.hello)) this.since = picture.time;
    else if (this.since !== null && picture.time > this.since + OUTSIDE_S) this.since = null;
    this.apply();
  }

  apply() {
    this.box.hidden = this.since === null || this.hello?.source !== 'live';
  }
}
