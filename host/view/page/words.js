// Words that must be read: banners for what lasts, short messages for what has happened. Entry points: `Alerts`, `toast`.

/** How long a message stays [ms]. */
const TOAST_MS = 5000;
const MOST_TOASTS = 4;

/** @param {string} id @returns {HTMLElement} */
export function element(id) {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no #${id}`);
  return found;
}

/** Messages that are shown: how often each has come, and the timer that removes it. @type {WeakMap<Element, {count: number, timer: number}>} */
const toasts = new WeakMap();

/** Shows a message for a while; one that is shown already is counted instead. @param {string} text @param {boolean} [bad] */
export function toast(text, bad = false) {
  const box = element('toasts');
  let message = /** @type {HTMLElement | undefined} */ ([...box.children].find((one) => one instanceof HTMLElement && one.dataset.text === text));
  const before = message ? toasts.get(message) : undefined;
  clearTimeout(before?.timer);
  const count = (before?.count ?? 0) + 1;
  if (!message) {
    message = document.createElement('p');
    message.dataset.text = text;
    box.append(message);
  }
  message.textContent = count > 1 ? `${text} (${count} times)` : text;
  message.classList.toggle('bad', bad);
  while (box.children.length > MOST_TOASTS) box.firstElementChild?.remove();
  const shown = message;
  toasts.set(shown, { count, timer: window.setTimeout(() => shown.remove(), TOAST_MS) });
}

/** Banners by name; what has not changed is not written again, or it would be read aloud again. */
export class Alerts {
  constructor() {
    this.box = element('alerts');
    /** @type {Map<string, HTMLElement>} */
    this.shown = new Map();
  }

  /**
   * @param {string} name
   * @param {string} message nothing: the banner goes
   * @param {string} [help]
   * @param {'bad' | 'warn'} [kind]
   */
  set(name, message, help = '', kind = 'bad') {
    const before = this.shown.get(name);
    if (!message) {
      before?.remove();
      this.shown.delete(name);
      return;
    }
    if (before?.dataset.text === message + help) return;
    const banner = document.createElement('p');
    banner.className = kind;
    banner.dataset.text = message + help;
    banner.dataset.name = name;
    const strong = document.createElement('strong');
    strong.textContent = message;
    const rest = document.createElement('span');
    rest.textContent = help;
    banner.append(strong, rest);
    if (before) before.replaceWith(banner);
    else this.box.append(banner);
    this.shown.set(name, banner);
  }

  /** Removes banners whose names begin so and that are not among `kept`. @param {string} prefix @param {string[]} kept */
  only(prefix, kept) {
    for (const name of [...this.shown.keys()]) if (name.startsWith(prefix) && !kept.includes(name)) this.set(name, '');
  }
}
