// The controls around a 3D scene: keys, named views, full screen, labels, the corner mark.
import { createLabels } from './labels.js';
import { $, all, unpack } from './page.js';
import { createScene } from './scene.js';

// The picture made with the page becomes a turnable scene; null where there is nothing to turn or no WebGL.
export async function turnable(extra, model, { onPick, step, label }) {
  const host = $('scene');
  if (!host || !extra.view) return null;
  const unpacked = async (mesh) => {
    const faces = await unpack(mesh.faces);
    return { ...mesh, vertices: new Uint16Array(await unpack(mesh.vertices)), faces: mesh.wide ? new Uint32Array(faces) : new Uint16Array(faces) };
  };
  const each = (list) => Promise.all((list ?? []).map(async (part) => ({ ...part, mesh: await unpacked(part.mesh ?? part.points) })));
  const mesh = extra.mesh && await unpacked(extra.mesh);
  const [bodies, dots, parts] = await Promise.all([each(extra.bodies), each(extra.dots), each(extra.tool?.parts)]);
  if (!document.createElement('canvas').getContext('webgl2')) return null; // the picture made with the page stays in place
  let view3d;
  const place = createLabels($('labels'), $('leaders'), extra.labels);
  const onDraw = (project) => {
    if (!view3d) return;
    place((p) => project(view3d.vector(p)), host.clientWidth, host.clientHeight);
    view3d.axes().forEach(([x, y], i) => {
      const arm = $('gizmo').children[i];
      arm.firstElementChild.setAttribute('x2', 28 + x * 16);
      arm.firstElementChild.setAttribute('y2', 28 + y * 16);
      arm.lastElementChild.setAttribute('x', 28 + x * 23);
      arm.lastElementChild.setAttribute('y', 32 + y * 23);
      arm.style.opacity = Math.hypot(x, y) < 0.4 ? 0 : 1; // an axis that points at the viewer has no direction
    });
  };
  view3d = createScene(host, { ...model, mesh, bodies, dots, tool: extra.tool && { ...extra.tool, parts }, view: extra.view }, { onPick, onDraw });
  host.classList.add('live');
  const { canvas } = view3d;
  canvas.tabIndex = 0;
  canvas.setAttribute('role', 'application');
  canvas.setAttribute('aria-label', label);
  canvas.addEventListener('focus', () => view3d.focus(true));
  canvas.addEventListener('blur', () => view3d.focus(false));
  const keys = {
    ArrowLeft: () => view3d.turn(0.12, 0), ArrowRight: () => view3d.turn(-0.12, 0), ArrowUp: () => view3d.turn(0, -0.1), ArrowDown: () => view3d.turn(0, 0.1),
    '+': () => view3d.turn(0, 0, 0.9), '=': () => view3d.turn(0, 0, 0.9), '-': () => view3d.turn(0, 0, 1.1), 0: () => view3d.view('front'),
    ',': () => step(-1), '.': () => step(1),
  };
  canvas.addEventListener('keydown', (event) => { if (keys[event.key]) { keys[event.key](); event.preventDefault(); } });
  for (const button of all('[data-view]')) button.addEventListener('click', () => view3d.view(button.dataset.view));

  const stage = $('stage'), larger = $('larger');
  const enlarged = (on) => { stage.classList.toggle('large', on); view3d.enlarge(on); larger.textContent = on ? 'Smaller' : 'Larger'; larger.setAttribute('aria-pressed', String(on)); };
  larger.addEventListener('click', () => {
    const on = !stage.classList.contains('large');
    enlarged(on);
    if (on) stage.requestFullscreen?.().catch(() => {}); // without it the scene still fills the window
    else if (document.fullscreenElement) document.exitFullscreen();
  });
  document.addEventListener('fullscreenchange', () => { if (!document.fullscreenElement) enlarged(false); });
  addEventListener('keydown', (event) => { if (event.key === 'Escape') enlarged(false); });
  return view3d;
}
