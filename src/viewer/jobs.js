// The list of the server's films, running or finished, with the actions on each.

import { getJson, reach } from './api.js';
import { $, button, bytes, complain, count } from './message.js';
import { Reel, downloadLink, hasFrames, jobUrl, showVideo } from './reel.js';

const POLL_MS = 2000;

export const isUnderWay = job => job.state === 'queued' || job.state === 'running';

export class Jobs {
  constructor() {
    this.reel = new Reel();
    this.list = [];
    this.doubtful = null; // the job whose deletion is to be confirmed
    this.timer = 0;
    this.onGone = this.onList = () => {};
    this.played = null;
    $('job-video-close').addEventListener('click', () => this.play(null));
    $('jobs').addEventListener('toggle', () => { if ($('jobs').open) this.refresh(); });
    document.addEventListener('visibilitychange', () => { if (!document.hidden && $('jobs').open) this.refresh(); });
  }

  offer(isThere) {
    $('jobs').hidden = !isThere;
    if (isThere) this.refresh();
  }

  async refresh() {
    clearTimeout(this.timer);
    if ($('jobs').hidden) return;
    try {
      this.list = (await getJson('/v1/jobs')).jobs;
      this.show();
      this.onList(this.list);
    } catch { /* the link says that nobody is there; it is asked again when it matters */ }
    const isFollowed = $('jobs').open && !document.hidden && this.list.some(isUnderWay);
    if (isFollowed) this.timer = setTimeout(() => this.refresh(), POLL_MS);
  }

  show() {
    const running = this.list.filter(isUnderWay).length;
    $('jobs-summary').textContent = this.list.length === 0 ? '' : running ? `${this.list.length}, ${running} under way` : String(this.list.length);
    $('no-jobs').hidden = this.list.length > 0;
    // Restores the focus after the list is rebuilt.
    const focused = $('job-list').contains(document.activeElement) ? document.activeElement.dataset.act : null;
    $('job-list').replaceChildren(...this.list.map(job => this.row(job)));
    if (focused) [...$('job-list').querySelectorAll('[data-act]')].find(one => one.dataset.act === focused)?.focus();
  }

  row(job) {
    const item = document.createElement('li'), head = document.createElement('b'), facts = document.createElement('small'), row = document.createElement('div');
    item.dataset.job = job.id;
    row.className = 'row';
    const path = typeof job.path === 'string' ? job.path : 'a recorded path';
    head.textContent = `${job.scene}, ${path}`;
    facts.textContent = `${inWords(job)} ${job.settings.w} × ${job.settings.h}, ${whenOf(job)}.`;
    item.append(head, facts);
    if (isUnderWay(job) && job.frames.total) item.append(progressOf(job));
    row.append(...this.actions(job));
    item.append(row);
    return item;
  }

  actions(job) {
    const act = (name, words, what) => {
      const made = button(words, what);
      made.dataset.act = `${name} ${job.id}`;
      return made;
    };
    if (this.doubtful === job.id) {
      return [act('delete', 'Delete it and its files', () => this.remove(job.id)), act('keep', 'Keep', () => this.doubt(null, `ask ${job.id}`))];
    }
    const found = [];
    if (job.video) {
      const link = downloadLink(document.createElement('a'), job.links.video, `${job.scene}-${job.id}.mp4`);
      link.textContent = `Download (${bytes(job.video.bytes)})`;
      link.dataset.act = `video ${job.id}`;
      found.push(act('play', 'Play', () => this.play(job)), link);
    }
    if (hasFrames(job)) found.push(act('frames', 'Look at the frames', () => this.reel.open(job.id)));
    if (isUnderWay(job)) found.push(act('cancel', 'Cancel', () => this.post(job.id, '/cancel')));
    if (job.state === 'failed' || job.state === 'cancelled') found.push(act('resume', 'Resume', () => this.post(job.id, '/resume')));
    const away = act('ask', '✕', () => this.doubt(job.id, `keep ${job.id}`));
    away.title = `Delete film ${job.id} …`;
    away.setAttribute('aria-label', away.title);
    return [...found, away];
  }

  // Plays the video of a film above the list; null closes the player.
  play(job) {
    this.played = job?.id;
    $('job-player').hidden = !job;
    $('job-video-title').textContent = job ? `Film ${job.id} of ${job.scene}` : '';
    showVideo($('job-video'), job?.links.video ?? null);
    if (job) $('job-player').scrollIntoView({ block: 'nearest' });
  }

  doubt(id, focused) {
    this.doubtful = id;
    this.show();
    [...$('job-list').querySelectorAll('[data-act]')].find(one => one.dataset.act === focused)?.focus();
  }

  async post(id, what) {
    try {
      await reach(jobUrl(id, what), { method: 'POST' });
    } catch (problem) {
      complain(problem, 'film');
    }
    this.refresh();
  }

  async remove(id) {
    this.doubtful = null;
    try {
      await reach(jobUrl(id), { method: 'DELETE' });
      if (this.reel.job?.id === id) this.reel.close();
      if (this.played === id) this.play(null);
      this.onGone(id);
    } catch (problem) {
      complain(problem, 'film');
    }
    this.refresh();
  }
}

// The state of a job in a sentence.
export function inWords(job) {
  const { done, total, coded } = job.frames, isCoding = job.stage === 'video';
  const rest = job.eta_seconds == null ? '' : `, ${Math.ceil(job.eta_seconds)} s to go`;
  return {
    queued: job.waits_for ? `Waiting: ${job.waits_for}.` : 'Waiting for its turn.',
    running: total ? `${count(isCoding ? coded : done)} of ${count(total)} frames ${isCoding ? 'coded' : 'drawn'}${rest}.` : 'Getting ready …',
    done: `Done: ${count(total)} frames.`,
    failed: `It failed: ${job.error?.detail || job.error?.title || 'nothing says why'}`.replace(/[^.]$/, '$&.'),
    cancelled: `Cancelled${total ? ` at ${count(done)} of ${count(total)} frames` : ''}.`,
  }[job.state] || job.state;
}

export const shareOf = job => (job.stage === 'video' ? job.frames.coded : job.frames.done) / job.frames.total;

function progressOf(job) {
  const progress = document.createElement('progress');
  progress.value = shareOf(job);
  progress.setAttribute('aria-label', `Film ${job.id}`);
  return progress;
}

function whenOf(job) {
  const minutes = Math.max(0, Date.now() - job.since_ms) / 60000;
  if (minutes < 1) return 'just now';
  if (minutes < 60) return `${Math.round(minutes)} min ago`;
  return minutes < 48 * 60 ? `${Math.round(minutes / 60)} h ago` : `${Math.round(minutes / 1440)} days ago`;
}
