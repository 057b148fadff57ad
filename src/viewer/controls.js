// Pointer, touch, wheel and keys on the picture: orbit around the target, or fly with the eye.

import { $ } from './message.js';
import { dollyTowards, extentOf, fly, look, orbit, pan } from './pose.js';

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const STEP = Math.PI / 36;
// Directions of flight by key (its place on the keyboard) and by button: right, up, forward.
const FLIGHT = {
  KeyW: [0, 0, 1], KeyS: [0, 0, -1], KeyA: [-1, 0, 0], KeyD: [1, 0, 0], KeyE: [0, 1, 0], KeyQ: [0, -1, 0],
  forward: [0, 0, 1], back: [0, 0, -1], left: [-1, 0, 0], right: [1, 0, 0], up: [0, 1, 0], down: [0, -1, 0],
};
// Speed of flight in extents of the scene per second.
const FLY_SPEED = 0.15, HASTE = 3;
const LEAST_STEP_S = 0.03, LONGEST_STEP_S = 0.1;

// A second click within this time makes the first one part of a double click.
const DOUBLE_MS = 300;
// Smaller movements of the pointer are no drag.
const CLICK_PX = 4;

// view: {pose(), bounds(), move(pose, moving), reset(), fit(), click(place), isMeasuring(), lookAt(place), help(), keys: {letter: action}}.
export class Controls {
  constructor(canvas, view) {
    this.canvas = canvas;
    this.view = view;
    this.fingers = new Map();
    this.held = new Set();
    this.hasty = false;
    this.isFlying = false;
    this.pointers();
    this.keys();
    this.buttons();
  }

  // --- pointers ----------------------------------------------------------------------------------
  pointers() {
    const { canvas, fingers } = this;
    canvas.addEventListener('pointerdown', event => {
      canvas.setPointerCapture(event.pointerId);
      canvas.focus({ preventScroll: true });
      fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      // A press of one finger or the main button that ends where it began is a click.
      this.pressed = fingers.size === 1 && event.button === 0 ? { x: event.clientX, y: event.clientY } : null;
    });
    canvas.addEventListener('pointerup', event => {
      const from = this.pressed;
      this.pressed = null;
      if (from && Math.hypot(event.clientX - from.x, event.clientY - from.y) <= CLICK_PX) this.clicked(this.placeOf(event));
    });
    canvas.addEventListener('pointermove', event => this.pointed(event));
    for (const name of ['pointerup', 'pointercancel', 'lostpointercapture']) {
      canvas.addEventListener(name, event => {
        // The view is at rest now, so the still frame is requested without waiting.
        if (fingers.delete(event.pointerId) && fingers.size === 0 && this.dragged) this.rest();
      });
    }
    canvas.addEventListener('contextmenu', event => event.preventDefault());
    canvas.addEventListener('wheel', event => {
      event.preventDefault();
      const pixels = event.deltaY * [1, 16, canvas.clientHeight][event.deltaMode];
      const factor = Math.exp(Math.max(-200, Math.min(200, pixels)) * 0.0015);
      if (this.isFlying) this.changeSpeed(-Math.sign(pixels)); else this.dolly(factor, this.placeOf(event));
    }, { passive: false });
    canvas.addEventListener('dblclick', event => {
      clearTimeout(this.clickTimer);
      if (!this.view.isMeasuring()) this.view.lookAt(this.placeOf(event));
    });
  }

  // While measuring, each click counts at once. Otherwise a click may be the first half of a double click.
  clicked(place) {
    clearTimeout(this.clickTimer);
    if (this.view.isMeasuring()) this.view.click(place);
    else this.clickTimer = setTimeout(() => this.view.click(place), DOUBLE_MS);
  }

  pointed(event) {
    const last = this.fingers.get(event.pointerId);
    if (!last) return;
    const before = [...this.fingers.values()].map(finger => ({ ...finger }));
    const dx = event.clientX - last.x, dy = event.clientY - last.y;
    last.x = event.clientX;
    last.y = event.clientY;
    const pose = this.view.pose();
    if ((dx === 0 && dy === 0) || !pose) return;
    this.dragged = true;
    const height = this.canvas.clientHeight || 1;
    if (this.fingers.size === 1) this.view.move(this.dragTo(pose, dx / height, dy / height, event), true);
    else if (this.fingers.size === 2) this.pinched(pose, before, [...this.fingers.values()], height);
  }

  dragTo(pose, dx, dy, event) {
    if (event.shiftKey || event.buttons & 6) return pan(pose, dx, dy);
    if (!this.isFlying) return orbit(pose, -dx * Math.PI, -dy * Math.PI);
    // The point under the pointer stays there.
    const angle = pose.fov * Math.PI / 180;
    return look(pose, dx * angle, dy * angle);
  }

  pinched(pose, before, after, height) {
    const span = ([a, b]) => Math.hypot(a.x - b.x, a.y - b.y) || 1;
    const middle = ([a, b]) => [(a.x + b.x) / 2, (a.y + b.y) / 2];
    const [m, n] = [middle(before), middle(after)], ratio = span(before) / span(after);
    const extent = extentOf(this.view.bounds(), pose);
    const place = this.placeOf({ clientX: m[0], clientY: m[1] });
    const nearer = this.isFlying ? fly(pose, [0, 0, extent * 0.3 * (1 - ratio)]) : dollyTowards(pose, ratio, extent, place);
    this.view.move(pan(nearer, (n[0] - m[0]) / height, (n[1] - m[1]) / height), true);
  }

  rest() {
    this.dragged = false;
    const pose = this.view.pose();
    if (pose) this.view.move(pose, false);
  }

  // Moves towards a place of the picture, and away from its middle, so that distant things stay in view.
  dolly(factor, place = [0, 0]) {
    const pose = this.view.pose(), towards = factor < 1 ? place : [0, 0];
    if (pose) this.view.move(dollyTowards(pose, factor, extentOf(this.view.bounds(), pose), towards));
  }

  // Returns [right, up] from the picture's middle, in halves of its height.
  placeOf({ clientX, clientY }) {
    const { left, top, width, height } = this.canvas.getBoundingClientRect(), half = height / 2 || 1;
    return [(clientX - left - width / 2) / half, (height / 2 - (clientY - top)) / half];
  }

  // --- keys --------------------------------------------------------------------------------------
  keys() {
    this.canvas.addEventListener('keydown', event => {
      if (event.ctrlKey || event.metaKey || event.altKey || !this.key(event)) return;
      event.preventDefault();
    });
    this.canvas.addEventListener('keyup', event => {
      this.hasty = event.shiftKey;
      this.release(event.code);
    });
    this.canvas.addEventListener('blur', () => this.releaseAll());
    addEventListener('blur', () => this.releaseAll());
  }

  // Returns whether the key has a meaning.
  key(event) {
    const pose = this.view.pose(), arrow = ARROWS[event.key];
    this.hasty = event.shiftKey;
    if (this.isFlying && FLIGHT[event.code]) return this.hold(event.code);
    if (arrow && pose) this.view.move(this.arrowed(pose, arrow, event.shiftKey));
    else if (event.key === '+' || event.key === '=') this.nearer();
    else if (event.key === '-' || event.key === '_') this.away();
    else if (event.key === 'Home') this.view.reset();
    else if (event.code === 'KeyZ') this.view.fit();
    else if (event.key === '?') this.view.help();
    else if (event.code === 'KeyF') this.setFlying(!this.isFlying);
    else if (event.key === 'Escape' && this.isFlying) this.setFlying(false);
    else if (this.view.keys[event.code]) this.view.keys[event.code]();
    else return false;
    return true;
  }

  arrowed(pose, [x, y], isShifted) {
    if (isShifted) return pan(pose, -x * 0.05, -y * 0.05);
    return this.isFlying ? look(pose, -x * STEP / 2, -y * STEP / 2) : orbit(pose, x * STEP, y * STEP);
  }

  nearer() { if (this.isFlying) this.changeSpeed(1); else this.dolly(0.85); }
  away() { if (this.isFlying) this.changeSpeed(-1); else this.dolly(1 / 0.85); }

  changeSpeed(by) {
    const speed = $('speed');
    speed.value = Number(speed.value) + 0.25 * by;
  }

  // --- flight ------------------------------------------------------------------------------------
  setFlying(isFlying) {
    this.isFlying = isFlying;
    this.releaseAll();
    $('fly').setAttribute('aria-pressed', isFlying);
    $('pad').hidden = !isFlying;
    $('view').classList.toggle('flying', isFlying);
  }

  hold(name) {
    const pose = this.view.pose();
    if (!pose || this.held.has(name)) return true;
    const isFirst = this.held.size === 0;
    this.held.add(name);
    if (!isFirst) return true;
    // Even the shortest press moves the view.
    this.view.move(fly(pose, this.way(pose, LEAST_STEP_S)), true);
    this.flownAt = performance.now();
    requestAnimationFrame(now => this.flight(now));
    return true;
  }

  release(name) {
    if (this.held.delete(name) && this.held.size === 0) this.rest();
  }

  releaseAll() {
    if (this.held.size === 0) return;
    this.held.clear();
    this.rest();
  }

  flight(now) {
    if (this.held.size === 0) return;
    const pose = this.view.pose(), seconds = Math.max(0, Math.min(LONGEST_STEP_S, (now - this.flownAt) / 1000));
    this.flownAt = now;
    if (pose && seconds > 0) this.view.move(fly(pose, this.way(pose, seconds)), true);
    requestAnimationFrame(later => this.flight(later));
  }

  way(pose, seconds) {
    const speed = extentOf(this.view.bounds(), pose) * FLY_SPEED * 2 ** Number($('speed').value) * (this.hasty ? HASTE : 1);
    const sum = [0, 0, 0];
    for (const name of this.held) FLIGHT[name].forEach((v, i) => { sum[i] += v; });
    const length = Math.hypot(...sum) || 1;
    return sum.map(v => v / length * speed * seconds);
  }

  // --- buttons -----------------------------------------------------------------------------------
  buttons() {
    $('fly').addEventListener('click', () => this.setFlying(!this.isFlying));
    $('in').addEventListener('click', () => this.nearer());
    $('out').addEventListener('click', () => this.away());
    $('fit').addEventListener('click', () => this.view.fit());
    $('back').addEventListener('click', () => this.view.reset());
    for (const button of document.querySelectorAll('[data-fly]')) {
      const name = button.dataset.fly;
      button.addEventListener('pointerdown', event => { button.setPointerCapture(event.pointerId); this.hold(name); });
      for (const end of ['pointerup', 'pointercancel', 'lostpointercapture']) button.addEventListener(end, () => this.release(name));
      button.addEventListener('contextmenu', event => event.preventDefault());
      // Pressed by keyboard or another device without a pointer: one step.
      button.addEventListener('click', event => { if (event.detail === 0) this.step(name); });
    }
  }

  step(name) {
    const pose = this.view.pose();
    if (!pose) return;
    this.held.add(name);
    const way = this.way(pose, 0.25);
    this.held.delete(name);
    this.view.move(fly(pose, way));
  }
}
