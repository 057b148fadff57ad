// A bar chart of the last frames: a column per frame with its steps stacked, the newest at the right.

import { $ } from './message.js';

const FRAMES = 120;
const PASS_COLORS = ['#4f9ddb', '#7ad0a6', '#e07f6a', '#b58be0', '#e0c15a', '#5fc7d4', '#e58fc0', '#98b84a', '#8f9cf0', '#d99a5b'];
const HOST_COLORS = { queue: '#8a949d', record: '#c58b3b', 'device wait': '#6f7a84', readback: '#a9774a', encode: '#d8b27a' };
const REST_COLOR = '#454d55';

const passColors = new Map();
const columns = [];
let isDue = false;

// The colour of a step, equal wherever the step is shown.
export function colorOf(name, isHost) {
  if (isHost) return HOST_COLORS[name] || REST_COLOR;
  if (!passColors.has(name)) passColors.set(name, PASS_COLORS[passColors.size % PASS_COLORS.length]);
  return passColors.get(name);
}

// The steps of a receipt: [name, nanoseconds (undefined if it did not run), whether it is the host's, the pass].
export function stepsOf(receipt) {
  return [
    ['queue', receipt.queue_ns, true], ['record', receipt.record_ns, true],
    ...receipt.passes.map(pass => [pass.name, pass.ran ? pass.gpu_ns : undefined, false, pass]),
    ['device wait', receipt.device_wait_ns, true], ['readback', receipt.readback_ns, true], ['encode', receipt.encode_ns, true],
  ];
}

export function addFrame(receipt, isStill) {
  const steps = stepsOf(receipt).filter(([, ns]) => ns > 0).map(([name, ns, isHost]) => ({ name, ns, color: colorOf(name, isHost) }));
  const known = steps.reduce((sum, step) => sum + step.ns, 0), total = Math.max(receipt.total_ns || 0, known);
  if (total > known) steps.push({ name: 'rest', ns: total - known, color: REST_COLOR });
  columns.push({ steps, total, isStill });
  if (columns.length > FRAMES) columns.shift();
  if (isDue) return;
  isDue = true;
  requestAnimationFrame(() => { isDue = false; draw(); describe(); });
}

export function clear() {
  columns.length = 0;
  draw();
}

// Rounds up to 1, 2 or 5 times a power of ten.
function roundUp(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 5, 10].map(n => n * power).find(n => n >= value * 0.999);
}

function draw() {
  const canvas = $('chart'), ratio = window.devicePixelRatio || 1;
  const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
  if (width === 0 || height === 0) return; // folded away
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  const paper = canvas.getContext('2d');
  paper.clearRect(0, 0, width, height);
  const most = roundUp(Math.max(1e5, ...columns.map(column => column.total)));
  const left = 54 * ratio, top = 6 * ratio, bottom = height - 8 * ratio, step = (width - left) / FRAMES;
  scale(paper, most, { left, top, bottom, width, ratio });
  columns.forEach((column, i) => {
    const x = width - (columns.length - i) * step;
    let y = bottom;
    for (const part of column.steps) {
      const tall = part.ns / most * (bottom - top);
      paper.fillStyle = part.color;
      paper.fillRect(x, y - tall, Math.max(1, step - ratio * 0.5), tall);
      y -= tall;
    }
    if (column.isStill) {
      paper.fillStyle = '#9fe0a8';
      paper.fillRect(x, bottom + 2 * ratio, Math.max(1, step - ratio * 0.5), 3 * ratio);
    }
  });
}

function scale(paper, most, { left, top, bottom, width, ratio }) {
  paper.font = `${11 * ratio}px system-ui, sans-serif`;
  paper.textAlign = 'right';
  paper.textBaseline = 'middle';
  for (const part of [0, 0.5, 1]) {
    const y = bottom - part * (bottom - top), value = most * part / 1e6;
    paper.fillStyle = '#31383f';
    paper.fillRect(left, Math.round(y), width - left, 1);
    paper.fillStyle = '#b9c2ca';
    const words = value >= 1000 ? `${Number((value / 1000).toPrecision(3))} s` : `${Number(value.toPrecision(3))} ms`;
    paper.fillText(part === 0 ? '0' : words, left - 5 * ratio, Math.min(y + 1, bottom - 2 * ratio));
  }
}

// A description for screen readers.
function describe() {
  const last = columns[columns.length - 1], longest = [...last.steps].sort((a, b) => b.ns - a.ns)[0];
  const text = ns => (ns / 1e6).toFixed(2) + ' ms';
  const words = `Time of the last ${columns.length} frames by step. The last took ${text(last.total)}`
    + (longest ? `, the longest step was ${longest.name} with ${text(longest.ns)}.` : '.');
  $('chart').setAttribute('aria-label', words);
  $('chart').dataset.columns = columns.length;
}

new ResizeObserver(draw).observe($('chart'));
