// What the scripts of all pages share: units, theme, unpacking, and folds that open for print.

export const $ = (id) => document.getElementById(id);
export const all = (query) => [...document.querySelectorAll(query)];
export const minus = (text) => text.replace('-', '−');
export const mm = (v, n = 1) => `${minus(v.toFixed(n))}\u00a0mm`;
export const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

export async function unpack(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream('gzip'))).arrayBuffer();
}

export function nearest(arc, s) { // the sample nearest to an arc length
  let low = 0, high = arc.length - 1;
  while (low < high) { const mid = (low + high) >> 1; if (arc[mid] < s) low = mid + 1; else high = mid; }
  return low && s - arc[low - 1] < arc[low] - s ? low - 1 : low;
}

export const painters = []; // functions called after the theme changes
export const dark = () => { const t = document.documentElement.dataset.theme; return t ? t === 'dark' : matchMedia('(prefers-color-scheme: dark)').matches; };
const repaint = () => { for (const paint of painters) paint(); };
for (const radio of all('input[name=theme]')) radio.addEventListener('change', () => {
  if (radio.value === 'auto') delete document.documentElement.dataset.theme; else document.documentElement.dataset.theme = radio.value;
  repaint();
});
matchMedia('(prefers-color-scheme: dark)').addEventListener('change', repaint);

addEventListener('beforeprint', () => { for (const fold of all('details')) { fold.dataset.was = fold.open; fold.open = true; } });
addEventListener('afterprint', () => { for (const fold of all('details')) fold.open = fold.dataset.was === 'true'; });
