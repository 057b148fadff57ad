// The viewer: holds what is looked at, and joins the parts.
//
//   controls, recorder ──pose──▶ app ──▶ link ──▶ daemon
//   settings ────────────────────▶ │      │
//   scenes, upload ─scene──────────┘      └──frames──▶ canvas, receipt, chart

import * as api from './api.js';
import * as chart from './chart.js';
import { Controls } from './controls.js';
import { Films } from './film.js';
import { Link } from './link.js';
import { $, complain, complainOfFrame, option, quiet, quietWaiting, tell } from './message.js';
import { sampler } from './path.js';
import { poseFrom } from './pose.js';
import { report } from './receipt.js';
import { Recorder } from './recorder.js';
import { frameUrl } from './requests.js';
import * as scenes from './scenes.js';
import * as settings from './settings.js';
import * as upload from './upload.js';

const POLL_MS = 1500, RETURN_MS = 3000, NEWS_MS = 8000;

const canvas = $('canvas'), paper = canvas.getContext('2d');
let limits = { max_side: 8192, max_pixels: 1 << 25 };
let scene = null;
let pose = null;       // {eye, target, up, fov}; null: whatever the server thinks shows the whole scene
let gone = null;       // {id, pose} of a scene that was deleted, in case it comes back
let frames = 0, pollTimer = 0, newsTimer = 0;

// --- what is asked for ---------------------------------------------------------------------------
function fullSize() {
  const ratio = window.devicePixelRatio || 1;
  const w = Math.max(1, Math.round(canvas.clientWidth * ratio)), h = Math.max(1, Math.round(canvas.clientHeight * ratio));
  const shrink = Math.min(1, limits.max_side / Math.max(w, h), Math.sqrt(limits.max_pixels / (w * h)));
  return [Math.max(1, Math.floor(w * shrink)), Math.max(1, Math.floor(h * shrink))];
}

function parameters() {
  const [w, h] = fullSize();
  return { ...pose, w, h, ...settings.parameters() };
}

const link = new Link(() => scene && { id: scene.id, params: parameters() }, {
  frame: drawn, scene: edited, gone: wentAway, state: linkState, denied,
  problem: problem => { canvas.dataset.state = 'error'; complainOfFrame(problem); },
});

// moving: as Link.show has it.
function changed(moving) {
  if (!scene) return;
  canvas.dataset.state = 'waiting';
  link.show(moving);
}

function setPose(next, moving) {
  pose = next;
  if (document.activeElement !== $('fov')) $('fov').value = Number(pose.fov.toFixed(2));
  changed(moving);
}

// --- what comes ----------------------------------------------------------------------------------
function drawn(info, isNewest) {
  const [w, h] = fullSize(), isStill = info.quality === 'still';
  draw(info.picture, w, h);
  info.picture.close();
  adopt(info, isNewest);
  report(info, [w, h], link.seq);
  if (info.receipt) settings.nameDefaults(info.receipt.settings);
  canvas.dataset.state = isStill && isNewest ? 'still' : 'moving';
  canvas.dataset.frames = ++frames;
  canvas.dataset.revision = info.revision ?? '';
  quietWaiting(isStill && isNewest);
  if (isStill && isNewest) remember();
}

function draw(picture, w, h) {
  // object-fit keeps the shape until a frame of a new size is here.
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  const isIds = $('output').value === 'id';
  paper.imageSmoothingEnabled = !isIds;
  paper.imageSmoothingQuality = 'medium';
  paper.clearRect(0, 0, w, h);
  paper.drawImage(picture, 0, 0, w, h);
  if (isIds) colorIds(w, h);
}

// Neighbouring ids differ by one in the red channel: spread them over the colours.
function colorIds(w, h) {
  const image = paper.getImageData(0, 0, w, h), words = new Uint32Array(image.data.buffer);
  for (let i = 0; i < words.length; i++) {
    const id = words[i] & 0xffffff, hash = Math.imul(id, 0x9e3779b1) >>> 8;
    words[i] = id === 0 ? 0xff181410 : 0xff404040 | (hash & 0xbfbfbf);
  }
  paper.putImageData(image, 0, 0);
}

// The pose that the server chose is where moving about starts from.
function adopt(info, isNewest) {
  if (pose || !isNewest || !info.receipt?.camera) return;
  const { eye, target, up, fov_deg: fov } = info.receipt.camera;
  pose = { eye, target, up, fov };
  $('fov').value = Number(fov.toFixed(2));
}

// The address keeps the view, so that a reload or whoever is sent it sees the same.
function remember() {
  if (!pose || !scene) return;
  const query = new URLSearchParams({ scene: scene.id, eye: pose.eye.join(','), target: pose.target.join(','), up: pose.up.join(','), fov: pose.fov });
  for (const [name, value] of Object.entries(settings.chosen())) query.set(name, value);
  history.replaceState(null, '', '#' + api.queryText(query));
  $('link').href = frameUrl(scene.id, parameters());
  $('link').hidden = false;
}

// --- how the link fares --------------------------------------------------------------------------
function linkState(name, words, delayMs) {
  $('link-state').dataset.link = name;
  $('link-state').textContent = words;
  if (name === 'waiting') {
    canvas.dataset.state = 'error';
    const seconds = Math.max(1, Math.round(delayMs / 1000));
    const why = words[0].toUpperCase() + words.slice(1);
    const detail = `${why}. Trying again in ${seconds} s; the view stays where it is.`;
    tell('wait', { title: 'Not connected', detail }, [['Try now', () => link.again()]]);
  }
  if (name === 'stream') {
    // What is on the screen may be of before.
    canvas.dataset.state = 'waiting';
    quietWaiting();
  }
}

function edited(revision) {
  if (scene.revision === revision) return;
  refreshScene();
  tell('news', { title: 'The scene was changed', detail: `This is revision ${revision}.` }, [['Dismiss', quiet]]);
  clearTimeout(newsTimer);
  newsTimer = setTimeout(() => { if ($('message').className === 'news') quiet(); }, NEWS_MS);
}

async function refreshScene() {
  const { id } = scene;
  try {
    const info = await api.getJson(api.sceneUrl(id));
    if (scene?.id !== id || info.state !== 'ready') return;
    scene = info;
    scenes.facts(scene);
    settings.ofScene(scene);
    await list();
  } catch { /* the link says what is wrong */ }
}

// With a problem: why it failed to load; otherwise it was deleted.
function wentAway(problem) {
  link.close();
  gone = { id: scene.id, pose };
  const name = scene.name || scene.id;
  scene = null;
  canvas.dataset.state = 'gone';
  $('link-state').dataset.link = 'gone';
  $('link-state').textContent = 'no scene';
  $('status').textContent = `${name} is not there any more; the picture is the last one of it.`;
  complain(problem || { title: `The scene ${name} was deleted`, detail: `There is no scene ${gone.id} on the server any more. Choose another, or add a file.` });
  loadScenes();
}

function denied(problem) {
  $('login').hidden = false;
  $('key').focus();
  linkState('denied', problem.status === 401 ? 'needs a key' : 'not allowed');
  complain(problem);
}

// --- scenes and cameras --------------------------------------------------------------------------
async function list() {
  await scenes.refresh();
  scenes.show(scene, choose);
}

async function loadScenes() {
  clearTimeout(pollTimer);
  try {
    limits = await api.getJson('/v1/limits');
    films.offer(Boolean(limits.jobs));
    await list();
  } catch (problem) {
    if (problem.status === 401 || problem.status === 403) return denied(problem);
    linkState('waiting', problem.detail || problem.title, RETURN_MS);
    pollTimer = setTimeout(loadScenes, RETURN_MS);
    return;
  }
  $('login').hidden = !api.hasKey();
  quietWaiting();
  const isLoading = scenes.all().some(other => other.state === 'loading');
  if (scene) { if (isLoading) pollTimer = setTimeout(loadScenes, POLL_MS); return; }
  if (gone) {
    if (scenes.find(gone.id)) { quiet(); return choose(gone.id, { pose: gone.pose }); }
  } else if (scenes.usable().length > 0) {
    const asked = new URLSearchParams(location.hash.slice(1) || location.search.slice(1));
    choose((scenes.find(asked.get('scene')) || scenes.usable()[0]).id, { asked });
    return unknown(asked.get('scene'));
  } else {
    nothing(isLoading);
  }
  pollTimer = setTimeout(loadScenes, isLoading ? POLL_MS : RETURN_MS);
}

// An address may name a scene that is not there (any more).
function unknown(id) {
  if (id && !scenes.find(id)) complain({ title: `There is no scene ${id}`, detail: 'The address names it, but the server does not have it. Choose another, or add a file.' });
}

function nothing(isLoading) {
  const failed = scenes.all().find(other => other.state === 'failed');
  canvas.dataset.state = 'empty';
  linkState('empty', 'no scene');
  $('status').textContent = isLoading ? 'The scenes are being loaded …'
    : failed ? `Scene ${failed.id} could not be loaded: ${failed.problem.detail}`
    : 'No scene is loaded yet. Drop a file here, or start the daemon with --scene.';
}

// given: {asked}, parameters of an address, or {pose}.
function choose(id, given = {}) {
  const found = scenes.find(id);
  if (!found) return;
  scene = found;
  gone = null;
  if (given.asked) settings.restore(given.asked);
  settings.ofScene(scene);
  scenes.show(scene, choose);
  scenes.facts(scene);
  chart.clear();
  films.show();
  recorder.ofScene(scene);
  canvas.setAttribute('aria-label', 'Rendered scene ' + (scene.name || id));
  $('camera').replaceChildren(option('', 'whole scene'), ...scene.cameras.map(camera => option(camera.name, camera.name)));
  $('status').textContent = 'Waiting for the first frame …';
  pose = given.pose || (given.asked && poseFrom(given.asked)) || null;
  if (pose) { $('camera').value = ''; $('fov').value = pose.fov; canvas.dataset.state = 'waiting'; }
  else chooseCamera(scene.cameras.length ? scene.cameras[0].name : '');
  link.open();
}

function chooseCamera(name) {
  const camera = scene && scene.cameras.find(other => other.name === name);
  $('camera').value = camera ? name : '';
  recorder.player.pause(false);
  if (camera) return setPose({ eye: camera.eye, target: camera.target, up: camera.up, fov: camera.fov });
  pose = null;
  changed();
}

// --- the parts -----------------------------------------------------------------------------------
const recorder = new Recorder({
  scene: () => scene, pose: () => pose, show: setPose, settings: settings.parameters,
});
const films = new Films({ scene: () => scene, recorder, settings: settings.parameters });
const controls = new Controls(canvas, {
  pose: () => pose,
  bounds: () => scene && scene.bounds,
  // A hand on the picture takes it from the path.
  move: (next, moving) => { recorder.player.pause(false); setPose(next, moving); },
  reset: () => chooseCamera($('camera').value),
  keys: { KeyK: () => recorder.add(), KeyP: () => recorder.toggle() },
});

settings.onChange(() => { changed(false); recorder.show(); });
upload.watch({
  added: async id => { await list(); choose(id); canvas.focus({ preventScroll: true }); },
  path: (text, name) => recorder.load(text, name),
  left: () => list().catch(() => {}),
});

$('scene').addEventListener('change', () => choose($('scene').value));
$('camera').addEventListener('change', () => chooseCamera($('camera').value));
$('fov').addEventListener('change', () => {
  const fov = Number($('fov').value), isGood = fov >= 1 && fov <= 170;
  $('fov').setAttribute('aria-invalid', String(!isGood));
  if (isGood && pose) setPose({ ...pose, fov }, false);
});
$('login').addEventListener('submit', event => {
  event.preventDefault();
  api.useKey($('key').value);
  quiet();
  if (scene) link.open(); else loadScenes();
});
$('scenes').addEventListener('toggle', () => { if ($('scenes').open) list().catch(() => {}); });
addEventListener('hashchange', () => {
  const asked = new URLSearchParams(location.hash.slice(1));
  if (scenes.find(asked.get('scene'))) choose(asked.get('scene'), { asked });
  else unknown(asked.get('scene'));
});

async function copy(text, what) {
  const said = $('copied');
  try {
    await navigator.clipboard.writeText(text);
    said.textContent = `${what} copied.`;
  } catch {
    // Pages over plain http from elsewhere have no clipboard: to be copied by hand.
    said.textContent = text;
    getSelection().selectAllChildren(said);
  }
}
$('copy').addEventListener('click', () => { remember(); copy(location.href, 'Link to this view'); });
$('copy-frame').addEventListener('click', () => {
  if (scene) copy(new URL(frameUrl(scene.id, parameters()), location.href).href, 'Link to this frame');
});

new ResizeObserver(() => { if (scene) changed(false); }).observe(canvas);
function densityChanged() {
  matchMedia(`(resolution: ${window.devicePixelRatio}dppx)`).addEventListener('change', () => { changed(false); densityChanged(); }, { once: true });
}
densityChanged();
loadScenes();

// For the console and for tests.
globalThis.viewer = {
  canvas, paper, link, recorder, controls, sampler,
  get scene() { return scene; }, get pose() { return pose; },
  get isStill() { return canvas.dataset.state === 'still' && !link.isDue; },
};
