// Films: the camera path drawn by the daemon, frame by frame at full quality, as a job that goes on without this page.

import { getJson, hasKey, reach, sceneUrl } from './api.js';
import { $, complain, count } from './message.js';
import { documentOf } from './path.js';

const POLL_MS = 700;
const FAILED_MS = 3000;

export class Films {
  // view: {scene(), recorder, settings()}.
  constructor(view) {
    this.view = view;
    this.job = null;
    $('film-start').addEventListener('click', () => this.start());
    $('film-cancel').addEventListener('click', () => this.cancel());
    $('film-result').addEventListener('click', event => this.fetched(event));
    view.recorder.onShow = () => this.show();
  }

  // Whether the daemon draws such jobs, as /v1/limits says.
  offer(isThere) {
    $('film').hidden = !isThere;
    this.show();
  }

  get isRunning() { return Boolean(this.job) && ['queued', 'running'].includes(this.job.state); }

  show() {
    const isEmpty = this.view.recorder.path.keys.length < 2;
    $('film-start').disabled = isEmpty || this.isRunning || !this.view.scene();
    $('film-cancel').hidden = $('film-progress').hidden = !this.isRunning;
  }

  async start() {
    const { recorder } = this.view, isVideo = $('film-want').value === 'video';
    const [w, h] = $('film-size').value.split('x').map(Number);
    const { format, quality, ...settings } = this.view.settings();
    const body = {
      scene: this.view.scene().id, path: recorder.name || documentOf(recorder.path), want: [isVideo ? 'video' : 'frames'],
      w, h, fps: recorder.path.fps, ...settings, ...(isVideo ? {} : { format, ...(quality ? { quality } : {}) }),
    };
    $('film-result').hidden = true;
    this.say('Sending …');
    try {
      const options = { method: 'POST', headers: { 'Content-Type': 'application/json' }, body: JSON.stringify(body) };
      this.came(await (await reach('/v1/jobs', options)).json());
      this.follow(this.job.id);
    } catch (problem) {
      this.say('');
      complain(problem);
    }
  }

  // The daemon tells by itself; a page with a key cannot listen, and asks.
  follow(id) {
    if (hasKey()) return this.ask(id);
    const events = new EventSource(`/v1/jobs/${encodeURIComponent(id)}/events`);
    const told = event => {
      this.came(JSON.parse(event.data));
      if (!this.isRunning) events.close();
    };
    for (const name of ['job', 'done', 'failed', 'cancelled']) events.addEventListener(name, told);
    events.addEventListener('deleted', () => { events.close(); this.gone(id); });
    // It comes back by itself, unless it was refused for good.
    events.onerror = () => { if (events.readyState === EventSource.CLOSED && this.isRunning) this.ask(id); };
  }

  async ask(id) {
    while (this.isRunning && this.job.id === id) {
      let pause = POLL_MS;
      try {
        this.came(await getJson(`/v1/jobs/${encodeURIComponent(id)}`));
      } catch (problem) {
        if (problem.status === 404) return this.gone(id);
        pause = FAILED_MS;
      }
      await new Promise(resolve => setTimeout(resolve, pause));
    }
  }

  // Somebody deleted it.
  gone(id) {
    if (this.job?.id !== id) return;
    this.job = null;
    this.say('The job was deleted.');
    this.show();
  }

  came(job) {
    this.job = job;
    const { done, total, coded } = job.frames, isCoding = job.stage === 'video';
    const made = isCoding ? coded : done, progress = $('film-progress');
    if (total) progress.value = made / total; else progress.removeAttribute('value');
    const rest = job.eta_seconds == null ? '' : `, ${Math.ceil(job.eta_seconds)} s to go`;
    this.say({
      queued: job.waits_for ? `Waiting: ${job.waits_for}` : 'Waiting for its turn',
      running: total ? `${count(made)} of ${count(total)} frames ${isCoding ? 'coded' : 'drawn'}${rest}` : 'Getting ready …',
      done: `Done: ${count(total)} frames.`,
      failed: 'It failed.',
      cancelled: 'Cancelled.',
    }[job.state] || job.state);
    if (job.state === 'failed' && job.error) complain(job.error);
    if (job.state === 'done') this.result(job);
    this.show();
  }

  result(job) {
    const link = $('film-result'), { video } = job.links;
    link.href = video || job.links.frames;
    link.textContent = video ? 'Download the video' : 'List of the frames';
    link.download = video ? `${job.scene}.mp4` : `${job.scene}-frames.jsonl`;
    link.hidden = false;
  }

  // A link cannot carry a key: with one, the file is fetched and then saved.
  async fetched(event) {
    const link = $('film-result');
    if (!hasKey() || link.protocol === 'blob:') return;
    event.preventDefault();
    try {
      link.href = URL.createObjectURL(await (await reach(link.href)).blob());
      link.click();
    } catch (problem) {
      complain(problem);
    }
  }

  async cancel() {
    if (!this.isRunning) return;
    try {
      const answer = await reach(`/v1/jobs/${encodeURIComponent(this.job.id)}/cancel`, { method: 'POST' });
      if (answer.status === 200) this.came(await answer.json());
    } catch (problem) {
      complain(problem);
    }
  }

  say(text) { $('film-text').textContent = text; }
}

// A film of a path that the scene names, for any <img>.
export function motionUrl(sceneId, path, settings) {
  const query = new URLSearchParams({ path, loop: 'true', w: 960, h: 540, ...settings });
  query.delete('format');
  return sceneUrl(sceneId, '/mjpeg?') + query;
}
