// The page against the made-up host, which can be brought to do what a session does not at will.

import { readFile } from 'node:fs/promises';
import { createRequire } from 'node:module';
import { Browser, alone, check, near, readPixels, until, variety } from '../harness.mjs';
import { start } from '../mock-server.mjs';

/** Opens the page of a made-up host, and closes both whatever happens. */
function withHost(options, run) {
  return async (context) => {
    const host = await start(options);
    let opened;
    try {
      opened = await context.browser.open(host.url, options);
      return await run({ ...context, host, ...opened });
    } finally {
      await opened?.close();
      await host.close();
    }
  };
}

const settled = (page, ms) => page.waitForTimeout(ms);
const choose = (page, summary) => page.locator('#panel summary', { hasText: summary }).click();

export const tests = [
  ['page opens', withHost({ scene: 'slab' }, async ({ page, troubles, shot }) => {
    const said = await page.evaluate(() => ({ renderer: window.sutura.stage.rendererName, quality: window.sutura.stage.quality, reason: window.sutura.stage.reason }));
    check(/swiftshader|llvmpipe/i.test(said.renderer), `the renderer is ${said.renderer}`);
    check(said.quality === 'lean' && said.reason.includes(said.renderer), `a software renderer begins with lean, and says why: ${JSON.stringify(said)}`);
    const { colours, background } = await variety(page);
    check(colours > 8 && background < 0.9, `a uniform picture: ${colours} colours, ${background} background`);
    await alone(page);
    const triangles = await page.evaluate(() => {
      const { stage, tissue } = window.sutura;
      stage.render();
      return [stage.renderer.info.render.triangles, tissue.geometry.triangles.length / 3];
    });
    check(triangles[0] === triangles[1] && triangles[0] > 1000, `triangles drawn and of the geometry: ${triangles}`);
    await settled(page, 600);
    check(troubles.length === 0, troubles.join('\n'));
    await shot('page-opens');
    return said.renderer;
  })],

  ['numbers move', withHost({ scene: 'slab' }, async ({ page, host, shot }) => {
    await until(page, () => window.sutura.plots.list.length === 4 && window.sutura.plots.newest > 1);
    const first = await page.evaluate(() => window.sutura.telemetry.ticks.newest);
    await until(page, (first) => window.sutura.telemetry.ticks.newest > first + 0.5, first);
    // All that the host has sent comes, and is plotted, however busy the machine is.
    host.mock.paused = true;
    await until(page, (time) => window.sutura.telemetry.ticks.newest > time - 0.001 && window.sutura.plots.newest > time - 0.1, host.mock.time);
    const { plotted, newest, age, bar, stack } = await page.evaluate(() => {
      const { plots, telemetry } = window.sutura;
      const { columns } = telemetry.solves;
      const at = telemetry.solves.at(telemetry.solves.length - 1);
      const stages = telemetry.stageColumns.reduce((sum, name) => sum + columns[name][at], columns.rest_us[at]);
      return { plotted: plots.newest, newest: telemetry.ticks.newest, age: document.querySelector('[data-metric=age] dd').textContent, bar: document.querySelector('[data-metric=hz] dd').textContent, stack: stages / columns.step_us[at] };
    });
    near(plotted, newest, 0.1, 'newest time that is plotted [s]');
    near(newest, host.mock.time, 0.001, 'newest time of the page against the host\'s [s]');
    check(/^\d+\.\d ms$/.test(age) && bar === '250 Hz', `top bar: ${age}, ${bar}`);
    near(stack, 1, 1e-5, 'stages and rest over the step');
    await choose(page, 'Counters');
    await until(page, () => [...document.querySelectorAll('tr')].some((row) => row.textContent === 'Frames of rows, sent / board takes190 Hz / 200 Hz'));
    await shot('plots');
  })],

  ['drag', withHost({ scene: 'slab' }, async ({ page, host, shot }) => {
    host.mock.way = () => [0, 0, 0.02];
    await until(page, () => Math.abs(window.sutura.picture.status.grip[2] - 0.02) < 1e-4);
    const place = await page.evaluate(() => {
      const { stage, picture } = window.sutura;
      const at = stage.centre.clone().fromArray(picture.tools[0].position).project(stage.camera);
      const box = stage.element.getBoundingClientRect();
      return { x: box.left + (box.width * (at.x + 1)) / 2, y: box.top + (box.height * (1 - at.y)) / 2, metre: stage.pixelsPerMetre };
    });
    await page.mouse.move(place.x, place.y);
    await page.mouse.down();
    await page.mouse.move(place.x, place.y + 0.012 * place.metre, { steps: 8 });
    await until(page, () => window.sutura.telemetry.ticks.value('force_n', 1e9) > 0.5);
    check(host.mock.target !== null && host.mock.target[2] < 0.012, `the host's target is ${host.mock.target}`);
    check(await page.evaluate(() => window.sutura.instruments.spring.visible), 'the spring is shown');
    await shot('drag');
    const camera = await page.evaluate(() => window.sutura.stage.pose);
    await page.mouse.up();
    await until(page, () => window.sutura.telemetry.ticks.value('force_n', 1e9) < 0.05);
    check(host.mock.target === null, 'let go');
    await page.evaluate(() => document.getElementById('stage').focus());
    await page.keyboard.press('KeyS');
    await page.keyboard.press('KeyS');
    await until(page, () => window.sutura.drag.target !== null);
    await page.keyboard.press('KeyR');
    await settled(page, 200);
    check(host.mock.target === null, 'let go by key');
    check(String(camera) === String(await page.evaluate(() => window.sutura.stage.pose)), 'the camera stays where it is while the probe is dragged');
  })],

  ['colours', withHost({ scene: 'slab' }, async ({ page, host, shot }) => {
    host.mock.way = () => [0.008, 0, 0.004];
    for (const [name, file] of [['displacement', 'displacement'], ['largest-principal', 'stress']]) {
      await page.getByLabel('Value', { exact: true }).selectOption(name);
      await until(page, (name) => window.sutura.tissue.coloured && window.sutura.hello.scalars[window.sutura.picture.scalar - 1]?.name === name && window.sutura.picture.status.grip[2] < 0.0042, name);
      await shot(file);
      await alone(page);
      const worst = await page.evaluate(colourErrors);
      check(worst.places >= 20, `${worst.places} places seen`);
      check(worst.error <= 3, `${name}: dE ${worst.error} between pixel and legend at ${JSON.stringify(worst.at)}`);
      await page.evaluate(() => ['outline', 'tools', 'contacts', 'wrench'].forEach((name) => window.sutura.view.setLook(name, true)));
    }
  })],

  ['stereo', withHost({ scene: 'slab' }, async ({ page, shot }) => {
    for (const mode of ['anaglyph', 'side-by-side']) {
      await page.evaluate((mode) => window.sutura.panelActions().stereo(mode), mode);
      await settled(page, 700);
      await shot(mode);
    }
    for (const mode of ['side-by-side', 'swapped', 'anaglyph-grey']) {
      const found = await page.evaluate(disparities, mode);
      check(found.length === 3, `${found.length} spheres`);
      for (const { seen, wanted, depth } of found) near(seen, mode === 'swapped' ? -wanted : wanted, 1, `${mode}: disparity at ${depth} of the distance [px]`);
    }
  })],

  ['qualities', withHost({ scene: 'slab', hz: 2 }, async ({ page, shot }) => {
    const chosen = async (quality) => {
      await page.evaluate((quality) => {
        window.sutura.stage.choose(quality, 'chosen by hand');
        window.sutura.stage.drawn = 0;
      }, quality);
      await until(page, () => window.sutura.stage.drawn > 2);
      return `${quality} ${await page.evaluate(framesASecond)}`;
    };
    const said = [await chosen('lean')];
    // The better ones take software long: not more of it than shows what they are.
    await page.setViewportSize({ width: 900, height: 644 });
    const pictures = [];
    for (const quality of ['lean', 'wet', 'full']) {
      said.push(await chosen(quality));
      await shot(quality);
      pictures.push(await page.evaluate(() => {
        window.sutura.stage.render();
        return window.sutura.stage.renderer.domElement.toDataURL();
      }));
      check((await variety(page)).colours > 8, `${quality} is uniform`);
    }
    check(new Set(pictures).size === 3, 'two qualities look alike');
    return said.join(', ');
  })],

  ['inside', withHost({ scene: 'tube' }, async ({ page, host, shot }) => {
    // The tool stays away, and the picture has it so: the tubes' walls are where they were.
    host.mock.way = () => [0.03, 0, 0.006];
    await until(page, () => window.sutura.picture.displacement?.every((part) => part === 0) ?? true);
    await page.evaluate(() => {
      const { sutura } = window;
      sutura.stage.choose('lean', 'chosen by hand');
      sutura.view.setLook('tools', false);
    });
    // The page's own colours of what is drawn through the tissue, and of cut walls.
    const count = (colour, within) => page.evaluate(`(() => {
      const { bytes } = ${readPixels};
      let found = 0;
      for (let i = 0; i < bytes.length; i += 4) {
        if (Math.abs(bytes[i] - ${colour[0]}) + Math.abs(bytes[i + 1] - ${colour[1]}) + Math.abs(bytes[i + 2] - ${colour[2]}) <= ${within}) found += 1;
      }
      return found;
    })()`);
    const thread = [0x5b, 0x8f, 0xf5];
    const outside = await count(thread, 60);
    const solid = await page.evaluate(needleSeen);
    await page.locator('label', { hasText: 'X-ray' }).click();
    await settled(page, 500);
    const inside = await count(thread, 60);
    check(inside > outside + 30, `x-ray shows ${inside} pixels of thread, ${outside} without`);
    const through = await page.evaluate(needleSeen);
    const said = JSON.stringify({ solid, through });
    check(solid.inside > 50 && solid.outsideSeen > 20, `the needle is inside and outside of tissue: ${said}`);
    check(solid.insideSeen === 0, `what of the needle is inside tissue is seen without x-ray: ${said}`);
    // Dashes have gaps.
    const part = through.insideSeen / through.inside;
    check(part > 0.3 && part < 0.95, `${(100 * part).toFixed(0)} % of the needle inside tissue is seen in x-ray: ${said}`);
    await shot('xray');
    await page.locator('label', { hasText: 'X-ray' }).click();
    const walls = [0x7c, 0x2f, 0x35];
    const before = await count(walls, 12);
    await page.evaluate(() => window.sutura.panel.setCut({ axis: 'y', at: 0, flip: true }));
    await settled(page, 500);
    const after = await count(walls, 12);
    check(before < 20 && after > before + 200, `pixels of the cut: ${before} before, ${after} after`);
    const front = await page.evaluate(() => {
      const { stage, tissue } = window.sutura;
      return tissue.plane.distanceToPoint(stage.camera.position) < 0 && tissue.clippingPlanes.length === 1;
    });
    check(front, 'the cut takes away the side that one looks from');
    await shot('cut');
    return `${(100 * part).toFixed(0)} % of the needle inside tissue is seen in x-ray, none without`;
  })],

  ['fault', withHost({ scene: 'slab', hz: 2 }, async ({ page, host, shot }) => {
    Object.assign(host.mock, { faults: ['e_stop'], mode: 'fault' });
    host.tell({ what: 'fault', text: 'fault: emergency stop', help: '' });
    await until(page, () => document.querySelector('#alerts [data-name=fault-e_stop]'));
    const words = await page.locator('[role=alert]').innerText();
    check(words.includes('The emergency stop is pressed.') && words.includes('Release it, then clear the fault and arm.'), words);
    check((await page.locator('#mode').innerText()) === 'fault', 'the mode says fault');
    await shot('fault');
    await page.locator('#clear').click();
    await until(page, () => document.getElementById('mode').textContent === 'idle' && !document.querySelector('#alerts [data-name]'));
    await page.locator('#arm').click();
    await until(page, () => document.getElementById('mode').textContent === 'armed');
    host.mock.connected = false;
    await until(page, () => document.querySelector('#alerts [data-name=console]'));
    const line = () => page.locator('[data-metric=force] dd').evaluate((value) => getComputedStyle(value).textDecorationLine);
    await until(page, () => getComputedStyle(document.querySelector('[data-metric=force] dd')).textDecorationLine === 'line-through');
    await shot('lost');
    host.mock.connected = true;
    await until(page, () => !document.querySelector('#alerts [data-name=console]'));
    await settled(page, 300);
    check((await line()) === 'none', 'a value that is back is not crossed out');
  })],

  ['safe stop by keys', withHost({ scene: 'slab', hz: 2 }, async ({ page, host }) => {
    const armed = async (mode) => {
      host.mock.mode = mode;
      await settled(page, 50);
    };
    for (const [at, key, stops] of [['body', 'Space', true], ['#stage', 'Escape', true], ['#play', 'Escape', true], ['#panel select', 'Escape', true], ['#play', 'Space', false]]) {
      await armed('armed');
      await page.locator(at).first().evaluate((element) => (document.activeElement?.blur?.(), element.focus()));
      await page.keyboard.press(key);
      if (stops) await expectMode(host, 'idle', `${key} at ${at}`);
      else {
        await settled(page, 300);
        check(host.mock.mode === 'armed' && host.mock.paused, `${key} at ${at} operates the control`);
      }
    }
    await armed('armed');
    await page.locator('#stop').click();
    await expectMode(host, 'idle', 'the button');
  })],

  ['arming motors is held', withHost({ scene: 'slab', motors: true, hz: 2 }, async ({ page, host }) => {
    host.mock.mode = 'idle';
    await until(page, () => !document.getElementById('arm').hidden);
    const box = await page.locator('#arm').boundingBox();
    await page.mouse.move(box.x + 5, box.y + 5);
    await page.mouse.down();
    await settled(page, 500);
    await page.mouse.up();
    await settled(page, 800);
    check(host.mock.mode === 'idle', 'half a second arms');
    await page.mouse.down();
    await expectMode(host, 'armed', 'a second');
    await page.mouse.up();
  })],

  ['settings, recordings and the last seconds', withHost({ scene: 'slab', hz: 2 }, async ({ page, host, browser }) => {
    const { mock } = host;
    const of = (name) => mock.settings.find((one) => one.name === name);
    const setting = (name) => of(name).value;
    const happens = async (what, wanted) => {
      for (let i = 0; i < 200 && what() !== wanted; i += 1) await settled(page, 20);
      check(what() === wanted, `the host has ${what()}, not ${wanted}`);
    };
    await page.getByLabel('Rendering', { exact: true }).selectOption('hold');
    await happens(() => setting('rendering'), 'hold');
    // A rate changes at once: what holds the slider goes on holding it, and the host's value is what it shows.
    const rate = page.getByLabel('Host Hz', { exact: true });
    await rate.focus();
    await page.keyboard.press('ArrowRight');
    await happens(() => setting('host-hz'), 275);
    of('host-hz').value = 300;
    for (const client of mock.clients) client.say(mock.hello(client));
    await until(page, () => /** @type {HTMLInputElement} */ (document.activeElement).value === '300');
    await page.getByLabel('Young\'s modulus', { exact: true }).fill('20000');
    await happens(() => setting('youngs-modulus'), 20000);
    await page.getByRole('button', { name: 'Do my drag again' }).click();
    await happens(() => mock.hand, 'recorded');

    // A recording begins with a session of its own, and the button ends it.
    const { session } = mock;
    await page.getByRole('button', { name: 'Start again and record' }).click();
    await happens(() => mock.recorded && mock.session === session + 1, true);
    await page.getByRole('button', { name: 'End the recording' }).click();
    await happens(() => mock.recorded, false);
    await page.getByRole('button', { name: 'Start again and record' }).waitFor();
    await page.getByRole('button', { name: 'Save the last 30 s' }).click();
    await until(page, () => document.getElementById('toasts').textContent.includes('sutura-last.mcap'));
    check(mock.saved === 1 && mock.session === session + 1, 'saved once, and the session goes on');

    const second = await browser.open(host.url, {});
    check((await second.page.getByRole('button', { name: /record|Save the last/ }).count()) === 0 && (await second.page.getByLabel('Rendering', { exact: true }).isDisabled()), 'who watches has none of it');
    await second.close();
  })],

  ['two clients', withHost({ scene: 'slab', hz: 2 }, async ({ page, host, browser }) => {
    const second = await browser.open(host.url, {});
    check((await second.page.locator('#role').innerText()) === 'you watch', 'the second one watches');
    check(await second.page.locator('#arm').isHidden(), 'who watches cannot arm');
    await second.page.getByText('Take control').click();
    await until(second.page, () => document.getElementById('role').textContent === 'you control');
    await until(page, () => document.getElementById('role').textContent === 'you watch');
    const session = await page.evaluate(() => window.sutura.telemetry.ticks.length);
    check(session > 0, 'a change of the role alone throws nothing away');
    await second.close();
  })],

  ['replay', withHost({ scene: 'recording' }, async ({ page, shot }) => {
    await until(page, () => window.sutura.telemetry.ticks.length > 4900);
    check((await page.locator('.badge').innerText()) === 'identical to the bit' && (await page.locator('.badge').getAttribute('title')) === 'run again: identical to the bit', 'the badge says what was found');
    for (const part of [0.31, 0.9, 0.05, 0.55, 0.72]) {
      await page.evaluate((part) => {
        const slider = document.querySelector('#time-line input');
        slider.value = String(1000 * part);
        slider.dispatchEvent(new Event('input'));
      }, part);
      await until(page, (time) => Math.abs(window.sutura.picture.time - time) < 1 / 30, 5 * part);
      // Two digits of the force of then.
      await until(page, (time) => Math.abs(Number.parseFloat(document.querySelector('[data-metric=force] dd').textContent) - window.sutura.telemetry.ticks.value('force_n', time)) < 0.0051, 5 * part);
      near(await page.evaluate(() => window.sutura.plots.play_s), 5 * part, 1e-6, 'plots and time line share the cursor');
    }
    await settled(page, 200);
    const plotted = await page.evaluate(() => window.sutura.plots.drawn);
    await settled(page, 2300);
    check((await page.locator('[role=alert]').innerText()) === '', 'a recording that says nothing is not gone');
    check((await page.evaluate(() => window.sutura.plots.drawn)) === plotted, 'plots are not drawn again where nothing is new');
    await shot('replay');
    await page.locator('#play').click();
    const from = await page.evaluate(() => window.sutura.player.time);
    await until(page, (from) => window.sutura.player.time > from + 0.5, from);
    await page.evaluate(() => window.sutura.player.play(false));
    await page.evaluate(() => window.sutura.plots.mark(1, 1.4));
    await page.getByText('Loop A–B').click();
    await page.evaluate(() => window.sutura.player.to(1.3));
    await page.locator('#play').click();
    await until(page, () => window.sutura.player.time < 1.2);
    check(await page.evaluate(() => window.sutura.player.time >= 1), 'the loop begins at A');
  })],

  ['a recording that is still run again', withHost({ scene: 'recording', ready: 1, at: 3 }, async ({ page, host }) => {
    const drawn = (time) => until(page, (time) => Math.abs(Number(document.getElementById('stage').dataset.drawnS) - time) < 1e-6, time);
    // The newest picture of then stands in for one that is not made yet, until it is.
    await drawn(1);
    for (const ready of [2, 4, 5]) {
      host.mock.ready = ready;
      host.tell({ what: 'ready', time_s: ready, text: '', help: '' });
      await drawn(Math.min(ready, 3));
    }
    check((await page.evaluate(() => window.sutura.player.time)) === 3, 'the time line stays where it was opened');
  })],

  ['slipped in', withHost({ scene: 'slab' }, async ({ page, host, shot, browser }) => {
    const { mock } = host;
    mock.way = () => [0, 0, -0.011];
    await until(page, () => window.sutura.picture.status.grip[2] < -0.0105);
    check(await page.locator('#slipped').isHidden(), 'a tool that touches has not slipped in');
    const dashes = () => page.evaluate(() => {
      const { instruments } = window.sutura;
      window.sutura.stage.render();
      return { visible: instruments.outline.line.visible, segments: instruments.outline.line.geometry.instanceCount };
    });
    check(!(await dashes()).visible, 'a tool that is seen has no dashes');
    Object.assign(mock, { inside: true, mode: 'idle' });
    await until(page, () => !document.getElementById('slipped').hidden);
    const words = await page.locator('#slipped').innerText();
    check(words.includes('The ball has slipped into the tissue.') && words.includes('Press less deep, or give the tool friction.'), words);
    const { visible, segments } = await dashes();
    check(visible && segments >= 24 && segments <= 200, `the outline of a ball has ${segments} edges, shown: ${visible}`);
    // Dashes are seen through the tissue, and alone.
    const seen = () => page.evaluate(`(() => {
      const { bytes } = ${readPixels};
      let count = 0;
      for (let i = 0; i < bytes.length; i += 4) count += bytes[i + 2] > bytes[i] + 30 && bytes[i + 2] > 150 ? 1 : 0;
      return count;
    })()`);
    const dashed = await seen();
    await page.evaluate(() => window.sutura.view.setLook('tools', false));
    const without = await seen();
    await page.evaluate(() => window.sutura.view.setLook('tools', true));
    check(dashed > without + 100, `${dashed} pixels are blue with dashes, ${without} without`);
    await shot('slipped-in');
    // Four targets that are refused are one notice.
    await page.evaluate(() => [1, 2, 3, 4].forEach((i) => window.sutura.drag.dispatchEvent(new CustomEvent('target', { detail: [0, 0, -0.001 * i] }))));
    await until(page, () => document.querySelector('#toasts p')?.textContent.includes('(4 times)'));
    check((await page.locator('#toasts p').count()) === 1, await page.locator('#toasts').innerText());
    // A watcher takes nothing out.
    const second = await browser.open(host.url);
    await until(second.page, () => !document.getElementById('slipped').hidden);
    check(await second.page.locator('#take-out').isHidden() && (await second.page.locator('#slipped').innerText()).includes('Take it out, then arm.'), 'who watches has no button');
    await second.close();
    mock.way = () => [0, 0, 0.02];
    await page.locator('#take-out').click();
    await until(page, () => document.getElementById('mode').textContent === 'armed');
    await until(page, () => document.getElementById('slipped').hidden);
    check(!(await dashes()).visible, 'a tool that is out again has no dashes');
    // A tool without an equilibrium has its words once the console has let go.
    mock.tooDeep = true;
    await until(page, () => window.sutura.picture.status.word === 3);
    await settled(page, 700);
    check(await page.locator('#slipped').isHidden(), 'a moment without a balance is not told');
    mock.mode = 'idle';
    await until(page, () => !document.getElementById('slipped').hidden);
    const deep = await page.locator('#slipped').innerText();
    check(deep.includes('so deep that no balance is found'), deep);
    await page.locator('#take-out').click();
    await until(page, () => document.getElementById('slipped').hidden);
  })],

  ['whose clock', withHost({ scene: 'slab', hz: 2 }, async ({ page, host }) => {
    const metric = (name) => page.locator(`[data-metric=${name}] dd`).innerText();
    await until(page, () => document.querySelector('[data-metric=hz] dd').textContent === '250 Hz');
    check((await metric('latency')).startsWith('5.2 / 6.1'), `latency ${await metric('latency')}`);
    // Slower than the clock on the wall: 170 ms a step.
    Object.assign(host.mock, { realSpeed: 0.0235, wall: { wall_hz: 5.9, wall_latency_us: { p50: 221e3, p99: 259e3 } } });
    await until(page, () => document.querySelector('[data-metric=hz] dd').textContent === '5.9 Hz');
    check((await metric('latency')).startsWith('221.0 / 259.0'), `latency ${await metric('latency')}`);
    const title = await page.locator('[data-metric=hz]').getAttribute('title');
    check(title.includes('clock on the wall') && title.includes('0.02 ×'), title);
  })],

  ['who asked for a safe stop', withHost({ scene: 'slab', hz: 2 }, async ({ page, browser, host }) => {
    const second = await browser.open(host.url);
    await page.keyboard.press('Escape');
    for (const one of [page, second.page]) {
      await until(one, () => document.querySelector('#alerts [data-name=stopped]'));
      const words = await one.locator('[data-name=stopped]').innerText();
      check(words.includes('Safe stop, asked for by the page that controls.'), words);
    }
    await page.locator('#arm').click();
    await until(second.page, () => !document.querySelector('#alerts [data-name=stopped]'));
    await second.close();
  })],

  ['looking back', withHost({ scene: 'slab' }, async ({ page }) => {
    await until(page, () => window.sutura.past.span[1] - window.sutura.past.span[0] > 1.3);
    await page.evaluate(() => {
      const slider = document.querySelector('#time-line input');
      slider.value = '300';
      slider.dispatchEvent(new Event('input'));
    });
    const { time, looking, newest } = await page.evaluate(() => ({ time: window.sutura.picture.time, looking: window.sutura.timeLine.looking, newest: window.sutura.newest.time }));
    check(time <= looking && looking - time < 0.5 && newest - time > 0.5, `looking back to ${looking} s of ${newest} s, the picture is of ${time} s`);
    await settled(page, 500);
    check((await page.evaluate(() => window.sutura.picture.time)) === time, 'the picture of then stays');
    check((await page.evaluate(() => window.sutura.newest.time)) > time + 0.3, 'the session goes on');
    await page.getByText('Live', { exact: true }).click();
    await until(page, (time) => window.sutura.picture.time > time + 0.5, time);
  })],

  ['no WebGL', async ({ executable, out }) => {
    const host = await start({ scene: 'slab' });
    const plain = new Browser({ executable, out });
    await plain.launch(['--disable-3d-apis']);
    try {
      const { page, shot } = await plain.open(host.url, { scene: false });
      check(await page.locator('#no-webgl').isVisible(), 'it is said');
      await until(page, () => window.sutura.plots.newest > 1);
      await page.keyboard.press('Escape');
      await expectMode(host, 'idle', 'Esc');
      await until(page, () => document.getElementById('mode').textContent === 'idle');
      await shot('no-webgl');
    } finally {
      await plain.close();
      await host.close();
    }
  }],

  ['reconnect', async ({ browser }) => {
    const host = await start({ scene: 'slab' });
    const { page, troubles, shot, close } = await browser.open(host.url);
    await host.close();
    await until(page, () => document.querySelector('#alerts [data-name=link]')?.textContent.includes('last seen'));
    check((await page.locator('[data-metric=force] dd').evaluate((value) => getComputedStyle(value).textDecorationLine)) === 'line-through', 'values are crossed out');
    await shot('no-host');
    const again = await start({ scene: 'tube', port: host.port });
    again.mock.session = 99;
    try {
      await until(page, () => window.sutura.hello.scene === 'tube' && window.sutura.picture?.threads.length === 1);
      await until(page, () => !document.querySelector('#alerts [data-name]') && window.sutura.plots.list.length === 5);
      check((await variety(page)).colours > 8, 'the scene is drawn');
      check(!troubles.some((trouble) => trouble.startsWith('error')), troubles.join('\n'));
    } finally {
      await close();
      await again.close();
    }
  }],

  ['wrong key', async ({ browser }) => {
    const host = await start({ scene: 'slab' });
    const context = await browser.browser.newContext();
    const page = await context.newPage();
    await page.goto(host.url.replace('key=mock', 'key=other'));
    await until(page, () => document.querySelector('#alerts [data-name=link]')?.textContent.includes('key'));
    await page.goto('about:blank');
    await page.goto(host.url.split('#')[0]);
    await until(page, () => document.querySelector('#alerts [data-name=link]')?.textContent.includes('no key'));
    await context.close();
    await host.close();
  }],

  ['context lost', withHost({ scene: 'slab' }, async ({ page }) => {
    await page.evaluate(() => {
      const { stage } = window.sutura;
      stage.choose('wet', 'chosen by hand');
      stage.stereo.mode = 'anaglyph';
      stage.request();
    });
    await until(page, () => window.sutura.stage.drawn > 1);
    await page.evaluate(() => {
      window.loser = window.sutura.stage.renderer.getContext().getExtension('WEBGL_lose_context');
      window.loser.loseContext();
    });
    await until(page, () => document.querySelector('#alerts [data-name=context]'));
    await page.evaluate(() => window.loser.restoreContext());
    await until(page, () => !document.querySelector('#alerts [data-name=context]') && !window.sutura.stage.lost);
    const drawn = await page.evaluate(() => window.sutura.stage.drawn);
    await until(page, (drawn) => window.sutura.stage.drawn > drawn + 1, drawn);
    const { colours, background } = await variety(page);
    check(colours > 8 && background < 0.9, `after it came back: ${colours} colours`);
  })],

  ['export', withHost({ scene: 'slab', hz: 5 }, async ({ page, browser, host }) => {
    await choose(page, 'Export');
    const download = async (name) => {
      const [file] = await Promise.all([page.waitForEvent('download'), page.getByRole('button', { name, exact: true }).click()]);
      return { name: file.suggestedFilename(), bytes: await readFile(await file.path()) };
    };
    const size = await page.evaluate(() => window.sutura.stage.size);
    await page.evaluate(() => {
      const { stage } = window.sutura;
      stage.addEventListener('draw', () => (window.widest = Math.max(window.widest ?? 0, stage.renderer.domElement.width)));
    });
    for (const [name, factor] of [['Picture', 1], ['Picture, 2 ×', 2]]) {
      const { bytes } = await download(name);
      check(bytes.readUInt32BE(16) === factor * size.width && bytes.readUInt32BE(20) === factor * size.height, `${name}: ${bytes.readUInt32BE(16)}x${bytes.readUInt32BE(20)}`);
      check((await page.evaluate(() => window.widest)) === factor * size.width, `${name} is drawn at its size, not enlarged`);
    }
    await until(page, () => window.sutura.telemetry.ticks.length > 500);
    await page.evaluate(() => window.sutura.plots.pause(true));
    const table = await download('CSV, as plotted');
    const lines = String(table.bytes).trim().split('\n');
    check(lines[0].startsWith('time_s,tick,x_m') && lines.length > 400, `${table.name}: ${lines.length} lines, ${lines[0]}`);
    const [time, tick] = lines[100].split(',').map(Number);
    near(tick, 1000 * time, 1e-6, 'a row\'s tick');
    const { bytes: plots } = await download('Plots');
    check(plots.readUInt32BE(16) > 1000, 'plots as a picture');
    await page.getByRole('button', { name: 'Record film' }).click();
    await settled(page, 1800);
    const film = await download('Stop and save');
    check(film.bytes.length > 2000 && /\.(webm|mp4)$/.test(film.name), `${film.name}: ${film.bytes.length} bytes`);
    const seconds = await page.evaluate(filmSeconds, film.bytes.toString('base64'));
    check(seconds >= 1, `the film lasts ${seconds} s`);
    await page.evaluate(() => {
      const { sutura } = window;
      sutura.stage.pose = [0.1, -0.07, 0.055, 0.001, 0.002, -0.003, 32];
      sutura.panel.setCut({ axis: 'x', at: 0.0125, flip: true });
      sutura.colouring.fix([0.001, 0.004]);
    });
    await page.getByRole('button', { name: 'Copy link' }).click();
    await until(page, () => document.getElementById('toasts').textContent.includes('Link copied'));
    const link = await page.evaluate(() => navigator.clipboard.readText());
    // It need not draw while another one opens.
    await page.evaluate(() => window.sutura.ask({ do: 'picture_hz', hz: 0 }));
    const again = await browser.open(link);
    const { pose, cut, range } = await again.page.evaluate(() => ({ pose: window.sutura.stage.pose, cut: window.sutura.tissue.cut, range: window.sutura.colouring.range.fixed }));
    [0.1, -0.07, 0.055, 0.001, 0.002, -0.003, 32].forEach((value, i) => near(pose[i], value, 1e-6, `camera ${i}`));
    near(cut.at, 0.0125, 1e-9, 'cut');
    check(cut.axis === 'x' && cut.flip && String(range) === '0.001,0.004', JSON.stringify({ cut, range }));
    await again.close();
    check(host.mock.clients.size >= 1, 'the first page is still there');
  })],

  ['keyboard', withHost({ scene: 'slab', hz: 2 }, async ({ page }) => {
    await page.evaluate(() => document.querySelectorAll('details').forEach((one) => (one.open = true)));
    const all = await page.evaluate(() => [...document.querySelectorAll('button, select, input, summary, #stage')].filter((one) => !one.disabled && one.checkVisibility()).length);
    const reached = new Set();
    for (let i = 0; i < all + 20; i += 1) {
      await page.keyboard.press('Tab');
      reached.add(await page.evaluate(() => {
        window.places ??= new Map();
        const at = document.activeElement;
        if (!window.places.has(at)) window.places.set(at, at === document.body ? -1 : window.places.size);
        return window.places.get(at);
      }));
    }
    reached.delete(-1);
    check(reached.size >= all, `Tab reaches ${reached.size} of ${all} controls`);
    return `${all} controls`;
  })],

  ['accessibility', withHost({ scene: 'slab', hz: 2 }, async ({ page, host }) => {
    host.mock.faults = ['e_stop'];
    await until(page, () => document.querySelector('#alerts [data-name]'));
    await page.evaluate(() => document.querySelectorAll('details').forEach((one) => (one.open = true)));
    const axe = createRequire(import.meta.url).resolve('axe-core/axe.min.js');
    await page.evaluate(String(await readFile(axe)));
    const found = await page.evaluate(() => window.axe.run(document, { resultTypes: ['violations'] }));
    const serious = found.violations.filter((one) => ['serious', 'critical'].includes(one.impact));
    check(serious.length === 0, serious.map((one) => `${one.id}: ${one.help}: ${one.nodes.map((node) => node.html.slice(0, 120)).join(' | ')}`).join('\n'));
    return `${found.violations.length} lesser findings`;
  })],
];

/** With a browser of its own, beside others. */
export const long = [
  ['memory is level', withHost({ scene: 'tube', hz: 30 }, async ({ page }) => {
    const client = await page.context().newCDPSession(page);
    const used = async () => {
      await client.send('HeapProfiler.collectGarbage');
      const { metrics } = await client.send('Performance.getMetrics');
      const counts = await page.evaluate(() => ({ ...window.sutura.stage.renderer.info.memory }));
      return { heap: metrics.find((one) => one.name === 'JSHeapUsedSize').value, ...counts };
    };
    await client.send('Performance.enable');
    // Pictures to look back to fill up for 30 s, and are no leak.
    await page.evaluate(() => (window.sutura.past.add = () => {}));
    await settled(page, 4000);
    const before = await used();
    await settled(page, 8000);
    const after = await used();
    check(after.heap - before.heap < 4e6, `the heap grew by ${after.heap - before.heap} bytes in 8 s`);
    check(after.geometries === before.geometries && after.textures === before.textures, JSON.stringify({ before, after }));
    return `${(after.heap / 1e6).toFixed(1)} MB, ${((after.heap - before.heap) / 1e3).toFixed(0)} kB more after 8 s`;
  })],
];

/** Size, and frames a second of drawing alone, by the median of five with new vertices. In the page. */
function framesASecond() {
  const { stage, picture } = window.sutura;
  stage.resolution = 1;
  stage.resize();
  const times = [];
  for (let i = 0; i < 7; i += 1) {
    const start = performance.now();
    window.sutura.show(picture);
    stage.render();
    stage.waitForPixels();
    times.push(performance.now() - start);
  }
  const median = times.slice(2).sort((a, b) => a - b)[2];
  return `${stage.renderer.domElement.width}x${stage.renderer.domElement.height}: ${(1000 / median).toFixed(1)}/s`;
}

/**
 * Places along the needle's middle that are inside the tubes' walls, or outside of them, and at how many of these the picture is
 * another one without the needle. In the page.
 */
function needleSeen() {
  const { hello, instruments, stage } = window.sutura;
  const { mesh, hidden } = instruments.needles.get(0);
  stage.resolution = 1;
  stage.resize();
  const gl = stage.renderer.getContext();
  const [width, height] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
  const read = () => {
    stage.render();
    const bytes = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    return bytes;
  };
  const both = [mesh, hidden.line];
  const visible = both.map((one) => one.visible);
  const [seen, bare] = [read(), (both.forEach((one) => (one.visible = false)), read())];
  both.forEach((one, i) => (one.visible = visible[i]));
  const found = { inside: 0, insideSeen: 0, outside: 0, outsideSeen: 0 };
  const { points_m: points } = hello.needles[0];
  for (let i = 0; i < 10 * (points.length - 1); i += 1) {
    const [a, b] = [points[Math.floor(i / 10)], points[Math.floor(i / 10) + 1]];
    const at = stage.centre.clone().fromArray(a.map((x, axis) => x + ((i % 10) / 10) * (b[axis] - x))).applyMatrix4(mesh.matrixWorld);
    const [radius, z] = [Math.hypot(at.x, at.y), at.z];
    // Half a millimetre into the walls, which is more than the needle is thick; and as far away from them.
    const within = (inner, outer, from, to, by) => radius > inner + by && radius < outer - by && z > from + by && z < to - by;
    const walls = [[0.008, 0.011, 0.001, 0.03], [0.009, 0.012, -0.03, -0.001]];
    const inside = walls.some((wall) => within(...wall, 5e-4));
    if (!inside && walls.some((wall) => within(...wall, -5e-4))) continue;
    at.project(stage.camera);
    const place = 4 * (Math.floor((height * (at.y + 1)) / 2) * width + Math.floor((width * (at.x + 1)) / 2));
    const differs = [0, 1, 2].some((channel) => Math.abs(seen[place + channel] - bare[place + channel]) > 12);
    const name = inside ? 'inside' : 'outside';
    found[name] += 1;
    if (differs) found[`${name}Seen`] += 1;
  }
  return found;
}

async function expectMode(host, mode, what) {
  for (let i = 0; i < 100 && host.mock.mode !== mode; i += 1) await new Promise((resolve) => setTimeout(resolve, 50));
  check(host.mock.mode === mode, `${what}: the host's mode is ${host.mock.mode}, not ${mode}`);
}

/** Largest CIE76 difference between pixels on the tissue and the legend's colour of the picture's value there. In the page. */
async function colourErrors() {
  const { sutura } = window;
  const [{ colourAt }, THREE] = await Promise.all([import('/page/colours.js'), import('three')]);
  const { stage, tissue, picture, colouring: { range } } = sutura;
  stage.choose('lean', 'chosen by hand');
  stage.look('top');
  sutura.show(picture);
  stage.render();
  const gl = stage.renderer.getContext();
  const [width, height] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
  const bytes = new Uint8Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
  const lab = (colour) => {
    const [r, g, b] = colour.map((value) => (value / 255 <= 0.04045 ? value / 255 / 12.92 : ((value / 255 + 0.055) / 1.055) ** 2.4));
    const f = (t) => (t > 0.008856 ? Math.cbrt(t) : 7.787 * t + 16 / 116);
    const [x, y, z] = [f((0.4124 * r + 0.3576 * g + 0.1805 * b) / 0.9505), f(0.2126 * r + 0.7152 * g + 0.0722 * b), f((0.0193 * r + 0.1192 * g + 0.9505 * b) / 1.089)];
    return [116 * y - 16, 500 * (x - y), 200 * (y - z)];
  };
  const [low, high] = range.ends;
  const step = (picture.scalarHigh - picture.scalarLow) / 65535;
  const value = (vertex) => picture.scalarLow + picture.scalars[tissue.surface.source[vertex]] * step;
  const caster = new THREE.Raycaster();
  tissue.buffers.boundingSphere = null;
  let worst = { error: -1, places: 0, at: {} };
  // Vertices of the top, around and below the tool.
  for (let i = 0; i < tissue.positions.count; i += 1) {
    const point = new THREE.Vector3().fromBufferAttribute(tissue.positions, i);
    if (point.z < -0.012 || Math.abs(point.x - 0.008) > 0.02 || Math.abs(point.y) > 0.02) continue;
    point.project(stage.camera);
    const [px, py] = [Math.floor(((point.x + 1) * width) / 2), Math.floor(((point.y + 1) * height) / 2)];
    caster.setFromCamera(new THREE.Vector2((2 * (px + 0.5)) / width - 1, (2 * (py + 0.5)) / height - 1), stage.camera);
    const hit = caster.intersectObject(tissue.skin)[0];
    if (!hit?.face) continue;
    const corner = (vertex) => new THREE.Vector3().fromBufferAttribute(tissue.positions, vertex);
    const { a, b, c } = hit.face;
    const weights = THREE.Triangle.getBarycoord(hit.point, corner(a), corner(b), corner(c), new THREE.Vector3());
    const here = weights.x * value(a) + weights.y * value(b) + weights.z * value(c);
    const at = 4 * (py * width + px);
    const [seen, wanted] = [[...bytes.slice(at, at + 3)], colourAt(sutura.tissue.signed, (here - low) / (high - low))];
    const [p, q] = [lab(seen), lab(wanted)];
    const error = Math.hypot(p[0] - q[0], p[1] - q[1], p[2] - q[2]);
    worst.places += 1;
    if (error > worst.error) worst = { ...worst, error, at: { seen, wanted } };
  }
  return worst;
}

/** Disparities of three spheres at known depths, seen and wanted [px]. In the page. */
async function disparities(mode) {
  const THREE = await import('three');
  const { stage } = window.sutura;
  stage.choose('lean', 'chosen by hand');
  stage.stereo.mode = mode;
  stage.resolution = 1;
  stage.resize();
  const hidden = stage.scene.children.filter((one) => one.visible && one.isGroup);
  hidden.forEach((one) => (one.visible = false));
  const background = stage.scene.background;
  stage.scene.background = new THREE.Color(0);
  const distance = stage.camera.position.distanceTo(stage.controls.target);
  const half = distance * Math.tan((stage.camera.fov * Math.PI) / 360);
  const spheres = [0.8, 1, 1.25].map((depth, i) => {
    const mesh = new THREE.Mesh(new THREE.SphereGeometry(0.03 * half * depth, 32, 24), new THREE.MeshBasicMaterial({ color: 0xffffff, toneMapped: false }));
    // One above the other as they are seen, so that each has rows of its own.
    mesh.position.set(0, (0.5 - 0.5 * i) * half * depth, -distance * depth);
    mesh.position.applyMatrix4(stage.camera.matrixWorld);
    stage.scene.add(mesh);
    return { mesh, depth };
  });
  stage.render();
  const gl = stage.renderer.getContext();
  const [width, height] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
  const bytes = new Uint8Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
  const halves = mode.startsWith('anaglyph') ? 1 : 2;
  const eye = width / halves;
  const middle = (row, from, channel) => {
    let [sum, weight] = [0, 0];
    for (let y = Math.round(row - 0.12 * height); y < row + 0.12 * height; y += 1) {
      for (let x = 0; x < eye; x += 1) {
        const value = bytes[4 * (y * width + from + x) + channel];
        sum += value * (x + 0.5);
        weight += value;
      }
    }
    return sum / weight;
  };
  const found = spheres.map(({ mesh, depth }, i) => {
    const row = height * (0.5 + 0.25 * (1 - i));
    const [left, right] = halves === 2 ? [middle(row, 0, 0), middle(row, eye, 0)] : [middle(row, 0, 0), middle(row, 0, 2)];
    stage.scene.remove(mesh);
    const separation = distance * stage.stereo.separation;
    const aspect = eye / height;
    const tangent = Math.tan((stage.camera.fov * Math.PI) / 360);
    return { depth, seen: right - left, wanted: ((1 - 1 / depth) * separation * eye) / (2 * distance * tangent * aspect) };
  });
  stage.scene.background = background;
  hidden.forEach((one) => (one.visible = true));
  return found;
}

/** How long a film lasts that the browser has made [s]. In the page. */
function filmSeconds(base64) {
  const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
  const video = document.createElement('video');
  video.muted = true;
  video.src = URL.createObjectURL(new Blob([bytes], { type: 'video/webm' }));
  return new Promise((resolve, reject) => {
    video.addEventListener('error', () => reject(new Error('the film cannot be read')));
    // Its length is known when its end has been looked for.
    video.addEventListener('loadedmetadata', () => (video.currentTime = 1e6));
    video.addEventListener('durationchange', () => Number.isFinite(video.duration) && resolve(video.duration));
  });
}
