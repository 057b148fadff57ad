// Overlays of the picture besides messages: a frame is being drawn, nothing is in view, and the hint on the first visit. On a
// phone also the sheet that holds the panel.

import { $ } from './message.js';
import * as store from './store.js';

// Shorter waits are not shown.
const BUSY_MS = 150;
const HINT_MS = 9000;
const HINTS = {
  mouse: 'Drag to turn, scroll to zoom, right-drag to move, double-click to look at a point.',
  touch: 'One finger turns, two fingers zoom and move, a double tap looks at a point.',
};

let busyTimer = 0, hintTimer = 0, isKnown = store.knowsItsWay();

// Starts the wait for a frame.
export function wait() {
  if (!busyTimer) busyTimer = setTimeout(() => $('view').classList.add('busy'), BUSY_MS);
}

export function waitIsOver() {
  clearTimeout(busyTimer);
  busyTimer = 0;
  $('view').classList.remove('busy');
}

// why: a sentence, or null if something is in view.
export function lost(why) {
  if (why) $('lost-why').textContent = why;
  $('lost').hidden = !why;
}

// Shows the hint once to users who have never moved a picture here.
export function greet() {
  if (isKnown || hintTimer) return;
  $('hint').textContent = matchMedia('(pointer: coarse)').matches ? HINTS.touch : HINTS.mouse;
  $('hint').hidden = false;
  hintTimer = setTimeout(goodbye, HINT_MS);
}

// The user has moved the picture, so the hint is no longer needed.
export function moved() {
  if (!isKnown) goodbye();
}

function goodbye() {
  isKnown = true;
  store.keepKnowing();
  clearTimeout(hintTimer);
  $('hint').classList.add('fading');
  hintTimer = setTimeout(() => { $('hint').hidden = true; }, 600);
}

// --- the sheet -------------------------------------------------------------------------------------
function setSheet(isOpen) {
  if (isOpen && !$('hint').hidden) goodbye();
  $('sheet').setAttribute('aria-expanded', isOpen);
  document.body.classList.toggle('sheet-open', isOpen);
}

export const closeSheet = () => setSheet(false);

$('sheet').addEventListener('click', () => setSheet($('sheet').getAttribute('aria-expanded') !== 'true'));
addEventListener('keydown', event => { if (event.key === 'Escape') setSheet(false); });
// Touching the picture closes the sheet.
$('canvas').addEventListener('pointerdown', () => setSheet(false));
