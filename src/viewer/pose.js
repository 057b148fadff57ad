// Poses and how they move, as pure functions from pose to pose. A pose is {eye, target, up, fov}: three arrays of three numbers,
// and degrees. Where rays are parallel, `ortho_height`, the height of the view, takes the place of `fov`. The page moves poses with
// `fov`; `parallel` and `perspective` lead from one to the other.

export const add = (a, b) => a.map((v, i) => v + b[i]);
export const sub = (a, b) => a.map((v, i) => v - b[i]);
export const mul = (a, s) => a.map(v => v * s);
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const norm = a => Math.hypot(...a);
export const unit = a => mul(a, 1 / norm(a));

// Rodrigues' rotation formula. The axis has unit length.
const turn = (v, axis, angle) => {
  const c = Math.cos(angle), s = Math.sin(angle);
  return add(add(mul(v, c), mul(cross(axis, v), s)), mul(axis, dot(axis, v) * (1 - c)));
};

// Smallest angle between the view and straight up or down, in radians.
const POLE = 0.01;

const anyAcross = v => unit(cross(v, Math.abs(v[0]) < 0.7 * norm(v) ? [1, 0, 0] : [0, 1, 0]));

// The view's right, up and forward directions, as unit vectors.
export function axes(pose) {
  const forward = unit(sub(pose.target, pose.eye)), side = cross(forward, unit(pose.up));
  const right = norm(side) > 1e-6 ? unit(side) : anyAcross(forward);
  return { right, up: cross(right, forward), forward };
}

// Limits a change of an angle so that the result stays away from both poles.
const pitched = (from, by) => Math.max(POLE, Math.min(Math.PI - POLE, from + by)) - from;
const angleFromUp = (v, up) => Math.acos(Math.max(-1, Math.min(1, dot(unit(v), up))));

// Turns around the target, by angles in radians.
export function orbit(pose, yaw, pitch) {
  const offset = sub(pose.eye, pose.target), up = unit(pose.up), { right } = axes(pose);
  const lifted = turn(offset, right, pitched(angleFromUp(offset, up), pitch));
  return { ...pose, eye: add(pose.target, turn(lifted, up, yaw)) };
}

// Turns around the eye, by angles in radians.
export function look(pose, yaw, pitch) {
  const ahead = sub(pose.target, pose.eye), up = unit(pose.up), { right } = axes(pose);
  const lifted = turn(ahead, right, -pitched(angleFromUp(ahead, up), -pitch));
  return { ...pose, target: add(pose.eye, turn(lifted, up, yaw)) };
}

export const DEFAULT_FOV = 40;

// Height of the view at the distance of the target.
export function viewHeight({ eye, target, fov, ortho_height: height }) {
  return height ?? 2 * norm(sub(eye, target)) * Math.tan(fov * Math.PI / 360);
}

const backward = ({ eye, target }) => unit(sub(eye, target));

// A pose with parallel rays that shows as much at the target. The eye stands `apart` farther away, so that it cuts nothing off.
export function parallel(pose, apart) {
  const { eye, target, up } = pose;
  return { eye: add(eye, mul(backward(pose), apart)), target, up, ortho_height: viewHeight(pose) };
}

// A pose with a field of view that shows as much at the target.
export function perspective(pose) {
  const { target, up, ortho_height: height } = pose;
  if (height == null) return pose;
  const distance = height / 2 / Math.tan(DEFAULT_FOV * Math.PI / 360);
  return { eye: add(target, mul(backward(pose), distance)), target, up, fov: DEFAULT_FOV };
}

// Moves across the view, by fractions of its height.
export function pan(pose, dx, dy) {
  const { right, up } = axes(pose);
  const height = viewHeight(pose);
  return shifted(pose, add(mul(right, -dx * height), mul(up, dy * height)));
}

// A smaller scene can hardly be found on the screen.
const DOT_PX = 12;
// Farther away than this many extents, a scene is a dot.
const FARTHEST = 100;

// Multiplies the distance to the target, within the range in which a scene of this extent can be seen.
export function dolly(pose, factor, extent) {
  const offset = sub(pose.eye, pose.target), distance = norm(offset);
  const wanted = Math.max(extent * 1e-5, Math.min(Math.max(distance, extent * FARTHEST), distance * factor));
  return { ...pose, eye: add(pose.target, mul(offset, wanted / distance)) };
}

// As `dolly`, but the point under a place of the picture, at the distance of the target, stays there. The place is [right, up]
// from the middle, in halves of the picture's height.
export function dollyTowards(pose, factor, extent, [x, y]) {
  const nearer = dolly(pose, factor, extent), { right, up } = axes(pose);
  const before = norm(sub(pose.eye, pose.target)), slope = Math.tan(pose.fov * Math.PI / 360);
  const share = (before - norm(sub(nearer.eye, nearer.target))) * slope;
  return shifted(nearer, add(mul(right, x * share), mul(up, y * share)));
}

// The position of a point in a picture of this size, in pixels from the top left. The point must be in front of the eye.
export function project(pose, point, [width, height]) {
  const { right, up, forward } = axes(pose), way = sub(point, pose.eye);
  const focal = pose.ortho_height ? height / pose.ortho_height : height / 2 / Math.tan(pose.fov * Math.PI / 360) / dot(way, forward);
  return [width / 2 + dot(way, right) * focal, height / 2 - dot(way, up) * focal];
}

// The part of a line in front of the eye, by at least a ten-thousandth of the target's distance; null if there is none.
export function clipped(pose, a, b) {
  const { forward } = axes(pose), near = norm(sub(pose.target, pose.eye)) * 1e-4;
  const [p, q] = [a, b].map(end => dot(sub(end, pose.eye), forward) - near);
  if (p <= 0 && q <= 0) return null;
  const crossing = () => add(a, mul(sub(b, a), p / (p - q)));
  return [p < 0 ? crossing() : a, q < 0 ? crossing() : b];
}

// Turns part of the way to another target, `share` from 0 to 1. The eye stays.
export function turnedTo(pose, target, share) {
  const [a, b] = [sub(pose.target, pose.eye), sub(target, pose.eye)];
  const between = add(mul(unit(a), 1 - share), mul(unit(b), share)), distance = norm(a) + (norm(b) - norm(a)) * share;
  return { ...pose, target: share >= 1 || norm(between) < 1e-9 ? target : add(pose.eye, mul(unit(between), distance)) };
}

// A camera made for a frame at least as wide as high shows the same width in a narrower one, up to a vertical field of view of
// 100 degrees, as with the server's `camera=`.
const WIDEST_FOV = 100;
export function forFrame(camera, [width, height]) {
  const { eye, target, up, fov, ortho_height: flat } = camera, sides = Math.max(1, height / width);
  if (flat != null) return { eye, target, up, ortho_height: flat * sides };
  const half = Math.tan(fov * Math.PI / 360) * sides;
  return { eye, target, up, fov: Math.max(fov, Math.min(WIDEST_FOV, Math.atan(half) * 360 / Math.PI)) };
}

// A coordinate with the digits that are visible from this distance: a ten-thousandth of it.
export function digits(value, distance) {
  const places = Math.max(0, Math.min(15, Math.ceil(4 - Math.log10(distance))));
  return Number.isFinite(places) ? String(Number(value.toFixed(places))) : String(value);
}

// Moves along the view's own axes: [right, up, forward], in scene units. The target moves along.
export function fly(pose, [x, y, z]) {
  const { right, up, forward } = axes(pose);
  return shifted(pose, add(add(mul(right, x), mul(up, y)), mul(forward, z)));
}

function shifted(pose, by) {
  return { ...pose, eye: add(pose.eye, by), target: add(pose.target, by) };
}

// The extent of a scene's box; for a scene without one, the distance of the pose's target.
export function extentOf(bounds, pose) {
  const size = bounds ? norm(sub(bounds[1], bounds[0])) : 0;
  return size || (pose ? norm(sub(pose.eye, pose.target)) : 1);
}

// Whether a box is beside the view, behind it, or only a dot in a picture of this size in pixels.
export function isOutOfSight(pose, [low, high], [width, height]) {
  const { right, up, forward } = axes(pose), flat = pose.ortho_height, slope = flat ? flat / 2 : Math.tan(pose.fov * Math.PI / 360);
  const wide = slope * width / height, divisor = z => (flat ? 1 : z);
  const corners = Array.from({ length: 8 }, (_, i) => {
    const way = sub([0, 1, 2].map(axis => (i >> axis & 1 ? high : low)[axis]), pose.eye);
    return [dot(way, right), dot(way, up), dot(way, forward)];
  });
  const outside = [([,, z]) => z <= 0, ([x,, z]) => x > divisor(z) * wide, ([x,, z]) => -x > divisor(z) * wide,
    ([, y, z]) => y > divisor(z) * slope, ([, y, z]) => -y > divisor(z) * slope];
  const distance = norm(sub(mul(add(low, high), 0.5), pose.eye)), extent = norm(sub(high, low));
  return outside.some(test => corners.every(test)) || (extent > 0 && extent / divisor(distance) / slope / 2 * height < DOT_PX);
}

// Whether two poses give the same view.
export function isSame(a, b) {
  const scale = norm(sub(a.eye, a.target)) * 1e-9;
  return norm(sub(a.eye, b.eye)) <= scale && norm(sub(a.target, b.target)) <= scale
    && norm(sub(unit(a.up), unit(b.up))) < 1e-9 && Math.abs(a.fov - b.fov) < 1e-9;
}
