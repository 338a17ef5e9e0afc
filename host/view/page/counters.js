// The panel's counters: figures of a session that the top bar has no room for. Entry point: `counters`.

import { fixed } from './units.js';

/** Limits of a device, by their key. @type {Record<string, string | undefined>} */
const LIMITS = { force: 'largest force', current: 'largest current (in force)', power: 'largest power', speed: 'largest speed', slew: 'slew' };

/**
 * Names and values.
 * @param {import('./link.js').Gauges} gauges
 * @param {import('./decode.js').Picture['status'] | undefined} status of the picture that is shown
 * @param {string[]} statuses the solver's words
 * @param {number | null | undefined} boardRowsHz frames of 24 rows a second that the console's board has time for [Hz]
 * @returns {[string, string][]}
 */
export function counters(gauges, status, statuses, boardRowsHz) {
  const whole = (/** @type {number | null | undefined} */ value) => (value?.toLocaleString('en') ?? '–');
  const ms = (/** @type {import('./link.js').Percentiles | undefined} */ both) => (both ? `${fixed(both.p50 / 1000, 2)} / ${fixed(both.p99 / 1000, 2)} ms` : '–');
  const hz = (/** @type {number | null | undefined} */ value) => (Number.isFinite(value) ? `${fixed(value, 0)} Hz` : '–');
  const limited = Object.entries(gauges.ticks_limited ?? {}).filter(([, count]) => count !== null && count > 0);
  const withheld = Object.entries(gauges.withheld).filter(([, count]) => count > 0);
  return [
    ['Solver', status ? (statuses[status.word] ?? '–') : '–'],
    ['Vertices touched', whole(status?.rows)],
    ['Touching tissue, pairs', whole(status?.pairs)],
    ['Newton iterations', whole(status?.iterations)],
    ['Residual', status ? status.residual.toExponential(1).replace('-', '−') : '–'],
    ['Largest thread tension', status && Number.isFinite(status.tension) ? `${fixed(status.tension, 3)} N` : '–'],
    ['Longest span', status && Number.isFinite(status.span) ? fixed(status.span, 3) : '–'],
    ['Latency, session p50 / p99', ms(gauges.latency_us?.all)],
    ['Step, session p50 / p99', ms(gauges.step_us?.all)],
    ['Round trip p50 / p99', ms(gauges.rtt_us?.now ?? gauges.rtt_us?.all)],
    ['Least energy', gauges.energy_min_j === null ? '–' : `${fixed(1000 * gauges.energy_min_j, 3)} mJ`],
    ['Ticks late', whole(gauges.ticks_late)],
    ['Tick overruns', whole(gauges.tick_overruns)],
    ...limited.map(([name, count]) => /** @type {[string, string]} */ ([`Ticks cut by the device's ${LIMITS[name] ?? name}`, whole(count)])),
    ['Frames of rows, sent / board takes', `${hz(gauges.rows_hz)} / ${hz(boardRowsHz)}`],
    ['Frames lost', whole(gauges.frames.lost)],
    ['Frames rejected', whole(gauges.frames.rejected)],
    ['Frames too late', whole(gauges.frames.late)],
    ['Frames superseded', whole(gauges.frames.superseded)],
    ...withheld.map(([name, count]) => /** @type {[string, string]} */ ([`Withheld: ${name}`, whole(count)])),
    ['Pictures made / sent', `${whole(gauges.pictures.made)} / ${whole(gauges.pictures.sent)}`],
    ['A picture takes', `${fixed(gauges.picture_us / 1000, 2)} ms`],
    ['Clients', whole(gauges.clients)],
  ];
}
