// The list of scenes: loaded, loading and failed ones.

import { getJson } from './api.js';
import { $, button, bytes, count, option, rows } from './message.js';
import { digits, norm, sub } from './pose.js';

let scenes = [];

export const all = () => scenes;
export const isUsable = scene => scene.state !== 'loading' && scene.state !== 'failed';
export const usable = () => scenes.filter(isUsable);
export const find = id => usable().find(scene => scene.id === id);

export async function refresh() {
  scenes = (await getJson('/v1/scenes')).scenes;
  return scenes;
}

// The default scene of a page: the first in the list, which was loaded first.
export const greeting = () => usable()[0];

// A scene's name where it stands without a list.
export const fullName = scene => !scene.name || scene.name === scene.id ? scene.id : `${scene.name} (${scene.id})`;

// A scene's name in lists, with its id if another scene has the same name.
function nameInList(scene) {
  if (scene.state === 'loading' || scene.state === 'failed') return `${scene.id} (${scene.state})`;
  return scenes.some(other => other.id !== scene.id && other.name === scene.name) ? fullName(scene) : scene.name || scene.id;
}

const short = n => n >= 1e6 ? (n / 1e6).toPrecision(3) + ' M' : n >= 1e4 ? Math.round(n / 1e3) + ' k' : String(n);
const size = ([low, high]) => high.map((v, i) => Number((v - low[i]).toPrecision(3))).join(' × ');

function inWords(scene) {
  if (scene.state === 'loading') return `being loaded for ${Math.round(scene.loading_ms / 1000)} s`;
  if (scene.state === 'failed') return `could not be loaded: ${scene.problem.detail}`;
  const counts = [[scene.samples, 'sample'], [scene.triangles, 'triangle'], [scene.segments, 'segment'], [scene.instances, 'instance']];
  const shown = counts.filter(([n]) => n > 0).map(([n, what]) => `${short(n)} ${n === 1 ? what : what + 's'}`);
  return [...shown, scene.bounds ? size(scene.bounds) : 'empty'].join(', ');
}

// Id of the scene whose deletion is to be confirmed.
let doubtful = null;
let shown = '';

export function show(current, choose, remove) {
  // Leave an unchanged list alone, so that an open one stays open.
  const now = JSON.stringify([current?.id, doubtful, scenes]);
  if (now === shown) return;
  shown = now;
  $('scene').replaceChildren(...scenes.map(scene => option(scene.id, nameInList(scene), !isUsable(scene))));
  if (current) $('scene').value = current.id;
  $('scenes-summary').textContent = String(scenes.length);
  const again = (id, focused) => {
    doubtful = id;
    show(current, choose, remove);
    $('scene-list').querySelector(focused)?.focus();
  };
  $('scene-list').replaceChildren(...scenes.map(scene => {
    const item = document.createElement('li'), facts = document.createElement('small');
    const main = button(nameInList(scene), () => choose(scene.id));
    main.dataset.scene = scene.id;
    main.disabled = !isUsable(scene);
    main.setAttribute('aria-pressed', String(Boolean(current) && scene.id === current.id));
    facts.textContent = inWords(scene);
    main.append(facts);
    const away = button('✕', () => again(scene.id, '[data-keep]'));
    away.title = `Delete ${scene.id} …`;
    away.setAttribute('aria-label', away.title);
    away.dataset.remove = scene.id;
    away.disabled = scene.state === 'loading';
    item.append(main, away);
    if (doubtful === scene.id) item.append(question(scene, () => { doubtful = null; remove(scene.id); }, () => again(null, `[data-remove="${scene.id}"]`)));
    return item;
  }));
}

function question(scene, remove, keep) {
  const box = document.createElement('div'), text = document.createElement('p');
  box.className = 'question';
  text.textContent = `Delete ${fullName(scene)}? Files that were uploaded for it are gone for good; a scene that the server was started with is back when it starts again.`;
  const kept = button('Keep', keep), deleted = button('Delete', remove);
  kept.dataset.keep = deleted.dataset.delete = scene.id;
  box.append(text, kept, ' ', deleted);
  return box;
}

export function facts(scene) {
  const { bounds: found } = scene, extent = found ? norm(sub(found[1], found[0])) || 1 : 1;
  const corner = v => v.map(x => digits(x, extent)).join(', '), some = (name, n) => n > 0 ? [[name, count(n)]] : [];
  rows($('about'), [
    ['id', scene.id], ['revision', count(scene.revision)],
    ...some('samples', scene.samples), ...some('triangles', scene.triangles), ...some('segments', scene.segments), ...some('instances', scene.instances),
    ...(scene.bounds ? [['from', corner(scene.bounds[0])], ['to', corner(scene.bounds[1])], ['size', size(scene.bounds)]] : [['bounds', 'empty']]),
    ...some('lights', scene.lights), ['GPU memory', bytes(scene.gpu_bytes)],
    ['assets', scene.assets.map(a => `${a.name} (${a.format}${a.normals_estimated ? ', normals estimated' : ''})`).join(', ')],
    ...(scene.warnings.length ? [['warnings', scene.warnings.join('; ')]] : []),
  ]);
}
