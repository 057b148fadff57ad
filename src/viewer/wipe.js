// A wipe over the picture between two frames of one comparison, and the map of their differences.

import { $ } from './message.js';
import { digits, short } from './curve.js';

const STEP = 20; // of the slider's 1000, with an arrow key

export class Wipe {
  constructor() {
    $('wipe-share').addEventListener('input', () => this.draw());
    $('wipe-map').addEventListener('change', () => this.draw());
    $('wipe-close').addEventListener('click', () => this.close());
    $('wipe').addEventListener('keydown', event => { if (event.key === 'Escape') this.close(); });
    $('wipe-pictures').addEventListener('pointerdown', event => { $('wipe-pictures').setPointerCapture(event.pointerId); this.follow(event); });
    $('wipe-pictures').addEventListener('pointermove', event => { if (event.pointerType === 'mouse' || event.buttons) this.follow(event); });
  }

  // found: the answer of a comparison; names: those of its sides.
  open(found, [a, b]) {
    $('wipe-a').src = found.a.image;
    $('wipe-b').src = found.b.image;
    $('wipe-difference').src = found.difference;
    $('wipe-left').textContent = side(a, found.a);
    $('wipe-right').textContent = side(b, found.b);
    $('wipe-figures').textContent = figures(found);
    $('wipe-share').value = 500;
    $('wipe-share').step = STEP;
    $('wipe-map').checked = false;
    $('wipe').hidden = false;
    this.draw();
    $('wipe-share').focus({ preventScroll: true });
  }

  get isOpen() { return !$('wipe').hidden; }

  close() {
    if (!this.isOpen) return;
    $('wipe').hidden = true;
    for (const id of ['wipe-a', 'wipe-b', 'wipe-difference']) $(id).removeAttribute('src');
    $('canvas').focus({ preventScroll: true });
  }

  follow(event) {
    const box = $('wipe-pictures').getBoundingClientRect();
    $('wipe-share').step = 1;
    $('wipe-share').value = (1000 * (event.clientX - box.left)) / box.width;
    $('wipe-share').step = STEP;
    this.draw((100 * (event.clientX - box.left)) / box.width);
  }

  // share: percent of the left side.
  draw(share = $('wipe-share').value / 10) {
    const isMap = $('wipe-map').checked, at = Math.min(100, Math.max(0, share));
    $('wipe-difference').hidden = !isMap;
    $('wipe-edge').hidden = $('wipe-share').disabled = isMap;
    $('wipe-a').style.clipPath = `inset(0 ${100 - at}% 0 0)`;
    $('wipe-edge').style.left = `${at}%`;
  }
}

const side = (name, { gpu_ms }) => gpu_ms == null ? name : `${name}, ${short(gpu_ms)} ms`;

function figures({ psnr_db, ssim, flip, max_error, coverage, width, height }) {
  const psnr = psnr_db == null ? 'equal frames' : `PSNR ${digits(psnr_db, 2)} dB`;
  return `${psnr}, SSIM ${digits(ssim, 4)}, FLIP ${digits(flip, 4)}, largest error ${max_error}, ${coverage.holes} hole and ${coverage.leaks} leak pixels of ${width} × ${height}.`;
}
