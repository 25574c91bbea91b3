// One finger in one canvas: camera, light, marks. Parallel projection, so that one scale bar holds everywhere.
import {
  BufferAttribute, BufferGeometry, Group, Line, LineBasicMaterial, LineSegments, OrthographicCamera, Points, PointsMaterial, Raycaster, Scene,
  LinearFilter, LinearSRGBColorSpace, Matrix4, NearestFilter, Spherical, Texture, Vector2, Vector3, WebGLRenderer,
} from "../vendor/three/three.module.min.js";
import { OrbitControls } from "../vendor/three/OrbitControls.js";
import { about, getDifference, getPicture } from "./api.js";
import { COLOURS, lampDirection, makeMaterial, MARK_COLOURS } from "./material.js";
import { boundsOf, Tiles } from "./tiles.js";

const PX_PER_VALUE = 1.7;
const PX_WHILE_MOVING = 5;
const PX_BY_PROCESSOR = 3.2;
const SLOW_MS = 45;
const DIRECTIONS = { top: [0, 0, 1], left: [-1, 0, 0.25], right: [1, 0, 0.25], tip: [0, 0.9, 0.5] };

/** Whether the processor draws, because there is no graphics card (or none that may be used): then fewer points and pixels. */
const byProcessor = (() => {
  let known;
  return () => {
    if (known === undefined) {
      const gl = new OffscreenCanvas(1, 1).getContext("webgl2");
      const about = gl?.getExtension("WEBGL_debug_renderer_info");
      const name = about ? String(gl.getParameter(about.UNMASKED_RENDERER_WEBGL)) : "";
      known = /swiftshader|llvmpipe|software|basic render/i.test(name);
    }
    return known;
  };
})();

export class View {
  /**
   * @param {HTMLElement} box
   * @param {any} meta
   * @param {any} look shared settings: colour, relief, contours, azimuth, elevation, lamp
   * @param {string} other key of the result that this one is compared with, where it can be
   */
  constructor(box, meta, look, other = "") {
    this.other = other;
    this.box = box;
    this.meta = meta;
    this.look = look;
    this.listeners = { camera: [], drawn: [] };
    this.frames = 0;
    this.moving = false;
    this.lastFrame = 0;
    this.slow = false;
    this.complete = false;
    this.canvas = document.createElement("canvas");
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    box.replaceChildren(this.canvas);
    this.scaleBar = this.#element("div", "scale");
    this.scaleBar.append(document.createTextNode(""), document.createElement("i"));
    this.#name();
    this.renderer = new WebGLRenderer({ canvas: this.canvas, antialias: !byProcessor(), alpha: true, preserveDrawingBuffer: false });
    this.renderer.outputColorSpace = LinearSRGBColorSpace;
    this.renderer.setClearAlpha(0);
    this.scene = new Scene();
    this.model = new Group();
    this.scene.add(this.model);
    this.marks = new Group(); // in the frame of the first finger
    this.scene.add(this.marks);
    this.ownMarks = new Group(); // in this finger's
    this.model.add(this.ownMarks);
    this.labels = [];
    this.material = makeMaterial(meta);
    this.tiles = new Tiles(meta, this.material, () => this.draw());
    this.model.add(this.tiles.group);
    this.bounds = boundsOf(meta);
    this.camera = new OrthographicCamera(-1, 1, 1, -1, -20 * this.bounds.radius, 20 * this.bounds.radius);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.enableDamping = false;
    this.controls.zoomToCursor = true;
    this.controls.minZoom = 0.3;
    this.controls.maxZoom = 120;
    this.controls.addEventListener("change", () => {
      this.draw();
      for (const call of this.listeners.camera) call();
    });
    this.controls.addEventListener("start", () => (this.moving = true));
    this.controls.addEventListener("end", () => {
      this.moving = false;
      this.draw();
    });
    this.sizes = new ResizeObserver(() => this.#resize());
    this.sizes.observe(box);
    this.lookFrom("top");
  }

  #element(kind, name) {
    const element = document.createElement(kind);
    element.className = name;
    this.box.append(element);
    return element;
  }

  #name() {
    const words = this.#element("div", "name");
    const small = document.createElement("small");
    small.textContent = [this.meta.preset, this.meta.subject, this.meta.finger, this.meta.session && `session ${this.meta.session}`].filter(Boolean).join(" · ");
    words.append(this.meta.name, document.createElement("br"), small);
    this.canvas.setAttribute(
      "aria-label",
      `Surface of ${this.meta.name}, ${(this.meta.high_mm[0] - this.meta.low_mm[0]).toFixed(1)} by ` +
        `${(this.meta.high_mm[1] - this.meta.low_mm[1]).toFixed(1)} ${this.meta.units[0]}. Arrow keys turn it; ? lists the keys.`,
    );
  }

  /** Show the first view. @param {Promise<import("./tiles.js").Tile[]>} coming asked for together with the facts */
  async load(coming) {
    const tiles = await coming;
    performance.mark("points are here");
    this.tiles.readFirst(tiles);
    await this.apply();
  }

  /** Take over the shared settings. */
  async apply() {
    const { uniforms, userData } = this.material;
    const colour = this.look.colour === "difference" && !this.other ? "clay" : this.look.colour;
    uniforms.relief.value = this.look.relief;
    uniforms.contours.value = this.look.contours;
    uniforms.colour.value = COLOURS.indexOf(colour);
    if (colour === "height" || colour === "relief") uniforms.scale.value = userData[colour];
    if (colour === "difference") uniforms.scale.value = userData.relief;
    if (["normals", "albedo", "specular", "difference"].includes(colour)) {
      if (!userData[colour]) {
        const coming = colour === "difference" ? getDifference(this.meta.key, this.other) : getPicture(this.meta.key, `${colour}.png`);
        userData[colour] = coming.then((image) => {
          const texture = new Texture(image);
          texture.flipY = false;
          texture.generateMipmaps = false;
          texture.minFilter = texture.magFilter = colour === "difference" ? NearestFilter : LinearFilter;
          texture.needsUpdate = true;
          return texture;
        });
      }
      const texture = await userData[colour];
      if (this.look.colour === colour) uniforms.picture.value = texture;
    }
    this.draw();
  }

  /** @param {"top" | "left" | "right" | "tip"} name */
  lookFrom(name) {
    const { middle, radius } = this.bounds;
    const target = middle.clone().applyMatrix4(this.model.matrixWorld);
    this.camera.up.set(0, 1, 0);
    this.camera.position.copy(target).addScaledVector(new Vector3(...DIRECTIONS[name]).normalize(), 4 * radius);
    if (name === "top") this.camera.position.y -= 1e-4; // up stays defined
    this.controls.target.copy(target);
    this.camera.zoom = 1;
    this.#resize();
    this.controls.update();
  }

  /** Turn about the finger (radians), or shift (CSS pixels), or zoom. */
  turn(across, up) {
    const offset = this.camera.position.clone().sub(this.controls.target);
    const place = new Spherical().setFromVector3(offset);
    place.theta -= across;
    place.phi = Math.min(Math.PI - 1e-3, Math.max(1e-3, place.phi - up));
    this.camera.position.copy(this.controls.target).add(offset.setFromSpherical(place));
    this.controls.update();
  }

  shift(x, y) {
    const step = this.mmPerPx / this.camera.zoom;
    const move = new Vector3(x * step, y * step, 0).applyQuaternion(this.camera.quaternion);
    this.camera.position.add(move);
    this.controls.target.add(move);
    this.controls.update();
  }

  zoom(factor) {
    this.camera.zoom = Math.min(this.controls.maxZoom, Math.max(this.controls.minZoom, this.camera.zoom * factor));
    this.camera.updateProjectionMatrix();
    for (const call of this.listeners.camera) call();
    this.draw();
  }

  #resize() {
    const width = Math.max(1, this.box.clientWidth);
    const height = Math.max(1, this.box.clientHeight);
    const size = [0, 1].map((k) => this.meta.high_mm[k] - this.meta.low_mm[k]);
    const half = Math.max(size[1] * 0.6, (size[0] * 0.58 * height) / width);
    this.mmPerPx = (2 * half) / height;
    this.camera.top = half;
    this.camera.bottom = -half;
    this.camera.right = (half * width) / height;
    this.camera.left = -this.camera.right;
    this.camera.updateProjectionMatrix();
    this.#setPixels();
    this.renderer.setSize(width, height, false);
    this.draw();
  }

  /** As many pixels as can be drawn in time: where the processor draws, fewer while it moves. */
  #setPixels() {
    const ratio = byProcessor() ? (this.moving ? 0.5 : 1) : Math.min(devicePixelRatio, 2);
    if (this.renderer.getPixelRatio() !== ratio) this.renderer.setPixelRatio(ratio);
  }

  /** Draw at the next frame. */
  draw() {
    if (this.asked) return;
    this.asked = requestAnimationFrame((now) => {
      this.asked = 0;
      this.#draw(now);
    });
  }

  #draw(now) {
    const gap = now - this.lastFrame;
    this.lastFrame = now;
    if (this.moving && gap < 1000) this.slow = gap > SLOW_MS || (this.slow && gap > SLOW_MS / 3);
    const cssPxPerMm = this.camera.zoom / this.mmPerPx;
    this.#setPixels();
    this.camera.updateMatrixWorld();
    const lamp = lampDirection(this.look.azimuth, this.look.elevation);
    this.material.uniforms.light.value.copy(this.look.lamp === "finger" ? lamp.transformDirection(this.camera.matrixWorldInverse) : lamp);
    const best = byProcessor() ? PX_BY_PROCESSOR : PX_PER_VALUE;
    const fine = this.moving && this.slow ? PX_WHILE_MOVING : best;
    const chosen = this.tiles.choose(this.camera, cssPxPerMm * this.renderer.getPixelRatio(), fine);
    this.complete = chosen.complete && !this.moving;
    this.renderer.render(this.scene, this.camera);
    this.#showScale(cssPxPerMm);
    this.#placeLabels();
    this.frames++;
    this.box.dataset.points = String(chosen.points);
    this.box.dataset.stride = String(chosen.stride);
    this.box.dataset.complete = String(this.complete);
    for (const call of this.listeners.drawn) call();
  }

  #showScale(pxPerMm) {
    let length = 10 ** Math.floor(Math.log10(120 / pxPerMm));
    if (5 * length * pxPerMm <= 120) length *= 5;
    else if (2 * length * pxPerMm <= 120) length *= 2;
    const [unit, fine, parts] = this.meta.units;
    this.scaleBar.firstChild.textContent = length >= 1 || parts === 1 ? `${length} ${unit}` : `${Math.round(parts * length)} ${fine}`;
    this.scaleBar.lastChild.style.width = `${length * pxPerMm}px`;
  }

  /** The same look from the same side as another view. @param {View} other */
  follow(other) {
    this.camera.position.copy(other.camera.position);
    this.controls.target.copy(other.controls.target);
    this.camera.up.copy(other.camera.up);
    this.camera.zoom = (other.camera.zoom * this.mmPerPx) / other.mmPerPx;
    this.camera.lookAt(this.controls.target);
    this.camera.updateProjectionMatrix();
    this.moving = other.moving;
    this.camera.updateMatrixWorld();
    this.draw();
  }

  /** Lay this finger on another one. @param {any} alignment */
  align(alignment) {
    new Matrix4().set(...alignment.matrix).decompose(this.model.position, this.model.quaternion, this.model.scale);
    this.model.updateMatrixWorld(true);
    this.draw();
  }

  /**
   * The point of the surface under a place of the canvas, from the result's own values.
   * @param {number} x CSS pixels from the left
   * @param {number} y from the top
   * @returns {Promise<number[] | null>} mm, in the first finger's frame
   */
  async pick(x, y) {
    const at = new Vector2((2 * x) / this.box.clientWidth - 1, 1 - (2 * y) / this.box.clientHeight);
    const caster = new Raycaster();
    this.camera.updateMatrixWorld();
    caster.setFromCamera(at, this.camera);
    // start in front of everything
    const far = 20 * this.bounds.radius;
    const origin = caster.ray.direction.clone().multiplyScalar(-far).add(new Vector3().copy(this.controls.target));
    const across = caster.ray.origin.clone().sub(origin);
    across.addScaledVector(caster.ray.direction, -across.dot(caster.ray.direction));
    origin.add(across);
    const back = this.model.matrixWorld.clone().invert();
    origin.applyMatrix4(back);
    const way = caster.ray.direction.clone().transformDirection(back);
    const ray = { ox: origin.x, oy: origin.y, oz: origin.z, dx: way.x, dy: way.y, dz: way.z, relief: this.look.relief };
    const { point_mm: point } = await about(this.meta.key, "pick", ray);
    return point && new Vector3(...point).applyMatrix4(this.model.matrixWorld).toArray();
  }

  /** Height in the picture. */
  #shown(z, relief_um) {
    return z + ((this.look.relief - 1) * (relief_um ?? 0)) / this.meta.units[2];
  }

  /** @param {any} cut a section, or null @param {"a" | "b"} [side] */
  showSection(cut, side = "a") {
    this.#clear("section");
    if (cut) {
      const places = [];
      cut.x_mm.forEach((x, k) => {
        if (cut.height_mm[k] !== null) places.push(x, cut.y_mm[k], this.#shown(cut.height_mm[k], cut.relief_um[k]) + 1e-3 * this.bounds.radius);
      });
      const geometry = new BufferGeometry();
      geometry.setAttribute("position", new BufferAttribute(new Float32Array(places), 3));
      const line = new Line(geometry, new LineBasicMaterial({ color: MARK_COLOURS[side], depthTest: false, transparent: true }));
      line.renderOrder = 5;
      line.name = "section";
      this.marks.add(line);
    }
    this.draw();
  }

  /** @param {{text: string, place: number[]}[]} points */
  showPoints(points) {
    this.labels.filter((label) => label.kind === "point").forEach((label) => label.element.remove());
    this.labels = this.labels.filter((label) => label.kind !== "point");
    for (const { text, place } of points) this.#label(text, place, "point");
    this.draw();
  }

  #label(text, place, kind) {
    const element = this.#element("span", "mark");
    element.textContent = text;
    this.labels.push({ element, place: new Vector3(...place), kind });
  }

  /** Minutiae on the surface: dots with tails, and numbers where they have partners. */
  showMinutiae(minutiae, numbers = new Map()) {
    this.#clear("minutiae");
    this.labels.filter((label) => label.kind === "minutia").forEach((label) => label.element.remove());
    this.labels = this.labels.filter((label) => label.kind !== "minutia");
    const known = (minutiae ?? []).map((m, k) => ({ ...m, k })).filter((m) => m.place_mm);
    const kinds = { ending: MARK_COLOURS.a, bifurcation: MARK_COLOURS.b };
    for (const [kind, colour] of Object.entries(kinds)) {
      const some = known.filter((m) => (m.kind === "ending") === (kind === "ending"));
      if (!some.length) continue;
      const dots = new BufferGeometry();
      dots.setAttribute("position", new BufferAttribute(new Float32Array(some.flatMap((m) => m.place_mm)), 3));
      const size = (kind === "ending" ? 6 : 8) * this.renderer.getPixelRatio();
      const cloud = new Points(dots, new PointsMaterial({ color: colour, size, sizeAttenuation: false, depthTest: false, transparent: true }));
      const tails = new BufferGeometry();
      const ends = some.filter((m) => m.tail_mm).flatMap((m) => [...m.place_mm, ...m.tail_mm]);
      tails.setAttribute("position", new BufferAttribute(new Float32Array(ends), 3));
      const strokes = new LineSegments(tails, new LineBasicMaterial({ color: colour, depthTest: false, transparent: true }));
      for (const object of [cloud, strokes]) {
        object.renderOrder = 4;
        object.name = "minutiae";
        this.ownMarks.add(object);
      }
    }
    for (const m of known) if (numbers.has(m.k)) this.#label(String(numbers.get(m.k)), m.place_mm, "minutia");
    this.draw();
  }

  #clear(name) {
    for (const object of [...this.marks.children, ...this.ownMarks.children].filter((child) => child.name === name)) {
      object.removeFromParent();
      object.geometry.dispose();
      object.material.dispose();
    }
  }

  #placeLabels() {
    const at = new Vector3();
    for (const { element, place, kind } of this.labels) {
      at.copy(place);
      if (kind === "minutia") at.applyMatrix4(this.model.matrixWorld);
      at.project(this.camera);
      const x = ((at.x + 1) / 2) * this.box.clientWidth;
      const y = ((1 - at.y) / 2) * this.box.clientHeight;
      element.style.transform = `translate(${x + 5}px, ${y - 20}px)`;
      element.hidden = Math.abs(at.x) > 1 || Math.abs(at.y) > 1;
    }
  }

  /** The picture as seen, on white. @returns {Promise<Blob>} */
  async png() {
    this.renderer.setClearColor(0xffffff, 1);
    this.renderer.render(this.scene, this.camera);
    const done = new Promise((resolve) => this.canvas.toBlob(resolve, "image/png"));
    this.renderer.setClearAlpha(0);
    const blob = await done;
    this.draw();
    return blob;
  }

  dispose() {
    cancelAnimationFrame(this.asked);
    this.sizes.disconnect();
    this.controls.dispose();
    this.tiles.dispose();
    this.material.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
    this.box.replaceChildren();
  }
}
