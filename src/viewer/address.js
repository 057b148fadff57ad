// The page's address holds the scene, the view and the settings, so that a reload or a shared link shows the same picture.

import { queryText } from './api.js';
import { DEFAULT_FOV, norm, sub } from './pose.js';
import * as settings from './settings.js';

const OWN = ['scene', 'camera', 'eye', 'target', 'up', 'fov', 'ortho_height'];
const SIZES = { fov: [1, 170, 'degrees'], ortho_height: [1e-15, 1e15, 'scene units'] };

export const asked = () => new URLSearchParams(location.hash.slice(1) || location.search.slice(1));

export function write(scene, camera, pose) {
  const query = new URLSearchParams({ scene: scene.id, ...(camera ? { camera } : {}) });
  for (const name of ['eye', 'target', 'up']) query.set(name, pose[name].join(','));
  query.set('fov', pose.fov);
  for (const [name, value] of Object.entries(settings.chosen())) query.set(name, value);
  history.replaceState(null, '', '#' + queryText(query));
}

// Reads the parameters of an address for a scene: {camera, pose, faults}, a name or null, a pose or null, and a sentence for each
// parameter that cannot be used.
export function read(params, scene) {
  const faults = [...params.keys()].filter(name => !OWN.includes(name) && !settings.NAMES.includes(name)).map(name => `${name}: the viewer knows no such setting`);
  const named = params.get('camera'), camera = scene.cameras.find(other => other.name === named) || null;
  if (named && !camera) {
    const there = scene.cameras.map(other => other.name).join(', ');
    faults.push(`camera=${named}: ${there ? `the scene’s cameras are ${there}` : 'the scene has no cameras'}`);
  }
  for (const name of settings.NAMES) {
    const accepted = params.has(name) ? settings.refused(name, params.get(name)) : null;
    if (accepted) faults.push(`${name}=${params.get(name)}: accepted are ${accepted}`);
  }
  return { camera: camera && camera.name, pose: poseOf(params, scene, camera, faults), faults };
}

// Missing parts come from the camera, or without one from the scene's defaults. A pose with invalid parts is null.
function poseOf(params, scene, camera, faults) {
  const wanted = ['eye', 'target', 'up', 'fov', 'ortho_height'].filter(name => params.has(name)), before = faults.length;
  const pose = { up: scene.up, fov: DEFAULT_FOV };
  if (camera) Object.assign(pose, camera, { name: undefined });
  for (const name of wanted) {
    const text = params.get(name), size = SIZES[name], value = size ? numberOf(text) : text.split(',').map(numberOf);
    if (size ? value >= size[0] && value <= size[1] : value.length === 3 && value.every(Number.isFinite)) pose[name] = value;
    else faults.push(`${name}=${text}: ${size ? `${size[0]} to ${size[1]} ${size[2]}` : 'three numbers, as in 1,2,3'} are accepted`);
  }
  delete pose.name;
  if (pose.ortho_height == null || (params.has('fov') && !params.has('ortho_height'))) delete pose.ortho_height; else delete pose.fov;
  if (wanted.length === 0 || faults.length > before) return null;
  for (const name of ['eye', 'target']) if (!pose[name]) faults.push(`${name} is missing: a view needs eye and target`);
  if (faults.length === before && norm(sub(pose.eye, pose.target)) === 0) faults.push('eye and target are the same point');
  if (faults.length === before && norm(pose.up) === 0) faults.push('up has no length');
  return faults.length > before ? null : pose;
}

const numberOf = text => text.trim() === '' ? NaN : Number(text);
