// One surface: turned, zoomed and lit; a click gives a place. Parallel projection.
import {
  BufferAttribute, BufferGeometry, DirectionalLight, AmbientLight, DoubleSide, Mesh, MeshLambertMaterial, OrthographicCamera, Raycaster, Scene,
  Vector2, WebGLRenderer,
} from "./vendor/three/three.module.min.js";
import { OrbitControls } from "./vendor/three/OrbitControls.js";

const byId = (id) => document.getElementById(id);
const canvas = byId("canvas");
const [facts, surface] = await Promise.all([
  fetch("facts").then((answer) => answer.json()),
  fetch("surface").then((answer) => answer.arrayBuffer()),
]);
document.title = `${facts.title} · splitknit`;
byId("title").textContent = `${facts.title}, ${facts.preset}, a value every ${facts.spacing.toPrecision(3)} ${facts.unit}`;
byId("warnings").append(...facts.warnings.map((text) => Object.assign(document.createElement("li"), { textContent: text })));

const [rows, columns] = new Int32Array(surface, 0, 2);
const [x, y, z, ridge] = [0, 1, 2, 3].map((k) => new Float32Array(surface, 8 + 4 * k * rows * columns, rows * columns));
const vertex = new Int32Array(rows * columns).fill(-1); // number of a value's vertex
const values = [];
z.forEach((height, k) => {
  if (!Number.isNaN(height)) vertex[k] = values.push(k) - 1;
});
const faces = [];
for (let row = 0; row + 1 < rows; row++) {
  for (let column = 0; column + 1 < columns; column++) {
    const k = row * columns + column;
    const around = [k, k + columns, k + columns + 1, k + 1].map((one) => vertex[one]).filter((one) => one >= 0);
    if (around.length > 2) faces.push(around[0], around[1], around[2]);
    if (around.length > 3) faces.push(around[0], around[2], around[3]);
  }
}
const geometry = new BufferGeometry();
const places = new BufferAttribute(new Float32Array(3 * values.length), 3);
geometry.setAttribute("position", places);
geometry.setIndex(faces);

/** Heights with the relief exaggerated. */
function raise() {
  const extra = byId("relief").valueAsNumber - 1;
  values.forEach((k, n) => places.setXYZ(n, x[k], y[k], z[k] + extra * ridge[k]));
  places.needsUpdate = true;
  geometry.computeVertexNormals();
  geometry.computeBoundingSphere();
}

raise();
const { center, radius } = geometry.boundingSphere;
const scene = new Scene();
const mesh = new Mesh(geometry, new MeshLambertMaterial({ color: 0xe6ccb2, side: DoubleSide }));
const lamp = new DirectionalLight(0xffffff, 2.5);
const camera = new OrthographicCamera(-1, 1, 1, -1, -20 * radius, 20 * radius);
scene.add(mesh, lamp, lamp.target, new AmbientLight(0xffffff, 0.5));
camera.position.set(center.x, center.y - 1e-4, center.z + 4 * radius);
const renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true });
const controls = new OrbitControls(camera, canvas);
controls.enableDamping = false;
controls.zoomToCursor = true;
controls.target.copy(center);
controls.update();

function draw() {
  const [azimuth, elevation] = ["azimuth", "elevation"].map((id) => (byId(id).valueAsNumber * Math.PI) / 180);
  lamp.target.position.copy(center);
  lamp.position.set(Math.cos(azimuth) * Math.cos(elevation), Math.sin(azimuth) * Math.cos(elevation), Math.sin(elevation));
  lamp.position.applyQuaternion(camera.quaternion).add(center); // it stays with the camera
  renderer.render(scene, camera);
  document.body.dataset.state = "ready";
}

function resize() {
  const { clientWidth: width, clientHeight: height } = canvas;
  const tall = 1.1 * radius * Math.max(1, height / width);
  Object.assign(camera, { top: tall, bottom: -tall, right: (tall * width) / height, left: (-tall * width) / height });
  camera.updateProjectionMatrix();
  renderer.setPixelRatio(devicePixelRatio);
  renderer.setSize(width, height, false);
  draw();
}

controls.addEventListener("change", draw);
new ResizeObserver(resize).observe(canvas);
for (const id of ["relief", "azimuth", "elevation"]) {
  byId(id).addEventListener("input", () => {
    if (id === "relief") raise();
    draw();
  });
}
canvas.addEventListener("click", (event) => {
  const at = new Vector2((2 * event.offsetX) / canvas.clientWidth - 1, 1 - (2 * event.offsetY) / canvas.clientHeight);
  const caster = new Raycaster();
  caster.setFromCamera(at, camera);
  const [hit] = caster.intersectObject(mesh);
  if (!hit) return;
  const k = values[hit.face.a];
  byId("place").textContent = `x ${x[k].toFixed(2)}, y ${y[k].toFixed(2)}, z ${z[k].toFixed(3)} ${facts.unit}`;
});
const steps = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
canvas.addEventListener("keydown", (event) => {
  const [across, up] = steps[event.key] ?? [0, 0];
  const zoom = { "+": 1.2, "-": 1 / 1.2 }[event.key] ?? 1;
  if (!across && !up && zoom === 1) return;
  event.preventDefault();
  const offset = camera.position.clone().sub(controls.target);
  offset.applyAxisAngle(camera.up, across);
  offset.applyAxisAngle(camera.up.clone().cross(offset).normalize(), up);
  camera.position.copy(controls.target).add(offset);
  camera.zoom *= zoom;
  camera.updateProjectionMatrix();
  controls.update();
  draw();
});
