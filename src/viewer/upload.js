// Files onto the page, by drop or by the button: sent with progress, then waited for while the daemon loads them.

import { getJson, headers, NO_ANSWER, problemFrom, sceneUrl } from './api.js';
import { $, bytes, complain, quiet } from './message.js';

// Seconds that the daemon may keep the answer back: after that it answers 202, and is asked how it goes.
const WAIT_SECONDS = 2;
const POLL_MS = 700;
// A camera path is text of this size at most.
const PATH_BYTES = 1 << 20;

let cancel = null;

// on: {added(id), path(text, name), left()} when a scene is there, a camera path was dropped, it is over one way or another.
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
    take([...event.dataTransfer.files], on);
  });
  $('add').addEventListener('click', () => $('files').click());
  $('files').addEventListener('change', () => {
    const files = [...$('files').files];
    $('files').value = '';
    take(files, on);
  });
  $('upload-cancel').addEventListener('click', () => cancel && cancel());
}

async function take(files, on) {
  if (files.length === 0) return;
  if (cancel) return complain({ title: 'One upload at a time', detail: 'Wait for the one that is under way, or cancel it.' });
  if (files.length === 1 && await isPath(files[0])) return on.path(await files[0].text(), files[0].name);
  quiet();
  try {
    const id = await send(files);
    if (id) on.added(id);
  } catch (problem) {
    complain(problem);
  } finally {
    cancel = null;
    $('upload').hidden = true;
    on.left();
  }
}

async function isPath(file) {
  if (!file.name.toLowerCase().endsWith('.json') || file.size > PATH_BYTES) return false;
  try {
    const value = JSON.parse(await file.text());
    return Array.isArray(value.keys) && value.nodes === undefined;
  } catch {
    return false; // the daemon says what is wrong with it
  }
}

function say(text, done) {
  $('upload').hidden = false;
  $('upload-text').textContent = text;
  if (done === null) $('upload-progress').removeAttribute('value'); else $('upload-progress').value = done;
}

// The id of the scene, or null when it was cancelled.
async function send(files) {
  const names = files.length === 1 ? files[0].name : `${files.length} files`;
  say(`${names}: sending …`, 0);
  const answer = await post(files, names);
  if (!answer) return null;
  return answer.state === 'loading' ? loaded(answer.id, names) : answer.id;
}

function post(files, names) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    let body = files[0], url = '/v1/scenes?name=' + encodeURIComponent(files[0].name);
    if (files.length > 1) {
      body = new FormData();
      url = '/v1/scenes';
      for (const file of files) body.append('file', file, file.name);
    }
    request.open('POST', url);
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

// Waits until the scene is there; cancelling only stops the waiting, for the daemon has everything.
async function loaded(id, names) {
  let isCancelled = false;
  cancel = () => { isCancelled = true; };
  while (!isCancelled) {
    const scene = await getJson(sceneUrl(id));
    if (scene.state === 'failed') throw scene.problem;
    if (scene.state === 'ready') return id;
    say(`${names}: received, being loaded for ${Math.round(scene.loading_ms / 1000)} s …`, null);
    await new Promise(resolve => setTimeout(resolve, POLL_MS));
  }
  return null;
}
