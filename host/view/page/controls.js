// Building blocks of the panel: sections, rows and controls with their names. Nothing here knows what they are for.

/** @param {HTMLElement} panel @param {string} title @param {boolean} open */
export function section(panel, title, open) {
  const details = document.createElement('details');
  details.open = open;
  const summary = document.createElement('summary');
  summary.textContent = title;
  const rows = document.createElement('div');
  rows.className = 'rows';
  details.append(summary, rows);
  panel.append(details);
  return rows;
}

let names = 0;

/** A control with its name in front. @template {HTMLElement} T @param {HTMLElement} rows @param {string} label @param {T} control @param {HTMLElement} [field] to be named, if not the control */
export function row(rows, label, control, field = control) {
  names += 1;
  const box = document.createElement('div');
  box.className = 'row';
  const name = document.createElement(field instanceof HTMLDivElement ? 'span' : 'label');
  name.textContent = label;
  name.id = `label-${names}`;
  if (name instanceof HTMLLabelElement) {
    field.id ||= `control-${names}`;
    name.htmlFor = field.id;
  } else {
    field.setAttribute('role', 'group');
    field.setAttribute('aria-labelledby', name.id);
  }
  box.append(name, control);
  rows.append(box);
  return control;
}

/** @param {[string, string][]} options value and text @param {string} chosen @param {(value: string) => void} change */
export function select(options, chosen, change) {
  const made = document.createElement('select');
  for (const [value, text] of options) made.append(new Option(text, value, false, value === chosen));
  made.addEventListener('change', () => change(made.value));
  return made;
}

/**
 * A slider with its value in words.
 * @param {{low: number, high: number, step: number, value: number}} range
 * @param {(value: number) => string} text
 * @param {(value: number) => void} change
 * @param {boolean} [late] only when it is let go
 */
export function slider(range, text, change, late = false) {
  const box = document.createElement('span');
  box.className = 'slide';
  const input = document.createElement('input');
  Object.assign(input, { type: 'range', min: String(range.low), max: String(range.high), step: String(range.step) });
  input.value = String(range.value);
  const output = document.createElement('output');
  output.textContent = text(range.value);
  input.addEventListener('input', () => {
    output.textContent = text(Number(input.value));
    if (!late) change(Number(input.value));
  });
  if (late) input.addEventListener('change', () => change(Number(input.value)));
  box.append(input, output);
  const set = (/** @type {number} */ value) => {
    input.value = String(value);
    output.textContent = text(value);
  };
  return { box, input, set };
}

/** @param {HTMLElement} into @param {string} label @param {boolean} on @param {(on: boolean) => void} change */
export function check(into, label, on, change) {
  const box = document.createElement('label');
  const input = document.createElement('input');
  input.type = 'checkbox';
  input.checked = on;
  input.addEventListener('change', () => change(input.checked));
  box.append(input, label);
  into.append(box);
  return input;
}

/** One of few, as buttons next to each other. @param {[string, string][]} options @param {string} chosen @param {(value: string) => void} change */
export function choice(options, chosen, change) {
  const box = document.createElement('div');
  box.className = 'choice';
  const set = (/** @type {string} */ value) => {
    for (const one of box.querySelectorAll('button')) one.setAttribute('aria-pressed', String(one.dataset.value === value));
  };
  for (const [value, text] of options) {
    const one = button(text, () => {
      set(value);
      change(value);
    });
    one.dataset.value = value;
    box.append(one);
  }
  set(chosen);
  return { box, set };
}

/** @param {string} text @param {() => void} action @param {string} [title] */
export function button(text, action, title = '') {
  const made = document.createElement('button');
  made.type = 'button';
  made.textContent = text;
  made.title = title;
  made.addEventListener('click', action);
  return made;
}

/** @param {HTMLElement} rows @param {string} text */
export function hint(rows, text) {
  const made = document.createElement('p');
  made.className = 'hint';
  made.textContent = text;
  rows.append(made);
  return made;
}
