// The list of scenes: what is loaded, what is on its way, what failed.

import { getJson } from './api.js';
import { $, bytes, count, option, rows } from './message.js';

let scenes = [];

export const all = () => scenes;
export const isUsable = scene => scene.state !== 'loading' && scene.state !== 'failed';
export const usable = () => scenes.filter(isUsable);
export const find = id => usable().find(scene => scene.id === id);

export async function refresh() {
  scenes = (await getJson('/v1/scenes')).scenes;
  return scenes;
}

const short = n => n >= 1e6 ? (n / 1e6).toPrecision(3) + ' M' : n >= 1e4 ? Math.round(n / 1e3) + ' k' : String(n);
const size = ([low, high]) => high.map((v, i) => Number((v - low[i]).toPrecision(3))).join(' × ');

function inWords(scene) {
  if (scene.state === 'loading') return `being loaded for ${Math.round(scene.loading_ms / 1000)} s`;
  if (scene.state === 'failed') return `could not be loaded: ${scene.problem.detail}`;
  const counts = [[scene.samples, 'samples'], [scene.triangles, 'triangles'], [scene.instances, scene.instances === 1 ? 'instance' : 'instances']];
  const shown = counts.filter(([n]) => n > 0).map(([n, what]) => `${short(n)} ${what}`);
  return [...shown, scene.bounds ? size(scene.bounds) : 'empty'].join(', ');
}

export function show(current, choose) {
  const text = scene => scene.state === 'loading' ? `${scene.id} (loading)` : scene.state === 'failed' ? `${scene.id} (failed)` : scene.name || scene.id;
  $('scene').replaceChildren(...scenes.map(scene => option(scene.id, text(scene), !isUsable(scene))));
  if (current) $('scene').value = current.id;
  $('scenes-summary').textContent = String(scenes.length);
  $('scene-list').replaceChildren(...scenes.map(scene => {
    const item = document.createElement('li'), button = document.createElement('button'), facts = document.createElement('small');
    button.type = 'button';
    button.dataset.scene = scene.id;
    button.disabled = !isUsable(scene);
    button.setAttribute('aria-pressed', String(Boolean(current) && scene.id === current.id));
    facts.textContent = inWords(scene);
    button.append(text(scene), facts);
    button.addEventListener('click', () => choose(scene.id));
    item.append(button);
    return item;
  }));
}

export function facts(scene) {
  const corner = v => v.map(x => Number(x.toPrecision(6))).join(', ');
  rows($('about'), [
    ['id', scene.id], ['revision', count(scene.revision)],
    ['samples', count(scene.samples)], ['triangles', count(scene.triangles)], ['instances', count(scene.instances)],
    ...(scene.bounds ? [['from', corner(scene.bounds[0])], ['to', corner(scene.bounds[1])], ['size', size(scene.bounds)]] : [['bounds', 'empty']]),
    ['lights', count(scene.lights)], ['GPU memory', bytes(scene.gpu_bytes)],
    ['assets', scene.assets.map(a => `${a.name} (${a.format}${a.normals_estimated ? ', normals estimated' : ''})`).join(', ')],
    ...(scene.warnings.length ? [['warnings', scene.warnings.join('; ')]] : []),
  ]);
}
