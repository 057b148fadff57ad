'use strict';

// The plot, the comparison and the table of a report. All of them show one scope (a pose, or all of them) and one measure, and share the
// chosen row.
const { results, images } = JSON.parse(document.getElementById('data').textContent);
const $ = (id) => document.getElementById(id);
const SVG = 'http://www.w3.org/2000/svg';

const MEASURES = {
  psnr: { name: 'PSNR against the reference, dB', value: (row) => row.psnr_db ?? Infinity, digits: 2, more: true },
  flip: { name: 'mean FLIP', value: (row) => row.flip, digits: 4, more: false },
  ssim: { name: 'SSIM', value: (row) => row.ssim, digits: 4, more: true },
};
const poses = results.scopes.filter((scope) => scope.folder);
const isPlotted = (row) => !row.same_as && row.gpu_ms;
const families = [...new Set(results.scopes.flatMap((scope) => scope.entries.filter(isPlotted).map((row) => row.family)))];
const state = { scope: results.scopes[0], measure: 'psnr', row: null, pose: poses[0], sort: { column: 2, down: false }, view: 'wipe' };

function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

function shape(name, attributes, ...children) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

function digits(value, count) {
  if (value === Infinity) return 'equal';
  return value == null || !isFinite(value) ? '–' : value.toFixed(count);
}

/** Three digits, or all digits before the point. */
function short(value) {
  if (value == null || !isFinite(value)) return '–';
  const before = Math.floor(Math.log10(Math.max(Math.abs(value), 1e-4))) + 1;
  return value.toFixed(Math.max(0, 3 - before));
}

const plotted = () => state.scope.entries.filter(isPlotted);
const front = () => state.scope.fronts[state.measure] ?? [];
const entry = (name) => state.scope.entries.find((row) => row.row === name);

// The plot.

const BOX = { width: 1180, height: 560, left: 70, right: 1160, top: 16, bottom: 508 };

function axis(values, from, to, least) {
  const finite = values.filter(isFinite);
  let [low, high] = finite.length ? [Math.min(...finite), Math.max(...finite)] : [0, 1];
  const margin = Math.max(0.05 * (high - low), 0.5 * (least - (high - low)));
  [low, high] = [low - margin, high + margin];
  const px = (value) => from + Math.min(1, Math.max(0, (value - low) / (high - low))) * (to - from);
  return { low, high, px };
}

function roundTicks({ low, high }) {
  const rough = (high - low) / 10;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((times) => times * power).find((found) => found >= rough);
  const ticks = [];
  for (let tick = Math.ceil(low / step); tick * step <= high; tick += 1) ticks.push(tick * step);
  return ticks;
}

function logTicks({ low, high }) {
  const ticks = [];
  for (let decade = Math.floor(low); decade <= Math.ceil(high); decade += 1) {
    for (const step of high - low > 4 ? [1] : [1, 2, 5]) ticks.push(step * 10 ** decade);
  }
  return ticks.filter((tick) => Math.log10(tick) >= low && Math.log10(tick) <= high);
}

function mark(family, x, y, attributes) {
  const paths = [
    `M${x - 5} ${y}a5 5 0 1 0 10 0a5 5 0 1 0 -10 0Z`,
    `M${x - 4.5} ${y - 4.5}h9v9h-9Z`,
    `M${x} ${y - 6}l5.5 10h-11Z`,
    `M${x} ${y - 6}l6 6l-6 6l-6 -6Z`,
    `M${x} ${y + 6}l5.5 -10h-11Z`,
    `M${x - 2.5} ${y - 4}h5l3 4l-3 4h-5l-3 -4Z`,
  ];
  return shape('path', { d: paths[family % 6], ...attributes });
}

function drawPlot() {
  const measure = MEASURES[state.measure];
  const rows = plotted();
  const x = axis(rows.flatMap((row) => [Math.log10(row.gpu_ms.low), Math.log10(row.gpu_ms.high)]), BOX.left, BOX.right, 0.3);
  const values = rows.map(measure.value);
  const sides = measure.more ? [BOX.bottom, BOX.top] : [BOX.top, BOX.bottom];
  const y = axis(values, ...sides, state.measure === 'psnr' ? 2 : 0.01);
  const svg = shape('svg', { viewBox: `0 0 ${BOX.width} ${BOX.height}`, role: 'group' });
  for (const tick of logTicks(x)) {
    const at = x.px(Math.log10(tick));
    svg.append(shape('path', { class: 'grid', d: `M${at} ${BOX.top}V${BOX.bottom}` }));
    svg.append(shape('text', { class: 'soft', x: at, y: BOX.bottom + 18, 'text-anchor': 'middle' }, String(+tick.toPrecision(3))));
  }
  for (const tick of roundTicks(y)) {
    const at = y.px(tick);
    svg.append(shape('path', { class: 'grid', d: `M${BOX.left} ${at}H${BOX.right}` }));
    svg.append(shape('text', { class: 'soft', x: BOX.left - 8, y: at + 4.5, 'text-anchor': 'end' }, String(+tick.toPrecision(4))));
  }
  svg.append(shape('rect', { class: 'frame', x: BOX.left, y: BOX.top, width: BOX.right - BOX.left, height: BOX.bottom - BOX.top }));
  const middle = (BOX.left + BOX.right) / 2;
  svg.append(shape('text', { x: middle, y: BOX.height - 10, 'text-anchor': 'middle' }, 'GPU time of a frame in milliseconds, logarithmic'));
  const centre = (BOX.top + BOX.bottom) / 2;
  const upright = { x: 20, y: centre, transform: `rotate(-90 20 ${centre})`, 'text-anchor': 'middle' };
  svg.append(shape('text', upright, `${measure.name} (better is up)`));
  const place = (row) => [x.px(Math.log10(row.gpu_ms.median)), y.px(measure.value(row))];
  for (const row of rows) {
    const at = place(row)[1];
    const [low, high] = [row.gpu_ms.low, row.gpu_ms.high].map((ms) => x.px(Math.log10(ms)));
    const family = families.indexOf(row.family);
    svg.append(shape('path', { class: `bar c${family % 6}`, d: `M${low} ${at}H${high}M${low} ${at - 3}v6M${high} ${at - 3}v6` }));
  }
  const best = front().map(entry).filter(Boolean);
  svg.append(shape('polyline', { class: 'front', points: best.map((row) => place(row).join(',')).join(' ') }));
  for (const row of rows) {
    const family = families.indexOf(row.family);
    const isBest = front().includes(row.row);
    const classes = isBest ? `dot best c${family % 6} f${family % 6}` : `dot c${family % 6}`;
    const dot = mark(family, ...place(row), { class: classes, tabindex: 0, role: 'button', 'aria-label': row.row });
    dot.append(shape('title', {}, `${row.row}: ${short(row.gpu_ms.median)} ms, ${digits(measure.value(row), measure.digits)}`));
    dot.addEventListener('click', () => choose(row.row));
    dot.addEventListener('keydown', (event) => {
      if (event.key === 'Enter' || event.key === ' ') choose(row.row);
    });
    svg.append(dot);
  }
  const chosen = entry(state.row);
  const shown = chosen && rows.find((row) => row.row === (chosen.same_as ?? chosen.row));
  const labelled = shown && !best.includes(shown) ? [shown, ...best] : best;
  if (shown) svg.append(shape('circle', { class: 'ring', cx: place(shown)[0], cy: place(shown)[1], r: 10 }));
  const taken = labelled.map(place).map(([px, py]) => [px - 6, py - 6, px + 6, py + 6]);
  for (const row of labelled) {
    const [px, py] = place(row);
    const width = 6.9 * row.row.length;
    const free = room(px, py, width, taken);
    if (!free) continue;
    taken.push(free);
    svg.append(shape('text', { class: 'label', x: free[0], y: free[3] - 3 }, row.row));
  }
  $('plot').replaceChildren(svg);
}

/** A box beside a point for a label, which covers none of the boxes that are taken. */
function room(x, y, width, taken) {
  const offsets = [[10, 5], [-10 - width, 5], [7, -7], [-7 - width, -7], [7, 19], [-7 - width, 19], [-width / 2, -11], [-width / 2, 24]];
  for (const [dx, dy] of offsets) {
    for (const shift of [0, -14, 14]) {
      const [left, bottom] = [x + dx, y + dy + shift];
      const box = [left, bottom - 15, left + width, bottom];
      const inside = box[0] >= BOX.left && box[2] <= BOX.right && box[1] >= BOX.top && box[3] <= BOX.bottom;
      const clashes = taken.some((other) => box[0] < other[2] && other[0] < box[2] && box[1] < other[3] && other[1] < box[3]);
      if (inside && !clashes) return box;
    }
  }
  return null;
}

function drawLegend() {
  const items = families.map((name, family) => {
    const svg = shape('svg', { viewBox: '0 0 14 14' }, mark(family, 7, 7, { class: `best c${family % 6} f${family % 6}` }));
    return element('span', {}, svg, name);
  });
  $('legend').replaceChildren(...items);
}

// The comparison.

function drawComparison() {
  const chosen = entry(state.row);
  const stage = $('stage');
  if (!chosen) return;
  const here = poses.find((pose) => pose === state.pose).entries.find((row) => row.row === state.row) ?? chosen;
  $('chosen').textContent = chosen.same_as ? `${chosen.row}, drawn as ${chosen.same_as}` : chosen.row;
  const parts = [
    `GPU ${short(here.gpu_ms?.median)} ms`,
    `PSNR ${digits(here.psnr_db ?? Infinity, 2)} dB`,
    `SSIM ${digits(here.ssim, 4)}`,
    `FLIP ${digits(here.flip, 4)}`,
    `${here.coverage.holes} hole pixels`,
    `${here.coverage.leaks} leak pixels`,
  ];
  $('figures').textContent = `At ${state.pose.name}: ${parts.join(', ')}. ${here.notes.join(' · ')}`;
  const owner = here.same_as ?? here.row;
  const slug = state.pose.entries.find((row) => row.row === owner)?.slug;
  const folder = state.pose.folder;
  const own = images.frames[folder]?.[slug];
  const reference = images.frames[folder]?.reference;
  const picture = (uri, text, attributes = {}) => element('img', { src: uri ?? '', alt: text, draggable: 'false', ...attributes });
  const figure = (uri, text) => element('figure', {}, picture(uri, text), element('figcaption', {}, text));
  stage.className = state.view === 'wipe' ? 'wipe' : 'side';
  $('wipe').disabled = state.view !== 'wipe';
  if (state.view === 'side') {
    stage.replaceChildren(figure(reference, 'reference'), figure(own, owner));
  } else if (state.view === 'flip') {
    stage.replaceChildren(figure(images.flips[folder]?.[slug], 'FLIP map'), figure(own, owner));
  } else {
    stage.replaceChildren(picture(own, owner), picture(reference, 'reference', { class: 'over' }), element('div', { class: 'edge' }));
    wipe();
  }
}

function wipe() {
  const share = $('wipe').value / 10;
  const over = document.querySelector('#stage .over');
  if (!over) return;
  // The reference is on the left.
  over.style.clipPath = `inset(0 ${100 - share}% 0 0)`;
  document.querySelector('#stage .edge').style.left = `${share}%`;
}

// The table.

const COLUMNS = [
  { name: '', text: true, value: (row) => (front().includes(row.row) ? 0 : 1), cell: (row) => (front().includes(row.row) ? '●' : '') },
  { name: 'setting', text: true, value: (row) => row.row, cell: (row) => row.row },
  { name: 'GPU, ms', value: (row) => row.gpu_ms.median, cell: (row) => `${short(row.gpu_ms.median)} (${short(row.gpu_ms.low)}–${short(row.gpu_ms.high)})` },
  { name: 'PSNR, dB', value: (row) => row.psnr_db ?? Infinity, cell: (row) => digits(row.psnr_db ?? Infinity, 2) },
  { name: 'SSIM', value: (row) => row.ssim, cell: (row) => digits(row.ssim, 4) },
  { name: 'FLIP', value: (row) => row.flip, cell: (row) => digits(row.flip, 4) },
  { name: 'max error', value: (row) => row.max_error, cell: (row) => String(row.max_error) },
  { name: 'holes', value: (row) => row.coverage.holes, cell: (row) => String(row.coverage.holes) },
  { name: 'leaks', value: (row) => row.coverage.leaks, cell: (row) => String(row.coverage.leaks) },
  { name: 'IoU', value: (row) => row.coverage.silhouette_iou, cell: (row) => digits(row.coverage.silhouette_iou, 4) },
  { name: 'depth error, median', value: (row) => row.depth?.median ?? Infinity, cell: (row) => row.depth?.median.toExponential(1) ?? '–' },
  { name: 'depth error, max', value: (row) => row.depth?.max ?? Infinity, cell: (row) => row.depth?.max.toExponential(1) ?? '–' },
  { name: 'normal error, median', value: (row) => row.normal_deg?.median ?? Infinity, cell: (row) => (row.normal_deg ? `${row.normal_deg.median.toFixed(2)}°` : '–') },
];

function drawTable() {
  const { column, down } = state.sort;
  const heads = COLUMNS.map((col, number) => {
    const head = element('th', { scope: 'col', class: col.text ? 'text' : '' }, col.name || '●');
    if (number === column) head.setAttribute('aria-sort', down ? 'descending' : 'ascending');
    head.addEventListener('click', () => {
      state.sort = { column: number, down: number === column ? !down : false };
      drawTable();
    });
    return head;
  });
  document.querySelector('#table thead').replaceChildren(element('tr', {}, element('th', {}, ''), ...heads));
  const order = (a, b) => {
    const [p, q] = [a, b].map(COLUMNS[column].value);
    return (down ? -1 : 1) * (typeof p === 'string' ? p.localeCompare(q) : p - q || 0);
  };
  const rows = plotted().sort(order).map((row) => {
    const uri = images.frames[state.pose.folder]?.[row.slug];
    const thumb = uri ? element('img', { src: uri, alt: '', loading: 'lazy' }) : '';
    const cells = COLUMNS.map((col) => element('td', { class: col.text ? 'text' : '' }, col.cell(row)));
    const made = element('tr', { class: row.row === state.row ? 'chosen' : '' }, element('td', {}, thumb), ...cells);
    made.addEventListener('click', () => choose(row.row));
    return made;
  });
  const reference = element('img', { src: images.frames[state.pose.folder]?.reference ?? '', alt: '' });
  const first = element('tr', {}, element('td', {}, reference), element('td', {}), element('td', { class: 'text', colspan: 12 }, 'the reference'));
  document.querySelector('#table tbody').replaceChildren(first, ...rows);
  drawOthers();
}

function list(title, heads, rows) {
  if (!rows.length) return [];
  const head = element('tr', {}, ...heads.map((name) => element('th', { class: 'text' }, name)));
  const body = rows.map((cells) => element('tr', {}, ...cells.map((text) => element('td', { class: 'text wrap' }, text))));
  return [element('h2', {}, title), element('table', {}, element('thead', {}, head), element('tbody', {}, ...body))];
}

function drawOthers() {
  const same = state.scope.entries.filter((row) => row.same_as).map((row) => [row.row, row.same_as, row.notes.join('; ')]);
  $('others').replaceChildren(
    ...list('Drawn as another setting', ['setting', 'drawn as', 'because'], same),
    ...list('Refused by the program', ['setting', 'reason'], state.scope.refused),
  );
}

// Choices.

function draw() {
  drawPlot();
  drawComparison();
  drawTable();
}

function choose(row) {
  state.row = row;
  draw();
}

function pickScope(name) {
  state.scope = results.scopes.find((scope) => scope.name === name) ?? results.scopes[0];
  if (state.scope.folder) {
    state.pose = state.scope;
    $('pose').value = state.pose.name;
  }
  if (!entry(state.row)) state.row = front().at(-1) ?? state.scope.entries[0]?.row;
  draw();
}

$('scope').append(...results.scopes.map((scope) => element('option', {}, scope.name)));
$('pose').append(...poses.map((pose) => element('option', {}, pose.name)));
$('scope').addEventListener('change', (event) => pickScope(event.target.value));
$('measure').addEventListener('change', (event) => {
  state.measure = event.target.value;
  draw();
});
$('pose').addEventListener('change', (event) => {
  state.pose = poses.find((pose) => pose.name === event.target.value);
  draw();
});
for (const radio of document.querySelectorAll('input[name=view]')) {
  radio.addEventListener('change', () => {
    state.view = radio.value;
    drawComparison();
  });
}
$('wipe').addEventListener('input', wipe);
$('stage').addEventListener('pointermove', (event) => {
  if (state.view !== 'wipe' || (event.pointerType !== 'mouse' && !event.buttons)) return;
  const box = $('stage').getBoundingClientRect();
  $('wipe').value = (1000 * (event.clientX - box.left)) / box.width;
  wipe();
});
drawLegend();
pickScope(results.scopes[0].name);
