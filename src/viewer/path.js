// Camera paths: the camera at any time between keys, equal to the server's (src/scene/path, src/math/spline.rs): centripetal
// Catmull-Rom positions, slerp, and a cubic of time for each part of the way. A browser test compares the two. A path is {fps,
// interpolation, ease, keys: [{t, eye, target, up, fov or ortho_height, ease}]}; a key without `ease` has the path's.

import { DEFAULT_FOV, add, axes, cross, mul, norm, sub, unit } from './pose.js';

export const EASES = ['smooth', 'linear', 'in', 'out', 'in_out', 'hold'];
export const DEFAULT_FPS = 30;
const STEEPEST = 3;

export const defaultEase = interpolation => interpolation === 'linear' ? 'linear' : 'smooth';

// --- quaternions, [x, y, z, w] -------------------------------------------------------------------
function quaternionOf([x, y, z]) { // from the columns of a rotation
  const [m00, m11, m22] = [x[0], y[1], z[2]];
  const quarters = [1 + m00 - m11 - m22, 1 - m00 + m11 - m22, 1 - m00 - m11 + m22, 1 + m00 + m11 + m22];
  const largest = quarters.indexOf(Math.max(...quarters)), s = 0.5 / Math.sqrt(quarters[largest]);
  const q = [[quarters[0], y[0] + x[1], z[0] + x[2], y[2] - z[1]], [y[0] + x[1], quarters[1], z[1] + y[2], z[0] - x[2]],
    [z[0] + x[2], z[1] + y[2], quarters[2], x[1] - y[0]], [y[2] - z[1], z[0] - x[2], x[1] - y[0], quarters[3]]][largest];
  return unit(mul(q, s));
}
const dot4 = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
const angleBetween = (a, b) => 2 * Math.acos(Math.min(1, Math.abs(dot4(a, b))));
function slerp(a, b, s) {
  let cosine = dot4(a, b);
  if (cosine < 0) { b = mul(b, -1); cosine = -cosine; }
  if (cosine > 0.9995) return unit(add(a, mul(sub(b, a), s)));
  const angle = Math.acos(Math.min(1, cosine));
  return unit(mul(add(mul(a, Math.sin((1 - s) * angle)), mul(b, Math.sin(s * angle))), 1 / Math.sin(angle)));
}
function rotate([x, y, z, w], v) {
  const q = [x, y, z], t = mul(cross(q, v), 2);
  return add(add(v, mul(t, w)), cross(q, t));
}
function orientation(camera) {
  const { right, up, forward } = axes(camera);
  return quaternionOf([right, up, mul(forward, -1)]);
}

// --- positions -----------------------------------------------------------------------------------
const distance = (a, b) => norm(sub(a, b));
const knotInterval = (a, b) => Math.sqrt(distance(a, b));
const coincide = (a, b) => distance(a, b) <= 4 * Number.EPSILON * Math.max(...a.map(Math.abs), ...b.map(Math.abs));

function tangents(points) {
  const slope = i => mul(sub(points[i + 1], points[i]), 1 / knotInterval(points[i], points[i + 1]));
  const last = points.length - 1;
  return points.map((_, i) => {
    if (last === 0) return [0, 0, 0];
    if (i === 0) return slope(0);
    if (i === last) return slope(i - 1);
    const before = knotInterval(points[i - 1], points[i]), after = knotInterval(points[i], points[i + 1]);
    const across = mul(sub(points[i + 1], points[i - 1]), 1 / (before + after));
    return add(sub(slope(i - 1), across), slope(i));
  });
}

// Derivatives of the position at both ends of each part of the path, with respect to the share of the way made.
function slopes(keys, isLinear) {
  const eyes = keys.map(key => key.eye), legs = eyes.slice(1);
  if (isLinear) return legs.map((eye, i) => { const way = sub(eye, eyes[i]); return [way, way]; });
  const points = [], place = [];
  eyes.forEach((eye, i) => {
    if (i === 0 || !coincide(eyes[i - 1], eye)) points.push(eye);
    place.push(points.length - 1);
  });
  const of = tangents(points);
  return legs.map((eye, i) => {
    const [a, b] = [place[i], place[i + 1]];
    if (a === b) { const way = sub(eye, eyes[i]); return [way, way]; }
    const interval = knotInterval(points[a], points[b]);
    return [mul(of[a], interval), mul(of[b], interval)];
  });
}

function hermite(a, b, slopeA, slopeB, u) {
  const v = 1 - u;
  return a.map((_, i) => a[i] + (b[i] - a[i]) * (u * u * (3 - 2 * u)) + slopeA[i] * (u * v * v) - slopeB[i] * (u * u * v));
}

// --- time ----------------------------------------------------------------------------------------
const OWN_SLOPES = { linear: [1, 1], in: [0, 2], out: [2, 0], in_out: [0, 0], hold: [0, 0] };

function amountBeside(part, other) {
  const amount = part.length != null && other.length != null ? part.length
    : part.length == null && other.length == null ? part.angle : 0;
  return amount > 1e-12 ? amount : null;
}

// Slope of a smooth part at the key that it shares with `other`; `end` is the end of `other` at that key.
function beside(part, other, end) {
  const own = amountBeside(part, other), theirs = amountBeside(other, part);
  if (own == null || theirs == null) return 0;
  const h = part.duration, hOther = other.duration, speed = theirs / hOther * h / own;
  const slopesOfOther = OWN_SLOPES[other.ease];
  if (slopesOfOther) return Math.min(STEEPEST, slopesOfOther[end] * speed);
  const weight = 2 * hOther + h, weightOther = 2 * h + hOther;
  return Math.min(STEEPEST, (weight + weightOther) / (weight + weightOther / speed));
}

// The slopes of a part's cubic, or null if the camera waits until the end of the part.
function wayOf(parts, i) {
  const part = parts[i];
  if (part.ease === 'hold') return null;
  return OWN_SLOPES[part.ease] || [
    i > 0 ? beside(part, parts[i - 1], 1) : 1,
    i + 1 < parts.length ? beside(part, parts[i + 1], 0) : 1,
  ];
}

function made(way, u) {
  if (!way) return u < 1 ? 0 : 1;
  const v = 1 - u;
  return Math.max(0, Math.min(1, u * u * (3 - 2 * u) + way[0] * u * v * v - way[1] * u * u * v));
}

// --- the whole -----------------------------------------------------------------------------------
// Returns a function from seconds to the pose at that time. The times of the keys must increase.
export function sampler(path) {
  const keys = path.keys.map(key => ({ up: [0, 1, 0], ...(key.ortho_height == null ? { fov: DEFAULT_FOV } : {}), ...key }));
  const size = keys[0].ortho_height == null ? 'fov' : 'ortho_height';
  const isLinear = path.interpolation === 'linear', ease = path.ease || defaultEase(path.interpolation);
  const turns = keys.map(orientation), ends = slopes(keys, isLinear);
  const parts = keys.slice(1).map((next, i) => ({
    duration: next.t - keys[i].t,
    length: coincide(keys[i].eye, next.eye) ? null : isLinear ? distance(keys[i].eye, next.eye) : knotInterval(keys[i].eye, next.eye),
    angle: angleBetween(turns[i], turns[i + 1]),
    ease: keys[i].ease || ease,
  }));
  const ways = parts.map((_, i) => wayOf(parts, i));
  const poseOf = ({ eye, target, up, [size]: shown }) => ({ eye, target, up, [size]: shown });
  return t => {
    let i = keys.length - 1;
    while (i > 0 && keys[i].t > t) i--;
    const key = keys[i], next = keys[i + 1];
    if (!next || t <= key.t) return poseOf(key);
    const share = made(ways[i], (t - key.t) / parts[i].duration);
    if (share <= 0) return poseOf(key);
    if (share >= 1) return poseOf(next);
    const eye = hermite(key.eye, next.eye, ends[i][0], ends[i][1], share);
    const turn = slerp(turns[i], turns[i + 1], share);
    const [from, to] = [distance(key.eye, key.target), distance(next.eye, next.target)];
    const ahead = Math.max(from + (to - from) * share, norm(eye) * 1e-12);
    return {
      eye,
      target: add(eye, mul(rotate(turn, [0, 0, -1]), ahead)),
      up: rotate(turn, [0, 1, 0]),
      [size]: key[size] + (next[size] - key[size]) * share,
    };
  };
}

export const startOf = path => path.keys.length ? path.keys[0].t : 0;
export const durationOf = path => path.keys.length ? path.keys[path.keys.length - 1].t - path.keys[0].t : 0;

// Says why the server would refuse a path, or returns null.
export function faultOf(path) {
  const isVector = v => Array.isArray(v) && v.length === 3 && v.every(Number.isFinite);
  if (!path || !Array.isArray(path.keys) || path.keys.length === 0) return 'keys: a path needs at least one key';
  if (path.fps != null && !(path.fps >= 0.001 && path.fps <= 1000)) return 'fps: accepted are 0.001 to 1000';
  if (path.interpolation != null && !['catmull_rom', 'linear'].includes(path.interpolation)) return 'interpolation: accepted are catmull_rom, linear';
  if (path.ease != null && !EASES.includes(path.ease)) return `ease: accepted are ${EASES.join(', ')}`;
  for (const [i, key] of path.keys.entries()) {
    const place = `keys[${i}]`;
    if (!key || !Number.isFinite(key.t)) return `${place}.t: needs a time in seconds`;
    if (i > 0 && key.t <= path.keys[i - 1].t) return `${place}.t: ${key.t} s must be later than the key before`;
    for (const name of ['eye', 'target']) if (!isVector(key[name])) return `${place}.${name}: needs three numbers`;
    if (distance(key.eye, key.target) === 0) return `${place}.target: must differ from eye`;
    if (key.up != null && !(isVector(key.up) && norm(key.up) > 0)) return `${place}.up: needs three numbers that are not all 0`;
    if (key.fov != null && !(key.fov >= 1e-6 && key.fov <= 179.999999)) return `${place}.fov: must be 0.000001 to 179.999999 degrees`;
    if (key.ortho_height != null && !(key.ortho_height >= 1e-15 && key.ortho_height <= 1e15)) return `${place}.ortho_height: must be 1e-15 to 1e15`;
    if (key.ortho_height != null && key.fov != null) return `${place}.ortho_height: a key has either fov or ortho_height`;
    if ((key.ortho_height == null) !== (path.keys[0].ortho_height == null)) return `${place}: either all keys have ortho_height, or none`;
    if (key.ease != null && !EASES.includes(key.ease)) return `${place}.ease: accepted are ${EASES.join(', ')}`;
  }
  return null;
}

// The path as in its file, without values that are the default.
export function documentOf(path) {
  const usual = defaultEase(path.interpolation), ease = path.ease || usual;
  return {
    fps: path.fps,
    ...(path.interpolation === 'linear' ? { interpolation: 'linear' } : {}),
    ...(ease !== usual ? { ease } : {}),
    keys: path.keys.map(key => ({
      t: key.t, eye: key.eye, target: key.target, up: key.up, ...(key.ortho_height == null ? { fov: key.fov } : { ortho_height: key.ortho_height }),
      ...(key.ease && key.ease !== ease ? { ease: key.ease } : {}),
    })),
  };
}
