// What people take away: pictures, films, tables, plots and links. Entry point: `Saving`.

import { address } from './address.js';
import { Film, fileName, picture as exported, save } from './export.js';
import { csv } from './telemetry.js';
import { toast } from './words.js';

/** @typedef {'png' | 'png2' | 'film' | 'link' | 'csv' | 'csv-all' | 'plots'} Saved */

/**
 * @typedef {object} Shown what there is to save just now
 * @property {string} scene
 * @property {number | null} time [s]
 * @property {import('./telemetry.js').Telemetry | null} telemetry
 */

export class Saving {
  /**
   * @param {() => Shown} shown
   * @param {import('./plots.js').Plots} plots
   * @param {import('./panel.js').Panel} panel
   */
  constructor(shown, plots, panel) {
    this.shown = shown;
    this.plots = plots;
    this.panel = panel;
    /** None without WebGL. @type {import('./view.js').View | null} */
    this.view = null;
    /** @type {Film | null} */
    this.film = null;
    this.overlay = (/** @type {CanvasRenderingContext2D} */ context, /** @type {{width: number, height: number}} */ size) => this.view?.overlay(context, size);
  }

  /** @param {import('./view.js').View} view */
  setView(view) {
    this.view = view;
    this.film = new Film(view.stage, this.overlay);
  }

  /** @param {string} ending */
  name(ending) {
    const { scene, time } = this.shown();
    return fileName(scene, time, ending);
  }

  /** @param {Saved} what */
  async save(what) {
    if (what === 'csv' || what === 'csv-all') {
      this.saveTables(what === 'csv-all');
    } else if (what === 'plots') {
      save(await png(this.plots.canvas()), this.name('plots.png'));
    } else if (!this.view || !this.film) {
      throw new Error('there is no picture');
    } else if (what === 'link') {
      await navigator.clipboard.writeText(address(this.view.now));
      toast('Link copied: whoever has it and reaches this host can control the session');
    } else if (what === 'film') {
      await this.toggleFilm(this.film);
    } else {
      save(await png(exported(this.view.stage, this.overlay, what === 'png2' ? 2 : 1)), this.name('png'));
    }
  }

  /** @param {boolean} all what the page has, not what is plotted; solves, too */
  saveTables(all) {
    const { telemetry } = this.shown();
    if (!telemetry) throw new Error('nothing has come yet');
    const text = (/** @type {string} */ content) => new Blob([content], { type: 'text/csv' });
    const { ticks, solves } = telemetry;
    const [from, to] = all ? [-Infinity, Infinity] : this.plots.range();
    save(text(csv(ticks, Object.keys(ticks.columns), from, to)), this.name('ticks.csv'));
    if (all) save(text(csv(solves, telemetry.solveNames, from, to)), this.name('solves.csv'));
  }

  /** @param {Film} film */
  async toggleFilm(film) {
    const button = this.panel.film;
    if (film.running) {
      const blob = await film.stop();
      save(blob, this.name(blob.type.includes('mp4') ? 'mp4' : 'webm'));
    } else {
      film.start();
    }
    if (button) button.textContent = film.running ? 'Stop and save' : 'Record film';
    button?.setAttribute('aria-pressed', String(film.running));
  }
}

/** @param {HTMLCanvasElement} canvas @returns {Promise<Blob>} */
function png(canvas) {
  return new Promise((resolve, reject) => {
    canvas.toBlob((blob) => (blob ? resolve(blob) : reject(new Error('the picture is too large for this browser'))), 'image/png');
  });
}
