// The 3D scene: translucent wall, path coloured by clearance, flagged parts, feature points, cursor.
import {
  BackSide, BoxGeometry, BufferAttribute, BufferGeometry, CatmullRomCurve3, Color, ConeGeometry, DoubleSide, FrontSide, Group,
  InstancedMesh, Matrix4, Mesh, MeshBasicMaterial, MeshLambertMaterial, HemisphereLight, DirectionalLight, OctahedronGeometry,
  PerspectiveCamera, Quaternion, Scene, ShaderMaterial, SphereGeometry, TorusGeometry, TubeGeometry, Vector3, WebGLRenderer,
} from 'three';
import { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';

const SHAPES = { // of unit size; scaled to the model
  start: () => new BoxGeometry(1.5, 1.5, 1.5), goal: () => new BoxGeometry(1.5, 1.5, 1.5),
  extremum: () => new SphereGeometry(0.8, 16, 12), segment: () => new OctahedronGeometry(1.05),
  inflection: () => new ConeGeometry(0.85, 1.6, 4), node: () => new SphereGeometry(0.6, 12, 8),
  clearance: () => new TorusGeometry(1.05, 0.28, 8, 24),
};
const PRECEDENCE = ['start', 'goal', 'clearance', 'extremum', 'segment', 'inflection', 'node'];

// A wall that is clear where it faces the viewer and dense along its outline, like an X-ray of glass.
const wallMaterial = (side) => new ShaderMaterial({
  transparent: true, depthWrite: false, side,
  uniforms: { colour: { value: new Color() }, face: { value: 0.1 }, rim: { value: 0.6 } },
  vertexShader: `varying vec3 n; varying vec3 e;
    void main() { vec4 p = modelViewMatrix * vec4(position, 1.0); n = normalMatrix * normal; e = -p.xyz; gl_Position = projectionMatrix * p; }`,
  fragmentShader: `uniform vec3 colour; uniform float face; uniform float rim; varying vec3 n; varying vec3 e;
    void main() { float f = 1.0 - abs(dot(normalize(n), normalize(e)));
      gl_FragColor = vec4(colour, face + rim * f * f * f);
      #include <colorspace_fragment>
    }`,
});

const placesOf = ({ low, high, vertices }) => Float32Array.from(vertices, (q, i) => low[i % 3] + (q / 65535) * (high[i % 3] - low[i % 3]));

function shapeOf(mesh) {
  const geometry = new BufferGeometry();
  geometry.setAttribute('position', new BufferAttribute(placesOf(mesh), 3));
  geometry.setIndex(new BufferAttribute(mesh.faces, 1));
  geometry.computeVertexNormals();
  return geometry;
}

function wall(mesh) {
  const geometry = shapeOf(mesh);
  const back = new Mesh(geometry, wallMaterial(BackSide));
  const front = new Mesh(geometry, wallMaterial(FrontSide));
  back.renderOrder = 1;
  front.renderOrder = 4;
  return { back, front };
}

function tube(points, radius, colourAt) {
  const n = Math.max(2, points.length - 1);
  const geometry = new TubeGeometry(new CatmullRomCurve3(points), n, radius, 10);
  if (colourAt) {
    const colours = new Float32Array(geometry.attributes.position.count * 3);
    for (let i = 0; i <= n; i++) for (let j = 0; j <= 10; j++) colourAt(i / n).toArray(colours, (i * 11 + j) * 3);
    geometry.setAttribute('color', new BufferAttribute(colours, 3));
  }
  return geometry;
}

const thinned = (points) => points.filter((_, i) => i % Math.ceil(points.length / 600) === 0 || i === points.length - 1);

// Feature points that would overlap: the one that says more stays, the table lists all.
function apart(features, gap) {
  const kept = [];
  for (const f of [...features].sort((a, b) => PRECEDENCE.indexOf(a.kind) - PRECEDENCE.indexOf(b.kind))) {
    if (kept.every((k) => Math.hypot(...k.point.map((v, i) => v - f.point[i])) > gap)) kept.push(f);
  }
  return kept;
}

export function createScene(host, model, { onPick, onDraw }) {
  const renderer = new WebGLRenderer({ antialias: true, alpha: true });
  const canvas = renderer.domElement;
  host.prepend(canvas);
  const scene = new Scene();
  const camera = new PerspectiveCamera(26, 1, 1, 5000);
  const up = new Vector3(...model.view.up).normalize();
  const toward = new Vector3(...model.view.toward).normalize();
  const right = new Vector3().crossVectors(up, toward).normalize();
  camera.up.copy(up);
  const sun = new DirectionalLight('#fff', 1.6);
  scene.add(new HemisphereLight('#fff', '#778', 2.2), sun);

  const points = model.points.map((p) => new Vector3(...p));
  const others = (model.others ?? []).map((other) => ({ points: other.map((p) => new Vector3(...p)) })); // paths laid side by side
  const skin = model.mesh ? wall(model.mesh) : null;
  if (skin) scene.add(skin.back, skin.front);
  const structures = new Group();
  const glasses = (model.bodies ?? []).map((body) => ({ ...wall(body.mesh), colour: body.colour })); // bodies to keep clear of
  for (const { back, front } of glasses) structures.add(back, front);
  const spots = new Group();
  for (const { mesh, colour, radius } of model.dots ?? []) {
    const places = placesOf(mesh);
    const many = new InstancedMesh(new SphereGeometry(radius, 8, 6), new MeshBasicMaterial(), places.length / 3);
    const move = new Matrix4();
    for (let i = 0; i < many.count; i++) many.setMatrixAt(i, move.makeTranslation(places[3 * i], places[3 * i + 1], places[3 * i + 2]));
    many.userData.colour = colour;
    spots.add(many);
  }
  const tool = new Group(); // stands with its tip at the cursor, turned as on that part of the path
  const poses = (model.tool?.poses ?? []).map(({ last, along, up }) => {
    const [x, y] = [new Vector3(...along), new Vector3(...up)];
    return { last, turn: new Quaternion().setFromRotationMatrix(new Matrix4().makeBasis(x, y, new Vector3().crossVectors(x, y))) };
  });
  for (const { mesh, colour } of model.tool?.parts ?? []) {
    const part = new Mesh(shapeOf(mesh), new MeshLambertMaterial({ side: DoubleSide }));
    part.userData.colour = colour;
    part.renderOrder = 2;
    tool.add(part);
  }
  scene.add(structures, spots, tool);
  const cloud = model.mesh ? Array.from({ length: Math.min(4000, model.mesh.vertices.length / 3) }, (_, k) => {
    const at = Math.floor((k * model.mesh.vertices.length) / 3 / Math.min(4000, model.mesh.vertices.length / 3)) * 3;
    return new Vector3(...[0, 1, 2].map((a) => model.mesh.low[a] + (model.mesh.vertices[at + a] / 65535) * (model.mesh.high[a] - model.mesh.low[a])));
  }) : points.length ? points : others.flatMap((other) => other.points);
  const middle = (way) => { let a = Infinity, b = -Infinity; for (const p of cloud) { const d = p.dot(way); a = Math.min(a, d); b = Math.max(b, d); } return [(a + b) / 2, b - a]; };
  const ahead = new Vector3().crossVectors(right, up); // toward the viewer, square to up
  const extent = { right: middle(right), up: middle(up), ahead: middle(ahead) };
  const centre = new Vector3().addScaledVector(right, extent.right[0]).addScaledVector(up, extent.up[0]).addScaledVector(ahead, extent.ahead[0]);
  const size = Math.hypot(extent.right[1], extent.up[1], extent.ahead[1]);
  const thick = Math.max(size * 0.0042, Math.min(size * 0.007, 0.45 * (model.clearance || 1)));

  const line = new Mesh(new BufferGeometry(), new MeshBasicMaterial({ vertexColors: true }));
  line.renderOrder = 2;
  const early = model.before.length > 1 ? new Mesh(tube(thinned(model.before.map((p) => new Vector3(...p))), thick * 0.45), new MeshBasicMaterial()) : new Group();
  early.renderOrder = 2;
  early.visible = false;
  const flags = model.stretches.map(([kind, from, to]) => {
    const part = new Mesh(tube(thinned(points.slice(from, to + 1)), thick * (kind === 'clearance' ? 1.55 : 1.48)), new MeshBasicMaterial());
    part.renderOrder = 3;
    part.userData.kind = kind;
    return part;
  });
  const features = new Group();
  for (const f of apart(model.features, thick * 5)) {
    const marker = new Mesh((SHAPES[f.kind] ?? SHAPES.node)(), new MeshLambertMaterial());
    marker.position.set(...f.point);
    marker.scale.setScalar(thick * 1.9);
    if (points.length > 1) {
      let near = 0;
      for (let i = 1; i < points.length; i++) if (points[i].distanceToSquared(marker.position) < points[near].distanceToSquared(marker.position)) near = i;
      const along = new Vector3().subVectors(points[Math.min(near + 1, points.length - 1)], points[Math.max(near - 1, 0)]).normalize();
      marker.quaternion.setFromUnitVectors(f.kind === 'inflection' ? new Vector3(0, 1, 0) : new Vector3(0, 0, 1), along);
    }
    marker.renderOrder = 3;
    features.add(marker);
  }
  const cursor = new Group();
  const dot = new Mesh(new SphereGeometry(thick * 1.6, 24, 16), new MeshBasicMaterial({ depthTest: false, transparent: true }));
  const halo = new Mesh(new SphereGeometry(thick * 2.5, 24, 16), new MeshBasicMaterial({ depthTest: false, transparent: true }));
  halo.renderOrder = 8;
  dot.renderOrder = 9;
  cursor.add(halo, dot);
  cursor.visible = points.length > 1;
  for (const other of others) {
    other.line = new Mesh(tube(thinned(other.points), thick * 0.8), new MeshBasicMaterial());
    other.line.renderOrder = 2;
    other.mark = new Mesh(new SphereGeometry(thick * 2.2, 24, 16), new MeshBasicMaterial({ depthTest: false, transparent: true }));
    other.mark.renderOrder = 8;
    scene.add(other.line, other.mark);
  }
  scene.add(line, early, ...flags, features, cursor);

  const controls = new OrbitControls(camera, canvas);
  controls.enablePan = false;
  let focused = false;
  let large = false;
  const zoomable = () => { controls.enableZoom = focused || large; canvas.style.touchAction = large ? 'none' : 'pan-y'; };
  zoomable(); // the wheel scrolls the page until the scene has focus; one finger up or down scrolls, sideways turns

  let waiting = 0;
  const draw = () => { waiting = 0; sun.position.copy(camera.position); renderer.render(scene, camera); onDraw(project); };
  const ask = () => { waiting ||= requestAnimationFrame(draw); };
  controls.addEventListener('change', ask);

  const project = (p) => {
    const v = p.clone().project(camera);
    return [(v.x * 0.5 + 0.5) * canvas.clientWidth, (0.5 - v.y * 0.5) * canvas.clientHeight];
  };
  function view(name) {
    const way = { front: toward, side: model.view.aside ? new Vector3(...model.view.aside) : right.clone().addScaledVector(ahead, 0.12).addScaledVector(up, 0.08), top: up.clone().addScaledVector(ahead, 0.12) }[name].clone().normalize();
    const half = Math.tan((camera.fov * Math.PI) / 360);
    const tall = (name === 'top' ? extent.ahead : extent.up)[1];
    const wide = (name === 'side' ? (model.view.aside ? middle(new Vector3().crossVectors(up, way)) : extent.ahead) : extent.right)[1];
    const deep = (name === 'top' ? extent.up : name === 'side' ? extent.right : extent.ahead)[1];
    const far = Math.max(tall / half, wide / half / camera.aspect) * 0.5 * 1.16 + deep / 2;
    controls.target.copy(centre);
    camera.position.copy(centre).addScaledVector(way, far);
    camera.near = far * 0.01;
    camera.far = far * 4;
    camera.updateProjectionMatrix();
    controls.minDistance = far * 0.08;
    controls.maxDistance = far * 1.8;
    controls.update();
    ask();
  }
  function turn(x, y, zoom = 1) {
    const offset = camera.position.clone().sub(controls.target).multiplyScalar(zoom);
    const side = new Vector3().crossVectors(camera.up, offset).normalize();
    offset.applyAxisAngle(camera.up, x);
    const tilted = offset.clone().applyAxisAngle(side, y);
    if (Math.abs(tilted.clone().normalize().dot(up)) < 0.985) offset.copy(tilted);
    camera.position.copy(controls.target).add(offset);
    controls.update();
    ask();
  }
  let first = true;
  function resize() {
    const { clientWidth: w, clientHeight: h } = host;
    if (!w || !h) return;
    renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    renderer.setSize(w, h);
    camera.aspect = w / h;
    camera.updateProjectionMatrix();
    if (first) { first = false; view(model.view.aside ? 'side' : 'front'); } else ask();
  }
  function paint(theme) { // colours from the style sheet, so both themes share one source
    if (skin) {
      for (const m of [skin.back, skin.front]) m.material.uniforms.colour.value.set(theme.wall);
      skin.back.material.uniforms.face.value = theme.dark ? 0.10 : 0.12;
      skin.back.material.uniforms.rim.value = theme.dark ? 0.30 : 0.34;
      skin.front.material.uniforms.face.value = theme.solid ? 0.22 : 0.05; // a body to keep out of is denser than a wall to look through
      skin.front.material.uniforms.rim.value = theme.dark ? 0.85 : 0.74;
    }
    for (const { back, front, colour } of glasses) {
      for (const m of [back, front]) m.material.uniforms.colour.value.set(theme.named(colour));
      back.material.uniforms.face.value = 0.06;
      back.material.uniforms.rim.value = 0.2;
      front.material.uniforms.face.value = theme.dark ? 0.16 : 0.14;
      front.material.uniforms.rim.value = 0.6;
    }
    for (const part of [...spots.children, ...tool.children]) part.material.color.set(theme.named(part.userData.colour));
    line.geometry.dispose();
    if (points.length > 1) line.geometry = tube(points, thick, (u) => new Color(theme.clearance(u)));
    for (const f of flags) f.material.color.set(f.userData.kind === 'clearance' ? theme.flagClearance : theme.flagCurvature);
    for (const m of features.children) m.material.color.set(theme.feature);
    early.material?.color.set(theme.before);
    others.forEach((other, k) => { other.line.material.color.set(theme.runs[k]); other.mark.material.color.set(theme.runs[k]); });
    dot.material.color.set(theme.surface);
    halo.material.color.set(theme.cursor);
    ask();
  }

  let free = true;
  canvas.addEventListener('pointerdown', (event) => { free = false; if (event.pointerType === 'touch') controls.enableZoom = true; }, { capture: true }); // two fingers pinch
  addEventListener('pointerup', (event) => { free = true; if (event.pointerType === 'touch') setTimeout(zoomable, 0); });
  canvas.addEventListener('pointermove', (event) => {
    if (!free) return;
    let best = 16;
    let at = -1;
    let of = -1;
    [points, ...others.map((other) => other.points)].forEach((line, k) => {
      for (let i = 0; i < line.length; i += 2) {
        const [x, y] = project(line[i]);
        const d = Math.hypot(x - event.offsetX, y - event.offsetY);
        if (d < best) { best = d; at = i; of = k - 1; }
      }
    });
    if (at >= 0) onPick(at, of);
  });
  new ResizeObserver(resize).observe(host);
  resize();

  return {
    canvas, paint, view, turn, draw,
    focus(on) { focused = on; zoomable(); },
    enlarge(on) { large = on; zoomable(); },
    axes() { // where the frame's axes point on screen, for the corner mark
      const q = new Quaternion().copy(camera.quaternion).invert();
      return [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((a) => { const v = new Vector3(...a).applyQuaternion(q); return [v.x, -v.y, v.z]; });
    },
    setCursor(i) {
      if (points[i]) { cursor.position.copy(points[i]); tool.position.copy(points[i]); }
      const pose = poses.find(({ last }) => i <= last);
      if (pose) tool.quaternion.copy(pose.turn);
      ask();
    },
    setMark(k, i) { others[k].mark.position.copy(others[k].points[i]); ask(); },
    cursorOnScreen() { return project(cursor.position); },
    show(what, on) { ({ before: early, features, structures, spots, tool })[what].visible = on; ask(); },
    showOther(k, on) { others[k].line.visible = on; others[k].mark.visible = on; ask(); },
    vector: (p) => new Vector3(...p),
  };
}
