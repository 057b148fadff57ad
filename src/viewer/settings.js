// Settings of frames: those that the server declares (/v1/settings), each with a control of its name, and two of this page: the
// output, and the encoding at rest.

import { getJson } from './api.js';
import { $, complain, fault } from './message.js';

const declared = await getJson('/v1/settings').then(answer => answer.settings, problem => { complain(problem, 'settings'); return []; });

export const NAMES = ['output', ...declared.map(setting => setting.name), 'quality'];

let scene = null;
// Settings of the last frame, including the scene's defaults.
let drawn = {};

function control(setting) {
  const label = document.createElement('label');
  label.append(setting.label + ' ');
  label.title = setting.help;
  if (setting.kind === 'number') {
    const input = document.createElement('input');
    Object.assign(input, { id: setting.name, type: 'number', min: setting.least, max: setting.most, step: 'any', inputMode: 'decimal', placeholder: setting.default ?? (setting.absent === 'the scene’s' ? 'as the scene' : setting.absent) });
    label.append(input);
    return label;
  }
  if (setting.kind === 'text') {
    const input = document.createElement('input'), hints = document.createElement('datalist');
    Object.assign(input, { id: setting.name, type: 'text', pattern: setting.pattern.slice(1, -1), placeholder: setting.default, size: 12 });
    hints.id = `${setting.name}-hints`;
    hints.append(...setting.examples.map(example => new Option(example)));
    input.setAttribute('list', hints.id);
    label.append(input, hints);
    return label;
  }
  const list = document.createElement('select');
  list.id = setting.name;
  const choices = setting.kind === 'flag' ? [{ value: 'true', text: 'on' }, { value: 'false', text: 'off' }] : setting.choices;
  if (setting.default == null) list.append(new Option('as the scene', ''));
  const first = choices.filter(choice => choice.value === setting.default);
  for (const choice of [...first, ...choices.filter(choice => choice.value !== setting.default)]) {
    const option = new Option(choice.text ?? choice.value, choice.value);
    option.title = choice.help ?? '';
    list.append(option);
  }
  label.append(list);
  return label;
}

$('output').parentElement.after(...declared.map(control));

const isNumber = name => $(name).type === 'number';
const isWritten = name => $(name).tagName === 'INPUT';
const isDefault = name => isWritten(name) ? $(name).value === '' || !$(name).validity.valid : $(name).selectedIndex === 0;

const fieldNames = () => (scene?.fields ?? []).map(field => field.name);

// The facts that rules are checked against: settings and scene. Unknown facts are missing.
function facts() {
  const found = { output: $('output').value, lights: scene?.lights > 0 ? 'some' : 'none', casting_lights: scene?.casting_lights > 0 ? 'some' : 'none', scene_fog: scene?.fog ? 'some' : 'none', scene_occlusion: scene?.occlusion ? 'some' : 'none', fields: fieldNames() };
  for (const { name } of declared) found[name] = $(name).value || drawn[name];
  // With a level of detail, meshes have samples.
  found.samples = scene && (scene.samples || found.lod === 'spt') ? 'some' : 'none';
  found.blur = Number(found.aperture) > 0 || Number(found.shutter) > 0 ? 'some' : 'none';
  found.segments = scene?.segments ? 'some' : 'none';
  return found;
}

function holds(rule, found) {
  const fact = found[rule.of], values = [fact ?? []].flat().map(String).filter(Boolean);
  if (rule.is.length === 0) return values.length > 0;
  return fact === undefined || values.some(value => rule.is.includes(value));
}

// Whether a setting has an effect with this scene and the other settings.
function applies(setting, found) {
  const needed = setting.needs.filter(rule => rule.value === undefined || rule.value === found[setting.name]);
  const useful = setting.useful_with.filter(rule => rule.value === undefined);
  return [...needed, ...useful].every(rule => holds(rule, found));
}

// Values that cannot be drawn, such as colours by a field that the scene lacks, cannot be chosen.
function offerValues() {
  const found = facts();
  for (const { name, useful_with } of declared.filter(setting => setting.kind === 'choice')) {
    for (const option of $(name).options) {
      const rules = useful_with.filter(rule => rule.value === option.value);
      option.disabled = option.hidden = !rules.every(rule => holds(rule, found));
    }
  }
}

function applying() {
  const found = facts();
  const names = declared.filter(setting => applies(setting, found)).map(setting => setting.name);
  return new Set(['output', ...(found.output === 'color' ? ['quality'] : []), ...names]);
}

function showSettings() {
  const names = applying();
  for (const name of NAMES) $(name).parentElement.hidden = !names.has(name);
}

// Fills in a field where colours by one are wanted and none is named.
function nameField() {
  const names = fieldNames();
  if (applying().has('field') && !names.includes($('field').value) && names.length > 0) $('field').value = names[0];
}

export function ofScene(info) {
  if (info !== scene) drawn = {};
  scene = info;
  $('field-hints').replaceChildren(...fieldNames().map(name => new Option(name)));
  offerValues();
  for (const setting of declared) if (setting.default == null && !isWritten(setting.name)) $(setting.name).options[0].text = 'as the scene';
  showSettings();
}

// Settings that trade accuracy for time: name, default (null: the scene's), and whether the control is left at it.
export const trading = () => declared.filter(setting => setting.trades)
  .map(({ name, default: usual }) => ({ name, usual: usual ?? null, isUsual: isDefault(name) }));

// Sets those settings that trade accuracy for time, as a hand would. Those that `values` lacks take their defaults.
export function trade(values) {
  for (const { name } of trading()) {
    const control = $(name), wanted = name in values ? String(values[name]) : '';
    if (isWritten(name)) control.value = wanted;
    else control.selectedIndex = Math.max(0, [...control.options].findIndex(o => o.value === wanted));
    fault(control, null);
  }
  showSettings();
  told();
}

// Splits the parameters of a frame into its settings and the others: pose, size and encoding.
export function parted({ output: _, ...params }) {
  const names = new Set(declared.map(setting => setting.name)), own = {}, others = {};
  for (const [name, value] of Object.entries(params)) (names.has(name) ? own : others)[name] = value;
  return { own, others };
}

// Settings that differ from their defaults, by name.
export function chosen() {
  const names = applying();
  return Object.fromEntries(NAMES.filter(name => names.has(name) && !isDefault(name)).map(name => [name, $(name).value]));
}

// The parameters of a frame's request. Only colours survive lossy compression.
export function parameters() {
  const { quality, ...found } = chosen();
  for (const { name, kind } of declared) {
    if (!(name in found)) continue;
    if (kind === 'number') found[name] = Number(found[name]);
    if (kind === 'flag') found[name] = found[name] === 'true';
  }
  return { ...found, ...(quality ? { format: 'jpeg', quality: Number(quality) } : { format: 'png' }) };
}

// Says which values a setting accepts if it does not accept this one; otherwise null.
export function refused(name, value) {
  if (isNumber(name)) {
    const { min, max } = $(name), number = value.trim() === '' ? NaN : Number(value);
    return number >= Number(min) && number <= Number(max) ? null : `${min} to ${max}`;
  }
  if (isWritten(name)) return new RegExp(`^(${$(name).pattern})$`).test(value) ? null : declared.find(setting => setting.name === name).accepted;
  const values = [...$(name).options].map(o => o.value);
  return values.includes(value) ? null : values.filter(Boolean).join(', ');
}

export function restore(params) {
  for (const name of NAMES) {
    const value = params.get(name);
    if (isWritten(name)) $(name).value = value !== null && refused(name, value) === null ? value : '';
    else $(name).selectedIndex = Math.max(0, [...$(name).options].findIndex(o => o.value === value));
  }
  showSettings();
}

// Names the scene's default in controls that are left at it.
export function nameDefaults(used) {
  drawn = used;
  for (const { name } of declared.filter(setting => setting.default == null && !isWritten(setting.name))) {
    const list = $(name), found = [...list.options].find(o => o.value === String(used[name]));
    if (list.value === '' && found) list.options[0].text = `scene: ${found.text}`;
  }
  showSettings();
}

export const value = name => NAMES.includes(name) ? $(name).value : '';

// Sets a control, as a hand would.
export function set(name, value) {
  $(name).value = value;
  showSettings();
}

let told = () => {};

export function onChange(changed) {
  told = changed;
  for (const name of NAMES) {
    $(name).addEventListener('change', () => {
      if (isWritten(name)) {
        const problem = $(name).value === '' ? null : refused(name, $(name).value);
        fault($(name), problem && `${problem}; drawn with ${isNumber(name) && declared.find(setting => setting.name === name).default != null ? $(name).placeholder : "the scene's"}`);
      }
      nameField();
      showSettings();
      changed();
    });
  }
}
