// Uploads files by drop or by button: sends one scene after the other with progress, then waits while the server loads it. Failed
// uploads are kept, to be sent again.

import { getJson, headers, isPassing, NO_ANSWER, problemFrom, sceneUrl } from './api.js';
import { faultOfGroup, filesOf, sorted, unreadable } from './files.js';
import { MODELS } from './formats.js';
import { $, bytes, complain, quiet } from './message.js';

// Seconds that the server may delay its answer. After that it answers 202, and the page polls.
const WAIT_SECONDS = 2;
const POLL_MS = 700;

$('formats').textContent = MODELS.map(format => format.toUpperCase()).join(', ');

let cancel = null, isSending = false;
// Groups of files, one per scene.
const queue = [];
// Subjects of messages about refused uploads: of the last choice of files, and of earlier ones, which go when an upload succeeds.
const failed = new Set(), stale = new Set();

// on: {added(id) when scenes are there, path(text, name) when a camera path was given, left() at the end in any case}.
export function watch(on) {
  const drop = $('drop');
  let depth = 0;
  const hasFiles = event => [...event.dataTransfer.types].includes('Files');
  addEventListener('dragenter', event => { if (hasFiles(event)) { depth++; drop.hidden = false; event.preventDefault(); } });
  addEventListener('dragover', event => { if (hasFiles(event)) event.preventDefault(); });
  addEventListener('dragleave', event => { if (hasFiles(event) && --depth <= 0) { depth = 0; drop.hidden = true; } });
  addEventListener('drop', event => {
    if (!hasFiles(event)) return;
    event.preventDefault();
    depth = 0;
    drop.hidden = true;
    dropped(event.dataTransfer, on);
  });
  $('add').addEventListener('click', () => $('files').click());
  $('files').addEventListener('change', () => {
    const files = [...$('files').files];
    $('files').value = '';
    take(files, on);
  });
  $('upload-cancel').addEventListener('click', () => { queue.length = 0; cancel?.(); });
  // Everything else survives the page.
  addEventListener('beforeunload', event => { if (isSending) event.preventDefault(); });
}

async function dropped(transfer, on) {
  let found;
  try {
    found = await filesOf(transfer);
  } catch (error) {
    return complain({ title: 'What was dropped cannot be read', detail: error.message }, 'drop');
  }
  if (found.files.length > 0) return take(found.files, on);
  const [name] = found.folders;
  complain(name ? { title: `Nothing in the folder ${name} can be shown`, detail: 'It holds no model, no scene and no camera path.' }
    : { title: 'No file was dropped', detail: 'Nothing was sent.' }, 'drop');
}

async function take(files, on) {
  quiet('drop');
  const faults = (await Promise.all(files.map(unreadable))).filter(Boolean);
  if (faults.length > 0) return complain({ title: 'Nothing was sent', detail: faults.join(' ') }, 'drop');
  const { paths, uploads, fault } = await sorted(files);
  if (fault) return complain({ title: 'Nothing was sent', detail: fault }, 'drop');
  failed.forEach(of => stale.add(of));
  failed.clear();
  queue.push(...uploads);
  if (!isSending) await work(on);
  for (const path of paths) on.path(await path.text(), path.name);
}

async function work(on) {
  isSending = true;
  let added = null;
  while (queue.length > 0) {
    const group = queue.shift(), of = `upload ${namesOf(group)}`;
    quiet(of);
    try {
      const fault = faultOfGroup(group);
      if (fault) throw { title: `${namesOf(group)} cannot be sent together`, detail: fault };
      const id = await send(group);
      if (id) {
        quiet(...stale);
        stale.clear();
      }
      added = id || added;
    } catch (problem) {
      const again = [['Send again', () => { quiet(of); queue.push(group); if (!isSending) work(on); }]];
      const isRefused = problem.status !== 0 && !(problem.status >= 429);
      stale.delete(of);
      if (isRefused) failed.add(of);
      complain(problem, of, isRefused ? [] : again);
    }
    cancel = null;
  }
  isSending = false;
  $('upload').hidden = true;
  if (added) on.added(added);
  on.left();
}

const namesOf = group => group.length === 1 ? group[0].name : `${group[0].name} and ${group.length - 1} more`;

function say(text, done) {
  $('upload').hidden = false;
  $('upload-text').textContent = queue.length > 0 ? `${text} (${queue.length} more to come)` : text;
  if (done === null) $('upload-progress').removeAttribute('value'); else $('upload-progress').value = done;
}

// Returns the id of the scene, or null if it was cancelled.
async function send(files) {
  const names = namesOf(files);
  say(`${names}: sending …`, 0);
  const answer = await post(files, names);
  if (!answer) return null;
  return answer.state === 'loading' ? loaded(answer.id, names) : answer.id;
}

function post(files, names) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    let body = files[0];
    if (files.length > 1) {
      body = new FormData();
      for (const file of files) body.append('file', file, file.name);
    }
    request.open('POST', '/v1/scenes?name=' + encodeURIComponent(files[0].name));
    const isJson = files.length === 1 && files[0].name.toLowerCase().endsWith('.json');
    if (files.length === 1) request.setRequestHeader('Content-Type', isJson ? 'application/json' : 'application/octet-stream');
    for (const [name, value] of Object.entries(headers())) request.setRequestHeader(name, value);
    request.setRequestHeader('Prefer', `wait=${WAIT_SECONDS}`);
    request.upload.onprogress = event => {
      if (event.lengthComputable) say(`${names}: ${bytes(event.loaded)} of ${bytes(event.total)} sent`, event.loaded / event.total);
    };
    request.upload.onload = () => say(`${names}: received, being read …`, null);
    request.onload = () => {
      const isFine = request.status === 201 || request.status === 202;
      if (isFine) resolve(JSON.parse(request.responseText));
      else reject(problemFrom(request.status, request.statusText, request.responseText, request.getResponseHeader('Retry-After')));
    };
    request.onerror = () => reject({ ...NO_ANSWER, title: `${names} could not be sent` });
    request.onabort = () => resolve(null);
    cancel = () => request.abort();
    request.send(body);
  });
}

// Waits until the scene is loaded. Cancelling only ends the wait, because the server has all files.
async function loaded(id, names) {
  let isCancelled = false;
  cancel = () => { isCancelled = true; };
  while (!isCancelled) {
    let scene = null, pause = POLL_MS;
    try {
      scene = await getJson(sceneUrl(id));
    } catch (problem) {
      // A restarted server loads what its predecessor received. A proxy before it answers meanwhile.
      if (!isPassing(problem)) throw problem;
      // A key over its rate stays over it if the page asks again before that time.
      pause = Math.max(pause, problem.retry_after_ms || 0);
      say(`${names}: received; the server does not answer just now …`, null);
    }
    if (scene?.state === 'failed') throw scene.problem;
    if (scene?.state === 'ready') return id;
    if (scene) say(`${names}: received, being loaded for ${Math.round(scene.loading_ms / 1000)} s …`, null);
    await new Promise(resolve => setTimeout(resolve, pause));
  }
  return null;
}
