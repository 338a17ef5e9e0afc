// Banners of what is wrong: faults with their fixes, a console or a host that has gone, a host that is late. Entry point:
// `Notices`.

import { Alerts, element } from './words.js';

/** Silent for so long, the host counts as gone [s]. */
const SILENCE_S = 2;

export class Notices {
  /** @param {import('./link.js').Link} link @param {import('./bar.js').Bar} bar */
  constructor(link, bar) {
    this.link = link;
    this.bar = bar;
    this.alerts = new Alerts();
    /** @type {import('./link.js').Hello | null} */
    this.hello = null;
    if (!link.key) this.alerts.set('link', 'This address has no key.', 'Open the address that sutura printed: it ends with #key=…');
  }

  get live() {
    return this.hello?.source === 'live';
  }

  /** @param {import('./link.js').Hello} hello */
  setSession(hello) {
    this.hello = hello;
    this.alerts.set('link', '');
    this.showFaults(hello.faults);
  }

  /** @param {import('./link.js').Gauges} gauges */
  setGauges(gauges) {
    const by = gauges.stopped_by;
    this.alerts.set('stopped', by ? `Safe stop, asked for by ${by}.` : '', 'The console rests until it is armed.', 'warn');
    this.showFaults(gauges.faults);
    this.alerts.set('console', gauges.connected || this.hello?.source === 'recording' ? '' : 'The console is gone.', 'Its values are crossed out. Look at its cable and power; the session goes on when it is back.');
    this.warnOfLateness(gauges);
  }

  /** @param {string[]} faults */
  showFaults(faults) {
    for (const name of faults) {
      const fix = this.hello?.fixes[name];
      this.alerts.set(`fault-${name}`, fix?.message ?? `Fault: ${name}`, fix?.help ?? '');
    }
    this.alerts.only('fault-', faults.map((name) => `fault-${name}`));
  }

  /** @param {import('./link.js').Gauges} gauges */
  warnOfLateness(gauges) {
    const age = gauges.age_us?.now?.p50 ?? 0;
    const horizon = 1000 * (this.hello?.horizon_ms ?? Infinity);
    const late = this.hello?.pace === 'real-time' && gauges.mode === 'armed' && age > horizon;
    const local = ['127.0.0.1', 'localhost', '[::1]'].includes(location.hostname);
    const port = location.port || '80';
    this.alerts.set('late', late ? 'The host lacks time: forces are older than their horizon.' : '', local ? `Watch from another PC (ssh -L ${port}:127.0.0.1:${port} THIS_PC), or choose the quality “lean”.` : 'Ask for a coarser mesh, or a simpler tissue.', 'warn');
  }

  /** Says what has gone, and crosses out its values. @param {import('./link.js').Gauges | null} gauges @param {boolean} shown whether a session is */
  showGone(gauges, shown) {
    const { alerts, link, live } = this;
    // Of a recording nothing comes that nobody has asked for.
    const gone = !link.open || (live && link.silence > SILENCE_S);
    this.bar.setGone(gone, live && gauges?.connected === false);
    element('view').classList.toggle('stale', gone && shown);
    if (link.final) alerts.set('link', 'The host has closed the connection.', link.final);
    else if (gone && link.key) alerts.set('link', `No connection to the host, last seen ${Math.floor(link.silence)} s ago.`, 'Trying again. Is sutura still running? A console stops by itself when its host is silent.');
    else if (link.key) alerts.set('link', '');
  }

  /** @param {string} badge of a recording that was run again @param {string} text */
  showVerdict(badge, text) {
    this.alerts.set('badge', badge === 'diverged' ? 'This recording could not be verified.' : '', text, 'warn');
  }

  /** @param {boolean} lost whether there is no picture, since the graphics card has dropped it */
  showLost(lost) {
    this.alerts.set('context', lost ? 'The graphics card has dropped the picture.' : '', 'It comes back by itself, or by reloading the page.', 'warn');
  }
}
