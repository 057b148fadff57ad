// Frames by requests, where a stream is impossible. At most one request is in flight, and the newest pose wins. While the pose
// moves, frames are JPEGs of a size that arrives in about TARGET_MS. At rest, one frame follows with the chosen settings.

import { isPassing, queryText, reach, sceneUrl } from './api.js';

const TARGET_MS = 70;
const SCALES = [1, 0.75, 0.5, 0.35, 0.25];
// Time without a change after which the pose counts as at rest.
const REST_MS = 160;
const MOVING_QUALITY = 75;

// The address of a frame with these parameters.
export function frameUrl(id, params) {
  const query = new URLSearchParams();
  for (const [name, value] of Object.entries(params)) query.set(name, Array.isArray(value) ? value.join(',') : value);
  return sceneUrl(id, '/frame?') + queryText(query);
}

export class Requests {
  constructor(wanted, came, failed) {
    this.wanted = wanted;
    this.came = came;
    this.failed = failed;
    this.isRunning = false;
    this.scale = 2;
    this.timer = 0;
    this.flight = null;
  }

  start(seq, moving) {
    this.isRunning = true;
    this.show(seq, moving);
  }

  stop() {
    this.isRunning = false;
    clearTimeout(this.timer);
    if (this.flight) this.flight.abort.abort();
    this.flight = null;
  }

  show(seq, moving) {
    this.seq = seq;
    this.restsAt = performance.now() + (moving === false ? 0 : REST_MS);
    this.best = null;
    // A full frame of an outdated pose is cancelled; a small one is not.
    if (this.flight && this.flight.isStill) this.flight.abort.abort();
    this.pump();
  }

  pump(delay = 0) {
    clearTimeout(this.timer);
    if (this.isRunning) this.timer = setTimeout(() => this.step(), delay);
  }

  step() {
    if (!this.isRunning || this.flight || document.hidden || this.best === 'still') return;
    const rest = this.restsAt - performance.now();
    if (rest <= 0) this.request(true);
    else if (this.best === null) this.request(false);
    else this.pump(rest);
  }

  async request(isStill) {
    const wanted = this.wanted();
    if (!wanted) return;
    const flight = this.flight = { seq: this.seq, isStill, abort: new AbortController() };
    const began = performance.now(), scale = isStill ? 1 : SCALES[this.scale];
    let failure = null;
    try {
      const params = isStill ? wanted.params : this.smaller(wanted.params, scale);
      const response = await reach(frameUrl(wanted.id, params), { signal: flight.abort.signal });
      const image = await response.blob(), picture = await createImageBitmap(image);
      if (flight.abort.signal.aborted) picture.close();
      flight.abort.signal.throwIfAborted();
      const elapsedMs = performance.now() - began;
      const receipt = JSON.parse(response.headers.get('Pointillist-Receipt') || 'null');
      const { w: width, h: height, format, quality } = params;
      if (flight.seq === this.seq) this.best = isStill ? 'still' : 'moving';
      this.adapt(isStill, elapsedMs);
      this.came({
        picture, receipt, elapsedMs, width, height, scale, format, jpeg_quality: format === 'jpeg' ? quality : null, seq: flight.seq,
        revision: receipt ? receipt.revision : null, quality: isStill ? 'still' : 'moving', bytes: image.size,
      });
    } catch (error) {
      if (!flight.abort.signal.aborted) failure = error;
    } finally {
      if (this.flight === flight) this.flight = null;
    }
    if (failure) this.recover(failure, flight.seq); else this.pump();
  }

  smaller(params, scale) {
    const side = full => Math.max(1, Math.round(full * scale));
    const lossy = !params.output || params.output === 'color' ? { format: 'jpeg', quality: MOVING_QUALITY } : {};
    return { ...params, w: side(params.w), h: side(params.h), ...lossy };
  }

  adapt(isStill, elapsedMs) {
    if (isStill) { if (elapsedMs < TARGET_MS) this.scale = 0; return; }
    if (elapsedMs > TARGET_MS * 1.4 && this.scale < SCALES.length - 1) this.scale++;
    else if (elapsedMs < TARGET_MS * 0.5 && this.scale > 0) this.scale--;
  }

  recover(problem, seq) {
    // The server refuses this pose or these settings. Wait for others, unless others are there already or another try may help.
    if (isPassing(problem) && problem.status !== 0) this.pump(problem.retry_after_ms || 2000);
    else if (seq === this.seq) this.best = 'still';
    else this.pump();
    this.failed(problem);
  }
}
