// Asks the server which element the picture shows at a place. Asks for a few pixels around it, because points leave gaps.

import { reach, sceneUrl } from './api.js';
import { digits } from './pose.js';

// Side of the square of pixels around the place.
const SIDE = 9, MIDDLE = (SIDE - 1) / 2;
// Steepest surface: its difference in depth across the square, in widths of the square.
const STEEPEST = 4;

// place: [right, up] from the picture's middle, in halves of its height. frame: the parameters of the picture. Returns null if
// there is nothing; else {position, distance, instance …} as the server sends it.
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
  // Points seen through the gaps of a surface are not meant.
  const near = Math.min(...found.map(pick => pick.hit.depth));
  const width = (params.ortho_height ?? near * 2 * Math.tan(params.fov * Math.PI / 360)) * SIDE / h;
  const limit = near + STEEPEST * width;
  const away = pick => Math.hypot(pick.x - x, pick.y - y);
  return found.filter(pick => pick.hit.depth <= limit).reduce((a, b) => (away(b) < away(a) ? b : a)).hit;
}

// A hit's coordinates with their significant digits: a sample's are stored, a triangle's follow from the position of the pixel.
export function coordinates({ kind, position, resolution, distance }) {
  const places = Math.max(0, Math.min(12, Math.floor(-Math.log10(resolution))));
  return position.map(value => (kind === 'triangle' || kind === 'segment' ? digits(value, distance) : String(Number(value.toFixed(places)))));
}

// The names of the nodes above the hit.
export function pathOf({ instance }) {
  if (!instance) return 'several instances';
  return instance.path.map(({ name, copy }) => (copy > 0 ? `${name} [${copy}]` : name)).join(' / ');
}
