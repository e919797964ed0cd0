// The page of several runs: one cursor through charts over arc length and over the share of the path, and the 3D scene.
import { $, all, css, dark, minus, mm, nearest, painters } from './page.js';
import { turnable } from './space.js';

const { runs } = JSON.parse($('tubeplan-compare').textContent);
const extra = JSON.parse($('tubeplan-scene').textContent);
const paths = runs.map((run) => (run.path?.s_mm?.length > 1 ? run.path : null));
const lengths = paths.map((path) => (path ? path.s_mm.at(-1) : 0));
const longest = Math.max(...lengths, 1e-9);

// --- cursor: a place is a distance in mm, the same for all runs, or a share, which is another distance in each --------
const views = []; // functions of (mode, value)
let mode = 'share', value = 0, queued = 0;
const placeOf = (k) => (mode === 'share' ? value * lengths[k] : value); // mm along run k
const reached = (k) => paths[k] && placeOf(k) <= lengths[k] + 1e-9;
function setCursor(kind, at) {
  mode = kind;
  value = Math.max(0, Math.min(kind === 'share' ? 1 : longest, at));
  queued ||= requestAnimationFrame(() => { queued = 0; for (const view of views) view(); });
}

for (const svg of all('svg[data-chart]')) {
  const cursor = svg.querySelector('.cursor');
  const { axis, left, right, low, high, y0, y1 } = svg.dataset;
  const width = svg.viewBox.baseVal.width - left - right;
  const quantity = svg.dataset.chart === 'clearance' ? 'clearance_mm' : 'curvature_per_mm';
  const line = cursor.querySelector('line');
  const dots = runs.map((_, k) => cursor.querySelector(`circle[data-run="${k}"]`));
  views.push(() => {
    const x = (u) => +left + u * width;
    line.style.display = axis === mode ? '' : 'none'; // in the other charts the runs stand at different places
    if (axis === mode) { const at = x(mode === 'share' ? value : value / longest); line.setAttribute('x1', at); line.setAttribute('x2', at); }
    dots.forEach((dot, k) => {
      if (!dot) return;
      dot.style.display = reached(k) ? '' : 'none';
      if (!reached(k)) return;
      const s = placeOf(k);
      const v = paths[k][quantity][nearest(paths[k].s_mm, s)];
      dot.setAttribute('cx', x(axis === 'share' ? s / lengths[k] : s / longest).toFixed(1));
      dot.setAttribute('cy', (+y0 + ((Math.max(low, Math.min(v, +high)) - low) / (high - low)) * (y1 - y0)).toFixed(1));
    });
  });
}
for (const area of all('[data-follow]')) {
  const move = (event) => {
    const drawing = [...area.querySelectorAll('svg[data-chart]')].find((node) => node.getBoundingClientRect().width);
    if (!drawing) return;
    const box = drawing.getBoundingClientRect();
    const scale = box.width / drawing.viewBox.baseVal.width;
    const u = (event.clientX - box.left - drawing.dataset.left * scale) / (box.width - (+drawing.dataset.left + +drawing.dataset.right) * scale);
    const share = Math.max(0, Math.min(1, u));
    setCursor(drawing.dataset.axis, drawing.dataset.axis === 'share' ? share : share * longest);
  };
  area.addEventListener('pointermove', (event) => { if (event.pointerType === 'mouse' || event.buttons) move(event); });
  area.addEventListener('pointerdown', move);
}

const slider = $('place');
if (slider) {
  slider.addEventListener('input', () => setCursor('share', slider.value / 1000));
  views.push(() => {
    if (mode === 'share') slider.value = Math.round(value * 1000);
    const where = mode === 'share' ? `${(100 * value).toFixed(1)}\u00a0% of each path` : `${mm(value)} along each path`;
    $('at').textContent = where;
    slider.setAttribute('aria-valuetext', where);
    runs.forEach((_, k) => {
      const cells = [...document.querySelectorAll(`[data-at="${k}"] td`)];
      if (!reached(k)) { cells.forEach((cell) => { cell.textContent = '–'; }); return; }
      const i = nearest(paths[k].s_mm, placeOf(k)), c = paths[k].curvature_per_mm[i];
      [mm(placeOf(k)), paths[k].clearance_mm ? mm(paths[k].clearance_mm[i], 2) : '–', c < 0.005 ? 'straight' : mm(1 / c), `${minus(c.toFixed(3))}`].forEach((text, n) => { cells[n].textContent = text; });
    });
  });
}

async function space() {
  const drawn = paths.map((path, k) => k).filter((k) => paths[k]);
  const view3d = await turnable(extra, {
    points: [], before: [], stretches: [], features: [], others: drawn.map((k) => paths[k].points_mm), clearance: extra.clearance,
  }, {
    onPick: (i, of) => setCursor('share', paths[drawn[of]].s_mm[i] / lengths[drawn[of]]),
    step: (way) => setCursor(mode, value + way * (mode === 'share' ? 0.01 : 1)),
    label: '3D scene: wall of the lumen and the paths of all runs. Arrow keys turn, plus and minus zoom, comma and full stop step along the paths, 0 resets.',
  });
  if (!view3d) return;
  const paint = () => view3d.paint({ dark: dark(), wall: css('--wall'), runs: drawn.map((k) => css(`--run-${k + 1}`)), feature: css('--feature'),
    before: css('--before'), cursor: css('--ink'), surface: css('--surface') });
  painters.push(paint);
  paint();
  views.push(() => drawn.forEach((k, n) => view3d.setMark(n, nearest(paths[k].s_mm, Math.min(placeOf(k), lengths[k])))));
  for (const check of all('[data-run-shown]')) check.addEventListener('change', () => view3d.showOther(drawn.indexOf(+check.dataset.runShown), check.checked));
}

space().then(() => { setCursor('share', extra.start); globalThis.tubeplanReady = true; });
