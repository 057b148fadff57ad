// Groups the given files into uploads: looks through folders, and makes a scene of each model that stands alone.

import { COMPANIONS, MODELS, MOST_FILES } from './formats.js';

// Formats whose files name others.
const NAMING = ['obj', 'gltf'];
// Largest number of scenes in one drop; more are hardly intended.
const MOST_SCENES = 32;
// Largest size of a file that is taken for a camera path.
const PATH_BYTES = 1 << 20;

const extension = name => name.includes('.') ? name.slice(name.lastIndexOf('.') + 1).toLowerCase() : '';
const baseName = path => path.slice(path.lastIndexOf('/') + 1);
const isHidden = name => name.startsWith('.') || name.startsWith('__MACOSX');
const formatOf = name => extension(name.toLowerCase().replace(/\.gz$/, ''));

// The files of a drop, including those in folders: {files, folders}, the latter by name.
export async function filesOf(transfer) {
  // Entries exist only during the event, so take all of them before the first await.
  const entries = [...transfer.items].map(item => item.webkitGetAsEntry?.()).filter(Boolean);
  if (!entries.some(entry => entry.isDirectory)) return { files: [...transfer.files], folders: [] };
  const files = [], inside = [];
  for (const entry of entries) await collect(entry, entry.isDirectory ? inside : files);
  // Other files in a folder were not meant: read-me files, records of other programs.
  const useful = [];
  for (const file of inside) if (await isOfUse(file)) useful.push(file);
  // Images and text files are useful only beside models; a text file alone may hold points.
  const isShown = useful.some(file => ['json', ...MODELS].includes(formatOf(file.name))) || useful.every(file => extension(file.name) === 'txt');
  if (isShown) files.push(...useful);
  return { files, folders: entries.filter(entry => entry.isDirectory).map(entry => entry.name) };
}

async function collect(entry, files) {
  if (isHidden(entry.name)) return;
  if (entry.isFile) return void files.push(await new Promise((resolve, reject) => entry.file(resolve, reject)));
  const reader = entry.createReader();
  // The reader returns entries in batches, and an empty batch at the end.
  for (;;) {
    const batch = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
    if (batch.length === 0) return;
    for (const inside of batch) await collect(inside, files);
  }
}

async function isOfUse(file) {
  if (extension(file.name) !== 'json') return [...MODELS, ...COMPANIONS].includes(formatOf(file.name));
  const value = await parsed(file);
  return Array.isArray(value?.nodes) || isPathDocument(value);
}

// Says why a file cannot be read, or returns null. A folder passed as a file, and a file moved since, cannot be read.
export async function unreadable(file) {
  try {
    await file.slice(0, 1).arrayBuffer();
    return null;
  } catch {
    return `${file.name} cannot be read. Is it a folder, or was it moved or changed since it was chosen?`;
  }
}

// Sorts the files: {paths, uploads, fault}. An upload is a list of files, the one to load first. `fault` says why they are
// refused.
export async function sorted(files) {
  const paths = [], rest = [];
  for (const file of files) (await isPath(file) ? paths : rest).push(file);
  const uploads = await groups(rest);
  const fault = uploads.length > MOST_SCENES ? `They would be ${uploads.length} scenes; ${MOST_SCENES} at a time are taken.` : null;
  return { paths, uploads, fault };
}

async function groups(files) {
  if (files.length < 2) return files.map(file => [file]);
  const of = test => files.filter(file => test(extension(file.name)));
  const scenes = of(kind => kind === 'json'), companions = of(kind => COMPANIONS.includes(kind));
  const models = of(kind => kind !== 'json' && !COMPANIONS.includes(kind));
  // A scene may name any of the other files.
  if (scenes.length > 0) return scenes.map(scene => [scene, ...companions, ...models]);
  if (models.length === 0) return files.map(file => [file]);
  return Promise.all(models.map(async model => {
    const kind = extension(model.name);
    if (!NAMING.includes(kind)) return [model];
    return [kind === 'gltf' ? await flattened(model, companions) : model, ...companions];
  }));
}

// Says what is wrong with a group of files as a whole, or returns null.
export function faultOfGroup(group) {
  if (group.length > MOST_FILES) return `They are ${group.length} files; one scene takes ${MOST_FILES} at most.`;
  const seen = new Set();
  for (const { name } of group) {
    if (seen.has(name)) return `Two of them are called ${name}; the files of a scene lie in one folder.`;
    seen.add(name);
  }
  return null;
}

// A glTF may name files in subfolders; in an upload all files are in one folder.
async function flattened(model, companions) {
  const names = new Set(companions.map(file => file.name));
  try {
    const document = JSON.parse(await model.text());
    for (const one of [...(document.buffers || []), ...(document.images || [])]) {
      const name = typeof one.uri === 'string' && !one.uri.startsWith('data:') ? baseName(decodeURIComponent(one.uri)) : '';
      if (names.has(name)) one.uri = encodeURIComponent(name);
    }
    return new File([JSON.stringify(document)], model.name);
  } catch {
    return model; // the server reports the error
  }
}

async function isPath(file) {
  return extension(file.name) === 'json' && file.size <= PATH_BYTES && isPathDocument(await parsed(file));
}

const isPathDocument = value => Array.isArray(value?.keys) && value.nodes === undefined;

// Returns null for invalid JSON; the server reports the error.
async function parsed(file) {
  try {
    return JSON.parse(await file.text());
  } catch {
    return null;
  }
}
