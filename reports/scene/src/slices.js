// CT pictures drawn from the reduced volume: three orthogonal planes, the plane across the path, and the path
// straightened. Patient axes LPS: x to the left, y to the back, z up.
export const FIELD = 44; // mm shown along each side of a tile

export function createVolume(ct) {
  const [nx, ny, nz] = ct.shape;
  const { levels, low, step: h } = ct;
  const sx = ny * nz;
  return (x, y, z) => { // trilinear, in stored grey levels; -1 where the CT was not kept
    const a = (x - low[0]) / h, b = (y - low[1]) / h, c = (z - low[2]) / h;
    const i = Math.floor(a), j = Math.floor(b), k = Math.floor(c);
    if (i < 0 || j < 0 || k < 0 || i >= nx - 1 || j >= ny - 1 || k >= nz - 1) return -1;
    const u = a - i, v = b - j, w = c - k, o = i * sx + j * nz + k;
    if (!levels[o] || !levels[o + sx + nz + 1]) return -1;
    const at = (p) => levels[p] * (1 - w) + levels[p + 1] * w;
    return (at(o) * (1 - v) + at(o + nz) * v) * (1 - u) + (at(o + sx) * (1 - v) + at(o + sx + nz) * v) * u;
  };
}

export function greyTable(ct, [centre, width]) {
  const low = centre - width / 2;
  return (level) => (level < 0 ? 0 : Math.max(0, Math.min(255, ((ct.hu0 + ct.hu_step * level - low) / width) * 255)));
}

function fill(canvas, w, h, valueAt) {
  const small = document.createElement('canvas');
  small.width = w;
  small.height = h;
  const context = small.getContext('2d');
  const image = context.createImageData(w, h);
  for (let r = 0, o = 0; r < h; r++) for (let c = 0; c < w; c++, o += 4) {
    const g = valueAt(c, r);
    image.data[o] = image.data[o + 1] = image.data[o + 2] = g;
    image.data[o + 3] = 255;
  }
  context.putImageData(image, 0, 0);
  const out = canvas.getContext('2d');
  out.imageSmoothingQuality = 'high';
  out.setTransform(1, 0, 0, 1, 0, 0);
  out.drawImage(small, 0, 0, canvas.width, canvas.height);
  return out;
}

// plane: origin and two unit directions (right, down)
export function drawTile(canvas, sample, grey, plane, overlay) {
  const css = canvas.clientWidth || 240;
  const dpr = Math.min(devicePixelRatio || 1, 2);
  canvas.width = canvas.height = Math.round(css * dpr);
  const n = 150;
  const { origin: o, right: a, down: b } = plane;
  const mm = (i) => ((i + 0.5) / n - 0.5) * FIELD;
  const out = fill(canvas, n, n, (c, r) => {
    const u = mm(c), v = mm(r);
    return grey(sample(o[0] + a[0] * u + b[0] * v, o[1] + a[1] * u + b[1] * v, o[2] + a[2] * u + b[2] * v));
  });
  if (!overlay.on) return;
  const k = canvas.width / FIELD;
  out.setTransform(k, 0, 0, k, canvas.width / 2, canvas.height / 2);
  const flat = (p) => [0, 1, 2].reduce((s, i) => [s[0] + (p[i] - o[i]) * a[i], s[1] + (p[i] - o[i]) * b[i]], [0, 0]);
  const hair = dpr / k;
  const stroke = (colour, width, draw) => { out.lineWidth = width * hair; out.strokeStyle = colour; out.beginPath(); draw(); out.stroke(); };
  if (overlay.path) stroke(overlay.colours.path, 1.75, () => overlay.path.forEach((p, i) => out[i ? 'lineTo' : 'moveTo'](...flat(p))));
  if (overlay.rim) stroke(overlay.colours.rim, 1.25, () => { overlay.rim.forEach((p, i) => out[i ? 'lineTo' : 'moveTo'](...p)); out.closePath(); });
  if (overlay.radius) stroke(overlay.bad ? overlay.colours.bad : overlay.colours.path, 1.5, () => out.arc(0, 0, overlay.radius, 0, 7));
  const gap = Math.max(5, (overlay.radius || 0) + 2);
  stroke(overlay.colours.hair, 1, () => { for (const [p, q] of [[-FIELD / 2, -gap], [gap, FIELD / 2]]) { out.moveTo(p, 0); out.lineTo(q, 0); out.moveTo(0, p); out.lineTo(0, q); } });
}

// One column per place on the path, rows from +half to -half along `way`.
export function drawReformation(canvas, sample, grey, points, way, half) {
  const dpr = 2;
  const { clientWidth, clientHeight } = canvas.parentElement; // the canvas itself is hidden until it is drawn
  canvas.width = Math.max(2, Math.round(clientWidth * dpr));
  canvas.height = Math.max(2, Math.round(clientHeight * dpr));
  const n = points.length;
  const w = Math.min(n, 500), h = 90;
  fill(canvas, w, h, (c, r) => {
    const i = Math.round((c / (w - 1)) * (n - 1)), d = (0.5 - (r + 0.5) / h) * 2 * half;
    const p = points[i], v = way[i];
    return grey(sample(p[0] + v[0] * d, p[1] + v[1] * d, p[2] + v[2] * d));
  });
}
