// Pages with a 3D scene: the report of a path and the comparison of runs. What is drawn without scripts is painted
// first; unpacking and the scene follow, so that the verdict never waits for them.
import './page.js';

document.documentElement.classList.add('script', 'cursors');
function start() {
  performance.mark('tubeplan-start');
  return document.getElementById('tubeplan-compare') ? import('./compare.js') : import('./app.js');
}
// A new frame is not yet a painted one: the scene's first shaders would hold up the picture that is on its way to the screen.
if (globalThis.PerformanceObserver?.supportedEntryTypes.includes('paint')) {
  const observer = new PerformanceObserver(() => { observer.disconnect(); start(); });
  observer.observe({ type: 'paint', buffered: true });
} else requestAnimationFrame(() => setTimeout(start));
