// Readings from the picture: the clicked point, the distance between two points, the scale bar and the legend of colours.

import { $ } from './message.js';
import { coordinates, pathOf } from './pick.js';
import { clipped, digits, norm, project, sub, viewHeight } from './pose.js';

// Length of the longest scale bar, in CSS pixels.
const LONGEST_PX = 140;
// Scene files have no units.
const UNITS = 'units';

let points = [];

export const isOn = () => $('measure').getAttribute('aria-pressed') === 'true';

export function toggle() {
  $('measure').setAttribute('aria-pressed', !isOn());
  $('view').classList.toggle('measuring', isOn());
  clear();
  if (isOn()) say('Click two points.');
}

export function clear() {
  points = [];
  say('');
  $('line').setAttribute('visibility', 'hidden');
}

// Takes the hit of a click; null if it hit nothing.
export function hit(found) {
  if (!found) return say('Nothing is seen there.');
  const where = coordinates(found).join(', '), away = `${digits(found.distance, found.distance)} ${UNITS} away`;
  if (!isOn()) {
    points = [found];
    return say(`${where}\n${away} · ${pathOf(found)}${fieldsOf(found)}`);
  }
  points = points.length === 1 ? [points[0], found] : [found];
  if (points.length === 1) return say(`From ${where}\nClick the second point.`);
  say(`${length()} ${UNITS}\nfrom ${coordinates(points[0]).join(', ')}\nto ${where}`);
}

// The distance with the digits that both points have.
function length() {
  const [a, b] = points, step = Math.max(a.resolution, b.resolution);
  const value = norm(sub(a.position, b.position)), far = Math.max(a.distance, b.distance);
  const isSurface = [a, b].some(point => point.kind === 'triangle');
  return isSurface ? digits(value, far) : String(Number(value.toFixed(Math.max(0, Math.min(12, Math.floor(-Math.log10(step)))))));
}

function say(text) {
  $('measured').textContent = text;
  $('measured').hidden = !text;
}

// Shows what the colours of a frame stand for; null hides it.
export function showLegend(legend) {
  $('legend').hidden = !legend;
  if (!legend) return;
  const far = Math.max(Math.abs(legend.most - legend.least), 1e-12);
  $('legend-colors').hidden = legend.colors.length === 0;
  $('legend-colors').style.background = `linear-gradient(to right, ${legend.colors.join(', ')})`;
  if (legend.classes?.length) return $('legend-text').replaceChildren(...legend.classes.map(entry));
  const unit = legend.of === 'height' ? ` ${UNITS}` : '';
  $('legend-text').textContent = `${legend.of} ${digits(legend.least, far)} to ${digits(legend.most, far)}${unit}`;
}

// A class with its colour.
function entry({ class: number, name, color }) {
  const line = document.createElement('span'), swatch = document.createElement('span');
  line.className = 'entry';
  swatch.className = 'swatch';
  swatch.style.background = color;
  line.append(swatch, name ? `${number} ${name}` : `class ${number}`);
  return line;
}

// Values of the scalar fields of a hit, in words.
function fieldsOf({ fields = {} }) {
  const values = Object.entries(fields).map(([name, value]) => `${name} ${Number(value.toPrecision(9))}`);
  return values.length > 0 ? `\n${values.join(' · ')}` : '';
}

// Draws the measurements over a picture of this pose, whose width and height are in CSS pixels.
export function draw(pose, [width, height]) {
  $('scale').hidden = !pose;
  if (!pose) return;
  const [bar, words] = scale(pose, height);
  $('scale-bar').style.width = `${bar}px`;
  $('scale-text').textContent = words;
  const line = $('line');
  $('marks').setAttribute('viewBox', `0 0 ${width} ${height}`);
  const ends = points.length > 0 ? clipped(pose, points[0].position, points.at(-1).position) : null;
  line.setAttribute('visibility', ends ? 'visible' : 'hidden');
  if (!ends) return;
  const at = ends.map(end => project(pose, end, [width, height]).map(v => v.toFixed(2)).join(','));
  line.setAttribute('points', at.join(' '));
}

// The longest bar of 1, 2 or 5 times a power of ten at the distance of the target: its pixels, and its length in words.
function scale(pose, height) {
  const unit = viewHeight(pose) / Math.max(1, height);
  const most = LONGEST_PX * unit, power = 10 ** Math.floor(Math.log10(most));
  const length = [5, 2, 1].map(factor => factor * power).find(one => one <= most) ?? power;
  return [length / unit, `${Number(length.toPrecision(1))} ${UNITS}`];
}
