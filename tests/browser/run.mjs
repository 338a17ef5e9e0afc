// Runs the page of `sutura view`: its modules under node, its types, then in a headless browser against a made-up host and
// against the program. `node tests/browser/run.mjs --sutura PATH --out DIR`; installs nothing, and says what is missing.

import { spawnSync } from 'node:child_process';
import { copyFileSync, existsSync, mkdirSync, statSync } from 'node:fs';
import path from 'node:path';
import { fileURLToPath } from 'node:url';
import { parseArgs } from 'node:util';

const HERE = fileURLToPath(new URL('.', import.meta.url));
const BROWSERS = ['/usr/bin/chromium', '/usr/bin/chromium-browser', '/usr/bin/google-chrome', '/usr/bin/google-chrome-stable'];
/** A picture of the book [bytes]. */
const MOST_BYTES = 150_000;
const HELP = `Tests the page of \`sutura view\` in a headless browser.

  node tests/browser/run.mjs --sutura PATH_TO_BINARY --out DIR [--only WORD] [--checkout] [--minutes M] [--book] [--full] [--seed N]

Without --sutura the program's own tests are left out, and that is said. Pictures of all tests are kept in DIR.
--checkout takes the page's files from here instead of the binary: for working on the page without building.
--minutes M watches memory for so long in place of one minute, once what is kept of the last one is full.
--full takes 200 pictures of recordings in place of six, at times that are drawn with the seed.
--book draws the program's pictures as a graphics card does, and copies those that the book shows into docs/src/view.
SUTURA_CHROMIUM names the browser, if it is not in /usr/bin.`;

const { values } = parseArgs({
  options: { sutura: { type: 'string' }, out: { type: 'string', default: 'out/browser' }, only: { type: 'string' }, checkout: { type: 'boolean' }, minutes: { type: 'string', default: '1' }, book: { type: 'boolean' }, full: { type: 'boolean' }, seed: { type: 'string' }, help: { type: 'boolean' } },
});
if (values.help) {
  console.log(HELP);
  process.exit(0);
}

/** What is missing, with the command that brings it. */
function missing() {
  const found = [];
  const executable = [process.env.SUTURA_CHROMIUM, ...BROWSERS].find((one) => one && existsSync(one));
  if (!executable) found.push('Chromium: apt-get install -y chromium, or set SUTURA_CHROMIUM');
  if (!existsSync(path.join(HERE, 'node_modules/playwright-core'))) found.push('packages: npm ci --ignore-scripts --prefix tests/browser');
  if (values.sutura && !existsSync(values.sutura)) found.push(`${values.sutura}: cargo build`);
  return { executable, found };
}

const { executable, found } = missing();
if (found.length > 0) {
  console.error(`Missing:\n  ${found.join('\n  ')}`);
  process.exit(2);
}
mkdirSync(values.out, { recursive: true });

const began = Date.now();
const counts = { passed: 0, failed: 0 };

/** @param {string} name @param {() => Promise<unknown> | unknown} run */
async function one(name, run) {
  if (values.only && !name.includes(values.only)) return;
  const begin = performance.now();
  try {
    const said = await run();
    counts.passed += 1;
    console.log(`ok    ${name} (${((performance.now() - begin) / 1000).toFixed(1)} s)${said ? `: ${said}` : ''}`);
  } catch (error) {
    counts.failed += 1;
    console.log(`FAIL  ${name}: ${error instanceof Error ? error.message : error}`);
  }
}

/** Pictures of the program's tests that the book shows, none too large to be read over a slow line. */
function copyForBook() {
  const folder = path.join(HERE, '../../docs/src/view');
  mkdirSync(folder, { recursive: true });
  const sewn = Array.from({ length: 8 }, (_, i) => `anastomosis-${i + 1}`);
  for (const name of ['palpation', 'stress', 'anastomosis', 'replay', ...sewn]) {
    const from = path.join(values.out, `program-${name}.png`);
    // With --only there are others of earlier runs.
    if (!existsSync(from) || statSync(from).mtimeMs < began) continue;
    const { size } = statSync(from);
    if (size > MOST_BYTES) {
      counts.failed += 1;
      console.log(`FAIL  ${from} is too large for the book: ${size} bytes, of ${MOST_BYTES}. Give it a smaller size in \`posed\``);
      continue;
    }
    copyFileSync(from, path.join(folder, `${name}.png`));
  }
}

/** @param {string} program @param {string[]} words */
function runs(program, words) {
  const done = spawnSync(program, words, { cwd: HERE, encoding: 'utf8' });
  if (done.status !== 0) throw new Error(`${done.stdout}${done.stderr}`);
}

await one('modules', () => runs(process.execPath, ['--test', 'units/']));
await one('types', () => runs(process.execPath, ['node_modules/typescript/bin/tsc', '--project', 'tsconfig.json']));

const { Browser } = await import('./harness.mjs');
// As it exits what it has started ends, too: browsers, and the program.
for (const [signal, number] of Object.entries({ SIGINT: 2, SIGTERM: 15, SIGHUP: 1 })) process.on(signal, () => process.exit(128 + number));
const page = await import('./suites/page.mjs');
const program = values.sutura ? await import('./suites/program.mjs') : { tests: [], long: [] };
if (!values.sutura) console.log('left out: tests of the program (no --sutura)');
// What watches memory waits most of its time: it has a browser of its own, and runs beside the others.
const suites = [[...page.tests, ...program.tests], [...page.long, ...program.long]];

await Promise.all(suites.map(async (all) => {
  const tests = all.filter(([name]) => !values.only || name.includes(values.only));
  if (tests.length === 0) return;
  const browser = new Browser({ executable, out: values.out, checkout: values.checkout });
  await browser.launch();
  for (const [name, run] of tests) await one(name, () => run({ browser, out: values.out, sutura: values.sutura, executable, book: values.book === true, minutes: Number(values.minutes), full: values.full === true, seed: Number(values.seed ?? Date.now() % 1e6) }));
  await browser.close();
}));
if (values.book) copyForBook();
console.log(`${counts.passed} passed, ${counts.failed} failed in ${((Date.now() - began) / 1000).toFixed(0)} s`);
process.exit(counts.failed > 0 || counts.passed === 0 ? 1 : 0);
