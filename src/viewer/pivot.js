// The point of the scene that is seen at a place of the picture, from a few pixels of depth drawn around it.

import { reach } from './api.js';
import { add, mul, rayThrough } from './pose.js';
import { frameUrl } from './requests.js';

// Pixels around the place: points leave gaps between them.
const SIDE = 9, MIDDLE = (SIDE - 1) / 2;

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
  let best = null;
  for (let j = 0; j < SIDE; j++) {
    for (let i = 0; i < SIDE; i++) {
      const depth = depths[j * SIDE + i], away = Math.hypot(i - MIDDLE, j - MIDDLE);
      if (Number.isFinite(depth) && depth > 0 && (!best || away < best.away)) best = { depth, away, i, j };
    }
  }
  if (!best) return null;
  const half = SIDE / 2, at = [(best.i + 0.5 - half) / half, (half - best.j - 0.5) / half], ray = rayThrough(small, at);
  // Depth counts along the axis that the small picture is drawn along.
  return add(pose.eye, mul(ray, best.depth / (ray[0] * direction[0] + ray[1] * direction[1] + ray[2] * direction[2])));
}
