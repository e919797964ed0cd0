// Ties the parts of the report to one cursor: an index into the planned path. The page is complete without this
// script; it adds the cursor, the turnable scene and the CT at any place.
import { createVolume, greyTable, drawTile, drawReformation } from './slices.js';
import { $, all, css, dark, minus, mm, nearest, painters, unpack } from './page.js';
import { turnable } from './space.js';

const signed = (v, n) => (v >= 0 ? '+' : '') + minus(v.toFixed(n));

const result = JSON.parse($('tubeplan-result').textContent);
const extra = JSON.parse($('tubeplan-scene').textContent);
const points = result.path?.points_mm ?? [];
const arc = result.path?.s_mm ?? [];
const clearance = result.path?.clearance_mm ?? null;
const curvature = result.path?.curvature_per_mm ?? [];
const asked = result.limits?.clearance_min_mm ?? null;
const allowed = result.limits?.curvature_max_per_mm ?? null;
const count = points.length;
const length = arc[count - 1] ?? 0;
const partAt = (s) => extra.parts.find((p) => s >= p.from && s <= p.to)?.name ?? '';
const indexAt = (s) => nearest(arc, s);

// --- cursor ------------------------------------------------------------------------------
const views = []; // functions of (index)
let now = extra.start;
let queued = 0;
function setCursor(i) {
  now = Math.max(0, Math.min(count - 1, i));
  queued ||= requestAnimationFrame(() => { queued = 0; for (const view of views) view(now); });
}

// --- charts: drawn by the server, the cursor moves here -------------------------------------
for (const svg of all('svg[data-chart]')) {
  const cursor = svg.querySelector('.cursor');
  if (!cursor) continue;
  const { chart, left, right, low, high, y0, y1 } = svg.dataset;
  const width = svg.viewBox.baseVal.width;
  const dot = cursor.querySelector('circle');
  const values = chart === 'clearance' ? clearance : curvature;
  views.push((i) => {
    const x = +left + (arc[i] / length) * (width - left - right);
    cursor.setAttribute('transform', `translate(${x.toFixed(1)} 0)`);
    dot?.setAttribute('cy', (+y0 + ((Math.min(values[i], +high) - low) / (high - low)) * (y1 - y0)).toFixed(1));
  });
}
for (const area of all('[data-follow]')) { // hover or drag on any picture that has the path along x
  const move = (event) => {
    const drawing = [...area.querySelectorAll('svg[data-chart], #cpr-box')].find((node) => node.getBoundingClientRect().width);
    if (!drawing || !count) return;
    const box = drawing.getBoundingClientRect();
    const scale = drawing.dataset.left === undefined ? 0 : box.width / drawing.viewBox.baseVal.width;
    const u = (event.clientX - box.left - (drawing.dataset.left ?? 0) * scale) / (box.width - (+(drawing.dataset.left ?? 0) + +(drawing.dataset.right ?? 0)) * scale);
    setCursor(indexAt(Math.max(0, Math.min(1, u)) * length));
  };
  area.addEventListener('pointermove', (e) => { if (e.pointerType === 'mouse' || e.buttons) move(e); });
  area.addEventListener('pointerdown', move);
}

// --- readout and controls ------------------------------------------------------------------
const slider = $('place');
if (slider) {
  slider.max = count - 1;
  slider.addEventListener('input', () => setCursor(+slider.value));
  views.push((i) => {
    const s = arc[i], c = curvature[i], r = clearance?.[i];
    const bend = c < 0.005 ? 'straight' : mm(1 / c);
    slider.value = i;
    slider.setAttribute('aria-valuetext', `${mm(s)}, ${partAt(s)}${r === undefined ? '' : ` clearance ${mm(r, 2)},`}${$('at-curvature') ? ` bend radius ${c < 0.005 ? 'over 200 mm' : bend}` : ''}`);
    $('at').textContent = mm(s);
    $('at-part').textContent = partAt(s) || `of ${mm(length)}`;
    if ($('at-curvature')) { // a path of straight pieces has no bend radius
      $('at-curvature').textContent = bend;
      $('at-bend').textContent = `${c.toFixed(3)} 1/mm`;
      $('at-curvature').parentElement.dataset.state = allowed !== null && c > allowed ? 'curvature' : '';
    }
    if (r === undefined) return;
    $('at-clearance').textContent = mm(r, 2);
    $('at-margin').textContent = asked === null ? '' : `${signed(r - asked, 2)}\u00a0mm to limit`;
    $('at-clearance').parentElement.dataset.state = asked !== null && r < asked ? 'clearance' : '';
  });
}
for (const button of all('[data-go]')) button.addEventListener('click', () => {
  setCursor(indexAt(+button.dataset.go));
  if (button.dataset.scroll !== undefined) $('path').scrollIntoView({ behavior: matchMedia('(prefers-reduced-motion: reduce)').matches ? 'auto' : 'smooth' });
});

// --- pictures of the CT and the straightened lumen --------------------------------------------
async function pictures() {
  if (!extra.rims) return;
  const { places, directions: k, step, normal } = extra.rims;
  const rim = k ? new Uint16Array(await unpack(extra.rims.values)) : null;
  const rimAt = (place, angle) => { const u = ((angle / (2 * Math.PI)) * k % k + k) % k; const a = Math.floor(u), f = u - a; return (rim[place * k + a % k] * (1 - f) + rim[place * k + (a + 1) % k] * f) * step; };
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (v) => { const n = Math.hypot(...v) || 1; return v.map((x) => x / n); };
  const binormal = places.map((i, j) => {
    const a = points[Math.max(0, i - 1)], b = points[Math.min(count - 1, i + 1)];
    return cross(unit([0, 1, 2].map((d) => b[d] - a[d])), normal[j]);
  });
  const placeOf = (i) => Math.round((i / (count - 1)) * (places.length - 1));
  const box = $('cpr-box');
  if (box) {
    const bar = $('cpr-cursor');
    views.push((i) => { bar.style.left = `${((arc[i] / length) * 100).toFixed(2)}%`; });
  }

  const volume = extra.ct && { ...extra.ct, levels: new Uint8Array(await unpack(extra.ct.levels)) };
  const sample = volume && createVolume(volume);
  let grey = volume && greyTable(volume, Object.values(extra.windows)[0]);
  let on = true;
  const colours = { path: '#7cc4f5', rim: 'rgba(255,255,255,.85)', bad: '#ffb02e', hair: 'rgba(255,255,255,.4)' };
  function tiles(i) {
    const j = placeOf(i);
    const origin = points[i];
    const near = points.slice(Math.max(0, i - 80), i + 81);
    const shared = { on, colours, radius: asked, bad: clearance !== null && asked !== null && clearance[i] < asked };
    const polygon = rim && Array.from({ length: k }, (_, d) => { const r = rim[j * k + d] * step, a = (2 * Math.PI * d) / k; return [r * Math.cos(a), -r * Math.sin(a)]; });
    drawTile($('across'), sample, grey, { origin, right: normal[j], down: binormal[j].map((v) => -v) }, { ...shared, rim: polygon });
    drawTile($('axial'), sample, grey, { origin, right: [1, 0, 0], down: [0, 1, 0] }, { ...shared, path: near });
    drawTile($('coronal'), sample, grey, { origin, right: [1, 0, 0], down: [0, 0, -1] }, { ...shared, path: near });
    drawTile($('sagittal'), sample, grey, { origin, right: [0, 1, 0], down: [0, 0, -1] }, { ...shared, path: near });
    $('cap-across').textContent = mm(arc[i]);
    $('cap-axial').textContent = `z ${mm(origin[2])}`;
    $('cap-coronal').textContent = `y ${mm(origin[1])}`;
    $('cap-sagittal').textContent = `x ${mm(origin[0])}`;
  }
  const way = (angle) => places.map((_, j) => normal[j].map((x, d) => Math.cos(angle) * x + Math.sin(angle) * binormal[j][d]));
  function reformation() {
    const angle = (+$('turn').value * Math.PI) / 180;
    const half = +box.dataset.half;
    if (volume && $('cpr')) {
      drawReformation($('cpr'), sample, grey, places.map((i) => points[i]), way(angle), half);
      $('cpr').classList.add('drawn');
    }
    if (!rim) return;
    const [one, other] = $('cpr-lines').querySelectorAll('.wall-line');
    const clip = (v) => Math.max(-1.2 * half, Math.min(1.2 * half, v));
    const trace = (at) => 'M' + places.map((i, j) => `${arc[i].toFixed(2)} ${(half - clip(at(j))).toFixed(3)}`).join('L');
    one.setAttribute('d', trace((j) => rimAt(j, angle)));
    other.setAttribute('d', trace((j) => -rimAt(j, angle + Math.PI)));
  }
  if (box) {
    $('turn').addEventListener('input', () => { $('turn-value').textContent = `${$('turn').value}°`; reformation(); });
    new ResizeObserver(() => reformation()).observe(box);
  }
  if (!volume) return;
  views.push(tiles);
  for (const radio of all('input[name=window]')) radio.addEventListener('change', () => { grey = greyTable(volume, extra.windows[radio.value]); tiles(now); if (box) reformation(); });
  $('overlay').addEventListener('change', () => { on = $('overlay').checked; if (box) $('cpr-lines').style.display = on ? '' : 'none'; tiles(now); });
  new ResizeObserver(() => tiles(now)).observe($('across').parentElement);
}

// --- the view from the tip --------------------------------------------------------------------
if (extra.film && $('tip')) {
  let shown = -1;
  views.push((i) => {
    const k = nearest(extra.film.s, arc[i]);
    $('cap-tip').textContent = mm(extra.film.s[k]);
    if (k !== shown) $('tip').src = `data:image/jpeg;base64,${extra.film.pictures[k]}`;
    shown = k;
  });
}

// --- 3D ------------------------------------------------------------------------------------------
async function space() {
  const view3d = await turnable(extra, {
    points, before: extra.before, stretches: extra.stretches, features: extra.features, clearance: asked,
  }, {
    onPick: setCursor,
    step: (way) => setCursor(now + 4 * way),
    label: `3D scene: ${extra.words}. Arrow keys turn, plus and minus zoom, comma and full stop step along the path, 0 resets.`,
  });
  if (!view3d) return;
  const rgb = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16));
  const paint = () => {
    const tight = rgb(css('--tight')), roomy = rgb(css('--roomy'));
    const share = (i) => (extra.ramp && clearance ? Math.max(0, Math.min(1, (clearance[i] - extra.ramp[0]) / (extra.ramp[1] - extra.ramp[0]))) : 0.5);
    const mix = (u) => { const t = share(Math.round(u * (count - 1))); return `rgb(${tight.map((v, i) => Math.round(v + (roomy[i] - v) * t)).join(',')})`; };
    view3d.paint({ dark: dark(), named: (colour) => (colour.startsWith('--') ? css(colour) : colour), wall: css(extra.body), solid: extra.body !== '--wall', clearance: mix, flagClearance: css('--clearance'), flagCurvature: css('--curvature'),
      feature: css('--feature'), before: css('--before'), cursor: css('--ink'), surface: css('--surface') });
  };
  painters.push(paint);
  paint();
  views.push((i) => view3d.setCursor(i));
  globalThis.tubeplanCursor = () => view3d.cursorOnScreen();
  for (const check of all('[data-show]')) { check.addEventListener('change', () => view3d.show(check.dataset.show, check.checked)); view3d.show(check.dataset.show, check.checked); }
}

// --- start ----------------------------------------------------------------------------------------
Promise.all([space(), pictures()]).then(() => { if (count > 1) setCursor(now); globalThis.tubeplanReady = true; });
