// Films: the server draws the camera path frame by frame at full quality, as a job that goes on without this page. The page
// stores the job's id, so that a reload follows it again.

import { getJson, hasKey, reach, sceneUrl } from './api.js';
import { inWords, isUnderWay, shareOf } from './jobs.js';
import { $, complain, quiet } from './message.js';
import { documentOf } from './path.js';
import { downloadLink, hasFrames, jobUrl, showVideo } from './reel.js';
import * as store from './store.js';

const POLL_MS = 700;
const FAILED_MS = 3000;

export class Films {
  // view: {scene(), recorder, settings(), jobs}.
  constructor(view) {
    this.view = view;
    this.job = null;
    this.isOffered = false;
    $('film-start').addEventListener('click', () => this.start());
    $('film-cancel').addEventListener('click', () => this.cancel());
    $('film-frames').addEventListener('click', () => view.jobs.reel.open(this.job.id));
    view.recorder.onShow = () => this.show();
    view.jobs.onGone = id => this.gone(id);
    view.jobs.onList = list => this.listed(list);
  }

  // isThere: whether the server draws jobs, by /v1/limits.
  offer(isThere) {
    $('film').hidden = !isThere;
    if (isThere && !this.isOffered) this.restore();
    this.isOffered = isThere;
    this.show();
  }

  // Continues with the film from before a reload.
  async restore() {
    const id = store.film();
    if (!id || this.job) return;
    try {
      const job = await getJson(jobUrl(id));
      if (this.job) return;
      this.came(job);
      if (!this.isRunning) return;
      $('paths').open = true;
      this.follow(id);
    } catch (problem) {
      // The job was deleted or has expired.
      if (problem.status === 404) store.keepFilm(null);
    }
  }

  get isRunning() { return Boolean(this.job) && isUnderWay(this.job); }

  show() {
    const isEmpty = this.view.recorder.path.keys.length < 2, { job } = this;
    $('film-start').disabled = isEmpty || this.isRunning || !this.view.scene();
    $('film-cancel').hidden = $('film-progress').hidden = !this.isRunning;
    const isDone = job?.state === 'done';
    $('film-frames').hidden = !isDone || !hasFrames(job);
    $('film-result').hidden = !isDone || !job.links.video;
    const video = isDone && job.links.video;
    if (video) downloadLink($('film-result'), video, `${job.scene}-${job.id}.mp4`);
    showVideo($('film-video'), video || null);
    if (job) this.say(this.view.scene()?.id === job.scene ? inWords(job) : `${job.scene}: ${inWords(job)}`);
  }

  async start() {
    const { recorder } = this.view, isVideo = $('film-want').value === 'video';
    const [w, h] = $('film-size').value.split('x').map(Number);
    const { format, quality, ...settings } = this.view.settings();
    const body = {
      scene: this.view.scene().id, path: recorder.name || documentOf(recorder.path), want: [isVideo ? 'video' : 'frames'],
      w, h, fps: recorder.path.fps, ...settings, ...(isVideo ? {} : { format, ...(quality ? { quality } : {}) }),
    };
    this.job = null;
    this.show();
    this.say('Sending …');
    quiet('film');
    try {
      const options = { method: 'POST', headers: { 'Content-Type': 'application/json' }, body: JSON.stringify(body) };
      this.came(await (await reach('/v1/jobs', options)).json());
      store.keepFilm(this.job.id);
      this.follow(this.job.id);
    } catch (problem) {
      this.say('');
      complain(problem, 'film');
    }
  }

  // The server sends events. EventSource cannot send a key, so a page with a key polls instead.
  follow(id) {
    if (hasKey()) return this.ask(id);
    const events = new EventSource(jobUrl(id, '/events'));
    const told = event => {
      this.came(JSON.parse(event.data));
      if (!this.isRunning) events.close();
    };
    for (const name of ['job', 'done', 'failed', 'cancelled']) events.addEventListener(name, told);
    events.addEventListener('deleted', () => { events.close(); this.gone(id); });
    // EventSource reconnects by itself, unless it was refused for good.
    events.onerror = () => { if (events.readyState === EventSource.CLOSED && this.isRunning) this.ask(id); };
  }

  async ask(id) {
    while (this.isRunning && this.job.id === id) {
      let pause = POLL_MS;
      try {
        this.came(await getJson(jobUrl(id)));
      } catch (problem) {
        if (problem.status === 404) return this.gone(id);
        pause = FAILED_MS;
      }
      await new Promise(resolve => setTimeout(resolve, pause));
    }
  }

  // Another client has resumed the job.
  listed(list) {
    const job = list.find(one => one.id === this.job?.id);
    if (!job || !isUnderWay(job) || this.isRunning) return;
    this.came(job);
    this.follow(job.id);
  }

  // Another client has deleted the job.
  gone(id) {
    if (this.job?.id !== id) return;
    this.job = null;
    store.keepFilm(null);
    this.show();
    this.say('The film was deleted.');
    this.view.jobs.refresh();
  }

  came(job) {
    const before = this.job?.state, progress = $('film-progress');
    this.job = job;
    if (job.frames.total) progress.value = shareOf(job); else progress.removeAttribute('value');
    if (job.state !== before) this.view.jobs.refresh();
    // A failure from before the page was opened is shown in the panel only.
    if (before && job.state === 'failed' && job.error) complain(job.error, 'film');
    this.show();
  }

  async cancel() {
    if (!this.isRunning) return;
    try {
      const answer = await reach(jobUrl(this.job.id, '/cancel'), { method: 'POST' });
      if (answer.status === 200) this.came(await answer.json());
    } catch (problem) {
      complain(problem, 'film');
    }
  }

  say(text) { $('film-text').textContent = text; }
}

// The address of a film of one of the scene's paths, for any <img>.
export function motionUrl(sceneId, path, settings) {
  const query = new URLSearchParams({ path, loop: 'true', w: 960, h: 540, ...settings });
  query.delete('format');
  return sceneUrl(sceneId, '/mjpeg?') + query;
}
