// Shows a frame's receipt: a status line, the table of steps, and the facts.

import { $, bytes, count, ms, rows } from './message.js';
import { digits, norm, sub } from './pose.js';
import { addFrame, colorOf, stepsOf } from './chart.js';

// info: a frame's header with `elapsedMs`; full: the frame's size at rest.
export function report(info, full, poses) {
  status(info, full);
  const { receipt } = info;
  if (!receipt) {
    $('passes').tBodies[0].replaceChildren();
    $('steps-note').hidden = true;
    return rows($('frame'), [['receipt', 'none came with the frame'], ['size', bytes(info.bytes)]]);
  }
  addFrame(receipt, info.quality === 'still');
  timings(receipt);
  facts(info, poses);
}

function status(info, [w, h]) {
  const isStill = info.quality === 'still', state = document.createElement('b');
  state.className = info.quality;
  state.textContent = isStill ? 'still, refined' : 'moving';
  const format = info.format === 'jpeg' ? `JPEG, quality ${info.jpeg_quality}` : `${(info.format || 'image').toUpperCase()}, lossless`;
  const reduced = isStill ? '' : `, declared lower quality than the ${w} × ${h} at rest`;
  const server = info.receipt ? `${ms(info.receipt.total_ns)} ms on the server` : '';
  const elapsed = info.elapsedMs == null ? '' : `${server ? ', ' : ''}${info.elapsedMs.toFixed(0)} ms from pose to picture`;
  const revision = info.revision == null ? '' : ` Revision ${info.revision}.`;
  // Screen readers announce still frames only.
  $('status').setAttribute('aria-live', isStill ? 'polite' : 'off');
  $('status').replaceChildren(state, `: ${info.width} × ${info.height} ${format}${reduced}. ${server}${elapsed}.${revision}`);
}

function facts(info, poses) {
  const { receipt } = info, { samples, splats, triangles, segments, instances, camera } = receipt;
  const distance = norm(sub(camera.eye, camera.target)), placed = v => v.map(x => digits(x, distance)).join(', ');
  rows($('frame'), [
    ['adapter', receipt.adapter], ['scene', `${receipt.scene}, revision ${receipt.revision}`],
    ['size', bytes(info.bytes)],
    ...(info.overtaken != null ? [['poses', `${count(poses)} sent, ${count(info.overtaken)} overtaken by newer ones`]] : []),
    ['in its batch', `${count(receipt.batch_size)}, ${count(receipt.views)} drawn together` + (receipt.coalesced ? ', shared with an identical request' : '')],
    ['samples', `${count(samples.stored)} stored, ${count(samples.tested)} tested, ${count(samples.drawn)} drawn`],
    ...(receipt.settings.filter ? [['drawn as', splatsInWords(receipt.settings)]] : []),
    ...(receipt.settings.because ? [['chosen', `${receipt.settings.reconstruct}: ${receipt.settings.because}`]] : []),
    ...(receipt.settings.provisional ? [['provisional', receipt.settings.provisional]] : []),
    ...(receipt.settings.instead_because ? [['instead', receipt.settings.instead_because]] : []),
    ...(receipt.translucent?.most_left_out > 1 / 255 ? [['left out', `translucent surfaces behind the nearest ${receipt.translucent.layers} of a pixel, up to ${(100 * receipt.translucent.most_left_out).toFixed(1)} % of the light`]] : []),
    ['triangles', `${count(triangles.stored)} stored, ${count(triangles.tested)} tested, ${count(triangles.rasterised)} rasterised`],
    ...(segments.stored ? [['segments', `${count(segments.stored)} stored, ${count(segments.tested)} tested, ${count(segments.listed)} listed`]] : []),
    ['instances', `${count(instances.stored)} stored, ${count(instances.drawn)} drawn`],
    ...(splats.clipped || splats.rasterised || splats.scattered ? [['splats', `${count(splats.scattered)} scattered, ${count(splats.rasterised)} rasterised, ${count(splats.clipped)} clipped`]] : []),
    ['on the GPU', bytes(receipt.gpu_bytes)],
    ['eye', placed(camera.eye)], ['target', placed(camera.target)],
  ]);
}

const splatsInWords = s => `splats: ${s.filter} filter, prefilter ${s.prefilter ? 'on' : 'off'}, ${s.blend}, `
  + (s.blend === 'opaque' ? 'lit at each pixel' : s.shading === 'splat' ? 'each lit alone' : 'lit at each pixel');

function timings(receipt) {
  const steps = stepsOf(receipt), total = receipt.total_ns || 1;
  const last = document.createElement('tr'), head = document.createElement('th'), cell = document.createElement('td');
  last.className = 'total';
  head.scope = 'row';
  head.textContent = 'total';
  cell.className = 'ms';
  cell.textContent = ms(receipt.total_ns);
  last.append(head, cell);
  $('passes').tHead.hidden = false;
  const skipped = [...receipt.passes, ...receipt.specialisations].filter(one => !one.ran);
  const others = steps.filter(([,,, pass]) => !pass || pass.ran).map(step => row(step, total));
  $('passes').tBodies[0].replaceChildren(...others, ...(skipped.length > 0 ? [folded(skipped)] : []), last);
  const known = steps.reduce((sum, [, ns]) => sum + (ns || 0), 0);
  $('steps-note').hidden = false;
  $('explained').textContent = `The steps explain ${Math.min(100, 100 * known / total).toFixed(0)} % of the total.`;
}

function row([name, ns, isHost, pass], total) {
  const line = document.createElement('tr'), head = document.createElement('th'), cell = document.createElement('td');
  head.scope = 'row';
  cell.className = 'ms';
  if (pass) line.dataset.pass = name;
  line.dataset.step = name;
  const swatch = document.createElement('span');
  swatch.className = 'swatch';
  swatch.style.backgroundColor = colorOf(name, isHost);
  head.append(swatch, name);
  if (isHost) line.className = 'host';
  if (ns != null) head.append(meter(name, ns, isHost, total));
  cell.textContent = ms(ns);
  line.append(head, cell);
  return line;
}

// Skipped passes and effects in one line that unfolds to the reasons. The line stays folded or unfolded from frame to frame.
let isUnfolded = false;
function folded(skipped) {
  const line = document.createElement('tr'), cell = document.createElement('td'), details = document.createElement('details');
  const summary = document.createElement('summary'), list = document.createElement('ul');
  line.className = 'skipped';
  cell.colSpan = 2;
  details.open = isUnfolded;
  details.addEventListener('toggle', () => { isUnfolded = details.open; });
  summary.textContent = `skipped passes and effects: ${skipped.length}`;
  list.append(...skipped.map(({ name, why }) => {
    const item = document.createElement('li'), what = document.createElement('b');
    item.dataset.skipped = what.textContent = name;
    item.append(what, `: ${why || 'no reason given'}`);
    return item;
  }));
  details.append(summary, list);
  cell.append(details);
  line.append(cell);
  return line;
}

function meter(name, ns, isHost, total) {
  const bar = document.createElement('span');
  bar.className = 'meter';
  bar.style.backgroundColor = colorOf(name, isHost);
  bar.style.width = Math.min(100, 100 * ns / total) + '%';
  return bar;
}
