// Plays a camera path by the clock, with a pose per animation frame. If the server is slow, poses are skipped and the time is
// kept.

import { durationOf, sampler, startOf } from './path.js';

export class Player {
  // path: a function that returns the path when playing begins. on: {pose(pose, moving), changed()}.
  constructor(path, on) {
    this.path = path;
    this.on = on;
    this.isPlaying = false;
    this.loops = false;
    this.at = 0; // seconds after the first key
  }

  play() {
    const path = this.path(), duration = durationOf(path);
    if (path.keys.length === 0 || this.isPlaying) return;
    this.pose = sampler(path);
    this.start = startOf(path);
    this.duration = duration;
    if (this.at >= duration) this.at = 0;
    this.isPlaying = true;
    this.began = performance.now() - this.at * 1000;
    this.on.changed();
    requestAnimationFrame(now => this.tick(now));
  }

  tick(now) {
    if (!this.isPlaying) return;
    let at = Math.max(0, (now - this.began) / 1000);
    if (at >= this.duration) {
      if (!this.loops || this.duration <= 0) {
        this.at = this.duration;
        this.isPlaying = false;
        this.on.pose(this.pose(this.start + this.duration), false);
        return this.on.changed();
      }
      at %= this.duration;
      this.began = now - at * 1000;
    }
    this.at = at;
    this.on.pose(this.pose(this.start + at), true);
    this.on.changed();
    requestAnimationFrame(later => this.tick(later));
  }

  // Stops at the current time. `isOwn`: draw the current pose at full quality; false if the view has another pose already.
  pause(isOwn = true) {
    if (!this.isPlaying) return;
    this.isPlaying = false;
    if (isOwn) this.on.pose(this.pose(this.start + this.at), false);
    this.on.changed();
  }

  // Shows the path at a time.
  seek(at, moving) {
    const path = this.path();
    if (path.keys.length === 0) return;
    this.at = Math.max(0, Math.min(durationOf(path), at));
    if (this.isPlaying) { this.began = performance.now() - this.at * 1000; return; }
    this.on.pose(sampler(path)(startOf(path) + this.at), moving);
    this.on.changed();
  }
}
