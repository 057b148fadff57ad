// Messages over the picture: problems with the accepted values, waiting, and news. Each message has a subject, and stays until
// the subject changes or the user dismisses it. Messages of different subjects never hide each other.

export const $ = id => document.getElementById(id);

// The messages by subject. A Map keeps their order.
const boxes = new Map();

// kind: 'problem', 'wait' (it is tried again) or 'news'. `of`: the subject, whose last message is replaced. `actions`: [label,
// function] pairs.
export function tell(kind, problem, actions = [], of = kind) {
  const box = document.createElement('div'), head = document.createElement('strong');
  box.className = kind;
  box.dataset.of = of;
  box.setAttribute('role', 'alert');
  head.textContent = titleOf(problem);
  const where = problem.parameter && !(problem.detail || '').startsWith(problem.parameter) ? `At: ${problem.parameter}` : null;
  const lines = [problem.detail || problem.message, where, problem.accepted && `Accepted: ${problem.accepted}`];
  box.append(head, ...lines.filter(Boolean).map(paragraph), ...actions.map(([words, act]) => button(words, act)));
  // The message keeps its place, so that repeating it does not move the others.
  if (boxes.has(of)) boxes.get(of).replaceWith(box); else $('message').prepend(box);
  boxes.set(of, box);
  $('message').hidden = false;
}

// Titles from the server begin in lower case. Other titles may begin with a file's name, which stays as it is.
function titleOf({ title = 'Something went wrong', status }) {
  return status ? `${title[0].toUpperCase() + title.slice(1)} (${status})` : title;
}

function paragraph(text) {
  const p = document.createElement('p');
  p.textContent = text;
  return p;
}

// `actions`: buttons beside Dismiss.
export function complain(problem, of = 'problem', actions = []) {
  tell('problem', problem, [...actions, ['Dismiss', () => quiet(of)]], of);
}

// Removes the messages of these subjects.
export function quiet(...of) {
  for (const name of of) {
    boxes.get(name)?.remove();
    boxes.delete(name);
  }
  $('message').hidden = boxes.size === 0;
}

// --- fields --------------------------------------------------------------------------------------
// Shows what is wrong with an input beside its field; null removes it.
export function fault(input, text) {
  const id = `${input.id}-fault`;
  input.setAttribute('aria-invalid', String(Boolean(text)));
  let note = $(id);
  if (!text) {
    input.removeAttribute('aria-describedby');
    return note?.remove();
  }
  if (!note) {
    note = document.createElement('small');
    note.id = id;
    note.className = 'fault';
    note.setAttribute('role', 'alert');
    input.closest('label').append(note);
  }
  note.textContent = text;
  input.setAttribute('aria-describedby', id);
}

// The number in a field if it is in range; otherwise NaN, and the field shows the range.
export function numberIn(input, [least, most], unit, stays) {
  const value = input.value.trim() === '' ? NaN : Number(input.value);
  const isGood = value >= least && value <= most;
  fault(input, isGood ? null : `${least} to ${count(most)}${unit}; ${stays}`);
  return isGood ? value : NaN;
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

export function button(words, act) {
  const made = document.createElement('button');
  made.type = 'button';
  made.textContent = words;
  made.addEventListener('click', act);
  return made;
}
