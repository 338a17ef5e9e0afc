// The page of the program itself: `sutura view` of shipped scenes and of a recording.

import { once } from 'node:events';
import { readFileSync } from 'node:fs';
import { mkdtemp, readFile, rm, writeFile } from 'node:fs/promises';
import os from 'node:os';
import path from 'node:path';
import { fileURLToPath } from 'node:url';
import { messages, series, vtu } from '../files.mjs';
import { PATIENCE_MS, alone, check, near, started, until, variety } from '../harness.mjs';

const ROOT = fileURLToPath(new URL('../../../', import.meta.url));
/** For a scene to be built and its page to be served [ms]. */
const STARTS_MS = 60_000;

/** Pictures a second that are asked for [Hz]. */
const DRAWN_HZ = 10;
/** The page sends targets of the probe as often [ms]. */
const SENT_EVERY_MS = 16;
/** By then the host's and the page's telemetry of the last 60 s is full, and whatever grows on is a leak [s of the session]. */
const FULL_S = 65;
/** States of which colours are compared, for each of two values. */
const STATES = 5;

/** Runs `sutura view`, and gives its address. */
async function view(sutura, words) {
  const child = started(path.resolve(sutura), ['view', ...words], { cwd: ROOT, stdio: ['ignore', 'pipe', 'pipe'] });
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
    pid: child.pid,
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
      // Most of the time of these tests is drawing in software.
      await opened.page.evaluate((hz) => window.sutura.ask({ do: 'picture_hz', hz }), DRAWN_HZ);
      return await run({ ...context, program, ...opened });
    } finally {
      await opened?.close();
      await program.end();
    }
  };
}

/** Runs the program to its end, while other tests go on; what it prints. */
async function runs(sutura, words) {
  const child = started(path.resolve(sutura), words, { cwd: ROOT, stdio: ['ignore', 'pipe', 'pipe'] });
  const said = { stdout: '', stderr: '' };
  for (const name of ['stdout', 'stderr']) child[name].setEncoding('utf8').on('data', (text) => (said[name] += text));
  const [code] = await once(child, 'close');
  check(code === 0, `sutura ${words.join(' ')} ends with ${code}: ${said.stderr}`);
  return said.stdout;
}

/** In a folder that is removed afterwards. */
async function withFolder(run) {
  const folder = await mkdtemp(path.join(os.tmpdir(), 'sutura-'));
  try {
    return await run(folder);
  } finally {
    await rm(folder, { recursive: true });
  }
}

/**
 * For the book: the session stands still, and is drawn as a graphics card does.
 * @param {{live?: boolean, size?: {width: number, height: number}}} options `size`: smaller where much of the picture is colours
 *   that go over into each other, of which its file would be too large
 */
async function posed({ page, book, shot }, name, { live = true, size = { width: 1200, height: 675 } } = {}) {
  if (book) {
    if (live) await page.evaluate(() => window.sutura.ask({ do: 'pause' }));
    await page.setViewportSize(size);
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

/** The scene's hand begins anew: it may have gone by the time that a page is open. */
const pressAgain = (page) => page.evaluate(() => window.sutura.ask({ do: 'hand', way: 'scene' }));

/** The same, until it presses deepest, which is the third time and held for a second; not the press that it was in before. */
async function pressDeepest(page) {
  const then = 2 + (await page.evaluate(() => window.sutura.telemetry.ticks.newest));
  await pressAgain(page);
  await until(page, (then) => window.sutura.picture.time > then && window.sutura.telemetry.ticks.value('force_n', 1e9) > 2.5 && window.sutura.picture.contacts.vertices.length > 4, then);
}

const force = (page) => page.evaluate(() => window.sutura.telemetry.ticks.value('force_n', 1e9));

export const tests = [
  ['program: palpation', withProgram(['scenes/palpation.toml'], async ({ page, troubles, shot, book }) => {
    await pressDeepest(page);
    await posed({ page, book, shot }, 'palpation');
    const first = await page.evaluate(() => window.sutura.telemetry.ticks.newest);
    await until(page, (first) => window.sutura.plots.newest > first + 0.5, first);
    // All that has come is plotted, however busy the machine is.
    await page.evaluate(() => window.sutura.ask({ do: 'pause' }));
    await until(page, () => window.sutura.gauges.paused && window.sutura.plots.newest > window.sutura.telemetry.ticks.newest - 0.1);
    const { plotted, newest, status } = await page.evaluate(() => ({ plotted: window.sutura.plots.newest, newest: window.sutura.telemetry.ticks.newest, status: window.sutura.hello.statuses[window.sutura.picture.status.word] }));
    near(plotted, newest, 0.5, 'newest time that is plotted [s]');
    check(status === 'ok', `the solver says ${status}`);
    const { rest, sums } = await page.evaluate(stagesAndRest);
    check(rest > -0.1, `stages take ${-rest} us more than their step`);
    check(sums.length > 100 && Math.max(...sums.map((sum) => Math.abs(sum - 1))) < 1e-4, `stages and rest are ${Math.max(...sums)} of the step`);
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
    await page.evaluate(() => window.sutura.choose('von-mises'));
    await pressDeepest(page);
    await until(page, () => window.sutura.tissue.coloured);
    await posed({ page, book, shot }, 'stress', { size: { width: 1040, height: 620 } });
    const { high, low } = await page.evaluate(() => ({ high: window.sutura.colouring.range.ends[1], low: window.sutura.colouring.range.ends[0] }));
    check(low === 0 && high > 100 && high < 1e5, `von Mises from ${low} to ${high} Pa`);
    await page.evaluate(() => window.sutura.choose('displacement'));
    await until(page, () => window.sutura.hello.scalars[window.sutura.picture.scalar - 1]?.name === 'displacement');
    const worst = await page.evaluate(() => {
      const { picture, colouring: { values }, tissue } = window.sutura;
      const metres = picture.displacementScale / 32767;
      let most = 0;
      for (let i = 0; i < values.length; i += 1) most = Math.max(most, Math.abs(values[i] - metres * Math.hypot(...picture.displacement.slice(3 * i, 3 * i + 3))));
      return [most / (picture.scalarHigh - picture.scalarLow || 1), tissue.geometry.positions.length / 3 === values.length];
    });
    check(worst[0] < 0.001 && worst[1], `values and displacements differ by ${worst[0]} of the range`);
  })],

  ['program: drag', async (context) => withFolder(async (folder) => {
    const file = path.join(folder, 'session.mcap');
    const said = await withProgram(['scenes/palpation.toml', '--record', file], dragged)({ ...context, folder });
    const { verified_steps: steps, identical } = JSON.parse(await runs(context.sutura, ['replay', file, '--verify', '--format', 'json'])).host;
    check(identical && steps > 500, `of the session's recording ${steps} solves are verified, identical: ${identical}`);
    return `${said}; ${steps} solves of the recording are identical`;
  })],

  ['program: slipped in', async (context) => withFolder(async (folder) => {
    // Without friction symmetry leaves open where the tissue goes.
    const scene = path.join(folder, 'smooth.toml');
    const text = readFileSync(path.join(ROOT, 'scenes/palpation.toml'), 'utf8');
    await writeFile(scene, text.split('\n').filter((line) => !line.startsWith('friction')).join('\n'));
    return withProgram([scene], slippedIn)(context);
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
    // The console's own wall is felt above the tissue, at once: 5 mm below where the hand has come to rest.
    await until(page, () => window.sutura.picture?.time > 5 && window.sutura.newest.status.grip[2] > 0.029);
    const first = await page.evaluate(() => window.sutura.session);
    await page.getByLabel('Fixture', { exact: true }).selectOption('wall');
    await until(page, () => window.sutura.hello.settings.some((one) => one.name === 'fixture' && one.value === 'wall'));
    check((await page.evaluate(() => window.sutura.session)) === first, 'the session goes on');
    await pressAgain(page);
    await until(page, () => window.sutura.newest.contacts.vertices.length === 0 && window.sutura.newest.status.grip[2] > 0.016 && window.sutura.telemetry.ticks.value('force_n', 1e9) > 1);
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

  ['program: recording', async ({ sutura, browser, book }) => withFolder(async (folder) => {
    const shown = path.join(folder, 'series');
    await runs(sutura, ['run', 'scenes/palpation.toml', '--lockstep', '--series', shown]);
    const file = path.join(shown, 'session.mcap');
    const program = await view(sutura, [file]);
    let opened;
    try {
      opened = await browser.open(program.url);
      const { page, shot } = opened;
      await until(page, () => document.querySelector('.badge').dataset.badge === 'identical');
      await until(page, () => window.sutura.telemetry.ticks.length > 4000);
      // The file says no times of steps, as its session was in lockstep: these are of running them again.
      const { rest, sums } = await page.evaluate(stagesAndRest);
      const timed = sums.filter((sum) => Math.abs(sum - 1) < 1e-4).length;
      check(rest > -0.1 && timed > 900 && timed === sums.length, `stages and rest are the step in ${timed} of ${sums.length} solves, the least rest is ${rest} us`);
      const worst = await scrubbed(page, await messages(file, '/tool'));
      const colours = await coloured(page, shown);
      await page.evaluate(() => window.sutura.player.to(2.2));
      // Pictures of another value are made when it is chosen, and come by themselves.
      await page.getByLabel('Value', { exact: true }).selectOption('pressure');
      await until(page, () => window.sutura.tissue.coloured && window.sutura.hello.scalars[window.sutura.picture.scalar - 1]?.name === 'pressure');
      const [pressed, hint] = await page.evaluate(() => [Math.max(...window.sutura.colouring.values), window.sutura.panel.scalarHint.hidden]);
      check(pressed > 100 && pressed < 1e5 && hint, `pressures up to ${pressed} Pa`);
      await page.getByLabel('Value', { exact: true }).selectOption('');
      await page.waitForTimeout(800);
      await posed({ page, book, shot }, 'replay', { live: false });
      return `${await page.locator('.badge').getAttribute('title')}; 100 places, forces differ by ${worst.toExponential(1)} N at most; ${colours}`;
    } finally {
      await opened?.close();
      await program.end();
    }
  })],

  ['program: anastomosis-50', async ({ sutura, browser, book, out }) => {
    if (!book) return 'only for the book';
    const program = await view(sutura, ['scenes/anastomosis-50.toml']);
    let opened;
    try {
      opened = await browser.open(program.url, { viewport: { width: 860, height: 744 } });
      const { page } = opened;
      const ask = (command) => page.evaluate((command) => window.sutura.ask(command), command);
      // From the start, which was over before the page was there.
      await page.evaluate(() => {
        const { sutura } = window;
        const { session } = sutura;
        sutura.link.addEventListener('hello', () => sutura.session !== session && !window.begun && (window.begun = sutura.ask({ do: 'pause' })));
      });
      await ask({ do: 'reset' });
      await until(page, () => window.begun);
      await ask({ do: 'speed', factor: 4 });
      await until(page, () => window.sutura.picture);
      await page.evaluate(() => {
        const { sutura } = window;
        sutura.stage.adapt = () => {};
        sutura.stage.choose('full', 'as with a graphics card');
        sutura.view.setLook('contacts', false);
        sutura.view.setLook('wrench', false);
        sutura.stage.pose = [0.026, -0.0445, 0.022, 0, 0, -0.001, 32];
        document.getElementById('views').hidden = true;
      });
      const said = [];
      for (const [i, time] of [0.3, 0.9, 2, 5, 9, 15.2, 18.2, 19.3].entries()) {
        const ticks = Math.round(1000 * (time - (await page.evaluate(() => window.sutura.telemetry.ticks.newest))));
        if (ticks > 0) await ask({ do: 'step', ticks });
        await page.waitForFunction((time) => window.sutura.newest.time >= time - 0.006, time, { timeout: 120_000 });
        await page.evaluate((through) => {
          window.sutura.view.setLook('xray', through);
          document.getElementById('toasts').replaceChildren();
        }, i > 1 && i < 6);
        await page.waitForTimeout(1500);
        await page.locator('#view').screenshot({ path: path.join(out, `program-anastomosis-${i + 1}.png`) });
        said.push(await page.evaluate(() => `${window.sutura.picture.time.toFixed(2)} s ${window.sutura.picture.needles[0].punctures} punctures`));
      }
      const span = await page.evaluate(() => window.sutura.picture.status.span);
      check(span < 0.1, `the longest span is still ${span} of what it was`);
      return `${said.join(', ')}; longest span at the end ${span.toFixed(3)}`;
    } finally {
      await opened?.close();
      await program.end();
    }
  }],
];

/** Their own, since they are a matter of minutes, in which others can run. */
export const long = [
  ['program: shots', async (context) => withFolder((folder) => shots(context, folder))],

  ['program: memory is level', async ({ sutura, browser, minutes }) => {
    const program = await view(sutura, ['scenes/palpation.toml']);
    let opened;
    try {
      opened = await browser.open(program.url, { viewport: { width: 640, height: 480 } });
      const { page } = opened;
      const client = await page.context().newCDPSession(page);
      await client.send('Performance.enable');
      await page.evaluate((hz) => window.sutura.ask({ do: 'picture_hz', hz }), DRAWN_HZ);
      // Pictures to look back to fill up for 30 s, and are no leak.
      await page.evaluate(() => (window.sutura.past.add = () => {}));
      const used = async () => {
        await client.send('HeapProfiler.collectGarbage');
        const { metrics } = await client.send('Performance.getMetrics');
        const host_mb = Number(/VmRSS:\s+(\d+)/.exec(readFileSync(`/proc/${program.pid}/status`, 'utf8'))?.[1]) / 1000;
        const heap_mb = metrics.find((one) => one.name === 'JSHeapUsedSize').value / 1e6;
        return { host_mb, heap_mb, ...(await page.evaluate(() => ({ ...window.sutura.stage.renderer.info.memory }))) };
      };
      // The scene's hand runs all the time.
      const again = setInterval(() => page.evaluate(() => window.sutura.ask({ do: 'hand', way: 'scene' })).catch(() => {}), 7000);
      // The session is slower than the clock on a machine that has much else to do.
      const passed = (from, time) => page.waitForFunction((time) => window.sutura.telemetry.ticks.newest >= time, time, { timeout: 120_000 + 4000 * (time - from), polling: 500 });
      const seen = [];
      for (const time of [15, 30, FULL_S, FULL_S + 30 * minutes, FULL_S + 60 * minutes]) {
        await passed(seen.at(-1)?.time ?? 0, time);
        seen.push({ time, ...(await used()) });
      }
      clearInterval(again);
      const [before, after] = [seen[2], seen[4]];
      const [host, heap] = [after.host_mb - before.host_mb, after.heap_mb - before.heap_mb];
      const all = seen.map((one) => `${one.time} s: ${one.host_mb.toFixed(1)} and ${one.heap_mb.toFixed(2)}`).join(', ');
      check(heap < 4, `the page's heap grew by ${heap} MB: ${all}`);
      check(host < 8, `the host grew by ${host} MB: ${all}`);
      check(after.geometries === before.geometries && after.textures === before.textures, JSON.stringify({ before, after }));
      return `host and heap [MB] at ${all}`;
    } finally {
      await opened?.close();
      await program.end();
    }
  }],
];

/** Least rest of all steps [us], and stages and rest over the step. In the page. */
function stagesAndRest() {
  const { solves, stageColumns } = window.sutura.telemetry;
  const { columns } = solves;
  const sums = [];
  let rest = Infinity;
  for (let i = 0; i < solves.length; i += 1) {
    const at = solves.at(i);
    rest = Math.min(rest, columns.rest_us[at]);
    sums.push(stageColumns.reduce((sum, name) => sum + columns[name][at], columns.rest_us[at]) / columns.step_us[at]);
  }
  return { rest, sums };
}

/** Waits for so much of the session's time [s], however long that takes. */
async function passes(page, seconds) {
  const then = seconds + (await page.evaluate(() => window.sutura.telemetry.ticks.newest));
  await until(page, (then) => window.sutura.telemetry.ticks.newest >= then && window.sutura.newest.time >= then - 0.1, then);
}

/** Moves the probe in the air, presses it in, and lets it go. */
async function dragged({ page, shot, sutura, folder }) {
  const ask = (command) => page.evaluate((command) => window.sutura.ask(command), command);
  // Let go, the hand goes back to where it was taken: in the air, where the scene's hand begins. Slowly, so that it is still
  // there when it is told to stay; once more where the machine stood still meanwhile.
  await until(page, () => window.sutura.grip() !== null && document.getElementById('mode').textContent === 'armed');
  do {
    await ask({ do: 'speed', factor: 0.2 });
    await ask({ do: 'hand', way: 'scene' });
    await until(page, () => window.sutura.newest.status.grip[2] > 0.0295);
    await ask({ do: 'hand', way: 'none' });
    await ask({ do: 'speed', factor: 1 });
    await passes(page, 0.3);
  } while (await page.evaluate(() => Math.abs(window.sutura.newest.status.grip[2] - 0.03) > 8e-4));
  await page.evaluate(() => window.sutura.stage.look('front'));
  await passes(page, 0.3);
  check((await force(page)) < 0.01, `in the air: ${await force(page)} N`);
  const ripple = await inTheAir(page);
  check(ripple < 0.2, `in the air the grip's speed ripples by ${(100 * ripple).toFixed(0)} % RMS`);
  await until(page, () => Math.hypot(window.sutura.newest.status.grip[0], window.sutura.newest.status.grip[2] - 0.03) < 1e-3);

  const place = await probe(page);
  await page.mouse.move(place.x, place.y);
  await page.mouse.down();
  const depth = async () => 0.014 - (await page.evaluate(() => window.sutura.newest.status.grip[2]));
  // The ball's lowest point is 14 mm below the grip; the hand is a spring, and gives way.
  const start = await depth();
  for (let press = 0.005 - start, i = 0; i < 10 && Math.abs((await depth()) - 0.005) > 3e-4; i += 1) {
    await page.mouse.move(place.x, place.y + press * place.metre);
    await passes(page, 0.5);
    press += 0.005 - (await depth());
  }
  await passes(page, 1);
  // Let go while time stands still, so that it is known when.
  await ask({ do: 'pause' });
  await page.waitForTimeout(300);
  const pressed = await force(page);
  const at = await page.evaluate(() => Array.from(window.sutura.newest.status.grip));
  near(0.014 - at[2], 0.005, 1e-3, 'how deep it is pressed in [m]');
  await shot('program-drag');
  const letGo = await page.evaluate(() => window.sutura.telemetry.ticks.newest);
  await page.mouse.up();
  await page.waitForTimeout(200);
  await ask({ do: 'resume' });
  const scene = path.join(folder, 'pressed.toml');
  const result = path.join(folder, 'pressed.json');
  const text = readFileSync(path.join(ROOT, 'scenes/palpation.toml'), 'utf8');
  const there = text.replace(/position_m = \[0.0, 0.0, 0.005\]/, `position_m = [${at.join(', ')}]`);
  check(there !== text, 'the scene has a tool to be put elsewhere');
  await writeFile(scene, there);
  await runs(sutura, ['solve', scene, '--out', result]);
  const solved = Math.hypot(...JSON.parse(await readFile(result, 'utf8')).tools[0].force_n);
  near(pressed, solved, 0.1 * solved, 'force, and that of `sutura solve` there [N]');
  await until(page, (then) => window.sutura.telemetry.ticks.newest > then, letGo + 0.6);
  const after = await page.evaluate((then) => window.sutura.telemetry.ticks.value('force_n', then), letGo + 0.5);
  check(after < 0.05, `half a second after it was let go: ${after} N`);
  return `in the air speed ripples by ${(100 * ripple).toFixed(1)} % RMS; 5 mm deep ${pressed.toFixed(3)} N, solved ${solved.toFixed(3)} N; let go ${after.toFixed(4)} N`;
}

/** Depth that a ball without friction reaches before tissue slips [m]. */
const SURE_M = 0.01;

/** Drags the probe straight down to 25 mm in 5 s of the session, and farther until it has slipped in; takes it out, and presses again. */
async function slippedIn({ page, shot }) {
  const ask = (command) => page.evaluate((command) => window.sutura.ask(command), command);
  const slipped = () => page.locator('#slipped').isVisible();
  const mode = (wanted) => until(page, (wanted) => document.getElementById('mode').textContent === wanted, wanted);
  await until(page, () => window.sutura.grip() !== null && document.getElementById('mode').textContent === 'armed');
  const still = async () => {
    await ask({ do: 'hand', way: 'scene' });
    await until(page, () => window.sutura.newest.status.grip[2] > 0.0295);
    await ask({ do: 'hand', way: 'none' });
    await page.evaluate(() => window.sutura.stage.look('front'));
    // Beside the middle, where the mesh is the same on no side.
    await ask({ do: 'drag', to_m: [0.003, 0.002, 0.022] });
    await passes(page, 0.7);
  };
  await still();
  const height = () => page.evaluate(() => window.sutura.newest.status.grip[2]);
  const place = await probe(page);
  const from = await height();
  await page.mouse.move(place.x, place.y);
  await page.mouse.down();
  const seen = [];
  for (let i = 1; !(await slipped()) && i <= 60; i += 1) {
    await page.mouse.move(place.x, place.y + (from - 0.014 + 0.025) * (i / 25) * place.metre);
    const then = 0.2 + (await page.evaluate(() => window.sutura.telemetry.ticks.newest));
    await page.waitForFunction((then) => window.sutura.telemetry.ticks.newest >= then || !document.getElementById('slipped').hidden, then, { timeout: PATIENCE_MS });
    const [depth, felt] = [0.014 - (await height()), await force(page)];
    if (await slipped()) break;
    // Pressed in that far by a hand that gives way, the deeper the more.
    if (depth > 0.001 && depth < SURE_M) {
      check(felt > 0.02 && felt > (seen.at(-1)?.felt ?? 0) - 0.03, `${depth} m deep ${felt} N after ${JSON.stringify(seen)}`);
      seen.push({ depth, felt });
    }
  }
  check(seen.length > 4, `it was pressed in so deep: ${JSON.stringify(seen)}`);
  await until(page, () => !document.getElementById('slipped').hidden);
  const deep = 0.014 - (await height());
  await mode('idle');
  const { inside, dashed } = await page.evaluate(() => ({ inside: window.sutura.hello.statuses[window.sutura.newest.status.word] === 'inside', dashed: window.sutura.instruments.outline.line.visible }));
  check(dashed === inside, `the ball is in the tissue: ${inside}, and dashed: ${dashed}`);
  await page.mouse.move(place.x, place.y + 0.05 * place.metre, { steps: 5 });
  await page.mouse.up();
  await shot('program-slipped-in');
  const notices = await page.locator('#toasts p').allInnerTexts();
  check(new Set(notices).size === notices.length && notices.length <= 2, `notices: ${JSON.stringify(notices)}`);
  check(await slipped(), 'the words stay while the console rests');
  await page.locator('#take-out').click();
  await mode('armed');
  await until(page, () => document.getElementById('slipped').hidden && window.sutura.hello.statuses[window.sutura.newest.status.word] === 'ok');
  check((await height()) > 0.014, `it is taken out to ${await height()} m`);
  check(!(await page.evaluate(() => window.sutura.instruments.outline.line.visible)), 'the ball is whole again');
  // The session goes on: it presses as before, and stays there.
  await ask({ do: 'drag', to_m: [0.003, 0.002, 0.006] });
  await until(page, () => window.sutura.telemetry.ticks.value('force_n', 1e9) > 1 && window.sutura.picture.contacts.vertices.length > 4);
  return `slipped in ${(1000 * deep).toFixed(1)} mm deep after ${seen.at(-1).felt.toFixed(2)} N at ${(1000 * seen.at(-1).depth).toFixed(1)} mm`;
}

/** Recordings of which pictures are taken: scene and seconds; all have 200 solves a second. */
const RECORDED = /** @type {[string, number][]} */ ([['palpation', 3], ['two-tools', 2], ['needle-arc', 2.5]]);

/**
 * Takes pictures of recordings at drawn times. Each is of its time by what the program says, and by what is in it: of pictures of
 * then, before and after it is most like that of then.
 */
async function shots({ sutura, browser, out, full, seed }, folder) {
  let state = seed % 2147483646 + 1;
  const draw = () => (state = (48271 * state) % 2147483647) / 2147483647;
  const count = full ? 200 : 6;
  // A session stands still at its time, a solve's period after the last one.
  let worst = 0;
  for (const at of [0, 0.01, 0.3]) worst = Math.max(worst, Math.abs(at - (await takenOf(sutura, 'scenes/palpation.toml', path.join(out, 'shot-scene.png'), at, seed))));
  for (const [which, [scene, seconds]] of RECORDED.entries()) {
    const file = path.join(folder, `${scene}.mcap`);
    await runs(sutura, ['run', `scenes/${scene}.toml`, '--lockstep', '--seconds', String(seconds), '--record', file]);
    const taken = [];
    for (let i = which; i < count; i += RECORDED.length) {
      const at = Number((draw() * (seconds - 0.01)).toFixed(3));
      const png = path.join(out, `shot-${scene}-${i}.png`);
      const drawn = await takenOf(sutura, file, png, at, seed);
      worst = Math.max(worst, Math.abs(drawn - at));
      if (taken.length < 2) taken.push({ at, drawn, png });
      else await rm(png);
    }
    await likened(sutura, browser, file, taken, seed);
  }
  return `${count} pictures, seed ${seed}: the farthest is ${(1000 * worst).toFixed(0)} ms before its time`;
}

/** Takes a picture; what time it is of [s]. */
async function takenOf(sutura, file, png, at, seed) {
  const child = started(path.resolve(sutura), ['view', file, '--shot', png, '--at', String(at), '--overwrite', '--view-port', '0'], { cwd: ROOT, stdio: ['ignore', 'ignore', 'pipe'] });
  let said = '';
  child.stderr.setEncoding('utf8').on('data', (text) => (said += text));
  const [code] = await once(child, 'close');
  const drawn = Number(/: the picture of ([\d.]+) s/.exec(said)?.[1]);
  check(code === 0 && Math.abs(drawn - at) <= 1 / 25, `seed ${seed}, ${file} at ${at} s: code ${code}, the picture of ${drawn} s: ${said}`);
  return drawn;
}

/** Compares pictures that were taken with those of the page. */
async function likened(sutura, browser, file, taken, seed) {
  const program = await view(sutura, [file, '--view-port', '0']);
  let opened;
  try {
    const first = await readFile(taken[0].png);
    const viewport = { width: first.readUInt32BE(16), height: first.readUInt32BE(20) };
    opened = await browser.open(program.url, { viewport });
    const { page } = opened;
    await until(page, () => document.querySelector('.badge').dataset.badge === 'identical');
    const clip = await page.locator('#stage').boundingBox();
    const shown = async (time) => {
      await page.evaluate((time) => window.sutura.player.to(time), time);
      await until(page, (time) => Math.abs(window.sutura.player.time - Number(document.getElementById('stage').dataset.drawnS)) < 1 / 20 && !window.sutura.player.busy, time);
      await page.waitForTimeout(300);
      return page.screenshot({ clip });
    };
    for (const { at, drawn, png } of taken) {
      const apart = [];
      const times = [];
      // A shot is framed by what is there at its time, and its arrows are as long as forces of then ask for.
      await shown(at);
      await page.evaluate(() => {
        window.sutura.instruments.forget();
        window.sutura.showAgain();
        window.sutura.frameAll();
      });
      for (const by of [0, -0.3, 0.3]) {
        const other = await shown(at + by);
        times.push(await page.evaluate(() => Number(document.getElementById('stage').dataset.drawnS)));
        apart.push(await page.evaluate(difference, { one: (await readFile(png)).toString('base64'), other: other.toString('base64'), clip }));
      }
      // Its words say another time, too.
      // Beyond the recording's ends there is no picture of another time.
      const others = apart.filter((_, i) => Math.abs(times[i] - at) > 0.2);
      check(others.length > 0 && apart[0] <= Math.min(...others) + 0.05, `seed ${seed}: ${png} of ${drawn} s differs from the page's at ${at} s by ${apart[0]}, 0.3 s before by ${apart[1]} and after by ${apart[2]}`);
    }
  } finally {
    await opened?.close();
    await program.end();
  }
}

/** Mean difference of a picture's part from another picture. Runs in the page. */
async function difference({ one, other, clip }) {
  const pixels = async (base64, x, y) => {
    const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
    const picture = await createImageBitmap(new Blob([bytes], { type: 'image/png' }));
    const canvas = new OffscreenCanvas(Math.floor(clip.width), Math.floor(clip.height));
    const context = canvas.getContext('2d');
    context.drawImage(picture, -x, -y);
    return context.getImageData(0, 0, canvas.width, canvas.height).data;
  };
  const [a, b] = [await pixels(one, clip.x, clip.y), await pixels(other, 0, 0)];
  let sum = 0;
  for (let i = 0; i < a.length; i += 1) sum += Math.abs(a[i] - b[i]);
  return sum / a.length;
}

/** Where the driven tool is on the page, and how long a metre is there [px]. */
function probe(page) {
  return page.evaluate(() => {
    const { stage, picture } = window.sutura;
    const at = stage.centre.clone().fromArray(picture.tools.find((tool) => tool.driven).position).project(stage.camera);
    const box = stage.element.getBoundingClientRect();
    return { x: box.left + (box.width * (at.x + 1)) / 2, y: box.top + (box.height * (1 - at.y)) / 2, metre: stage.pixelsPerMetre };
  });
}

/**
 * Drags the probe sideways at 50 mm/s, with the page's own targets, as often as it sends them; how much the grip's speed
 * ripples, over its mean. Time goes on from one to the next only, so that no machine is too busy.
 */
async function inTheAir(page) {
  const place = await probe(page);
  await page.mouse.move(place.x, place.y);
  await page.mouse.down();
  await page.evaluate(async ({ x, y, metre, every }) => {
    const { sutura } = window;
    const newest = () => sutura.telemetry.ticks.newest;
    const pass = async (ticks) => {
      const then = newest() + ticks / 1000;
      await sutura.ask({ do: 'step', ticks });
      while (newest() < then - 5e-4) await new Promise((resolve) => setTimeout(resolve, 5));
    };
    await sutura.ask({ do: 'pause' });
    await new Promise((resolve) => setTimeout(resolve, 300));
    for (let moved = 0; moved < 0.04; moved += 0.05e-3 * every) {
      const told = new Promise((resolve) => sutura.drag.addEventListener('target', resolve, { once: true }));
      sutura.stage.element.dispatchEvent(new PointerEvent('pointermove', { clientX: x - moved * metre, clientY: y, buttons: 1, bubbles: true }));
      await told;
      await pass(every);
    }
    await pass(500);
    await sutura.ask({ do: 'resume' });
  }, { ...place, every: SENT_EVERY_MS });
  // Of the 25 mm in the middle of the way.
  const speeds = await page.evaluate(() => {
    const { ticks } = window.sutura.telemetry;
    const at = (i) => ['x_m', 'y_m', 'z_m'].map((name) => ticks.columns[name][ticks.at(i)]);
    const apart = (a, b) => Math.hypot(...a.map((x, axis) => x - b[axis]));
    const end = at(ticks.length - 1);
    const found = [];
    for (let i = ticks.length - 1; i > 0; i -= 1) {
      const away = apart(at(i), end);
      if (away > 0.03) break;
      if (away > 0.005) found.push(apart(at(i), at(i - 1)) / (ticks.time[ticks.at(i)] - ticks.time[ticks.at(i - 1)]));
    }
    return found;
  });
  const mean = speeds.reduce((sum, one) => sum + one, 0) / speeds.length;
  check(mean > 0.03 && mean < 0.08, `it is dragged at ${mean} m/s`);
  await page.mouse.up();
  return Math.sqrt(speeds.reduce((sum, one) => sum + (one - mean) ** 2, 0) / speeds.length) / mean;
}

/** Looks at a hundred times of a recording; how far forces are from the file's at most [N]. */
async function scrubbed(page, tool) {
  const times = await page.evaluate((numbers) => {
    const { ticks } = window.sutura.telemetry;
    const time = new Map();
    for (let i = 0; i < ticks.length; i += 1) time.set(ticks.columns.tick[ticks.at(i)], ticks.time[ticks.at(i)]);
    return numbers.map((number) => time.get(number) ?? null);
  }, tool.map((one) => one.tick));
  const known = tool.map((one, i) => ({ time: times[i], force: Math.hypot(one.force_n.x, one.force_n.y, one.force_n.z) })).filter((one) => one.time !== null && one.time >= 0 && one.time < 4.9);
  check(known.length > 200, `${known.length} of the file's ${tool.length} samples are on the page`);
  let seed = 1;
  const chosen = Array.from({ length: 100 }, () => known[(seed = (48271 * seed) % 2147483647) % known.length]);
  const worst = await page.evaluate(async ([chosen, patience_ms]) => {
    const { sutura } = window;
    const [shown, began] = [document.querySelector('[data-metric=force] dd'), performance.now()];
    let most = 0;
    for (const { time, force } of chosen) {
      sutura.player.to(time);
      while (Math.abs(sutura.picture.time - time) > 1 / 30 + 0.005 || Math.abs(Number.parseFloat(shown.textContent) - force) >= 0.00501) {
        if (performance.now() - began > patience_ms) throw new Error(`at ${time} s the picture is of ${sutura.picture.time} s, and the force ${shown.textContent} instead of ${force} N`);
        await new Promise(requestAnimationFrame);
      }
      most = Math.max(most, Math.abs(sutura.telemetry.ticks.value('force_n', time) - force));
    }
    return most;
  }, [chosen, PATIENCE_MS]);
  check(worst < 1e-5, `forces differ from the file's by ${worst} N`);
  return worst;
}

/** Compares what the page colours with the VTU files of the same states; how far they are at most, over the range. */
async function coloured(page, folder) {
  const rows = await series(path.join(folder, 'session.pvd'));
  const worst = { displacement: 0, 'von-mises': 0 };
  const geometry = await page.evaluate(() => {
    const { positions, triangles, nodeOf } = window.sutura.tissue.geometry;
    return { positions: Array.from(positions), triangles: Array.from(triangles), nodeOf: Array.from(nodeOf) };
  });
  const states = [];
  for (const name of ['displacement', 'von-mises']) {
    await page.evaluate((name) => window.sutura.choose(name), name);
    for (const { time, name: file } of rows.filter((row) => row.time > 0.5 && row.time < 4.3)) {
      if (states.filter((one) => one === name).length === STATES) break;
      // The pictures' times and the files' are both those of solves; some are the same.
      await page.evaluate((time) => window.sutura.link.ask({ do: 'seek', time_s: time + 1e-6 }), time);
      const seen = await until(page, (time) => Math.abs(window.sutura.newest.time - time) < 1 / 25, time).then(() => page.evaluate(([time, name]) => {
        const { picture, colouring: { values }, hello } = window.sutura;
        if (Math.abs(picture.time - time) > 1e-6 || (hello.scalars[picture.scalar - 1]?.name !== name && name !== 'displacement')) return null;
        return Array.from(values);
      }, [time, name]));
      if (!seen) continue;
      const wanted = valuesOf(await vtu(path.join(folder, file)), geometry, name);
      const high = Math.max(...wanted);
      // At rest there is no range.
      if (high === 0) continue;
      states.push(name);
      // Twenty vertices, among them those that differ most from rest.
      const order = wanted.map((_, i) => i).sort((a, b) => wanted[b] - wanted[a]);
      const chosen = [...order.slice(0, 10), ...order.filter((_, i) => i > 10 && i % Math.ceil(order.length / 10) === 0)];
      check(chosen.length >= 19, `${chosen.length} vertices`);
      for (const vertex of chosen) worst[name] = Math.max(worst[name], Math.abs(seen[vertex] - wanted[vertex]) / high);
    }
  }
  check(states.length === 2 * STATES, `${states.length} pictures are of the files' states`);
  check(worst.displacement < 0.01 && worst['von-mises'] < 0.01, `values differ from the VTU by ${JSON.stringify(worst)} of the range`);
  return `colours of ${states.length} states are the VTU's within ${(100 * Math.max(...Object.values(worst))).toFixed(3)} % of the range`;
}

/** What the page should colour, of a VTU: at vertices, stresses of the cells behind triangles averaged by area. */
function valuesOf({ displacement, cells }, { positions, triangles, nodeOf }, name) {
  if (name === 'displacement') return nodeOf.map((node) => Math.hypot(...displacement.slice(3 * node, 3 * node + 3)));
  const behind = new Map();
  const key = (nodes) => [...nodes].sort((a, b) => a - b).join();
  for (const { nodes, stress } of cells) nodes.forEach((_, i) => behind.set(key(nodes.filter((__, j) => j !== i)), stress));
  const [sums, areas] = [new Array(nodeOf.length).fill(0), new Array(nodeOf.length).fill(0)];
  for (let t = 0; t < triangles.length; t += 3) {
    const corners = triangles.slice(t, t + 3);
    const [a, b, c] = corners.map((vertex) => positions.slice(3 * vertex, 3 * vertex + 3));
    const [u, v] = [b, c].map((end) => end.map((x, axis) => x - a[axis]));
    const area = Math.hypot(u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]);
    for (const vertex of corners) {
      sums[vertex] += area * behind.get(key(corners.map((one) => nodeOf[one])));
      areas[vertex] += area;
    }
  }
  return sums.map((sum, i) => sum / areas[i]);
}
