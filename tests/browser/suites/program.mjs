// The page of the program itself: `sutura view` of shipped scenes and of a recording.

import { spawn, spawnSync } from 'node:child_process';
import { mkdtemp, rm } from 'node:fs/promises';
import os from 'node:os';
import path from 'node:path';
import { fileURLToPath } from 'node:url';
import { alone, check, near, until, variety } from '../harness.mjs';

const ROOT = fileURLToPath(new URL('../../../', import.meta.url));
/** For a scene to be built and its page to be served [ms]. */
const STARTS_MS = 60_000;

/** Runs `sutura view`, and gives its address. */
async function view(sutura, words) {
  const child = spawn(path.resolve(sutura), ['view', ...words], { cwd: ROOT, stdio: ['ignore', 'pipe', 'pipe'] });
  let said = '';
  const url = await new Promise((resolve, reject) => {
    const timer = setTimeout(() => reject(new Error(`no address after ${STARTS_MS} ms: ${said}`)), STARTS_MS);
    child.stderr.on('data', (bytes) => {
      said += bytes;
      const found = /http:\/\/\S+#key=\S+/.exec(said);
      if (!found) return;
      clearTimeout(timer);
      resolve(found[0]);
    });
    child.on('exit', (code) => reject(new Error(`sutura view ended with ${code}: ${said}`)));
  });
  return {
    url,
    /** As Ctrl-C does; how it ended. */
    end: () => new Promise((resolve) => {
      child.removeAllListeners('exit');
      child.on('exit', (code) => resolve(code));
      child.kill('SIGINT');
    }),
  };
}

function withProgram(words, run) {
  return async (context) => {
    const program = await view(context.sutura, words);
    let opened;
    try {
      opened = await context.browser.open(program.url);
      return await run({ ...context, program, ...opened });
    } finally {
      await opened?.close();
      await program.end();
    }
  };
}

/** For the book: the session stands still, and is drawn as a graphics card does. */
async function posed({ page, book, shot }, name, live = true) {
  if (book) {
    if (live) await page.evaluate(() => window.sutura.ask({ do: 'pause' }));
    await page.setViewportSize({ width: 1200, height: 675 });
    await page.evaluate(() => {
      const { stage } = window.sutura;
      stage.adapt = () => {};
      stage.choose('full', 'as with a graphics card');
      document.getElementById('toasts').replaceChildren();
    });
    await until(page, () => window.sutura.stage.drawn > 0);
    await page.evaluate(() => window.sutura.plots.redraw(true));
    await page.waitForTimeout(1000);
  }
  await shot(`program-${name}`);
  if (book && live) await page.evaluate(() => window.sutura.ask({ do: 'resume' }));
}

const force = (page) => page.evaluate(() => window.sutura.telemetry.ticks.value('force_n', 1e9));

export const tests = [
  ['program: palpation', withProgram(['scenes/palpation.toml'], async ({ page, troubles, shot, book }) => {
    // The deepest of three presses, which is held for a second.
    await until(page, () => window.sutura.telemetry.ticks.value('force_n', 1e9) > 2.5 && window.sutura.picture.contacts.vertices.length > 4);
    await posed({ page, book, shot }, 'palpation');
    const first = await page.evaluate(() => window.sutura.telemetry.ticks.newest);
    await until(page, (first) => window.sutura.plots.newest > first + 0.5, first);
    const { plotted, newest, status } = await page.evaluate(() => ({ plotted: window.sutura.plots.newest, newest: window.sutura.telemetry.ticks.newest, status: window.sutura.hello.statuses[window.sutura.picture.status.word] }));
    near(plotted, newest, 0.5, 'newest time that is plotted [s]');
    check(status === 'ok', `the solver says ${status}`);
    const { colours, background } = await variety(page);
    check(colours > 8 && background < 0.9, `a uniform picture: ${colours} colours`);
    await alone(page);
    const triangles = await page.evaluate(() => {
      window.sutura.stage.render();
      return [window.sutura.stage.renderer.info.render.triangles, window.sutura.tissue.geometry.triangles.length / 3];
    });
    check(triangles[0] === triangles[1] && triangles[0] > 500, `triangles drawn and of the geometry: ${triangles}`);
    check(troubles.length === 0, troubles.join('\n'));
  })],

  ['program: colours', withProgram(['scenes/palpation.toml'], async ({ page, shot, book }) => {
    await page.evaluate(() => window.sutura.setScalar('von-mises'));
    await until(page, () => window.sutura.tissue.coloured && window.sutura.telemetry.ticks.value('force_n', 1e9) > 2.5);
    await posed({ page, book, shot }, 'stress');
    const { high, low } = await page.evaluate(() => ({ high: window.sutura.range.ends[1], low: window.sutura.range.ends[0] }));
    check(low === 0 && high > 100 && high < 1e5, `von Mises from ${low} to ${high} Pa`);
    await page.evaluate(() => window.sutura.setScalar('displacement'));
    await until(page, () => window.sutura.hello.scalars[window.sutura.picture.scalar - 1]?.name === 'displacement');
    const worst = await page.evaluate(() => {
      const { picture, values, tissue } = window.sutura;
      const metres = picture.displacementScale / 32767;
      let most = 0;
      for (let i = 0; i < values.length; i += 1) most = Math.max(most, Math.abs(values[i] - metres * Math.hypot(...picture.displacement.slice(3 * i, 3 * i + 3))));
      return [most / (picture.scalarHigh - picture.scalarLow || 1), tissue.geometry.positions.length / 3 === values.length];
    });
    check(worst[0] < 0.001 && worst[1], `values and displacements differ by ${worst[0]} of the range`);
  })],

  ['program: drag', withProgram(['scenes/palpation.toml'], async ({ page, shot }) => {
    await until(page, () => window.sutura.grip() !== null && document.getElementById('mode').textContent === 'armed');
    // Let go, the hand goes back to where it was taken: in the air, where the scene's hand begins. Slowly, so that it is
    // still there when it is told to stay.
    const ask = (command) => page.evaluate((command) => window.sutura.ask(command), command);
    await ask({ do: 'speed', factor: 0.2 });
    await ask({ do: 'hand', way: 'scene' });
    await until(page, () => window.sutura.newest.status.grip[2] > 0.0295);
    await ask({ do: 'hand', way: 'none' });
    await ask({ do: 'speed', factor: 1 });
    await page.waitForTimeout(500);
    check((await force(page)) < 0.01, `in the air: ${await force(page)} N`);
    const place = await page.evaluate(() => {
      const { stage, picture } = window.sutura;
      const at = stage.centre.clone().fromArray(picture.tools.find((tool) => tool.driven).position).project(stage.camera);
      const box = stage.element.getBoundingClientRect();
      return { x: box.left + (box.width * (at.x + 1)) / 2, y: box.top + (box.height * (1 - at.y)) / 2, metre: stage.pixelsPerMetre };
    });
    await page.mouse.move(place.x, place.y);
    await page.mouse.down();
    await page.mouse.move(place.x, place.y + 0.028 * place.metre, { steps: 12 });
    await until(page, () => window.sutura.telemetry.ticks.value('force_n', 1e9) > 0.3);
    await page.waitForTimeout(1500);
    const pressed = await force(page);
    await shot('program-drag');
    await page.mouse.up();
    await until(page, () => window.sutura.telemetry.ticks.value('force_n', 1e9) < 0.05);
    await page.waitForTimeout(1000);
    check((await force(page)) < 0.05, `let go: ${await force(page)} N`);
    return `pressed ${pressed.toFixed(2)} N, let go ${(await force(page)).toFixed(3)} N`;
  })],

  ['program: safe stop and arm', withProgram(['scenes/palpation.toml'], async ({ page }) => {
    const mode = (wanted) => until(page, (wanted) => document.getElementById('mode').textContent === wanted, wanted);
    await mode('armed');
    await page.keyboard.press('Escape');
    await mode('idle');
    await page.locator('#arm').click();
    await mode('armed');
    await page.locator('#play').click();
    await until(page, () => document.getElementById('play').textContent === 'Resume');
    const stands = await page.evaluate(() => window.sutura.telemetry.ticks.newest);
    await page.waitForTimeout(700);
    check((await page.evaluate(() => window.sutura.telemetry.ticks.newest)) === stands, 'paused, time stands still');
    await page.getByText('+ solve').click();
    await until(page, (stands) => window.sutura.telemetry.ticks.newest > stands, stands);
  })],

  ['program: another scene', withProgram(['scenes/palpation.toml'], async ({ page, shot, book }) => {
    const before = await page.evaluate(() => [window.sutura.session, window.sutura.tissue.triangles]);
    await page.locator('#panel select').first().selectOption('anastomosis-20');
    await until(page, (before) => window.sutura.session !== before && window.sutura.picture?.threads.length === 1, before[0]);
    check((await page.evaluate(() => window.sutura.tissue.triangles)) !== before[1], 'the tissue is another one');
    check((await page.evaluate(() => window.sutura.plots.list.length)) === 5, 'needle and thread are plotted');
    await until(page, () => window.sutura.picture.time > 2.5);
    await shot('program-tissue-switch');
    await page.locator('label', { hasText: 'X-ray' }).click();
    await page.waitForTimeout(600);
    await posed({ page, book, shot }, 'anastomosis');
  })],

  ['program: recording', async ({ sutura, browser, book }) => {
    const folder = await mkdtemp(path.join(os.tmpdir(), 'sutura-'));
    const file = path.join(folder, 'palpation.mcap');
    const ran = spawnSync(path.resolve(sutura), ['run', 'scenes/palpation.toml', '--lockstep', '--record', file], { cwd: ROOT, encoding: 'utf8' });
    check(ran.status === 0, `sutura run: ${ran.stderr}`);
    const program = await view(sutura, [file]);
    let opened;
    try {
      opened = await browser.open(program.url);
      const { page, shot } = opened;
      await until(page, () => document.querySelector('.badge').dataset.badge === 'identical');
      await until(page, () => window.sutura.telemetry.ticks.length > 4000);
      for (const time of [2.2, 0.9, 3.6, 1.6]) {
        await page.evaluate((time) => window.sutura.player.to(time), time);
        await until(page, (time) => Math.abs(window.sutura.picture.time - time) <= 1 / 30 + 0.005, time);
        await until(page, (time) => Math.abs(Number.parseFloat(document.querySelector('[data-metric=force] dd').textContent) - window.sutura.telemetry.ticks.value('force_n', time)) < 0.0051, time);
      }
      await page.evaluate(() => window.sutura.player.to(2.2));
      await page.waitForTimeout(800);
      await posed({ page, book, shot }, 'replay', false);
      return await page.locator('.badge').getAttribute('title');
    } finally {
      await opened?.close();
      await program.end();
      await rm(folder, { recursive: true });
    }
  }],
];
