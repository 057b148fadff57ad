// What outlasts a reload: the path recorded for each scene, the film under way, the scene seen last. A browser that keeps nothing
// (private windows, full disks) costs no more than that.

const PREFIX = 'pointillist-';
// Scenes whose paths are kept; those not touched for longest go first.
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

// Whether the hint for the first visit has been seen.
export const knowsItsWay = () => read('knows') === true;
export const keepKnowing = () => write('knows', true);

export const film = () => read('film');
export const keepFilm = id => write('film', id);

// {name} of the scene's own path, or {path}; null where none was left.
export const pathOf = sceneId => (read('paths') || []).find(([id]) => id === sceneId)?.[1] ?? null;

export function keepPath(sceneId, kept) {
  const others = (read('paths') || []).filter(([id]) => id !== sceneId);
  write('paths', (kept ? [[sceneId, kept], ...others] : others).slice(0, MOST_PATHS));
}
