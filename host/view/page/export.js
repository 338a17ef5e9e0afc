// Files from the page: pictures with what is written over them, films, tables. Entry points: `picture`, `Film`, `save`.

/** @param {Blob} blob @param {string} name */
export function save(blob, name) {
  const link = document.createElement('a');
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** A name that sorts by time. @param {string} scene @param {number | null} time [s] @param {string} ending */
export function fileName(scene, time, ending) {
  const plain = scene.toLowerCase().replace(/[^a-z0-9]+/g, '-').replace(/^-|-$/g, '') || 'sutura';
  return `${plain}${time === null ? '' : `-${time.toFixed(3)}s`}.${ending}`;
}

/**
 * The scene at `factor` times the size on the screen, with all that is written over it.
 * @param {import('./stage.js').Stage} stage
 * @param {(context: CanvasRenderingContext2D, size: {width: number, height: number}) => void} overlay
 * @param {number} factor
 */
export function picture(stage, overlay, factor) {
  const { width, height } = stage.size;
  const { renderer, resolution } = stage;
  const ratio = renderer.getPixelRatio();
  renderer.setPixelRatio(1);
  renderer.setSize(width * factor, height * factor, false);
  stage.stereo.resize(width * factor, height * factor);
  stage.resolution = factor;
  stage.render();
  const canvas = document.createElement('canvas');
  compose(canvas, renderer.domElement, overlay, { width, height }, factor);
  renderer.setPixelRatio(ratio);
  stage.resolution = resolution;
  stage.resize();
  stage.render();
  return canvas;
}

/**
 * @param {HTMLCanvasElement} canvas
 * @param {HTMLCanvasElement} scene
 * @param {(context: CanvasRenderingContext2D, size: {width: number, height: number}) => void} overlay
 * @param {{width: number, height: number}} size
 * @param {number} factor
 */
function compose(canvas, scene, overlay, size, factor) {
  canvas.width = Math.round(size.width * factor);
  canvas.height = Math.round(size.height * factor);
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext('2d'));
  context.drawImage(scene, 0, 0, canvas.width, canvas.height);
  context.scale(factor, factor);
  overlay(context, size);
}

/** Films what is drawn. */
export class Film {
  /**
   * @param {import('./stage.js').Stage} stage
   * @param {(context: CanvasRenderingContext2D, size: {width: number, height: number}) => void} overlay
   */
  constructor(stage, overlay) {
    this.stage = stage;
    this.overlay = overlay;
    /** @type {MediaRecorder | null} */
    this.recorder = null;
    /** @type {Blob[]} */
    this.parts = [];
    this.canvas = document.createElement('canvas');
    this.add = () => compose(this.canvas, stage.renderer.domElement, overlay, stage.size, 1);
  }

  get running() {
    return this.recorder !== null;
  }

  start() {
    this.stage.render();
    this.add();
    this.stage.addEventListener('drawn', this.add);
    const kinds = ['video/webm;codecs=vp9', 'video/webm;codecs=vp8', 'video/webm', 'video/mp4'];
    const mimeType = kinds.find((kind) => MediaRecorder.isTypeSupported(kind));
    this.parts = [];
    this.recorder = new MediaRecorder(this.canvas.captureStream(30), { mimeType, videoBitsPerSecond: 8e6 });
    this.recorder.addEventListener('dataavailable', (event) => this.parts.push(event.data));
    this.recorder.start(500);
    return this.recorder.mimeType;
  }

  /** @returns {Promise<Blob>} */
  stop() {
    const { recorder } = this;
    this.stage.removeEventListener('drawn', this.add);
    this.recorder = null;
    return new Promise((resolve, reject) => {
      if (!recorder) {
        reject(new Error('no film is being made'));
        return;
      }
      recorder.addEventListener('stop', () => resolve(new Blob(this.parts, { type: recorder.mimeType.split(';')[0] })));
      recorder.stop();
    });
  }
}
