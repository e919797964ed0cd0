// Pages with a 3D scene: the report of a path and the comparison of runs. What is drawn without scripts is painted
// first; unpacking and the scene follow, so that the verdict never waits for them.
import './page.js';

document.documentElement.classList.add('script', 'cursors');
const start = () => (document.getElementById('tubeplan-compare') ? import('./compare.js') : import('./app.js'));
requestAnimationFrame(() => setTimeout(start));
