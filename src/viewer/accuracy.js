// What accuracy costs in time: the measured curve of the scene, with the place of the view's own frame, and comparisons of two settings.

import { getJson, isPassing, reach, sceneUrl } from './api.js';
import { MEASURES, curve, digits, familiesOf, isPlotted, legend, short } from './curve.js';
import { $, complain, option, quiet } from './message.js';
import { closeSheet } from './overlay.js';
import * as settings from './settings.js';
import { Wipe } from './wipe.js';

const POLL_MS = 700;
const FAILED_MS = 3000;
// Size of the plot, in the units of its own image; the panel is about as wide.
const BOX = { width: 360, height: 300, left: 46, right: 352, top: 8, bottom: 252, ticks: 5, letter: 0 };
// Names in the list of what a frame is compared with. No row can have such a name.
const REFERENCE = '\0reference', DEFAULTS = '\0defaults';

export class Accuracy {
  // view: {scene(), request(), limits(), scale(), setScale(share)}; request(): the parameters of the view's frame; scale(): the share of its full width
  // and height that it is drawn at.
  constructor(view) {
    this.view = view;
    this.wipe = new Wipe();
    this.known = null;   // what the server knows of the scene; null if it was never measured
    this.receipt = null; // that of the newest frame at rest
    this.chosen = null;
    this.timer = 0;
    $('accuracy').addEventListener('toggle', () => { if ($('accuracy').open) this.ask(); });
    $('accuracy-start').addEventListener('click', () => this.start());
    $('accuracy-cancel').addEventListener('click', () => this.change('POST', '/accuracy/cancel'));
    for (const id of ['accuracy-scope', 'accuracy-measure']) $(id).addEventListener('change', () => this.plot());
    $('accuracy-row').addEventListener('change', () => this.choose($('accuracy-row').value));
    $('wipe-start').addEventListener('click', () => this.compare());
    this.show();
  }

  ofScene() {
    this.known = this.receipt = this.chosen = null;
    this.resize(1);
    this.wipe.close();
    this.show();
    if ($('accuracy').open) this.ask();
  }

  // The scene has a new revision: results become stale.
  edited() {
    this.wipe.close();
    if ($('accuracy').open) this.ask();
  }

  // The view has moved: a comparison shows another one.
  moved() { this.wipe.close(); }

  // receipt: that of a frame at rest.
  frame(receipt) {
    this.receipt = receipt;
    if ($('accuracy').open) this.plot();
  }

  async ask() {
    clearTimeout(this.timer);
    const { id } = this.view.scene() ?? {};
    if (!id) return;
    try {
      this.came(id, await getJson(sceneUrl(id, '/accuracy')));
    } catch (problem) {
      // Problems are those of the connection, which says so itself, or of a scene that was deleted.
      if (isPassing(problem) && this.view.scene()?.id === id && this.known?.state === 'running') this.askAgain(FAILED_MS);
    }
  }

  askAgain(delay) {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.ask(), delay);
  }

  came(id, known) {
    if (this.view.scene()?.id !== id) return;
    const before = this.known;
    this.known = known;
    if (before?.state === 'running' && known?.state === 'failed') complain(known.error, 'accuracy');
    this.show(before?.since_ms !== known?.since_ms);
    clearTimeout(this.timer);
    if (known?.state === 'running') this.askAgain(POLL_MS);
  }

  start() {
    quiet('accuracy');
    return this.change('POST', '/accuracy', { quick: $('accuracy-extent').value === 'quick' });
  }

  async change(method, place, body) {
    const { id } = this.view.scene() ?? {};
    if (!id) return;
    try {
      const sent = body ? { headers: { 'Content-Type': 'application/json' }, body: JSON.stringify(body) } : {};
      this.came(id, await (await reach(sceneUrl(id, place), { method, ...sent })).json());
    } catch (problem) {
      complain(problem, 'accuracy');
    }
  }

  // isNew: the results are others than before.
  show(isNew = true) {
    const { known } = this, isRunning = known?.state === 'running', progress = $('accuracy-progress');
    $('accuracy-start').disabled = !this.view.scene() || isRunning;
    $('accuracy-start').textContent = known?.results ? 'Measure again' : 'Measure this scene';
    $('accuracy-cancel').hidden = progress.hidden = !isRunning;
    if (isRunning && known.progress.total > 0) progress.value = known.progress.done / known.progress.total;
    else progress.removeAttribute('value');
    $('accuracy-said').textContent = inWords(known);
    $('accuracy-summary').textContent = known?.results ? summary(known.results) : '';
    $('accuracy-results').hidden = !known?.results;
    if (isNew) this.list();
    this.plot();
  }

  // Fills the lists with what was measured.
  list() {
    const scopes = this.known?.results?.scopes ?? [], scope = scopes[0], chosen = $('wipe-with').value;
    $('accuracy-scope').replaceChildren(...scopes.map(({ name }) => option(name, name)));
    const rows = (scope?.entries ?? []).filter(isPlotted).sort((a, b) => a.gpu_ms.median - b.gpu_ms.median).map(row => row.row);
    const words = row => row === scope.default ? `${row} (default)` : row;
    $('accuracy-row').replaceChildren(option('', 'choose a point …'), ...rows.map(row => option(row, words(row))));
    // Both sides of a comparison have the same size.
    const whole = rows.filter(row => scope.entries.find(found => found.row === row).scale === 1);
    $('wipe-with').replaceChildren(option(REFERENCE, 'the reference'), option(DEFAULTS, 'the defaults'), ...whole.map(row => option(row, row)));
    $('wipe-with').value = chosen;
    if (!$('wipe-with').value) $('wipe-with').value = REFERENCE;
    if (!rows.includes(this.chosen)) this.chosen = null;
  }

  get scope() {
    const scopes = this.known?.results?.scopes ?? [];
    return scopes.find(scope => scope.name === $('accuracy-scope').value) ?? scopes[0];
  }

  plot() {
    const { scope, known } = this;
    if (!scope) return;
    const families = familiesOf(known.results), measure = $('accuracy-measure').value, here = this.here(scope);
    // The mark that has the focus keeps it.
    const focused = $('curve').contains(document.activeElement) ? document.activeElement.dataset.row : null;
    const svg = curve({ scope, families, measure, chosen: this.chosen, here, box: BOX, choose: row => this.choose(row) });
    $('curve').replaceChildren(svg);
    if (focused != null) svg.querySelector(`[data-row="${CSS.escape(focused)}"]`)?.focus();
    $('curve-legend').replaceChildren(...legend(families, Boolean(scope.default)));
    $('accuracy-row').value = this.chosen ?? '';
    $('accuracy-row-said').textContent = this.figures(scope);
    $('accuracy-here').textContent = here ? hereInWords(here, scope, known.results.identity, this.receipt) : '';
  }

  // The place of the view's own frame: its GPU time, and the row that is drawn likewise.
  here(scope) {
    const { receipt } = this, ns = receipt?.gpu_ns;
    if (ns == null) return null;
    const rows = scope.entries.filter(row => isPlotted(row) && row.scale === this.view.scale()), used = settings.trading().filter(({ name }) => receipt.settings[name] !== undefined);
    // A row that leaves a setting to the scene is drawn like a view that does.
    const fits = row => used.every(({ name, usual, isUsual }) => {
      const own = row.settings[name] ?? usual;
      return own == null ? isUsual : String(own) === String(receipt.settings[name]);
    });
    // Settings that had no effect on the frame are not in its receipt: of several rows, the one that says the least.
    const [row] = rows.filter(fits).sort((a, b) => Object.keys(a.settings).length - Object.keys(b.settings).length);
    return { ms: ns / 1e6 / Math.max(1, receipt.views), row: row?.row ?? null };
  }

  figures(scope) {
    const row = this.chosen && scope.entries.find(found => found.row === this.chosen);
    if (!row) return 'Click a point to draw the view with its settings.';
    const parts = Object.values(MEASURES).map(({ name, value, digits: count }) => `${name.split(/[ ,]/)[0] === 'mean' ? 'FLIP' : name.split(/[ ,]/)[0]} ${digits(value(row), count)}`);
    return `${row.row}: ${short(row.gpu_ms?.median)} ms, ${parts.join(', ')}, ${row.coverage.holes} hole pixels, ${row.coverage.leaks} leak pixels.${row.scale < 1 ? ` Drawn at ${100 * row.scale} % of the width and height, and enlarged.` : ''}`;
  }

  // Draws the view with the settings and in the size of a point.
  choose(name) {
    const row = this.scope?.entries.find(found => found.row === name);
    this.chosen = row ? name : null;
    this.resize(row?.scale ?? 1);
    if (row) settings.trade(row.settings);
    this.plot();
  }

  resize(scale) {
    if (scale !== this.view.scale()) this.view.setScale(scale);
  }

  async compare() {
    const scene = this.view.scene(), wanted = $('wipe-with').value;
    if (!scene) return;
    // On a phone the picture is larger without the sheet.
    closeSheet();
    await rendered();
    const { own, others } = settings.parted(this.view.request());
    const { w, h, ...pose } = others, row = this.scope?.entries.find(found => found.row === wanted);
    const trading = new Set(settings.trading().map(({ name }) => name));
    const kept = Object.fromEntries(Object.entries(own).filter(([name]) => !trading.has(name)));
    const b = wanted === REFERENCE ? { against: 'reference' } : { b: { ...kept, ...row?.settings } };
    const body = { ...pose, ...fitting([w, h], this.view.limits()), a: own, ...b };
    const names = ['this view', wanted === REFERENCE ? 'the reference' : wanted === DEFAULTS ? 'the defaults' : wanted];
    quiet('accuracy');
    $('wipe-start').disabled = true;
    $('wipe-said').textContent = 'Drawing both …';
    try {
      const options = { method: 'POST', headers: { 'Content-Type': 'application/json' }, body: JSON.stringify(body) };
      const found = await (await reach(sceneUrl(scene.id, '/compare'), options)).json();
      if (this.view.scene()?.id === scene.id) this.wipe.open(found, names);
    } catch (problem) {
      complain(problem, 'accuracy');
    } finally {
      $('wipe-start').disabled = false;
      $('wipe-said').textContent = '';
    }
  }
}

// Waits until a change of the layout has reached the picture.
const rendered = () => new Promise(resolve => requestAnimationFrame(() => requestAnimationFrame(resolve)));

// A size of this shape that can be compared with a reference, which has 4 × 4 times the pixels.
function fitting([w, h], limits) {
  const most = Math.min(limits.max_compare_pixels, limits.max_pixels / 16), side = limits.max_side / 4;
  const shrink = Math.min(1, Math.sqrt(most / (w * h)), side / Math.max(w, h));
  const [width, height] = [w, h].map(full => Math.max(1, Math.floor(full * shrink)));
  return { w: width, h: height };
}

function inWords(known) {
  if (!known || known.state === 'not_measured') return 'Not measured yet. A measurement draws this scene with the settings that trade accuracy for time; other frames come first.';
  const { state, progress, error, stale, results } = known;
  if (state === 'running') return progress.total > 0 ? `Step ${progress.done} of ${progress.total}: ${progress.what}` : progress.what || 'Beginning …';
  const ended = state === 'failed' ? `The measurement failed: ${error.detail}. ` : state === 'cancelled' ? 'The measurement was cancelled. ' : '';
  return results && stale ? `${ended}The scene, the adapter or the program has changed since the measurement.` : ended;
}

const summary = ({ identity, date, summary: words }) => `${words} Measured at ${identity.width} × ${identity.height} on ${identity.adapter}, ${date} UTC.`;

function hereInWords({ ms, row }, scope, identity, { camera }) {
  const found = row && scope.entries.find(other => other.row === row);
  const likewise = found ? `, drawn as ${row}, which took ${short(found.gpu_ms.median)} ms at ${identity.width} × ${identity.height}` : ', drawn as no point here';
  return `Line: this view, ${short(ms)} ms at ${camera.width} × ${camera.height}${likewise}.`;
}
