// A surface in pieces: coarse ones at once, finer ones where one looks closely.
import { BufferAttribute, BufferGeometry, Frustum, Group, Matrix4, Mesh, Sphere, Vector3 } from "../vendor/three/three.module.min.js";
import { dropped, getBytes } from "./api.js";

const HEAD = 40;
const AT_ONCE = 6;
const MAX_KEPT = 260;

/** @typedef {{stride: number, row: number, column: number, rows: number, columns: number, first: number[],
 *   fields: Float32Array[]}} Tile x, y, z, relief with a rim of one value */

/** @param {ArrayBuffer} bytes @param {number} at @returns {{tile: Tile, next: number}} */
function readTile(bytes, at = 0) {
  const head = new DataView(bytes, at, HEAD);
  const [size, stride, row, column, rows, columns, r0, c0] = [0, 1, 2, 3, 4, 5, 6, 7].map((k) => head.getInt32(4 * k, true));
  const count = rows * columns;
  const known = new Uint8Array(bytes, at + HEAD, count);
  const fields = [0, 1, 2, 3].map((k) => unpack(new Uint8Array(bytes, at + HEAD + count + 4 * k * count, 4 * count), columns, known, head.getFloat64(32, true)));
  return { tile: { stride, row, column, rows, columns, first: [r0, c0], fields }, next: at + size };
}

/** Undo what the server did so that the values pack well (viewer/surface.py): bytes apart, zigzag, differences along columns and rows. */
function unpack(bytes, columns, known, quantum) {
  const count = known.length;
  const whole = new Int32Array(count);
  const values = new Float32Array(count);
  for (let k = 0; k < count; k++) {
    const zigzag = bytes[k] | (bytes[count + k] << 8) | (bytes[2 * count + k] << 16) | (bytes[3 * count + k] << 24);
    const left = k % columns ? whole[k - 1] - (k > columns ? whole[k - columns - 1] : 0) : 0;
    whole[k] = ((zigzag >>> 1) ^ -(zigzag & 1)) + left + (k >= columns ? whole[k - columns] : 0);
    values[k] = known[k] ? whole[k] * quantum : NaN;
  }
  return values;
}

/** The tiles of the first view. @param {string} key @returns {Promise<Tile[]>} */
export async function getFirst(key) {
  const own = dropped.get(key);
  if (own) return own.meta.tiles[own.meta.strides[0]].map(([row, column]) => own.tile(own.meta.strides[0], row, column));
  const bytes = await getBytes(`api/result/${key}/first`);
  const found = [];
  for (let at = 0; at < bytes.byteLength; ) {
    const { tile, next } = readTile(bytes, at);
    found.push(tile);
    at = next;
  }
  return found;
}

/** @param {string} key @returns {Promise<Tile>} */
async function getTile(key, stride, row, column) {
  return dropped.get(key)?.tile(stride, row, column) ?? readTile(await getBytes(`api/result/${key}/tile/${stride}/${row}/${column}`)).tile;
}

/** Slope of the four fields' differences: columns and rows need not lie along x and y. */
function slope(dxc, dyc, dxr, dyr, dc, dr, out, at) {
  const det = dxc * dyr - dyc * dxr;
  out[at] = det === 0 ? 0 : (dc * dyr - dr * dyc) / det;
  out[at + 1] = det === 0 ? 0 : (dr * dxc - dc * dxr) / det;
}

/**
 * Triangles of a tile, with a skirt along its borders that hides cracks between levels.
 * @param {Tile} tile
 * @param {number[]} inputSize rows, columns of the input
 * @param {number} drop mm, depth of the skirt
 * @returns {BufferGeometry | null}
 */
export function makeGeometry(tile, inputSize, drop) {
  const { rows, columns, stride, first } = tile;
  const [x, y, z, ridge] = tile.fields;
  const vertexOf = new Int32Array(rows * columns).fill(-1);
  let count = 0;
  for (let r = 1; r < rows - 1; r++) {
    for (let c = 1; c < columns - 1; c++) {
      const k = r * columns + c;
      if (z[k] === z[k]) vertexOf[k] = count++;
    }
  }
  const border = [];
  for (let c = 1; c < columns - 1; c++) border.push([1, c], [rows - 2, c]);
  for (let r = 1; r < rows - 1; r++) border.push([r, 1], [r, columns - 2]);
  const most = count + border.length;
  const places = new Float32Array(3 * most);
  const ridges = new Float32Array(most);
  const slopes = new Float32Array(4 * most);
  const uv = new Float32Array(2 * most);
  for (let r = 1; r < rows - 1; r++) {
    for (let c = 1; c < columns - 1; c++) {
      const k = r * columns + c;
      const v = vertexOf[k];
      if (v < 0) continue;
      const left = z[k - 1] === z[k - 1] ? k - 1 : k;
      const right = z[k + 1] === z[k + 1] ? k + 1 : k;
      const up = z[k - columns] === z[k - columns] ? k - columns : k;
      const down = z[k + columns] === z[k + columns] ? k + columns : k;
      const dxc = x[right] - x[left], dyc = y[right] - y[left];
      const dxr = x[down] - x[up], dyr = y[down] - y[up];
      slope(dxc, dyc, dxr, dyr, z[right] - z[left], z[down] - z[up], slopes, 4 * v);
      slope(dxc, dyc, dxr, dyr, ridge[right] - ridge[left], ridge[down] - ridge[up], slopes, 4 * v + 2);
      places.set([x[k], y[k], z[k]], 3 * v);
      ridges[v] = ridge[k];
      uv[2 * v] = (first[1] + c * stride + 0.5) / inputSize[1];
      uv[2 * v + 1] = (first[0] + r * stride + 0.5) / inputSize[0];
    }
  }
  const faces = new Uint32Array(6 * (rows - 3) * (columns - 3) + 12 * border.length);
  let f = 0;
  const face = (a, b, c) => {
    faces[f++] = a;
    faces[f++] = b;
    faces[f++] = c;
  };
  for (let r = 1; r < rows - 2; r++) {
    for (let k = r * columns + 1; k < r * columns + columns - 2; k++) {
      const a = vertexOf[k], b = vertexOf[k + 1], c = vertexOf[k + columns], d = vertexOf[k + columns + 1];
      const missing = (a < 0) + (b < 0) + (c < 0) + (d < 0);
      if (missing === 0) {
        face(a, c, b);
        face(b, c, d);
      } else if (missing === 1) {
        const three = [a, c, d, b].filter((v) => v >= 0);
        face(three[0], three[1], three[2]);
      }
    }
  }
  if (f === 0) return null;
  let last = count;
  const lowered = new Map();
  const low = (v) => {
    if (!lowered.has(v)) {
      places.copyWithin(3 * last, 3 * v, 3 * v + 3);
      places[3 * last + 2] -= drop;
      slopes.copyWithin(4 * last, 4 * v, 4 * v + 4);
      uv.copyWithin(2 * last, 2 * v, 2 * v + 2);
      ridges[last] = ridges[v];
      lowered.set(v, last++);
    }
    return lowered.get(v);
  };
  // between the places k and m, where another tile goes on beyond them (at `beyond` from each); none at the finger's rim
  const wall = (k, m, beyond) => {
    const a = vertexOf[k], b = vertexOf[m];
    const around = [k, m, k + beyond, m + beyond, 2 * k - m, 2 * m - k];
    if (around.some((n) => z[n] !== z[n])) return;
    face(a, b, low(a));
    face(b, low(b), low(a));
  };
  for (let c = 1; c < columns - 2; c++) {
    wall(columns + c, columns + c + 1, -columns);
    wall((rows - 2) * columns + c + 1, (rows - 2) * columns + c, columns);
  }
  for (let r = 1; r < rows - 2; r++) {
    wall((r + 1) * columns + 1, r * columns + 1, -1);
    wall(r * columns + columns - 2, (r + 1) * columns + columns - 2, 1);
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(places.slice(0, 3 * last), 3));
  geometry.setAttribute("ridge", new BufferAttribute(ridges.slice(0, last), 1));
  geometry.setAttribute("slopes", new BufferAttribute(slopes.slice(0, 4 * last), 4));
  geometry.setAttribute("uv", new BufferAttribute(uv.slice(0, 2 * last), 2));
  geometry.setIndex(new BufferAttribute(faces.slice(0, f), 1));
  geometry.computeBoundingSphere();
  return geometry;
}

/** The tiles of one result, as a group of meshes of which those are seen that the view needs. */
export class Tiles {
  /**
   * @param {any} meta facts about a result
   * @param {import("../vendor/three/three.module.min.js").Material} material
   * @param {() => void} changed called when a tile has come
   */
  constructor(meta, material, changed) {
    this.meta = meta;
    this.material = material;
    this.changed = changed;
    this.group = new Group();
    /** @type {Map<string, any>} */
    this.nodes = new Map();
    this.waiting = [];
    this.asked = 0;
    this.clock = 0;
    this.frustum = new Frustum();
    this.matrix = new Matrix4();
    this.sphere = new Sphere();
    for (const stride of meta.strides) {
      for (const [row, column] of meta.tiles[stride]) {
        this.nodes.set(`${stride}/${row}/${column}`, { stride, row, column, mesh: null, state: "absent", used: 0, sphere: null });
      }
    }
  }

  /** @param {Tile[]} tiles of the first view */
  readFirst(tiles) {
    tiles.forEach((tile) => this.#put(tile));
  }

  #put(tile) {
    const node = this.nodes.get(`${tile.stride}/${tile.row}/${tile.column}`);
    if (!node) return;
    const geometry = makeGeometry(tile, this.meta.input_size, 1.5 * tile.stride * this.meta.pitch_mm);
    node.state = "here";
    if (!geometry) return;
    node.mesh = new Mesh(geometry, this.material);
    node.mesh.frustumCulled = false; // decided here, with room for the exaggerated relief
    node.mesh.visible = false;
    node.sphere = geometry.boundingSphere;
    this.group.add(node.mesh);
  }

  #seen(node) {
    if (!node.sphere) return true;
    this.sphere.copy(node.sphere).applyMatrix4(this.group.matrixWorld);
    this.sphere.radius += 10 * this.meta.highest_relief_mm;
    return this.frustum.intersectsSphere(this.sphere);
  }

  /**
   * Choose what is drawn.
   * @param {any} camera
   * @param {number} pxPerMm device pixels a mm on the screen
   * @param {number} pxPerValue how many pixels apart two values may lie
   * @returns {{points: number, stride: number, complete: boolean}}
   */
  choose(camera, pxPerMm, pxPerValue) {
    this.clock++;
    this.group.updateWorldMatrix(true, false);
    this.frustum.setFromProjectionMatrix(this.matrix.multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse));
    const strides = this.meta.strides;
    const wanted = strides.find((s) => s * this.meta.pitch_mm * pxPerMm <= pxPerValue) ?? 1;
    for (const mesh of this.group.children) mesh.visible = false;
    this.waiting.length = 0;
    const result = { points: 0, stride: wanted, complete: true };
    for (const [row, column] of this.meta.tiles[strides[0]]) this.#walk(strides[0], row, column, wanted, result);
    this.#fetchNext();
    this.#forget();
    return result;
  }

  #walk(stride, row, column, wanted, result) {
    const node = this.nodes.get(`${stride}/${row}/${column}`);
    if (!node || !this.#seen(node)) return;
    node.used = this.clock;
    if (stride > wanted) {
      const below = [];
      for (const r of [2 * row, 2 * row + 1]) {
        for (const c of [2 * column, 2 * column + 1]) {
          const child = this.nodes.get(`${stride / 2}/${r}/${c}`);
          if (child) below.push(child);
        }
      }
      const absent = below.filter((child) => child.state !== "here");
      if (absent.length === 0) {
        for (const child of below) this.#walk(child.stride, child.row, child.column, wanted, result);
        return;
      }
      result.complete = false;
      this.waiting.push(...absent.filter((child) => child.state === "absent"));
    }
    if (node.mesh) {
      node.mesh.visible = true;
      result.points += node.mesh.geometry.getAttribute("position").count;
    }
  }

  #fetchNext() {
    while (this.asked < AT_ONCE && this.waiting.length) {
      const node = this.waiting.shift();
      if (node.state !== "absent") continue;
      node.state = "asked";
      this.asked++;
      getTile(this.meta.key, node.stride, node.row, node.column)
        .then((tile) => this.#put(tile))
        .catch(() => (node.state = "failed"))
        .finally(() => {
          this.asked--;
          this.changed();
        });
    }
  }

  /** Drop what was not used for longest, never the first view. */
  #forget() {
    const root = this.meta.strides[0];
    const kept = [...this.nodes.values()].filter((node) => node.mesh && node.stride !== root && node.used !== this.clock);
    if (kept.length <= MAX_KEPT) return;
    kept.sort((a, b) => a.used - b.used);
    for (const node of kept.slice(0, kept.length - MAX_KEPT)) {
      this.group.remove(node.mesh);
      node.mesh.geometry.dispose();
      node.mesh = null;
      node.state = "absent";
    }
  }

  dispose() {
    for (const node of this.nodes.values()) node.mesh?.geometry.dispose();
  }
}

/** @param {any} meta @returns {{middle: Vector3, radius: number}} */
export function boundsOf(meta) {
  const low = new Vector3(...meta.low_mm);
  const high = new Vector3(...meta.high_mm);
  return { middle: low.clone().add(high).multiplyScalar(0.5), radius: 0.5 * low.distanceTo(high) };
}
