// What lies over the picture beside messages: that a frame is being drawn, that nothing can be seen, and the first visit's hint. On a
// phone also the sheet that holds the panel.

import { $ } from './message.js';
import * as store from './store.js';

// Shorter waits are not worth a word.
const BUSY_MS = 150;
const HINT_MS = 9000;
const HINTS = {
  mouse: 'Drag to turn, scroll to zoom, right-drag to move, double-click to look at a point.',
  touch: 'One finger turns, two fingers zoom and move, a double tap looks at a point.',
};

let busyTimer = 0, hintTimer = 0, isKnown = store.knowsItsWay();

// A frame is waited for from now on. Frames that come meanwhile begin the wait anew.
export function wait() {
  if (!busyTimer) busyTimer = setTimeout(() => $('view').classList.add('busy'), BUSY_MS);
}

export function waitIsOver() {
  clearTimeout(busyTimer);
  busyTimer = 0;
  $('view').classList.remove('busy');
}

// why: a sentence, or null where something can be seen.
export function lost(why) {
  if (why) $('lost-why').textContent = why;
  $('lost').hidden = !why;
}

// Once, for whoever has never moved a picture here.
export function greet() {
  if (isKnown || hintTimer) return;
  $('hint').textContent = matchMedia('(pointer: coarse)').matches ? HINTS.touch : HINTS.mouse;
  $('hint').hidden = false;
  hintTimer = setTimeout(goodbye, HINT_MS);
}

// A hand moved the picture: the hint has served.
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
  $('sheet').setAttribute('aria-expanded', isOpen);
  document.body.classList.toggle('sheet-open', isOpen);
}

$('sheet').addEventListener('click', () => setSheet($('sheet').getAttribute('aria-expanded') !== 'true'));
addEventListener('keydown', event => { if (event.key === 'Escape') setSheet(false); });
// A hand on the picture wants the picture.
$('canvas').addEventListener('pointerdown', () => setSheet(false));
