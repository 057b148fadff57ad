// What is told the user: problems with what would be accepted, waiting, and news. One at a time, over the picture.

export const $ = id => document.getElementById(id);

// kind: 'problem', 'wait' (it is being tried again) or 'news'. `actions` are [words, what they do].
export function tell(kind, problem, actions = []) {
  const box = $('message'), head = document.createElement('strong');
  box.className = kind;
  box.dataset.of = '';
  const title = problem.title || 'Something went wrong', capital = title[0].toUpperCase() + title.slice(1);
  head.textContent = problem.status ? `${capital} (${problem.status})` : capital;
  const where = problem.parameter && !(problem.detail || '').startsWith(problem.parameter) ? `At: ${problem.parameter}` : null;
  const lines = [problem.detail || problem.message, where, problem.accepted && `Accepted: ${problem.accepted}`];
  const buttons = actions.map(([words, act]) => {
    const button = document.createElement('button');
    button.type = 'button';
    button.textContent = words;
    button.addEventListener('click', act);
    return button;
  });
  box.replaceChildren(head, ...lines.filter(Boolean).map(paragraph), ...buttons);
  box.hidden = false;
}

function paragraph(text) {
  const p = document.createElement('p');
  p.textContent = text;
  return p;
}

export const complain = problem => tell('problem', problem, [['Dismiss', quiet]]);

// A problem of a frame is over when a frame is there.
export function complainOfFrame(problem) {
  complain(problem);
  $('message').dataset.of = 'frame';
}

export function quiet() { $('message').hidden = true; }

// Ends messages about waiting, and with a good frame those about bad ones; the others stay until they are read.
export function quietWaiting(isGoodFrame) {
  const { className, dataset } = $('message');
  if (className === 'wait' || (isGoodFrame && dataset.of === 'frame')) quiet();
}

// --- numbers in words ----------------------------------------------------------------------------
export const count = n => n == null ? 'unknown' : n.toLocaleString('en');
export const ms = ns => ns == null ? '–' : (ns / 1e6).toFixed(ns < 1e7 ? 2 : 1);
export function bytes(n) {
  if (n == null) return 'unknown';
  for (const unit of ['B', 'KiB', 'MiB']) {
    if (n < 1024) return `${unit === 'B' ? n : n.toFixed(1)} ${unit}`;
    n /= 1024;
  }
  return n.toFixed(2) + ' GiB';
}

export function rows(list, pairs) {
  list.replaceChildren(...pairs.flatMap(([name, value]) => {
    const dt = document.createElement('dt'), dd = document.createElement('dd');
    dt.textContent = name;
    dd.textContent = value;
    return [dt, dd];
  }));
}

export function option(value, text, isDisabled) {
  const element = new Option(text, value);
  element.disabled = Boolean(isDisabled);
  return element;
}
