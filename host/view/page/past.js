// The pictures of the last while, so that one can look back while the session goes on. Entry point: `Past`.

/** Kept at most. */
const SECONDS = 30;
const BYTES = 64e6;

export class Past {
  constructor() {
    /** @type {{picture: import('./decode.js').Picture, bytes: number}[]} */
    this.list = [];
    this.bytes = 0;
  }

  clear() {
    this.list = [];
    this.bytes = 0;
  }

  /** @param {import('./decode.js').Picture} picture */
  add(picture) {
    const last = this.list[this.list.length - 1];
    if (last && picture.time <= last.picture.time) return;
    const bytes = picture.displacement ? picture.displacement.buffer.byteLength : 0;
    this.list.push({ picture, bytes });
    this.bytes += bytes;
    while (this.list.length > 2 && (this.bytes > BYTES || picture.time - this.list[0].picture.time > SECONDS)) {
      this.bytes -= this.list[0].bytes;
      this.list.shift();
    }
  }

  /** @returns {[number, number]} times of the oldest and the newest [s] */
  get span() {
    if (this.list.length === 0) return [0, 0];
    return [this.list[0].picture.time, this.list[this.list.length - 1].picture.time];
  }

  /** The picture at or before `time`. @param {number} time [s] */
  at(time) {
    let found = this.list[0];
    for (const one of this.list) {
      if (one.picture.time > time) break;
      found = one;
    }
    return found?.picture ?? null;
  }
}
