// The viewer's main module: holds the state of the view, and connects the parts.
//
//   controls, recorder ──pose──▶ app ──▶ link ──▶ server
//   settings ────────────────────▶ │      │
//   scenes, upload ─scene──────────┘      └──frames──▶ canvas, receipt, chart

import { Accuracy } from './accuracy.js';
import * as address from './address.js';
import * as api from './api.js';
import * as chart from './chart.js';
import { Controls } from './controls.js';
import { Films } from './film.js';
import { Jobs } from './jobs.js';
import { Link } from './link.js';
import { $, complain, fault, numberIn, option, quiet, tell } from './message.js';
import * as overlay from './overlay.js';
import * as measure from './measure.js';
import { sampler } from './path.js';
import { pickAt } from './pick.js';
import { extentOf, forFrame, isOutOfSight, isSame, parallel, perspective, turnedTo } from './pose.js';
import { report } from './receipt.js';
import { Recorder } from './recorder.js';
import { frameUrl } from './requests.js';
import * as scenes from './scenes.js';
import * as settings from './settings.js';
import * as store from './store.js';
import * as upload from './upload.js';

const POLL_MS = 1500, LIST_MS = 5000, RETURN_MS = 3000, NEWS_MS = 8000;
// Value in the list of cameras for a view that is no camera's. No camera can have this name.
const FREE = '\0';
const OUT_OF_SIGHT = 'The scene is out of sight.';
const TURN_MS = 250;

const canvas = $('canvas'), paper = canvas.getContext('2d');
let limits = { max_side: 8192, max_pixels: 1 << 25 };
let scene = null;
let pose = null;       // {eye, target, up, fov}; null: the server chooses a view of the whole scene
let whole = null;      // the view that the server chose
let camera = '';       // the camera that was chosen last, to which Reset returns; '' is the whole scene
let gone = null;       // {id, pose} of a deleted scene, in case it comes back
let isFlatByCamera = false; // the camera that was chosen is orthographic
let frames = 0, pollTimer = 0, newsTimer = 0, turning = 0;

// --- requests ------------------------------------------------------------------------------------
let scale = 1; // share of the full width and height that frames are drawn at; the page enlarges them

function fullSize() {
  const ratio = window.devicePixelRatio || 1;
  const w = Math.max(1, Math.round(canvas.clientWidth * ratio)), h = Math.max(1, Math.round(canvas.clientHeight * ratio));
  // The limits hold for the parts of pixels: 4 or 16 of each with antialiasing.
  const parts = settings.value('output') === 'color' ? parseInt(settings.value('antialias'), 10) || 1 : 1;
  const shrink = Math.min(1, limits.max_side / Math.sqrt(parts) / Math.max(w, h), Math.sqrt(limits.max_pixels / parts / (w * h)));
  return [Math.max(1, Math.floor(w * shrink)), Math.max(1, Math.floor(h * shrink))];
}

function parameters() {
  const [w, h] = fullSize().map(side => Math.max(1, Math.round(scale * side))), { projection, ...others } = settings.parameters();
  // Without a pose the server frames the scene in this projection.
  return { ...shown(), w, h, ...(projection && !pose ? { projection } : {}), ...others };
}

const isFlat = () => settings.value('projection') === 'orthographic';

// The pose in the projection that is chosen.
const shown = () => pose && isFlat() ? parallel(pose, extentOf(scene.bounds, pose)) : pose;

const link = new Link(() => scene && { id: scene.id, params: parameters() }, {
  frame: drawn, scene: edited, gone: wentAway, state: linkState, denied,
  problem: problem => { canvas.dataset.state = 'error'; complain(problem, 'frame'); },
});

// moving: as in Link.show.
function changed(moving) {
  if (!scene) return;
  accuracy.moved();
  canvas.dataset.state = 'waiting';
  overlay.wait();
  link.show(moving);
}

function setPose(next, moving) {
  if (next.ortho_height != null && !isFlat()) {
    settings.set('projection', 'orthographic');
    isFlatByCamera = true;
  }
  pose = perspective(next);
  turning++;
  if (document.activeElement !== $('fov')) showFov();
  showCamera();
  overlay.lost(outOfSight());
  drawMeasures();
  changed(moving);
}

const outOfSight = () => scene?.bounds && isOutOfSight(shown(), scene.bounds, fullSize()) ? OUT_OF_SIGHT : null;

function showFov() {
  $('fov').value = Number(pose.fov.toFixed(2));
  fault($('fov'), null);
}

// A view that has left its camera is listed as free, so that the camera can be chosen again.
function showCamera() {
  if (!scene) return;
  const at = !pose || (whole && isSame(pose, whole)) ? '' : scene.cameras.find(other => isSame(pose, perspective(forFrame(other, fullSize()))))?.name ?? FREE;
  if ($('camera').value !== at) $('camera').value = at;
}

// --- frames --------------------------------------------------------------------------------------
function drawn(info, isNewest) {
  const [w, h] = fullSize(), isStill = info.quality === 'still';
  draw(info.picture, w, h);
  info.picture.close();
  adopt(info, isNewest);
  if (isNewest && isStill) overlay.waitIsOver(); else { overlay.waitIsOver(); overlay.wait(); }
  if (isNewest && info.receipt) seen(info.receipt.nothing_visible);
  report(info, [w, h], link.seq);
  if (info.receipt) {
    settings.nameDefaults(info.receipt.settings);
    measure.showLegend(info.receipt.legend);
  }
  canvas.dataset.state = isStill && isNewest ? 'still' : 'moving';
  canvas.dataset.frames = ++frames;
  canvas.dataset.revision = info.revision ?? '';
  quiet('link');
  if (!isStill || !isNewest) return;
  if (info.receipt) accuracy.frame(info.receipt);
  // A frame ends the problem of an earlier one.
  quiet('frame');
  remember();
}

function draw(picture, w, h) {
  // object-fit keeps the aspect ratio until a frame of the new size arrives.
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  const isIds = $('output').value === 'id';
  paper.imageSmoothingEnabled = !isIds;
  paper.imageSmoothingQuality = 'medium';
  paper.clearRect(0, 0, w, h);
  paper.drawImage(picture, 0, 0, w, h);
  if (isIds) colorIds(w, h);
}

// why: the server's sentence if a frame shows nothing.
function seen(why) {
  overlay.lost(why ? `${why[0].toUpperCase()}${why.slice(1).split(':')[0]}.` : pose && outOfSight());
  overlay.greet();
}

// Neighbouring ids differ by one in the red channel. A hash spreads them over the colours.
function colorIds(w, h) {
  const image = paper.getImageData(0, 0, w, h), words = new Uint32Array(image.data.buffer);
  for (let i = 0; i < words.length; i++) {
    const id = words[i] & 0xffffff, hash = Math.imul(id, 0x9e3779b1) >>> 8;
    words[i] = id === 0 ? 0xff181410 : 0xff404040 | (hash & 0xbfbfbf);
  }
  paper.putImageData(image, 0, 0);
}

// Navigation starts from the pose that the server chose.
function adopt(info, isNewest) {
  if (pose || !isNewest || !info.receipt?.camera) return;
  const { eye, target, up, fov_deg: fov, ortho_height } = info.receipt.camera;
  pose = whole = perspective(ortho_height == null ? { eye, target, up, fov } : { eye, target, up, ortho_height });
  drawMeasures();
  showFov();
}

function remember() {
  if (!pose || !scene) return;
  address.write(scene, camera, pose);
  $('link').href = frameUrl(scene.id, parameters());
  $('link').hidden = false;
}

// --- the connection ------------------------------------------------------------------------------
function linkState(name, words, delayMs) {
  if (name !== 'stream' && name !== 'requests') overlay.waitIsOver();
  $('link-state').dataset.link = name;
  $('link-state').textContent = $('link-state').title = words;
  if (name === 'waiting') {
    canvas.dataset.state = 'error';
    const seconds = Math.max(1, Math.round(delayMs / 1000));
    const why = words[0].toUpperCase() + words.slice(1);
    const detail = `${why}. Trying again in ${seconds} s; the view stays where it is.`;
    tell('wait', { title: 'Not connected', detail }, [['Try now', () => link.again()]], 'link');
  }
  if (name === 'stream') {
    // The picture on the screen may be out of date.
    canvas.dataset.state = 'waiting';
    quiet('link');
  }
}

function edited(revision) {
  if (scene.revision === revision) return;
  refreshScene();
  tell('news', { title: 'The scene was changed', detail: `This is revision ${revision}.` }, [['Dismiss', () => quiet('edit')]], 'edit');
  clearTimeout(newsTimer);
  newsTimer = setTimeout(() => quiet('edit'), NEWS_MS);
}

async function refreshScene() {
  const { id } = scene;
  try {
    const info = await api.getJson(api.sceneUrl(id));
    if (scene?.id !== id || info.state !== 'ready') return;
    scene = info;
    scenes.facts(scene);
    settings.ofScene(scene);
    accuracy.edited();
    await list();
  } catch { /* the link says what is wrong */ }
}

// With a problem: the scene failed to load. Without one, it was deleted.
function wentAway(problem) {
  link.close();
  gone = { id: scene.id, pose };
  const name = scenes.fullName(scene);
  scene = null;
  canvas.dataset.state = 'gone';
  $('link-state').dataset.link = 'gone';
  $('link-state').textContent = 'no scene';
  $('status').textContent = `${name} is not there any more; the picture is the last one of it.`;
  quiet('frame', 'edit');
  complain(problem || { title: `The scene ${name} was deleted`, detail: 'The picture is the last one of it. Choose another scene, or add a file.' }, 'scene');
  loadScenes();
}

function denied(problem) {
  $('login').hidden = false;
  $('key').focus();
  linkState('denied', problem.status === 401 ? 'needs a key' : 'not allowed');
  complain(problem, 'key');
}

// --- scenes and cameras --------------------------------------------------------------------------
async function list() {
  await scenes.refresh();
  scenes.show(scene, choose, remove);
}

async function loadScenes() {
  clearTimeout(pollTimer);
  try {
    limits = await api.getJson('/v1/limits');
    films.offer(Boolean(limits.jobs));
    jobs.offer(Boolean(limits.jobs));
    await list();
  } catch (problem) {
    if (problem.status === 401 || problem.status === 403) return denied(problem);
    linkState('waiting', problem.detail || problem.title, RETURN_MS);
    pollTimer = setTimeout(loadScenes, RETURN_MS);
    return;
  }
  $('login').hidden = !api.hasKey();
  quiet('link');
  const isLoading = scenes.all().some(other => other.state === 'loading');
  if (scene) { if (isLoading) pollTimer = setTimeout(loadScenes, POLL_MS); return; }
  if (gone) {
    if (scenes.find(gone.id)) return choose(gone.id, { pose: gone.pose });
  } else if (scenes.usable().length > 0) {
    const asked = address.asked(), id = asked.get('scene'), wanted = id || store.lastScene();
    const isWaitedFor = scenes.all().some(other => other.id === wanted && other.state === 'loading');
    if (!isWaitedFor) {
      choose((scenes.find(wanted) || scenes.greeting()).id, { asked });
      return unknown(id);
    }
    $('status').textContent = `Scene ${wanted} is being loaded …`;
  } else {
    nothing(isLoading);
  }
  pollTimer = setTimeout(loadScenes, isLoading ? POLL_MS : RETURN_MS);
}

// The address may name a scene that does not exist, or no longer.
function unknown(id) {
  if (id && !scenes.find(id)) complain({ title: `There is no scene ${id}`, detail: 'The address names it, but the server does not have it. Choose another, or add a file.' }, 'scene');
}

async function remove(id) {
  const isShown = scene?.id === id;
  // Otherwise the link would report the end of the scene.
  if (isShown) link.close();
  try {
    await api.reach(api.sceneUrl(id), { method: 'DELETE' });
  } catch (problem) {
    complain(problem, 'scene');
    if (isShown) link.open();
    return;
  }
  store.keepPath(id, null);
  if (isShown) {
    scene = null;
    canvas.dataset.state = 'gone';
    // The address names the scene that is gone.
    history.replaceState(null, '', location.pathname);
  }
  loadScenes();
}

function nothing(isLoading) {
  const failed = scenes.all().find(other => other.state === 'failed');
  canvas.dataset.state = 'empty';
  paper.clearRect(0, 0, canvas.width, canvas.height);
  linkState('empty', 'no scene');
  $('status').textContent = isLoading ? 'The scenes are being loaded …'
    : failed ? `Scene ${failed.id} could not be loaded: ${failed.problem.detail}`
    : 'No scene is loaded yet. Drop a file here, or start the server with --scene.';
}

// given: {asked}, the parameters of an address, or {pose}.
function choose(id, given = {}) {
  const found = scenes.find(id);
  if (!found) return;
  scene = found;
  gone = null;
  store.keepScene(id);
  quiet('scene', 'frame', 'address', 'edit', 'pivot');
  const asked = given.asked ? address.read(given.asked, scene) : { faults: [] };
  if (asked.faults.length > 0) complain({ title: 'Not all of the address could be used', detail: asked.faults.join('\n') }, 'address');
  if (given.asked) settings.restore(given.asked);
  settings.ofScene(scene);
  scenes.show(scene, choose, remove);
  scenes.facts(scene);
  chart.clear();
  measure.clear();
  films.show();
  recorder.ofScene(scene);
  accuracy.ofScene();
  canvas.setAttribute('aria-label', 'Rendered scene ' + scenes.fullName(scene));
  const free = option(FREE, 'free view');
  free.hidden = true;
  $('camera').replaceChildren(free, option('', 'whole scene'), ...scene.cameras.map(other => option(other.name, other.name)));
  $('status').textContent = 'Waiting for the first frame …';
  whole = null;
  camera = asked.camera ?? scene.cameras[0]?.name ?? '';
  if (given.pose || asked.pose) setPose(given.pose || asked.pose, false); else chooseCamera(camera);
  link.open();
}

// Shows the whole scene; Reset still returns to the chosen camera.
function showWhole() {
  const chosen = camera;
  chooseCamera('');
  camera = chosen;
}

function chooseCamera(name) {
  if (!scene) return;
  const found = scene.cameras.find(other => other.name === name);
  camera = found ? name : '';
  recorder.player.pause(false);
  if (isFlatByCamera) settings.set('projection', '');
  isFlatByCamera = false;
  // No other pose follows at once, so the frame is drawn at full quality immediately.
  if (found) return setPose(forFrame(found, fullSize()), false);
  pose = null;
  turning++;
  showCamera();
  changed(false);
}

// Returns the element at a place of the picture: a hit, null, or undefined if the request failed or the view has changed.
async function seenAt(place) {
  if (!scene || !pose) return undefined;
  const { id } = scene, before = pose;
  try {
    const hit = await pickAt(id, parameters(), place);
    return scene?.id === id && pose === before ? hit : undefined;
  } catch (problem) {
    complain(problem, 'frame');
    return undefined;
  }
}

// Reports the point at a place of the picture, or measures from it.
async function readOff(place) {
  const hit = await seenAt(place);
  if (hit === undefined) return;
  measure.hit(hit);
  drawMeasures();
}

function drawMeasures() {
  measure.draw(shown(), [canvas.clientWidth, canvas.clientHeight]);
}

function toggleMeasuring() {
  measure.toggle();
  drawMeasures();
}

// Turns the view to the point at a place of the picture, and orbits around that point from then on.
async function lookAt(place) {
  const before = pose, hit = await seenAt(place);
  if (hit === undefined) return;
  if (!hit) return tell('news', { title: 'Nothing here to turn around', detail: 'Double-click a part of the scene.' }, [['Dismiss', () => quiet('pivot')]], 'pivot');
  quiet('pivot');
  const point = hit.position;
  const began = performance.now(), isStill = matchMedia('(prefers-reduced-motion: reduce)').matches;
  let ticket = -1;
  const step = now => {
    if (ticket >= 0 && ticket !== turning) return; // something else has moved the view
    const share = isStill ? 1 : Math.min(1, (now - began) / TURN_MS);
    setPose(turnedTo(before, point, share * share * (3 - 2 * share)), share < 1);
    ticket = turning;
    if (share < 1) requestAnimationFrame(step);
  };
  step(performance.now());
}

// At another aspect ratio the chosen camera or the whole scene is shown again, fitted to it.
function resized() {
  drawMeasures();
  if (!scene) return;
  const found = scene.cameras.find(other => other.name === camera);
  const isWhole = pose && whole && isSame(pose, whole);
  if (isWhole) showWhole();
  else if (found && pose && found.name === $('camera').value) chooseCamera(camera);
  else changed(false);
}

// --- the parts -----------------------------------------------------------------------------------
const recorder = new Recorder({
  scene: () => scene, pose: () => pose, show: setPose, settings: settings.parameters,
});
const jobs = new Jobs();
const accuracy = new Accuracy({
  scene: () => scene, request: parameters, limits: () => limits, scale: () => scale,
  setScale: next => {
    scale = next;
    if (scene) changed(false);
  },
});
const films = new Films({ scene: () => scene, recorder, settings: settings.parameters, jobs });
const controls = new Controls(canvas, {
  pose: () => pose,
  bounds: () => scene && scene.bounds,
  // Moving the picture by hand stops the path.
  move: (next, moving) => { recorder.player.pause(false); overlay.moved(); setPose(next, moving); },
  reset: () => chooseCamera(camera),
  click: readOff,
  isMeasuring: measure.isOn,
  lookAt,
  fit: showWhole,
  help: () => { $('moving-about').open = true; $('moving-about').scrollIntoView({ block: 'nearest' }); },
  keys: { KeyK: () => recorder.add(), KeyP: () => recorder.toggle(), KeyM: toggleMeasuring },
});

$('measure').addEventListener('click', toggleMeasuring);
settings.onChange(() => { isFlatByCamera &&= isFlat(); drawMeasures(); changed(false); recorder.show(); });
upload.watch({
  added: async id => { await list(); choose(id); canvas.focus({ preventScroll: true }); },
  path: (text, name) => recorder.load(text, name),
  left: () => list().catch(() => {}),
});

$('scene').addEventListener('change', () => choose($('scene').value));
$('camera').addEventListener('change', () => chooseCamera($('camera').value));
$('fov').addEventListener('change', () => {
  if (!pose) return;
  const fov = numberIn($('fov'), [1, 170], ' degrees', `the view keeps ${Number(pose.fov.toFixed(2))}`);
  if (fov) setPose({ ...pose, fov }, false);
});
$('login').addEventListener('submit', event => {
  event.preventDefault();
  api.useKey($('key').value);
  quiet('key');
  if (scene) link.open(); else loadScenes();
});
$('scenes').addEventListener('toggle', () => { if ($('scenes').open) list().catch(() => {}); });
// Watch for scenes that others add or remove.
setInterval(() => {
  if ($('scenes').open && !document.hidden && scene && document.activeElement?.closest('#scenes, #scene') === null) list().catch(() => {});
}, LIST_MS);
addEventListener('hashchange', () => {
  const asked = address.asked(), id = asked.get('scene') ?? scene?.id;
  if (scenes.find(id)) choose(id, { asked });
  else unknown(id);
});

async function copy(text, what) {
  const said = $('copied');
  try {
    await navigator.clipboard.writeText(text);
    said.textContent = `${what} copied.`;
  } catch {
    // Pages over plain http from another host have no clipboard. Select the text, to be copied by hand.
    said.textContent = text;
    getSelection().selectAllChildren(said);
  }
}
$('copy').addEventListener('click', () => { remember(); copy(location.href, 'Link to this view'); });
$('copy-frame').addEventListener('click', () => {
  if (scene) copy(new URL(frameUrl(scene.id, parameters()), location.href).href, 'Link to this frame');
});

$('lost-fit').addEventListener('click', showWhole);
new ResizeObserver(resized).observe(canvas);
function densityChanged() {
  matchMedia(`(resolution: ${window.devicePixelRatio}dppx)`).addEventListener('change', () => { changed(false); densityChanged(); }, { once: true });
}
densityChanged();
loadScenes();

// For the console and for tests.
globalThis.viewer = {
  canvas, paper, link, recorder, controls, sampler, accuracy, jobs,
  get scene() { return scene; }, get pose() { return pose; },
  get isStill() { return canvas.dataset.state === 'still' && !link.isDue; },
};
