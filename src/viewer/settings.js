// Settings of frames: each is a parameter of a frame and a control of the same name, whose first option is the default.

import { $ } from './message.js';

export const NAMES = ['output', 'lod', 'max_error_px', 'error_mode', 'paint', 'reconstruct', 'filter', 'prefilter', 'blend', 'shading', 'quality'];
const OF_SPLATS = ['filter', 'prefilter', 'blend', 'shading'];

let scene = null;

// Whether splats are asked for, by name.
const ofSplats = () => !['auto', 'points'].includes($('reconstruct').value);

// Whether a setting means anything for this scene and the other settings.
function applies(name) {
  if (name === 'output' || name === 'lod') return true;
  if (name === 'quality') return $('output').value === 'color';
  if (name === 'max_error_px') return $('lod').value === 'spt';
  if (name === 'error_mode') return $('lod').value === 'spt' && ofSplats();
  if (name === 'paint') return $('lod').value === 'spt' && $('output').value === 'color';
  // Meshes have samples where detail is chosen.
  if (!scene || !(scene.samples || $('lod').value === 'spt')) return false;
  if (name === 'reconstruct') return true;
  if (!ofSplats()) return false;
  if (name === 'filter' || name === 'prefilter') return true;
  if ($('reconstruct').value === 'fuzzy') return false;
  return name !== 'shading' || (scene.lights > 0 && $('blend').value !== 'opaque' && $('output').value === 'color');
}

function showSettings() {
  for (const name of NAMES) $(name).parentElement.hidden = !applies(name);
}

export function ofScene(info) {
  scene = info;
  for (const name of OF_SPLATS) $(name).options[0].text = 'as the scene';
  showSettings();
}

// Those that are not as they come, by name.
export function chosen() {
  return Object.fromEntries(NAMES.filter(name => applies(name) && $(name).selectedIndex > 0).map(name => [name, $(name).value]));
}

// What a frame is asked for with: only colours survive lossy compression.
export function parameters() {
  const { quality, ...found } = chosen();
  if (found.max_error_px) found.max_error_px = Number(found.max_error_px);
  if (found.prefilter) found.prefilter = found.prefilter === 'true';
  return { ...found, ...(quality ? { format: 'jpeg', quality: Number(quality) } : { format: 'png' }) };
}

// What a setting takes, where it does not take this; otherwise null.
export function refused(name, value) {
  const values = [...$(name).options].map(o => o.value);
  return values.includes(value) ? null : values.filter(Boolean).join(', ');
}

export function restore(params) {
  for (const name of NAMES) {
    const index = [...$(name).options].findIndex(o => o.value === params.get(name));
    $(name).selectedIndex = Math.max(0, index);
  }
  showSettings();
}

// What the scene says, where nothing else was asked for.
export function nameDefaults(used) {
  for (const name of OF_SPLATS) {
    const list = $(name), found = [...list.options].find(o => o.value === String(used[name]));
    if (list.value === '' && found) list.options[0].text = `scene: ${found.text}`;
  }
}

export function onChange(changed) {
  for (const name of NAMES) $(name).addEventListener('change', () => { showSettings(); changed(); });
}
