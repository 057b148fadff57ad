// The plot of an accuracy survey: error over GPU time, with quartiles and the Pareto front. The viewer shows it, and the report of
// `pointillist accuracy` contains it.

const SVG = 'http://www.w3.org/2000/svg';

// Errors by which a survey is plotted. more: more is better.
export const MEASURES = {
  psnr: { name: 'PSNR against the reference, dB', value: row => row.psnr_db ?? Infinity, digits: 2, more: true },
  flip: { name: 'mean FLIP', value: row => row.flip, digits: 4, more: false },
  ssim: { name: 'SSIM', value: row => row.ssim, digits: 4, more: true },
};

// The report's size. letter: width of a letter of a label, 0 for no labels.
export const WIDE = { width: 1180, height: 560, left: 70, right: 1160, top: 16, bottom: 508, ticks: 10, letter: 6.9 };

// Rows that are drawn for themselves and timed.
export const isPlotted = row => !row.same_as && row.gpu_ms;

// Ways to draw samples, in the order of their colours.
export const familiesOf = results => [...new Set(results.scopes.flatMap(scope => scope.entries.filter(isPlotted).map(row => row.family)))];

export function shape(name, attributes, ...children) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

export function digits(value, count) {
  if (value === Infinity) return 'equal';
  return value == null || !isFinite(value) ? '–' : value.toFixed(count);
}

// Three digits, or all digits before the point.
export function short(value) {
  if (value == null || !isFinite(value)) return '–';
  const before = Math.floor(Math.log10(Math.max(Math.abs(value), 1e-4))) + 1;
  return value.toFixed(Math.max(0, 3 - before));
}

function axis(values, from, to, least) {
  const finite = values.filter(isFinite);
  let [low, high] = finite.length ? [Math.min(...finite), Math.max(...finite)] : [0, 1];
  const margin = Math.max(0.05 * (high - low), 0.5 * (least - (high - low)));
  [low, high] = [low - margin, high + margin];
  const px = value => from + Math.min(1, Math.max(0, (value - low) / (high - low))) * (to - from);
  return { low, high, px };
}

function roundTicks({ low, high }, most) {
  const rough = (high - low) / most;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map(times => times * power).find(found => found >= rough);
  const ticks = [];
  for (let tick = Math.ceil(low / step); tick * step <= high; tick += 1) ticks.push(tick * step);
  return ticks;
}

function logTicks({ low, high }, most) {
  const ticks = [];
  for (let decade = Math.floor(low); decade <= Math.ceil(high); decade += 1) {
    for (const step of 3 * (high - low) > most ? [1] : [1, 2, 5]) ticks.push(step * 10 ** decade);
  }
  return ticks.filter(tick => Math.log10(tick) >= low && Math.log10(tick) <= high);
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

// The marks with their families' names, and those of the plot.
export function legend(families, hasDefault) {
  const item = (name, ...marks) => {
    const span = document.createElement('span');
    span.append(shape('svg', { viewBox: '0 0 14 14', class: 'curve' }, ...marks), name);
    return span;
  };
  const items = families.map((name, family) => item(name, mark(family, 7, 7, { class: `best c${family % 6} f${family % 6}` })));
  const ring = shape('circle', { class: 'usual', cx: 7, cy: 7, r: 6 });
  return hasDefault ? [...items, item('default', ring)] : items;
}

function grid(svg, x, y, box, words) {
  for (const tick of logTicks(x, 1.2 * box.ticks)) {
    const at = x.px(Math.log10(tick));
    svg.append(shape('path', { class: 'grid', d: `M${at} ${box.top}V${box.bottom}` }));
    svg.append(shape('text', { class: 'soft', x: at, y: box.bottom + 18, 'text-anchor': 'middle' }, String(+tick.toPrecision(3))));
  }
  for (const tick of roundTicks(y, box.ticks)) {
    const at = y.px(tick);
    svg.append(shape('path', { class: 'grid', d: `M${box.left} ${at}H${box.right}` }));
    svg.append(shape('text', { class: 'soft', x: box.left - 8, y: at + 4.5, 'text-anchor': 'end' }, String(+tick.toPrecision(4))));
  }
  svg.append(shape('rect', { class: 'frame', x: box.left, y: box.top, width: box.right - box.left, height: box.bottom - box.top }));
  const middle = (box.left + box.right) / 2, centre = (box.top + box.bottom) / 2, side = box.letter ? 20 : 12;
  svg.append(shape('text', { x: middle, y: box.height - 10, 'text-anchor': 'middle' }, box.letter ? 'GPU time of a frame in milliseconds, logarithmic' : 'GPU time of a frame, ms'));
  svg.append(shape('text', { x: side, y: centre, transform: `rotate(-90 ${side} ${centre})`, 'text-anchor': 'middle' }, words));
}

// The plot of a scope as an SVG. chosen: name of a row; choose(name): called for a mark that is clicked or pressed; here: {ms, row}, the GPU
// time of another frame, and the name of the row that is drawn likewise, if there is one.
export function curve({ scope, families, measure: name, chosen, choose, here, box = WIDE }) {
  const measure = MEASURES[name], rows = scope.entries.filter(isPlotted), front = scope.fronts[name] ?? [];
  const entry = row => scope.entries.find(found => found.row === row);
  const times = rows.flatMap(row => [row.gpu_ms.low, row.gpu_ms.high]);
  const x = axis([...times, ...(here ? [here.ms] : [])].map(Math.log10), box.left, box.right, 0.3);
  const sides = measure.more ? [box.bottom, box.top] : [box.top, box.bottom];
  const y = axis(rows.map(measure.value), ...sides, name === 'psnr' ? 2 : 0.01);
  const svg = shape('svg', { viewBox: `0 0 ${box.width} ${box.height}`, role: 'group', class: 'curve', 'aria-label': 'Error over GPU time' });
  grid(svg, x, y, box, box.letter ? `${measure.name} (better is up)` : measure.name.replace(' against the reference', ''));
  const place = row => [x.px(Math.log10(row.gpu_ms.median)), y.px(measure.value(row))];
  for (const row of rows) {
    const at = place(row)[1], family = families.indexOf(row.family) % 6;
    const [low, high] = [row.gpu_ms.low, row.gpu_ms.high].map(ms => x.px(Math.log10(ms)));
    svg.append(shape('path', { class: `bar c${family}`, d: `M${low} ${at}H${high}M${low} ${at - 3}v6M${high} ${at - 3}v6` }));
  }
  const best = front.map(entry).filter(Boolean);
  svg.append(shape('polyline', { class: 'front', points: best.map(row => place(row).join(',')).join(' ') }));
  if (here) {
    const at = x.px(Math.log10(here.ms)), likewise = here.row && entry(here.row);
    svg.append(shape('path', { class: 'here', d: `M${at} ${box.top}V${box.bottom}` }));
    if (likewise?.gpu_ms) svg.append(shape('path', { class: 'here', d: `M${place(likewise)[0]} ${place(likewise)[1]}H${at}` }));
  }
  const usual = rows.find(row => row.row === scope.default);
  if (usual) svg.append(shape('circle', { class: 'usual', cx: place(usual)[0], cy: place(usual)[1], r: 8 }));
  for (const row of rows) svg.append(dot(row));
  function dot(row) {
    const family = families.indexOf(row.family) % 6;
    const words = `${row.row}${row === usual ? ' (default)' : ''}: ${short(row.gpu_ms.median)} ms, ${digits(measure.value(row), measure.digits)}`;
    const classes = front.includes(row.row) ? `dot best c${family} f${family}` : `dot c${family}`;
    const made = mark(family, ...place(row), { class: classes, tabindex: 0, role: 'button', 'aria-label': words, 'data-row': row.row, 'aria-pressed': row.row === chosen });
    made.append(shape('title', {}, words));
    made.addEventListener('click', () => choose(row.row));
    made.addEventListener('keydown', event => {
      if (event.key !== 'Enter' && event.key !== ' ') return;
      event.preventDefault();
      choose(row.row);
    });
    return made;
  }
  const wanted = chosen && entry(chosen), shown = wanted && rows.find(row => row.row === (wanted.same_as ?? wanted.row));
  if (shown) svg.append(shape('circle', { class: 'ring', cx: place(shown)[0], cy: place(shown)[1], r: 10 }));
  if (box.letter) label(svg, [...(shown && !best.includes(shown) ? [shown] : []), ...best], place, box);
  return svg;
}

function label(svg, rows, place, box) {
  const taken = rows.map(place).map(([px, py]) => [px - 6, py - 6, px + 6, py + 6]);
  for (const row of rows) {
    const free = room(...place(row), box.letter * row.row.length, taken, box);
    if (!free) continue;
    taken.push(free);
    svg.append(shape('text', { class: 'label', x: free[0], y: free[3] - 3 }, row.row));
  }
}

// A box beside a point for a label, which covers none of the boxes that are taken.
function room(x, y, width, taken, { left, right, top, bottom }) {
  const offsets = [[10, 5], [-10 - width, 5], [7, -7], [-7 - width, -7], [7, 19], [-7 - width, 19], [-width / 2, -11], [-width / 2, 24]];
  for (const [dx, dy] of offsets) {
    for (const shift of [0, -14, 14]) {
      const box = [x + dx, y + dy + shift - 15, x + dx + width, y + dy + shift];
      const inside = box[0] >= left && box[2] <= right && box[1] >= top && box[3] <= bottom;
      const clashes = taken.some(other => box[0] < other[2] && other[0] < box[2] && box[1] < other[3] && other[1] < box[3]);
      if (inside && !clashes) return box;
    }
  }
  return null;
}
