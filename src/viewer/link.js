// The connection to the server: a WebSocket on which poses go out and frames come in, or requests where a WebSocket is
// impossible.
//
//   open ──▶ connecting ──▶ stream ──lost──▶ waiting ──▶ connecting     longer each time, at once when the network is back
//                │ closed before it was open
//                └──▶ probe ──▶ waiting (nobody there, loading), gone, denied, or the second time in a row: requests
//
// The page holds the pose, so a new connection continues where the old one was. A frame is acknowledged after it is drawn, so
// that the server follows the pace of this decoder. A frame that a newer one overtakes before it is decoded is skipped.

import { getJson, isPassing, sceneUrl, subprotocols } from './api.js';
import { Requests } from './requests.js';

const FIRST_WAIT_MS = 300, LONGEST_WAIT_MS = 8000;
// A stream on which nothing came for this long, although it was pinged, counts as dead.
const PING_MS = 8000, DEAD_MS = 24000;
// Time after which the stream is tried again while requests are used.
const REQUESTS_MS = 30000;

// Delay in milliseconds before try number `tries`, from 0. `random`, between 0 and 1, spreads clients.
export const waitBefore = (tries, random) => Math.min(LONGEST_WAIT_MS, FIRST_WAIT_MS * 2 ** tries) * (0.75 + 0.5 * random);

export class Link {
  // wanted(): {id, params} to show, or null. on: {frame(info, picture), state(name, detail), scene(revision), gone(), problem(p), denied(p)}.
  constructor(wanted, on) {
    this.wanted = wanted;
    this.on = on;
    this.socket = null;
    this.seq = 0;
    this.sentAt = new Map();
    this.tries = 0;
    this.refusals = 0;
    this.timer = 0;
    this.isDue = false;
    this.moving = undefined;
    this.newest = null;
    this.isDecoding = false;
    this.requests = new Requests(wanted, info => this.came(info), problem => this.requestFailed(problem));
    addEventListener('online', () => this.again());
    document.addEventListener('visibilitychange', () => { if (!document.hidden) this.woken(); });
    setInterval(() => this.heartbeat(), PING_MS);
  }

  // Shows another scene, or the same scene over a new connection.
  open() {
    this.close();
    this.tries = this.refusals = 0;
    this.connect();
  }

  close() {
    clearTimeout(this.timer);
    this.requests.stop();
    const socket = this.socket;
    this.socket = null;
    this.newest = null;
    if (socket) socket.close();
  }

  // The pose or a setting has changed. moving: true if another change will follow soon, false if none will, undefined if unknown.
  show(moving) {
    this.moving = moving;
    this.seq++;
    if (this.isDue) return this.seq;
    this.isDue = true;
    // At most one message per animation frame, however often a pointer reports.
    requestAnimationFrame(() => this.flush());
    return this.seq;
  }

  flush() {
    this.isDue = false;
    if (this.requests.isRunning) return this.requests.show(this.seq, this.moving);
    const wanted = this.wanted();
    if (!wanted || !this.socket || this.socket.readyState !== WebSocket.OPEN) return;
    const moving = this.moving === undefined ? {} : { moving: this.moving };
    // `reset`: parameters that this message leaves out take their defaults.
    this.socket.send(JSON.stringify({ seq: this.seq, reset: true, ...moving, ...wanted.params }));
    this.sentAt.set(this.seq, performance.now());
    for (const seq of this.sentAt.keys()) if (seq < this.seq - 500) this.sentAt.delete(seq);
  }

  connect() {
    clearTimeout(this.timer);
    const wanted = this.wanted();
    if (!wanted) return;
    if (!this.requests.isRunning) this.on.state('connecting', 'connecting …');
    const url = new URL(sceneUrl(wanted.id, '/stream'), location.href);
    url.protocol = url.protocol.replace('http', 'ws');
    let socket;
    try {
      socket = new WebSocket(url, subprotocols());
    } catch {
      // The key cannot be a subprotocol, or the page may not open a WebSocket.
      return this.fall('this page can open no stream');
    }
    this.socket = socket;
    socket.binaryType = 'arraybuffer';
    let wasOpen = false;
    socket.onopen = () => {
      wasOpen = true;
      this.refusals = 0;
      this.heardAt = performance.now();
      this.requests.stop();
      this.on.state('stream', 'streaming');
      // A page that has just opened is at rest, unless the user moves the picture already.
      if (!this.moving) this.moving = false;
      this.seq++;
      this.flush();
    };
    socket.onmessage = ({ data }) => { if (this.socket === socket) this.message(data, socket); };
    socket.onclose = event => {
      if (this.socket !== socket) return;
      this.socket = null;
      if (wasOpen) this.lost(event.code, event.reason); else this.probe(wanted.id);
    };
  }

  message(data, socket) {
    this.heardAt = performance.now();
    if (typeof data === 'string') {
      const event = JSON.parse(data);
      if (event.event === 'scene') this.on.scene(event.revision);
      else if (event.event === 'problem') this.on.problem(event);
      return; // `deleted` is followed by a close that says the same
    }
    const length = new DataView(data).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    this.newest = { header, socket, image: new Blob([new Uint8Array(data, 4 + length)], { type: header.content_type }) };
    if (!this.isDecoding) this.decode();
  }

  async decode() {
    this.isDecoding = true;
    while (this.newest) {
      const { header, image, socket } = this.newest;
      this.newest = null;
      let picture = null;
      try {
        picture = await createImageBitmap(image);
      } catch {
        // A connection that was left, for another scene for example, has nothing to say.
        if (socket === this.socket) this.on.problem({ title: 'A frame cannot be decoded', detail: `${header.content_type}, ${header.bytes} bytes` });
      }
      if (socket !== this.socket) { if (picture) picture.close(); continue; }
      if (picture) {
        const sent = this.sentAt.get(header.seq);
        this.came({ ...header, picture, elapsedMs: sent === undefined ? null : performance.now() - sent });
      }
      if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ ack: header.frame }));
    }
    this.isDecoding = false;
  }

  came(info) {
    this.tries = 0;
    this.on.frame(info, info.seq === this.seq && !this.isDue);
  }

  lost(code, reason) {
    if (code === 4404) return this.on.gone();
    if (code === 4429) return this.fall('too many streams are open');
    if (code === 4408 && document.hidden) return this.on.state('asleep', 'asleep');
    this.wait(reason || (code === 1001 ? 'the server is shutting down' : 'the connection was lost'));
  }

  // The stream was refused, or there is no server: a plain request tells which.
  async probe(id) {
    try {
      const scene = await getJson(sceneUrl(id));
      if (this.socket || this.wanted()?.id !== id) return;
      if (scene.state === 'failed') return this.on.gone(scene.problem);
      if (scene.state !== 'ready') return this.wait('the scene is being loaded');
      // A single refusal may come from a server that is just starting.
      if (++this.refusals < 2) return this.wait('the stream was refused');
      this.fall('no stream can be opened here');
    } catch (problem) {
      if (this.socket || this.wanted()?.id !== id) return;
      if (problem.status === 401 || problem.status === 403) this.on.denied(problem);
      else if (problem.status === 404) this.on.gone();
      else this.wait(isPassing(problem) && problem.status === 0 ? 'the server does not answer' : problem.detail || problem.title);
    }
  }

  wait(why) {
    const delay = waitBefore(this.tries++, Math.random());
    clearTimeout(this.timer);
    this.requests.stop();
    this.timer = setTimeout(() => this.connect(), delay);
    this.on.state('waiting', why, delay);
  }

  // Tries at once if it waits for the next try.
  again() {
    if (this.socket || this.requests.isRunning || !this.wanted()) return;
    this.connect();
  }

  woken() {
    // No ping was sent while the page was hidden.
    this.heardAt = performance.now();
    this.again();
    if (this.requests.isRunning) this.requests.show(this.seq, undefined);
  }

  heartbeat() {
    const socket = this.socket;
    if (document.hidden || !socket || socket.readyState !== WebSocket.OPEN) return;
    if (performance.now() - this.heardAt > DEAD_MS) {
      this.socket = null;
      socket.close();
      return this.wait('nothing comes from the server any more');
    }
    socket.send('{"ping":1}');
  }

  // Requests frames one by one until the stream is open again, which is tried later.
  fall(why) {
    this.on.state('requests', `by requests: ${why}`);
    if (!this.requests.isRunning) this.requests.start(this.seq, this.moving || false);
    clearTimeout(this.timer);
    this.timer = setTimeout(() => { this.refusals = 1; this.connect(); }, REQUESTS_MS);
  }

  requestFailed(problem) {
    if (problem.status === 404) { this.close(); return this.on.gone(); }
    if (problem.status === 401) { this.close(); return this.on.denied(problem); }
    if (problem.status === 0) return this.wait('the server does not answer');
    this.on.problem(problem);
  }
}
