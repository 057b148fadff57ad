// The frames of a film without video: shows or plays them, and downloads one or all.

import { getJson, hasKey, reach } from './api.js';
import { $, complain, count } from './message.js';
import { MOST_BYTES, MOST_FILES, Zip } from './zip.js';

// Formats that an <img> shows.
const SHOWN = ['png', 'jpeg', 'webp'];
const SLOWEST_FPS = 0.1;

export const jobUrl = (id, rest = '') => `/v1/jobs/${encodeURIComponent(id)}${rest}`;
export const hasFrames = job => job.want.includes('frames') && job.frames.done > 0;

// Makes a link that downloads from an address. A link cannot send a key: with a key, the file is fetched first.
export function downloadLink(link, url, name) {
  link.href = url;
  link.download = name;
  link.onclick = async event => {
    if (!hasKey()) return;
    event.preventDefault();
    try {
      save(await (await reach(url)).blob(), name);
    } catch (problem) {
      complain(problem, 'film');
    }
  };
  return link;
}

// Shows the video at an address in its element; null hides the element.
export async function showVideo(element, url) {
  element.hidden = !url;
  if (element.dataset.of === (url ?? '')) return;
  element.dataset.of = url ?? '';
  if (element.src.startsWith('blob:')) URL.revokeObjectURL(element.src);
  if (!url) return element.removeAttribute('src');
  try {
    // A video element cannot send a key either.
    const src = hasKey() ? URL.createObjectURL(await (await reach(url)).blob()) : url;
    if (element.dataset.of === url) element.src = src;
    else URL.revokeObjectURL(src);
  } catch (problem) {
    complain(problem, 'film');
  }
}

function save(blob, name) {
  const link = document.createElement('a');
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
}

export class Reel {
  constructor() {
    this.job = null;
    this.numbers = []; // of the frames that are there, in order
    this.isPlaying = false;
    this.packing = null; // the archive that is being made
    this.asked = 0;
    $('reel-close').addEventListener('click', () => this.close());
    $('reel-play').addEventListener('click', () => { if (this.isPlaying) this.stop(); else this.play(); });
    $('reel-frame').addEventListener('input', () => { this.stop(); this.look(Number($('reel-frame').value)); });
    $('reel-all').addEventListener('click', () => this.pack());
  }

  get last() { return this.numbers.length - 1; }
  get extension() { return this.job.settings.format === 'jpeg' ? 'jpg' : this.job.settings.format; }

  async open(id) {
    let job, numbers;
    try {
      job = await getJson(jobUrl(id));
      numbers = await numbersOf(job);
    } catch (problem) {
      return complain(problem, 'film');
    }
    this.close();
    Object.assign(this, { job, numbers });
    const isShown = SHOWN.includes(job.settings.format);
    $('reel-title').textContent = `Film ${job.id} of ${job.scene}, ${job.settings.w} × ${job.settings.h}`;
    Object.assign($('reel-frame'), { min: 0, max: this.last, value: 0 });
    $('reel-image').hidden = !isShown;
    $('reel-play').disabled = !isShown || numbers.length < 2;
    this.say(isShown ? '' : `No browser shows ${job.settings.format.toUpperCase()}; the frames can be downloaded.`);
    downloadLink($('reel-list'), job.links.frames, `${job.scene}-${job.id}-frames.jsonl`);
    $('reel').hidden = false;
    $('jobs').open = true;
    await this.look(0);
    $('reel').scrollIntoView({ block: 'nearest' });
  }

  close() {
    this.stop();
    this.packing = null;
    this.job = null;
    $('reel').hidden = true;
    this.free();
  }

  // Shows the frame at this place in `numbers`. Returns whether it was shown: a later call, or one for another film, overtakes it.
  async look(place) {
    const ticket = ++this.asked, { job } = this, number = this.numbers[place], image = $('reel-image');
    const url = jobUrl(job.id, `/frames/${number}`), name = `${job.scene}-${job.id}-${numbered(number)}.${this.extension}`;
    $('reel-frame').value = place;
    $('reel-frame').ariaValueText = `${number}`;
    $('reel-shown').textContent = `${number}`;
    downloadLink($('reel-one'), url, name);
    if (image.hidden) return true;
    let src = url;
    const shown = new Image();
    try {
      if (hasKey()) src = URL.createObjectURL(await (await reach(url)).blob());
      // Decode it separately, so that the earlier picture stays until the new one is ready.
      shown.src = src;
      await shown.decode();
    } catch (problem) {
      URL.revokeObjectURL(src);
      if (ticket === this.asked) this.say(`Frame ${number} cannot be shown: ${problem.detail || 'it is not there'}.`, true);
      return false;
    }
    if (ticket !== this.asked || this.job !== job) {
      URL.revokeObjectURL(src);
      return false;
    }
    this.free();
    image.src = src;
    image.alt = `Frame ${number}`;
    if (this.isOfFrame) this.say('');
    return true;
  }

  // isOfFrame: the text goes away when the next frame is shown.
  say(text, isOfFrame = false) {
    this.isOfFrame = isOfFrame;
    $('reel-text').textContent = text;
  }

  free() {
    if ($('reel-image').src.startsWith('blob:')) URL.revokeObjectURL($('reel-image').src);
  }

  async play() {
    const fps = Math.max(SLOWEST_FPS, this.job.fps || 30), { job, last } = this;
    const from = Number($('reel-frame').value) >= last ? 0 : Number($('reel-frame').value), began = performance.now();
    this.isPlaying = true;
    $('reel-play').textContent = 'Pause';
    let place = from;
    while (this.isPlaying && this.job === job) {
      if (!await this.look(place) || place === last) break;
      // Keep the film's own time: late frames are skipped, except for the last.
      await new Promise(resolve => setTimeout(resolve, Math.max(0, began + (place + 1 - from) * 1000 / fps - performance.now())));
      place = Math.min(last, Math.max(place + 1, from + Math.floor((performance.now() - began) * fps / 1000)));
    }
    if (this.job === job) this.stop();
  }

  stop() {
    this.isPlaying = false;
    $('reel-play').textContent = 'Play';
  }

  async pack() {
    const { job, numbers } = this, total = numbers.length, say = text => { if (this.job === job) this.say(text); };
    if (job.bytes > MOST_BYTES * 0.99 || total > MOST_FILES) return say(`${count(total)} frames are more than an archive made here holds; ${job.links.multipart} sends them all.`);
    if (this.packing) return;
    // A film that is closed meanwhile ends its archive, even if another one is begun.
    const zip = this.packing = new Zip();
    try {
      for (const [fetched, number] of numbers.entries()) {
        if (this.packing !== zip) return;
        say(`${count(fetched)} of ${count(total)} frames fetched …`);
        await zip.add(`${numbered(number)}.${this.extension}`, await (await reach(jobUrl(job.id, `/frames/${number}`))).blob());
      }
      if (this.packing !== zip) return;
      save(zip.finish(), `${job.scene}-${job.id}-frames.zip`);
      say(`${count(total)} frames saved as one archive.`);
    } catch (problem) {
      if (this.packing !== zip) return;
      say('');
      complain(problem, 'film');
    } finally {
      if (this.packing === zip) this.packing = null;
    }
  }
}

// Workers finish frames in any order, so the manifest tells which ones an unfinished film has.
async function numbersOf({ frames: { from, done, total }, links }) {
  if (done === total) return Array.from({ length: done }, (_, place) => (from ?? 0) + place);
  const lines = (await (await reach(links.frames)).text()).split('\n').slice(1).filter(Boolean);
  return [...new Set(lines.map(line => JSON.parse(line).frame))].sort((a, b) => a - b);
}

const numbered = number => String(number).padStart(6, '0');
