// The panel of the camera path: records keys from views, edits times and eases, plays, saves and loads.

import { getJson, hasKey, sceneUrl } from './api.js';
import { motionUrl } from './film.js';
import { $, complain, count, fault, numberIn, option, quiet } from './message.js';
import { DEFAULT_FPS, EASES, defaultEase, documentOf, durationOf, faultOf, startOf } from './path.js';
import { DEFAULT_FOV, parallel } from './pose.js';
import { Player } from './player.js';
import * as store from './store.js';

const EASE_WORDS = { smooth: 'smooth', linear: 'even', in: 'from rest', out: 'to rest', in_out: 'rest to rest', hold: 'cut' };
const KEY_SECONDS = 2;
// Ranges of the fields, chosen so that the server accepts a film of the longest path at the highest rate.
const FPS = [1, 120], SECONDS = [0.1, 8000];

const rounded = seconds => Math.round(seconds * 1000) / 1000;
const empty = () => ({ fps: DEFAULT_FPS, interpolation: 'catmull_rom', ease: 'smooth', keys: [] });

export class Recorder {
  // view: {scene(), pose(), show(pose, moving), settings()}. `onShow` is called when the path has changed.
  constructor(view) {
    this.view = view;
    this.path = empty();
    this.name = null; // name of the scene's path that this one is a copy of, while unchanged
    this.edition = 0; // number of changes so far: most change the path in place
    this.onShow = () => {};
    this.player = new Player(() => this.path, {
      pose: (pose, moving) => view.show(pose, moving),
      changed: () => this.showTime(),
    });
    $('ease').replaceChildren(...EASES.map(ease => option(ease, EASE_WORDS[ease])));
    $('key-add').addEventListener('click', () => this.add());
    $('play').addEventListener('click', () => this.toggle());
    $('stop').addEventListener('click', () => { this.player.pause(); this.player.seek(0, false); });
    $('loop').addEventListener('change', () => { this.player.loops = $('loop').checked; });
    $('time').addEventListener('input', () => this.player.seek(Number($('time').value), true));
    $('time').addEventListener('change', () => this.player.seek(Number($('time').value), false));
    $('duration').addEventListener('change', () => this.stretch());
    $('ease').addEventListener('change', () => this.change(path => { path.ease = $('ease').value; }));
    $('interpolation').addEventListener('change', () => this.changeCurve());
    $('fps').addEventListener('change', () => this.changeRate());
    $('path-save').addEventListener('click', () => this.save());
    $('path-load').addEventListener('click', () => $('path-file').click());
    $('path-file').addEventListener('change', () => this.loadFiles());
    $('path-clear').addEventListener('click', () => this.set(empty()));
    $('named').addEventListener('change', () => this.loadNamed($('named').value));
    this.show();
  }

  // Lists the paths of a scene.
  ofScene(scene) {
    this.player.pause(false);
    $('named-label').hidden = scene.paths.length === 0;
    $('named').replaceChildren(option('', 'choose …'), ...scene.paths.map(name => option(name, name)));
    if (this.sceneId === scene.id) return this.show();
    // Poses of another scene are meaningless here: each scene has its own recorded path.
    this.sceneId = scene.id;
    this.restore(store.pathOf(scene.id));
  }

  restore(kept) {
    const isPath = kept?.path && Array.isArray(kept.path.keys) && !faultOf(kept.path);
    this.set(isPath ? kept.path : empty(), null, false);
    if (kept?.name) this.loadNamed(kept.name, false);
  }

  // --- changes -----------------------------------------------------------------------------------
  set(path, name = null, isKept = true) {
    this.player.pause(false);
    this.player.at = 0;
    this.path = path;
    this.name = name;
    this.changed(isKept);
  }

  change(how) {
    how(this.path);
    this.name = null;
    this.player.pause();
    this.changed();
  }

  changed(isKept = true) {
    const { path, name } = this;
    this.edition++;
    if (isKept && this.sceneId) store.keepPath(this.sceneId, name ? { name } : path.keys.length > 0 ? { path } : null);
    // Messages about the earlier path no longer apply.
    quiet('path');
    for (const id of ['duration', 'fps']) fault($(id), null);
    $('key-fault').hidden = true;
    this.show();
  }

  add() {
    const pose = this.view.pose();
    if (!pose) return;
    this.change(path => {
      // All keys have one projection.
      const { eye, target, up, ...size } = path.keys[0]?.ortho_height == null ? pose : parallel(pose, 0);
      const last = path.keys[path.keys.length - 1];
      path.keys.push({ t: last ? rounded(last.t + KEY_SECONDS) : 0, eye, target, up, ...size });
    });
    this.player.at = durationOf(this.path);
    $('paths').open = true;
    this.show();
  }

  // Keys are ordered by time, so a new time may change a key's place.
  retime(index, input) {
    const t = Number(input.value), key = this.path.keys[index], others = this.path.keys.filter(other => other !== key).map(other => other.t);
    const span = Math.max(t, ...others) - Math.min(t, ...others);
    const wrong = input.value.trim() === '' || !Number.isFinite(t) ? 'a key needs a time in seconds'
      : others.includes(t) ? `another key is at ${t} s already`
      : span > SECONDS[1] ? `a path lasts ${count(SECONDS[1])} s at most` : null;
    input.setAttribute('aria-invalid', String(Boolean(wrong)));
    $('key-fault').hidden = !wrong;
    if (wrong) {
      $('key-fault').textContent = `Key ${index + 1} stays at ${key.t} s: ${wrong}.`;
      return;
    }
    this.change(path => {
      key.t = t;
      path.keys.sort((a, b) => a.t - b.t);
    });
    this.focusOn(this.path.keys.indexOf(key), 'input');
  }

  // Swaps the views of two keys; their times stay.
  swap(index, other, action) {
    this.change(({ keys }) => {
      const [a, b] = [keys[index], keys[other]];
      [keys[index], keys[other]] = [{ ...b, t: a.t }, { ...a, t: b.t }];
    });
    this.focusOn(other, `[data-action="${action}"]`);
  }

  remove(index) {
    this.change(path => { path.keys.splice(index, 1); });
    if (this.path.keys.length === 0) $('key-add').focus();
    else this.focusOn(Math.min(index, this.path.keys.length - 1), '[data-action="delete"]');
  }

  stretch() {
    const now = durationOf(this.path), start = startOf(this.path);
    const wanted = numberIn($('duration'), SECONDS, ' s', `the path keeps ${rounded(now)} s`);
    if (!wanted) return;
    const times = this.path.keys.map(key => rounded(start + (key.t - start) * wanted / now));
    // Times are in milliseconds, and no two keys have one time.
    const meets = times.findIndex((t, i) => t === times[i + 1]) + 1;
    if (meets) return fault($('duration'), `keys ${meets} and ${meets + 1} would be at one time; the path keeps ${rounded(now)} s`);
    this.change(path => path.keys.forEach((key, i) => { key.t = times[i]; }));
  }

  changeRate() {
    const fps = numberIn($('fps'), FPS, '', `the path keeps ${this.path.fps}`);
    if (fps) this.change(path => { path.fps = fps; });
  }

  changeCurve() {
    this.change(path => {
      const wasUsual = path.ease === defaultEase(path.interpolation);
      path.interpolation = $('interpolation').value;
      if (wasUsual) path.ease = defaultEase(path.interpolation);
    });
  }

  toggle() {
    if (this.player.isPlaying) this.player.pause(); else this.player.play();
  }

  // --- files -------------------------------------------------------------------------------------
  save() {
    const text = JSON.stringify(documentOf(this.path), null, 2) + '\n';
    const link = document.createElement('a');
    link.href = URL.createObjectURL(new Blob([text], { type: 'application/json' }));
    link.download = `${this.view.scene().id}-path.json`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }

  async loadFiles() {
    const [file] = $('path-file').files;
    $('path-file').value = '';
    if (file) this.load(await file.text(), file.name);
  }

  // Loads the text of a path file, or reports what is wrong with it.
  load(text, name, sceneName = null, isShown = true) {
    let path = null, wrong = null;
    try { path = JSON.parse(text); } catch (error) { wrong = error.message; }
    wrong = wrong || faultOf(path);
    if (wrong) return complain({ title: `${name} is no camera path`, detail: wrong }, 'path');
    const up = this.view.scene() ? this.view.scene().up : [0, 1, 0], interpolation = path.interpolation || 'catmull_rom';
    const ease = path.ease || defaultEase(interpolation);
    const keys = path.keys.map(({ ease: own, ...key }) => ({ up, ...(key.ortho_height == null ? { fov: DEFAULT_FOV } : {}), ...key, ...(own && own !== ease ? { ease: own } : {}) }));
    this.set({ fps: path.fps || DEFAULT_FPS, interpolation, ease, keys }, sceneName);
    if (!isShown) return;
    $('paths').open = true;
    this.player.seek(0, false);
  }

  // isShown: the view moves to the path's beginning.
  async loadNamed(name, isShown = true) {
    if (!name) return;
    const { sceneId, edition } = this;
    try {
      const path = await getJson(sceneUrl(sceneId, `/paths/${encodeURIComponent(name)}`));
      // Skip it if another path was loaded or recorded meanwhile.
      if (this.sceneId === sceneId && this.edition === edition) this.load(JSON.stringify(path), name, name, isShown);
    } catch (problem) {
      if (isShown) complain(problem, 'path');
    }
  }

  // --- the view ----------------------------------------------------------------------------------
  show() {
    const { path } = this, { keys } = path, duration = durationOf(path), isEmpty = keys.length === 0;
    this.player.at = Math.min(this.player.at, duration);
    $('keys').hidden = isEmpty;
    $('no-keys').hidden = !isEmpty;
    $('keys').tBodies[0].replaceChildren(...keys.map((key, index) => this.row(key, index)));
    for (const id of ['path-save', 'path-clear', 'stop']) $(id).disabled = isEmpty;
    $('play').disabled = $('time').disabled = $('duration').disabled = keys.length < 2;
    $('time').max = duration;
    $('duration').value = keys.length < 2 ? '' : rounded(duration);
    $('ease').value = path.ease;
    $('interpolation').value = path.interpolation;
    $('fps').value = path.fps;
    $('path-summary').textContent = isEmpty ? '' : `${keys.length} ${keys.length === 1 ? 'key' : 'keys'}, ${rounded(duration)} s`;
    $('named').value = this.name || '';
    const isFilm = this.name && !hasKey();
    $('film-link').hidden = !isFilm;
    if (isFilm) $('mjpeg').href = motionUrl(this.sceneId, this.name, this.view.settings());
    this.showTime();
    this.onShow();
  }

  showTime() {
    const { at, isPlaying } = this.player, t = startOf(this.path) + at;
    $('time').value = at;
    $('time-shown').textContent = `${at.toFixed(1)} s`;
    $('play').textContent = isPlaying ? 'Pause' : 'Play';
    $('play').dataset.playing = isPlaying;
    const current = this.path.keys.findLastIndex(key => key.t <= t + 1e-6);
    [...$('keys').tBodies[0].rows].forEach((row, i) => row.classList.toggle('current', i === current));
  }

  row(key, index) {
    const row = document.createElement('tr'), last = this.path.keys.length - 1, number = index + 1;
    const head = document.createElement('th');
    head.scope = 'row';
    head.append(button('go', String(number), `Show key ${number}`, () => this.player.seek(key.t - startOf(this.path), false)));
    const time = document.createElement('input');
    Object.assign(time, { type: 'number', step: '0.1', value: key.t });
    time.setAttribute('aria-label', `Seconds of key ${number}`);
    time.addEventListener('change', () => this.retime(index, time));
    const ease = document.createElement('select');
    ease.append(option('', `as path`), ...EASES.map(name => option(name, EASE_WORDS[name])));
    ease.value = key.ease || '';
    ease.disabled = index === last;
    ease.setAttribute('aria-label', `Ease from key ${number} on`);
    ease.addEventListener('change', () => this.change(() => { if (ease.value) key.ease = ease.value; else delete key.ease; }));
    const up = button('up', '↑', `Key ${number} earlier`, () => this.swap(index, index - 1, 'up'));
    const down = button('down', '↓', `Key ${number} later`, () => this.swap(index, index + 1, 'down'));
    up.disabled = index === 0;
    down.disabled = index === last;
    const remove = button('delete', '✕', `Delete key ${number}`, () => this.remove(index));
    row.append(head, cell(time), cell(ease), cell(up, ' ', down, ' ', remove));
    return row;
  }

  // The table was rebuilt. Focus the element that replaces the focused one.
  focusOn(index, selector) {
    const row = $('keys').tBodies[0].rows[index], wanted = row && row.querySelector(selector);
    if (!wanted) return;
    (wanted.disabled ? row.querySelector('[data-action="go"]') : wanted).focus();
  }
}

function cell(...content) {
  const td = document.createElement('td');
  td.append(...content);
  return td;
}

function button(action, text, label, act) {
  const made = document.createElement('button');
  made.type = 'button';
  made.textContent = text;
  made.dataset.action = action;
  made.setAttribute('aria-label', label);
  made.title = label;
  made.addEventListener('click', act);
  return made;
}
