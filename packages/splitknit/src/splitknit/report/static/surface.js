// Surfaces of a report: turned, zoomed, lit and cut. Parallel projection, so that one scale bar holds everywhere.
// Several surfaces stand beside each other and turn together. Frame: x right, y to the tip, z to the camera, mm.
const EMPTY = -1;
const RELIEF_COLOURS = [[0, 34, 78], [53, 69, 108], [102, 105, 112], [148, 142, 119], [200, 184, 102], [254, 232, 56]];
const LINE_COLOURS = ["#0072b2", "#d55e00"];
const byId = (id) => document.getElementById(id);

/** Pixels (RGBA) of an encoded picture, its values untouched by colour management. */
async function pixels(encoded, kind) {
  const bytes = Uint8Array.from(atob(encoded), (letter) => letter.charCodeAt(0));
  const picture = await createImageBitmap(new Blob([bytes], { type: kind }), {
    colorSpaceConversion: "none",
    premultiplyAlpha: "none",
  });
  const canvas = Object.assign(document.createElement("canvas"), { width: picture.width, height: picture.height });
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(picture, 0, 0);
  return context.getImageData(0, 0, picture.width, picture.height);
}

/** Values in mm of a field whose 16 bits stand in red and green; NaN where both are zero. */
async function values(field) {
  const { data, width, height } = await pixels(field.png, "image/png");
  const result = new Float32Array(width * height);
  for (let k = 0; k < result.length; k++) {
    const level = 256 * data[4 * k] + data[4 * k + 1];
    result[k] = level ? field.low + field.step * (level - 1) : NaN;
  }
  return result;
}

/** Red, green, blue in 0 to 1 for a fraction of the relief's range. */
function reliefColour(fraction) {
  const place = Math.min(Math.max(fraction, 0), 0.9999) * (RELIEF_COLOURS.length - 1);
  const stop = Math.floor(place);
  return [0, 1, 2].map((channel) => {
    const low = RELIEF_COLOURS[stop][channel];
    const high = RELIEF_COLOURS[stop + 1][channel];
    return (low + (place - stop) * (high - low)) / 255;
  });
}

/** A surface on a regular grid, its triangles and its colours. */
class Surface {
  constructor(facts, shape, ridge, brightness) {
    Object.assign(this, facts, { shape, ridge });
    this.vertexOf = new Int32Array(shape.length).fill(EMPTY);
    this.cells = [];
    shape.forEach((value, k) => {
      if (!Number.isNaN(value)) this.vertexOf[k] = this.cells.push(k) - 1;
    });
    this.geometry = new THREE.BufferGeometry();
    const points = new THREE.BufferAttribute(new Float32Array(3 * this.cells.length), 3);
    this.geometry.setAttribute("position", points);
    this.geometry.setIndex(this.triangles());
    const sorted = Float32Array.from(this.cells, (k) => ridge[k]).sort();
    const range = [0.03, 0.97].map((fraction) => sorted[Math.floor(fraction * (sorted.length - 1))]);
    this.paints = {
      matt: () => [0.9, 0.8, 0.7],
      brightness: (k) => [0, 1, 2].map((c) => (brightness[4 * k + c] / 255) ** 2.2),
      relief: (k) => reliefColour((ridge[k] - range[0]) / (range[1] - range[0])).map((level) => level ** 2.2),
    };
    this.paint("matt");
  }

  triangles() {
    const faces = [];
    for (let row = 0; row + 1 < this.rows; row++) {
      for (let column = 0; column + 1 < this.columns; column++) {
        const k = row * this.columns + column;
        const corners = [k, k + this.columns, k + this.columns + 1, k + 1];
        const around = corners.map((corner) => this.vertexOf[corner]).filter((vertex) => vertex !== EMPTY);
        if (around.length > 2) faces.push(around[0], around[1], around[2]);
        if (around.length > 3) faces.push(around[0], around[2], around[3]);
      }
    }
    return faces;
  }

  /** x and y of a grid point. */
  place(k) {
    return [this.left + this.pitch * (k % this.columns), this.top - this.pitch * Math.floor(k / this.columns)];
  }

  raise(factor, ridgesAlone) {
    this.height = (k) => (ridgesAlone ? 0 : this.shape[k]) + factor * this.ridge[k];
    const points = this.geometry.attributes.position;
    this.cells.forEach((k, vertex) => points.setXYZ(vertex, ...this.place(k), this.height(k)));
    points.needsUpdate = true;
    this.geometry.computeVertexNormals();
    this.geometry.computeBoundingSphere();
  }

  paint(name) {
    const colours = new Float32Array(3 * this.cells.length);
    this.cells.forEach((k, vertex) => colours.set(this.paints[name](k), 3 * vertex));
    this.geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3));
  }

  /** A field at x and y in mm, bilinear; NaN outside the surface. */
  at(field, x, y) {
    const column = (x - this.left) / this.pitch;
    const row = (this.top - y) / this.pitch;
    const [c, r] = [Math.floor(column), Math.floor(row)];
    if (c < 0 || r < 0 || c + 1 >= this.columns || r + 1 >= this.rows) return NaN;
    const [across, down] = [column - c, row - r];
    const k = r * this.columns + c;
    const upper = (1 - across) * field[k] + across * field[k + 1];
    const lower = (1 - across) * field[k + this.columns] + across * field[k + this.columns + 1];
    return (1 - down) * upper + down * lower;
  }
}

/** One canvas with its surface, camera and lamp. */
class View {
  constructor(surface, figure) {
    this.surface = surface;
    this.canvas = figure.querySelector("canvas");
    this.bar = figure.querySelector(".bar");
    surface.raise(1, false);
    const { center, radius } = surface.geometry.boundingSphere;
    Object.assign(this, { center: center.clone(), radius });
    const [across, down] = [surface.columns, surface.rows].map((count) => surface.pitch * count);
    this.half = { across: across / 2, down: down / 2 };
    figure.style.setProperty("--ratio", Math.min(Math.max(across / down, 0.5), 2));
    this.material = new THREE.MeshPhongMaterial({ vertexColors: true, side: THREE.DoubleSide, shininess: 18 });
    this.material.specular.setScalar(0.06);
    this.mesh = new THREE.Mesh(surface.geometry, this.material);
    this.lamp = new THREE.DirectionalLight(0xffffff, 2.6);
    this.scene = new THREE.Scene();
    this.scene.add(this.mesh, this.lamp, this.lamp.target, new THREE.AmbientLight(0xffffff, 0.45));
    this.marks = new THREE.Group();
    this.minutiae = new THREE.Group();
    this.scene.add(this.marks, this.minutiae);
    this.camera = new THREE.OrthographicCamera(-1, 1, 1, -1, -20 * radius, 20 * radius);
    this.camera.position.set(center.x, center.y - 1e-4, center.z + 4 * radius);
    this.renderer = new THREE.WebGLRenderer({ canvas: this.canvas, antialias: true, alpha: true });
    this.controls = new THREE.OrbitControls(this.camera, this.canvas);
    this.controls.enableDamping = false;
    this.controls.zoomToCursor = true;
    this.controls.target.copy(center);
    this.controls.update();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    const tall = 1.04 * Math.max(this.half.down, (this.half.across * height) / width);
    const wide = (tall * width) / height;
    Object.assign(this.camera, { top: tall, bottom: -tall, right: wide, left: -wide });
    this.camera.updateProjectionMatrix();
    this.renderer.setPixelRatio(devicePixelRatio);
    this.renderer.setSize(width, height, false);
    this.draw();
  }

  draw() {
    this.lamp.target.position.copy(this.center);
    this.lamp.position.set(...light).applyQuaternion(this.camera.quaternion).add(this.center); // stays with the viewer
    this.renderer.render(this.scene, this.camera);
    const perPixel = (this.camera.right - this.camera.left) / this.camera.zoom / this.canvas.clientWidth;
    const target = 0.3 * this.canvas.clientWidth * perPixel;
    const ten = 10 ** Math.floor(Math.log10(target));
    const length = [5, 2, 1].map((digit) => digit * ten).find((step) => step <= target);
    this.bar.style.width = `${length / perPixel}px`;
    this.bar.textContent = `${Number(length.toPrecision(1))} ${this.surface.unit}`;
  }

  /** The grid's x and y under the pointer, or undefined. */
  under(event) {
    const across = (2 * event.offsetX) / this.canvas.clientWidth - 1;
    const up = 1 - (2 * event.offsetY) / this.canvas.clientHeight;
    const caster = new THREE.Raycaster();
    caster.setFromCamera(new THREE.Vector2(across, up), this.camera);
    const [hit] = caster.intersectObject(this.mesh);
    return hit && [hit.point.x, hit.point.y];
  }

  /** A line on the surface through places [x, y], raised a little so that it is not hidden. */
  line(places, colour) {
    const raised = 0.004 * this.radius;
    const points = places.map(([x, y]) => {
      const shape = byId("alone").checked ? 0 : this.surface.at(this.surface.shape, x, y);
      const z = shape + relief() * this.surface.at(this.surface.ridge, x, y);
      return new THREE.Vector3(x, y, z + raised);
    });
    const known = points.filter((point) => !Number.isNaN(point.z));
    const material = new THREE.LineBasicMaterial({ color: colour });
    return new THREE.Line(new THREE.BufferGeometry().setFromPoints(known), material);
  }

  mark() {
    this.marks.clear();
    if (ends.length === 1) {
      const [x, y] = ends[0];
      const arm = 0.02 * this.radius;
      this.marks.add(this.line([[x - arm, y], [x + arm, y]], 0xd00000), this.line([[x, y - arm], [x, y + arm]], 0xd00000));
    }
    if (ends.length === 2) this.marks.add(this.line(cut().map(({ x, y }) => [x, y]), 0xd00000));
    this.minutiae.clear();
    if (!byId("minutiae")?.checked) return;
    for (const [x, y, angle] of this.surface.minutiae) {
      const corners = [0, 1, 2, 3, 4, 5, 6, 7, 8].map((k) => (k * Math.PI) / 4);
      const ring = corners.map((turn) => [x + 0.15 * Math.cos(turn), y + 0.15 * Math.sin(turn)]);
      const tail = [0.15, 0.6].map((far) => [x + far * Math.cos(angle), y + far * Math.sin(angle)]);
      this.minutiae.add(this.line(ring, 0xd00000), this.line(tail, 0xd00000));
    }
  }
}

const light = [-0.55, 0.55, 0.63];
let ends = []; // [x, y] of the section's ends
const views = [];
const relief = () => byId("exaggeration").valueAsNumber;
const pointerTo = () => document.querySelector("input[name=pointer]:checked").value;

/** Places along the section, a grid step apart: [{x, y, along}]. */
function cut() {
  const [[x0, y0], [x1, y1]] = ends;
  const length = Math.hypot(x1 - x0, y1 - y0);
  const count = Math.min(4000, Math.max(2, Math.ceil(length / views[0].surface.pitch)));
  return Array.from({ length: count + 1 }, (_, k) => k / count).map((fraction) => ({
    x: x0 + fraction * (x1 - x0),
    y: y0 + fraction * (y1 - y0),
    along: fraction * length,
  }));
}

/** Round numbers that divide a range into about `count` steps. */
function ticks(low, high, count) {
  const raw = (high - low) / count;
  const ten = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((digit) => digit * ten).find((candidate) => candidate >= raw);
  const first = Math.ceil(low / step);
  return Array.from({ length: Math.floor(high / step) - first + 1 }, (_, k) => Number(((first + k) * step).toPrecision(6)));
}

/** Heights of a surface at places, or its relief alone. */
function heightsOf(surface, places, alone) {
  return places.map(({ x, y }) => (alone ? 0 : surface.at(surface.shape, x, y)) + surface.at(surface.ridge, x, y));
}

/** The section of every surface as a chart, and its figures. */
function drawSection() {
  const chart = byId("section");
  const note = byId("section-note");
  if (ends.length < 2) {
    chart.replaceChildren();
    note.textContent = ends.length ? "Choose the other end." : "";
    return;
  }
  const places = cut();
  const alone = byId("alone").checked;
  const { unit, small } = views[0].surface;
  const levels = views.map(({ surface }) => {
    const heights = heightsOf(surface, places, alone);
    const known = heights.filter((height) => !Number.isNaN(height));
    const mean = known.reduce((sum, height) => sum + height, 0) / known.length;
    return heights.map((height) => height - mean);
  });
  const every = levels.flat().filter((height) => !Number.isNaN(height));
  if (!every.length) {
    chart.replaceChildren();
    note.textContent = "No surface lies between the two points.";
    return;
  }
  const fine = unit !== small && Math.max(...every) - Math.min(...every) < 1;
  const [factor, named] = fine ? [1000, small] : [1, unit]; // um in a mm
  const curves = levels.map((heights) => heights.map((height) => factor * height));
  const [low, high] = [factor * Math.min(...every), factor * Math.max(...every)];
  const spread = Math.max(high - low, 1e-6);
  const length = places.at(-1).along;
  const width = chart.parentElement.clientWidth;
  chart.setAttribute("viewBox", `0 0 ${width} 300`);
  const box = { left: 50, right: width - 10, top: 12, bottom: 250 };
  const across = (along) => box.left + ((box.right - box.left) * along) / length;
  const up = (height) => box.bottom - ((box.bottom - box.top) * (height - low)) / spread;
  const drawn = [];
  const add = (name, attributes, text) => {
    const node = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    if (text !== undefined) node.textContent = text;
    drawn.push(node);
  };
  for (const height of ticks(low, high, 5)) {
    add("path", { d: `M${box.left} ${up(height)}H${box.right}`, stroke: "#ddd" });
    add("text", { x: box.left - 6, y: up(height) + 4, "text-anchor": "end" }, height);
  }
  for (const along of ticks(0, length, width / 90)) {
    add("path", { d: `M${across(along)} ${box.bottom}v5`, stroke: "#888" });
    add("text", { x: across(along), y: box.bottom + 18, "text-anchor": "middle" }, along);
  }
  add("text", { x: box.left, y: box.bottom + 36 }, `${alone ? "relief" : "height"} in ${named}, along in ${unit}`);
  curves.forEach((curve, n) => {
    const steps = curve.map((height, k) => {
      if (Number.isNaN(height)) return "";
      const begins = !k || Number.isNaN(curve[k - 1]);
      return `${begins ? "M" : "L"}${across(places[k].along).toFixed(1)} ${up(height).toFixed(1)}`;
    });
    add("path", { d: steps.join(""), fill: "none", stroke: LINE_COLOURS[n % 2], "stroke-width": 1.4 });
    if (views.length > 1) {
      const text = { x: box.right - 10, y: box.top + 14 + 16 * n, "text-anchor": "end", fill: LINE_COLOURS[n % 2] };
      add("text", text, views[n].surface.title);
    }
  });
  chart.replaceChildren(...drawn);
  const corners = ends.map(([x, y]) => `${x.toFixed(2)},${y.toFixed(2)}`).join(" to ");
  const { factor_sd: factorSd, steep } = views[0].surface;
  const known = factorSd ? ` \u00b1 ${Number((factorSd * spread).toPrecision(2))}` : "";
  const figures = `${length.toFixed(2)} ${unit} long, ${Number(spread.toPrecision(3))}${known} ${named} from lowest to highest`;
  const step = length / (places.length - 1);
  const whole = heightsOf(views[0].surface, places, false);
  const wall = whole.some((height, k) => Math.abs(height - whole[k - 1]) > steep * step);
  const limit = wall ? " A lower limit: it crosses walls steeper than 70 deg, where shadow hides how high they are." : "";
  note.textContent = `Section from ${corners} ${unit}: ${figures}.${limit}`;
}

function redraw() {
  for (const view of views) {
    view.mark();
    view.draw();
  }
  drawSection();
}

function listen(view) {
  const { canvas, camera, controls } = view;
  controls.addEventListener("change", () => {
    for (const other of views) {
      if (other !== view) {
        const offset = camera.position.clone().sub(controls.target);
        const moved = controls.target.clone().sub(view.center);
        other.controls.target.copy(other.center).add(moved);
        other.camera.position.copy(other.controls.target).add(offset);
        other.camera.quaternion.copy(camera.quaternion);
        other.camera.zoom = camera.zoom;
        other.camera.updateProjectionMatrix();
      }
      other.draw();
    }
  });
  canvas.addEventListener("pointermove", (event) => {
    if (pointerTo() !== "light") return;
    const x = (2 * event.offsetX) / canvas.clientWidth - 1;
    const y = 1 - (2 * event.offsetY) / canvas.clientHeight;
    const far = Math.min(1, Math.hypot(x, y));
    const scale = far ? far / Math.hypot(x, y) : 0;
    light.splice(0, 3, scale * x, scale * y, Math.sqrt(Math.max(1 - far * far, 0.003)));
    for (const other of views) other.draw();
  });
  canvas.addEventListener("click", (event) => {
    if (pointerTo() !== "section") return;
    const place = view.under(event);
    if (!place) return;
    ends = ends.length === 1 ? [ends[0], place] : [place];
    redraw();
  });
  const steps = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
  canvas.addEventListener("keydown", (event) => {
    const [across, upwards] = steps[event.key] ?? [0, 0];
    const zoom = { "+": 1.2, "-": 1 / 1.2 }[event.key] ?? 1;
    if (!across && !upwards && zoom === 1) return;
    event.preventDefault();
    const offset = camera.position.clone().sub(controls.target);
    offset.applyAxisAngle(camera.up, across);
    offset.applyAxisAngle(camera.up.clone().cross(offset).normalize(), upwards);
    camera.position.copy(controls.target).add(offset);
    camera.zoom *= zoom;
    camera.updateProjectionMatrix();
    controls.update();
    controls.dispatchEvent({ type: "change" });
  });
  new ResizeObserver(() => view.resize()).observe(canvas);
}

async function start() {
  const figures = document.querySelectorAll("figure.view");
  const described = JSON.parse(byId("surfaces").textContent);
  for (const [n, facts] of described.entries()) {
    const [shape, ridge, brightness] = await Promise.all([
      values(facts.shape),
      values(facts.ridge),
      facts.brightness && pixels(facts.brightness, "image/jpeg"),
    ]);
    if (!brightness) byId("paint").querySelector("[value=brightness]")?.remove();
    views.push(new View(new Surface(facts, shape, ridge, brightness?.data), figures[n]));
  }
  for (const view of views) listen(view);
  byId("exaggeration").addEventListener("input", raise);
  byId("alone").addEventListener("change", raise);
  byId("minutiae")?.addEventListener("change", redraw);
  byId("paint").addEventListener("change", () => {
    for (const { surface } of views) surface.paint(byId("paint").value);
    redraw();
  });
  for (const choice of document.querySelectorAll("input[name=pointer]")) {
    choice.addEventListener("change", () => {
      for (const { controls } of views) controls.enabled = pointerTo() === "turn";
    });
  }
  redraw();
  document.body.dataset.state = "ready";
}

function raise() {
  byId("factor").textContent = `${relief()} times`;
  for (const { surface } of views) surface.raise(relief(), byId("alone").checked);
  redraw();
}

start().catch((error) => {
  byId("section-note").textContent = `This browser cannot draw the surface (${error.message}); the pictures below show it.`;
  document.body.dataset.state = "failed";
});
