// Plays a recording: asks the host for the picture of a time, one at a time. Entry point: `Player`.

export class Player {
  /**
   * @param {(time_s: number) => Promise<unknown>} seek
   * @param {() => void} onChange
   */
  constructor(seek, onChange) {
    this.seek = seek;
    this.onChange = onChange;
    this.playing = false;
    this.rate = 1;
    this.time = 0;
    /** @type {[number, number]} [s] */
    this.span = [0, 0];
    /** Pictures are there up to here [s]. */
    this.ready = 0;
    this.hz = 30;
    /** Repeated [s]. @type {[number, number] | null} */
    this.loop = null;
    this.asked = NaN;
    this.busy = false;
    this.before = 0;
  }

  /** @param {import('./link.js').TimeLine} line */
  start(line) {
    this.span = [line.from_s, line.to_s];
    this.ready = line.ready_s;
    this.hz = line.hz;
    this.loop = null;
    this.asked = NaN;
    this.playing = false;
    this.to(line.at_s ?? line.from_s);
  }

  /** Pictures are there up to here. @param {number} time [s] */
  setReady(time) {
    // The newest picture of then stood in for one that was not made yet.
    if (this.asked > this.ready) this.asked = NaN;
    this.ready = time;
    this.ask();
  }

  /** @param {number} time [s] */
  to(time) {
    this.time = Math.min(Math.max(time, this.span[0]), this.span[1]);
    this.ask();
    this.onChange();
  }

  /** @param {boolean} playing */
  play(playing) {
    if (playing && this.time >= this.span[1] - 1e-6) this.time = this.span[0];
    this.playing = playing;
    this.before = performance.now();
    this.onChange();
  }

  /** Asks for the same picture again, which may have another value now. */
  again() {
    this.asked = NaN;
    this.ask();
  }

  /** To be called with every frame. */
  advance() {
    if (!this.playing) return;
    const now = performance.now();
    const elapsed = (now - this.before) / 1000;
    this.before = now;
    const [begin, end] = this.loop ?? this.span;
    let time = Math.min(this.time + elapsed * this.rate, Math.max(this.ready, this.span[0]));
    if (time >= end) {
      if (this.loop) time = begin;
      else this.playing = false;
    }
    this.to(time);
  }

  /** Of pictures there are `hz` a second; more are not asked for. */
  ask() {
    if (this.busy || Math.abs(this.time - this.asked) < 1e-9) return;
    if (this.playing && Math.abs(this.time - this.asked) < 0.9 / this.hz) return;
    this.busy = true;
    this.asked = this.time;
    this.seek(this.time)
      .then(() => {
        this.busy = false;
        if (this.time !== this.asked) this.ask();
      })
      .catch(() => {
        // Not there yet: asked for again when more is ready.
        this.busy = false;
        this.asked = NaN;
      });
  }
}
