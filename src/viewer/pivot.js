// The point of the scene that is seen at a place of the picture, from a few pixels of depth drawn around it.

import { reach } from './api.js';
import { add, mul, rayThrough } from './pose.js';
import { frameUrl } from './requests.js';

// Pixels around the place: points leave gaps between them.
const SIDE = 9, MIDDLE = (SIDE - 1) / 2;
// How much farther a surface may be at one end of them than at the other, in widths of all of them.
const STEEPEST = 4;

// place: [right, up] from the picture's middle, in halves of its height; `height`: its pixels. Null where nothing is seen.
export async function pointAt(sceneId, pose, place, height, settings) {
  const direction = rayThrough(pose, place);
  // A pixel has the same angle as in the picture's middle.
  const slope = Math.tan(pose.fov * Math.PI / 360) * SIDE / height;
  const small = { ...pose, target: add(pose.eye, direction), fov: Math.atan(slope) * 360 / Math.PI };
  const { format, quality, paint, ...others } = settings;
  const params = { ...small, w: SIDE, h: SIDE, ...others, output: 'depth', format: 'raw' };
  const response = await reach(frameUrl(sceneId, params));
  const depths = new Float32Array(await response.arrayBuffer());
  const pixels = [...depths].map((depth, n) => ({ depth, i: n % SIDE, j: Math.floor(n / SIDE) })).filter(({ depth }) => depth > 0 && Number.isFinite(depth));
  if (pixels.length === 0) return null;
  // What shows through the gaps of a surface is not what is meant.
  const nearest = Math.min(...pixels.map(({ depth }) => depth)), limit = nearest * (1 + STEEPEST * 2 * slope);
  const away = ({ i, j }) => Math.hypot(i - MIDDLE, j - MIDDLE);
  const best = pixels.filter(({ depth }) => depth <= limit).reduce((a, b) => (away(b) < away(a) ? b : a));
  const half = SIDE / 2, at = [(best.i + 0.5 - half) / half, (half - best.j - 0.5) / half], ray = rayThrough(small, at);
  // Depth counts along the axis that the small picture is drawn along.
  return add(pose.eye, mul(ray, best.depth / (ray[0] * direction[0] + ray[1] * direction[1] + ray[2] * direction[2])));
}
