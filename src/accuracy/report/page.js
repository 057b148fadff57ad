// The plot, the comparison and the table of a report. All of them show one scope (a pose, or all of them) and one measure, and share the
// chosen row. The plot is curve.js, which stands before this text.
const { results, images } = JSON.parse(document.getElementById('data').textContent);
const $ = (id) => document.getElementById(id);
const poses = results.scopes.filter((scope) => scope.folder);
const families = familiesOf(results);
const state = { scope: results.scopes[0], measure: 'psnr', row: null, pose: poses[0], sort: { column: 2, down: false }, alongSort: { column: 3, down: false }, view: 'wipe' };

function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

const plotted = () => state.scope.entries.filter(isPlotted);
const front = () => state.scope.fronts[state.measure] ?? [];
const entry = (name) => state.scope.entries.find((row) => row.row === name);

function drawPlot() {
  $('plot').replaceChildren(curve({ scope: state.scope, families, measure: state.measure, chosen: state.row, choose }));
}

function drawLegend() {
  $('legend').replaceChildren(...legend(families, results.scopes.some((scope) => scope.default)));
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

// The tables. A column: its name, whether it is text, the value by which it sorts, and what a cell shows.

const COLUMNS = [
  { name: '', text: true, value: (row) => (front().includes(row.row) ? 0 : 1), cell: (row) => (front().includes(row.row) ? '●' : '') },
  { name: 'setting', text: true, value: (row) => row.row, cell: (row) => (row.row === state.scope.default ? `${row.row} (default)` : row.row) },
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

const ALONG_COLUMNS = [
  { name: 'setting', text: true, value: (row) => row.row, cell: (row) => (row.row === results.along.default ? `${row.row} (default)` : row.row) },
  { name: 'frames', value: (row) => row.frames, cell: (row) => String(row.frames) },
  { name: 'PSNR, dB', value: (row) => row.psnr_db ?? Infinity, cell: (row) => digits(row.psnr_db ?? Infinity, 2) },
  { name: 'flicker energy', value: (row) => row.flicker, cell: (row) => short(row.flicker) },
  { name: '× full detail', value: (row) => row.flicker_times ?? Infinity, cell: (row) => short(row.flicker_times) },
  { name: 'largest pop, px', value: (row) => row.pop_px, cell: (row) => String(row.pop_px) },
  { name: 'in frame', value: (row) => row.pop_frame ?? Infinity, cell: (row) => String(row.pop_frame ?? '–') },
  { name: 'pops', value: (row) => row.pops, cell: (row) => String(row.pops) },
];

// Headings that sort, and the comparison of two rows. sort: {column, down}, which a click replaces before redraw().
function sorting(columns, sort, redraw) {
  const heads = columns.map((col, number) => {
    const head = element('th', { scope: 'col', class: col.text ? 'text' : '' }, col.name || '●');
    if (number === sort.column) head.setAttribute('aria-sort', sort.down ? 'descending' : 'ascending');
    head.addEventListener('click', () => {
      Object.assign(sort, { column: number, down: number === sort.column ? !sort.down : false });
      redraw();
    });
    return head;
  });
  const order = (a, b) => {
    const [p, q] = [a, b].map(columns[sort.column].value);
    return (sort.down ? -1 : 1) * (typeof p === 'string' ? p.localeCompare(q) : p - q || 0);
  };
  return { heads, order };
}

const cellsOf = (columns, row) => columns.map((col) => element('td', { class: col.text ? 'text' : '' }, col.cell(row)));

// A row of a table, which a click chooses.
function choosable(name, ...cells) {
  const made = element('tr', { class: name === state.row ? 'chosen' : '' }, ...cells);
  made.addEventListener('click', () => choose(name));
  return made;
}

function drawTable() {
  const { heads, order } = sorting(COLUMNS, state.sort, drawTable);
  document.querySelector('#table thead').replaceChildren(element('tr', {}, element('th', {}, ''), ...heads));
  const rows = plotted().sort(order).map((row) => {
    const uri = images.frames[state.pose.folder]?.[row.slug];
    const thumb = uri ? element('img', { src: uri, alt: '', loading: 'lazy' }) : '';
    return choosable(row.row, element('td', {}, thumb), ...cellsOf(COLUMNS, row));
  });
  const reference = element('img', { src: images.frames[state.pose.folder]?.reference ?? '', alt: '' });
  const first = element('tr', {}, element('td', {}, reference), element('td', {}), element('td', { class: 'text', colspan: 12 }, 'the reference'));
  document.querySelector('#table tbody').replaceChildren(first, ...rows);
  drawOthers();
}

// What flickers along a camera path.
function drawAlong() {
  const { along } = results;
  $('along').hidden = !along;
  if (!along) return;
  $('along-name').textContent = `Along ${results.identity.path.name}`;
  $('along-summary').textContent = along.summary;
  const { heads, order } = sorting(ALONG_COLUMNS, state.alongSort, drawAlong);
  document.querySelector('#along thead').replaceChildren(element('tr', {}, ...heads));
  const rows = along.entries.filter((row) => !row.same_as).sort(order).map((row) => choosable(row.row, ...cellsOf(ALONG_COLUMNS, row)));
  document.querySelector('#along tbody').replaceChildren(...rows);
  const same = along.entries.filter((row) => row.same_as).map((row) => [row.row, row.same_as]);
  $('along-others').replaceChildren(
    ...list('Drawn as another setting in all frames', ['setting', 'drawn as'], same),
    ...list('Refused along the path', ['setting', 'reason'], along.refused),
  );
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
  drawAlong();
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
