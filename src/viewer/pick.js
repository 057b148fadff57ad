// What the scene shows at a place of the picture: asked of the daemon, for a few pixels around the place, because points leave gaps
// between them.

import { reach, sceneUrl } from './api.js';
import { digits } from './pose.js';

// Pixels around the place.
const SIDE = 9, MIDDLE = (SIDE - 1) / 2;
// How much farther a surface may be at one end of them than at the other, in widths of all of them.
const STEEPEST = 4;

// place: [right, up] from the picture's middle, in halves of its height. frame: the parameters of the picture. Null where nothing is
// seen; else {position, distance, instance …} as the daemon has it.
export async function pickAt(sceneId, frame, [right, up]) {
  const { format, quality, output, ...params } = frame, { w, h } = params;
  const x = Math.floor(w / 2 + right * h / 2), y = Math.floor(h / 2 - up * h / 2), pixels = [];
  for (let j = y - MIDDLE; j <= y + MIDDLE; j++) {
    for (let i = x - MIDDLE; i <= x + MIDDLE; i++) if (i >= 0 && j >= 0 && i < w && j < h) pixels.push([i, j]);
  }
  if (pixels.length === 0) return null;
  const response = await reach(sceneUrl(sceneId, '/pick'), {
    method: 'POST', headers: { 'Content-Type': 'application/json' }, body: JSON.stringify({ ...params, pixels }),
  });
  const found = (await response.json()).picks.filter(pick => pick.hit);
  if (found.length === 0) return null;
  // What shows through the gaps of a surface is not what is meant.
  const near = Math.min(...found.map(pick => pick.hit.depth));
  const width = (params.ortho_height ?? near * 2 * Math.tan(params.fov * Math.PI / 360)) * SIDE / h;
  const limit = near + STEEPEST * width;
  const away = pick => Math.hypot(pick.x - x, pick.y - y);
  return found.filter(pick => pick.hit.depth <= limit).reduce((a, b) => (away(b) < away(a) ? b : a)).hit;
}

// A hit's coordinates with the digits that they have: a sample's are stored, a triangle's follow from where the pixel is.
export function coordinates({ kind, position, resolution, distance }) {
  const places = Math.max(0, Math.min(12, Math.floor(-Math.log10(resolution))));
  return position.map(value => (kind === 'triangle' ? digits(value, distance) : String(Number(value.toFixed(places)))));
}

// The nodes that lead to what was hit.
export function pathOf({ instance }) {
  if (!instance) return 'several instances';
  return instance.path.map(({ name, copy }) => (copy > 0 ? `${name} [${copy}]` : name)).join(' / ');
}
