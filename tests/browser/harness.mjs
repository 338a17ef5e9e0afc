// A browser for tests of the page: opens it, notes all that goes wrong in it, keeps pictures. Entry point: `Browser`.

import { spawn } from 'node:child_process';
import path from 'node:path';
import { fileURLToPath } from 'node:url';
import { chromium } from 'playwright-core';

const PAGE = fileURLToPath(new URL('../../host/view/page/', import.meta.url));

/**
 * Software WebGL, which Chromium has only where it is asked for, in one place. The rest of the page is put together without it: through
 * it a page comes to 4 frames a second, without it to 57.
 */
const SOFTWARE = ['--no-sandbox', '--disable-gpu-compositing', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist', '--mute-audio', '--enable-precise-memory-info'];
const SIZE = { width: 1280, height: 720 };
/** For the browser to do what takes it moments on an idle machine [ms]. */
export const PATIENCE_MS = 90_000;

/** Programs that run for a test. */
const children = new Set();
process.on('exit', () => {
  for (const child of children) child.kill('SIGTERM');
});

/** Starts a program, which ends at the latest when this one does. @param {string} program @param {string[]} words @param {import('node:child_process').SpawnOptions} options */
export function started(program, words, options) {
  const child = spawn(program, words, options);
  children.add(child);
  child.on('exit', () => children.delete(child));
  return child;
}

export class Browser {
  /** @param {{executable: string, out: string, checkout?: boolean}} options `checkout`: its files of the page, not the host's */
  constructor({ executable, out, checkout = false }) {
    this.executable = executable;
    this.out = out;
    this.checkout = checkout;
  }

  async launch(more = []) {
    this.browser = await chromium.launch({ executablePath: this.executable, args: [...SOFTWARE, ...more], handleSIGINT: false, handleSIGTERM: false, handleSIGHUP: false });
  }

  async close() {
    await this.browser?.close();
  }

  /**
   * Opens an address and waits until the session is shown.
   * @param {string} url
   * @param {{scene?: boolean, viewport?: {width: number, height: number}}} options `scene`: wait for a picture
   */
  async open(url, { scene = true, viewport = SIZE } = {}) {
    const context = await this.browser.newContext({ viewport, acceptDownloads: true, permissions: ['clipboard-read', 'clipboard-write'] });
    if (this.checkout) await context.route('**/page/*', (route) => route.fulfill({ path: path.join(PAGE, path.basename(new URL(route.request().url()).pathname)) }));
    const page = await context.newPage();
    page.setDefaultTimeout(PATIENCE_MS);
    const troubles = [];
    const host = new URL(url).host;
    page.on('console', (message) => {
      // Of how this browser takes the scene's picture into the page's.
      if (!message.text().includes('GPU stall due to ReadPixels')) troubles.push(`console ${message.type()}: ${message.text()}`);
    });
    page.on('pageerror', (error) => troubles.push(`error: ${error.message}`));
    page.on('requestfailed', (request) => troubles.push(`failed: ${request.url()} ${request.failure()?.errorText}`));
    page.on('response', (response) => {
      if (response.status() >= 400) troubles.push(`${response.status()}: ${response.url()}`);
    });
    page.on('request', (request) => {
      const asked = new URL(request.url());
      if (!['blob:', 'data:'].includes(asked.protocol) && asked.host !== host) troubles.push(`another host: ${request.url()}`);
    });
    await page.goto(url);
    if (scene) await page.waitForFunction(() => window.sutura?.picture && window.sutura.stage?.drawn > 1);
    else await page.waitForFunction(() => window.sutura?.hello);
    return { page, troubles, shot: (name) => page.screenshot({ path: path.join(this.out, `${name}.png`) }), close: () => context.close() };
  }
}

/** Draws and reads the picture: colours found, and places of some of them. Runs in the page. */
export const readPixels = `(() => {
  const { stage } = window.sutura;
  stage.render();
  const gl = stage.renderer.getContext();
  const [width, height] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
  const bytes = new Uint8Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
  return { width, height, bytes };
})()`;

/** How many colours the picture has, and how much of it is not background. */
export async function variety(page) {
  return page.evaluate(`(() => {
    const { bytes, width, height } = ${readPixels};
    const seen = new Map();
    for (let i = 0; i < bytes.length; i += 4) {
      const colour = (bytes[i] << 16) | (bytes[i + 1] << 8) | bytes[i + 2];
      seen.set(colour, (seen.get(colour) ?? 0) + 1);
    }
    return { colours: seen.size, background: Math.max(...seen.values()) / (width * height) };
  })()`);
}

/** Hides all but the tissue. */
export function alone(page) {
  return page.evaluate(() => {
    const { sutura } = window;
    for (const name of ['outline', 'tools', 'contacts', 'wrench']) sutura.view.setLook(name, false);
    sutura.show(sutura.picture);
  });
}

export async function until(page, condition, argument) {
  await page.waitForFunction(condition, argument, { timeout: PATIENCE_MS, polling: 50 }).catch((error) => {
    throw new Error(`${error.message} Waited for ${condition}`);
  });
}

export function check(condition, message) {
  if (!condition) throw new Error(message);
}

export function near(value, wanted, within, what) {
  check(Math.abs(value - wanted) <= within, `${what}: ${value}, not within ${within} of ${wanted}`);
}
