// Data that survives a reload: the path recorded for each scene, the running film, and the last scene. If a browser stores
// nothing (private windows, full disks), only these are lost.

const PREFIX = 'pointillist-';
// Number of scenes whose paths are kept. The least recently used ones go first.
const MOST_PATHS = 24;

function read(name) {
  try {
    return JSON.parse(localStorage.getItem(PREFIX + name));
  } catch {
    return null;
  }
}

function write(name, value) {
  try {
    if (value == null) localStorage.removeItem(PREFIX + name); else localStorage.setItem(PREFIX + name, JSON.stringify(value));
  } catch { /* it is there until the page is left */ }
}

export const lastScene = () => read('scene');
export const keepScene = id => write('scene', id);

// Whether the user has seen the hint for the first visit.
export const knowsItsWay = () => read('knows') === true;
export const keepKnowing = () => write('knows', true);

export const film = () => read('film');
export const keepFilm = id => write('film', id);

// {name} of a path of the scene, or {path}; null if none is stored.
export const pathOf = sceneId => (read('paths') || []).find(([id]) => id === sceneId)?.[1] ?? null;

export function keepPath(sceneId, kept) {
  const others = (read('paths') || []).filter(([id]) => id !== sceneId);
  write('paths', (kept ? [[sceneId, kept], ...others] : others).slice(0, MOST_PATHS));
}
