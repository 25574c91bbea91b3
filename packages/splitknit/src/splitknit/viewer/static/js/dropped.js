// A result folder that was dropped onto the page, read here: nothing of it is sent anywhere. It answers what the server
// answers about its own results, by the same definitions (viewer/surface.py).
const TILE = 96;
const FIRST_VIEW = 70_000;
const MAX_BYTES = 600_000_000;
const RIDGE_SIGMA_MM = 0.32;
const MAX_SAMPLES = 20_000;
const PICTURES = ["normals.png", "albedo.png", "specular.png"];

/** Folders with a height.npz among what was dropped or chosen. @param {{path: string, file: File}[]} files */
export function resultsIn(files) {
  const folders = new Map();
  for (const { path, file } of files) {
    const cut = path.lastIndexOf("/");
    const folder = path.slice(0, Math.max(0, cut));
    if (!folders.has(folder)) folders.set(folder, new Map());
    folders.get(folder).set(path.slice(cut + 1), file);
  }
  return [...folders].filter(([, named]) => named.has("height.npz")).map(([folder, named]) => ({ name: folder || "dropped", files: named }));
}

/** All files of what was dropped, with their paths; folders are read to a depth of 4. @param {FileSystemEntry[]} entries */
export async function filesOf(entries) {
  const found = [];
  const walk = async (entry, depth) => {
    if (entry.isFile) found.push({ path: entry.fullPath.replace(/^\//, ""), file: await new Promise((done, fail) => entry.file(done, fail)) });
    else if (depth < 4) {
      const reader = entry.createReader();
      for (let some; (some = await new Promise((done, fail) => reader.readEntries(done, fail))).length; ) {
        for (const one of some) await walk(one, depth + 1);
      }
    }
  };
  for (const entry of entries) await walk(entry, 0);
  return found;
}

/** Arrays of an .npz file by name (APPNOTE.TXT of ZIP, 4.3; NEP 1 of NumPy). @param {File} file @param {string[]} names */
async function readNpz(file, names) {
  const damaged = new Error(`${file.name} cannot be read: it is damaged, or no result's.`);
  const tail = new DataView(await file.slice(Math.max(0, file.size - 65_557)).arrayBuffer());
  let end = tail.byteLength - 22;
  while (end >= 0 && tail.getUint32(end, true) !== 0x06054b50) end--;
  if (end < 0) throw damaged;
  const start = tail.getUint32(end + 16, true);
  const list = new DataView(await file.slice(start, start + tail.getUint32(end + 12, true)).arrayBuffer());
  const members = new Map();
  for (let at = 0; at + 46 <= list.byteLength && list.getUint32(at, true) === 0x02014b50; ) {
    const length = list.getUint16(at + 28, true);
    const name = new TextDecoder().decode(new Uint8Array(list.buffer, at + 46, length)).replace(/\.npy$/, "");
    members.set(name, { method: list.getUint16(at + 10, true), packed: list.getUint32(at + 20, true), size: list.getUint32(at + 24, true), at: list.getUint32(at + 42, true) });
    at += 46 + length + list.getUint16(at + 30, true) + list.getUint16(at + 32, true);
  }
  const chosen = [...members].filter(([name]) => names.includes(name));
  if (chosen.reduce((sum, [, one]) => sum + one.size, 0) > MAX_BYTES) throw new Error(`${file.name} holds more than ${MAX_BYTES / 1e6} MB; open it with \`splitknit view\`.`);
  return Object.fromEntries(await Promise.all(chosen.map(async ([name, one]) => [name, await member(file, one, damaged)])));
}

async function member(file, { method, packed, size, at }, damaged) {
  const head = new DataView(await file.slice(at, at + 30).arrayBuffer());
  const from = at + 30 + head.getUint16(26, true) + head.getUint16(28, true);
  let stream = file.slice(from, from + packed).stream();
  if (method === 8) stream = stream.pipeThrough(new DecompressionStream("deflate-raw"));
  else if (method !== 0) throw damaged;
  const bytes = new Uint8Array(size);
  let filled = 0;
  for await (const piece of pieces(stream)) {
    if (filled + piece.length > size) throw damaged;
    bytes.set(piece, filled);
    filled += piece.length;
  }
  const long = bytes[6] === 1 ? 10 : 12;
  const length = bytes[6] === 1 ? bytes[8] + 256 * bytes[9] : new DataView(bytes.buffer).getUint32(8, true);
  const about = /'descr': '[<|](b1|u1|f4|f8|i8)', 'fortran_order': False, 'shape': \(([\d, ]*)\)/.exec(new TextDecoder().decode(bytes.slice(long, long + length)));
  if (filled !== size || !about) throw damaged;
  const kind = { b1: Uint8Array, u1: Uint8Array, f4: Float32Array, f8: Float64Array, i8: BigInt64Array }[about[1]];
  const shape = about[2].split(",").map((text) => text.trim()).filter(Boolean).map(Number);
  const data = new kind(bytes.buffer.slice(long + length));
  if (data.length !== shape.reduce((a, b) => a * b, 1)) throw damaged;
  return { data, shape };
}

async function* pieces(stream) {
  const reader = stream.getReader();
  for (let got; !(got = await reader.read()).done; ) yield got.value;
}

/** Size and resolution of a print from its PNG header; 500 ppi where it states none. */
async function sizeOf(file) {
  const head = new DataView(await file.slice(0, 65_536).arrayBuffer());
  if (head.byteLength < 33 || head.getUint32(0) !== 0x89504e47) return null;
  let ppi = 500;
  for (let at = 8; at + 21 <= head.byteLength; at += 12 + head.getUint32(at)) {
    if (head.getUint32(at + 4) === 0x70485973 && head.getUint8(at + 16) === 1) ppi = 0.0254 * head.getUint32(at + 8);
  }
  return { columns: head.getUint32(16), rows: head.getUint32(20), ppi };
}

export class Dropped {
  /** @param {string} key @param {string} name @param {Map<string, File>} files */
  constructor(key, name, files) {
    Object.assign(this, { key, name, files, urls: new Map() });
  }

  /** Read the arrays and the report. */
  async read() {
    const arrays = await readNpz(this.files.get("height.npz"), ["height_mm", "height_px", "ridge_mm", "ridge_px", "mask", "pitch_mm", "input_from_upright", "x_mm", "y_mm"]);
    let report = {};
    try {
      report = JSON.parse(await this.files.get("report.json").text()) ?? {};
    } catch {
      // facts are missing then
    }
    this.scaled = "height_mm" in arrays;
    const height = arrays.height_mm ?? arrays.height_px;
    const ridge = arrays.ridge_mm ?? arrays.ridge_px;
    const { mask, input_from_upright: matrix } = arrays;
    const like = (one) => one?.shape.length === 2 && one.shape.every((side, k) => side === mask?.shape[k]);
    if (!like(height) || !like(ridge) || matrix?.data.length !== 9 || (this.scaled && !(arrays.pitch_mm?.data[0] > 0))) throw new Error(`${this.name}: height.npz is not a result's; reconstruct the capture again.`);
    this.pitch = this.scaled ? arrays.pitch_mm.data[0] : 1;
    this.size = mask.shape;
    this.#turn(matrix.data);
    this.#crop(mask.data, height.data, ridge.data, like(arrays.x_mm) && like(arrays.y_mm) ? [arrays.x_mm.data, arrays.y_mm.data] : null);
    this.meta = this.#describe(report);
    this.meta.print = this.files.has("print.png") ? await sizeOf(this.files.get("print.png")) : null;
  }

  /** From (x, y) of the rig's frame to the upright one: a rotation. */
  #turn([a, b, , c, d]) {
    const det = a * d - b * c;
    const root = Math.sqrt(Math.abs(det)) * Math.sign(det);
    this.turn = [[d / root, b / root], [c / root, a / root]]; // the inverse, with rows upwards
  }

  #crop(mask, height, ridge, rays) {
    const [rows, columns] = this.size;
    let [top, bottom, left, right] = [rows, -1, columns, -1];
    for (let r = 0; r < rows; r++) {
      for (let c = 0; c < columns; c++) {
        const k = r * columns + c;
        if (!mask[k] || !Number.isFinite(height[k])) continue;
        top = Math.min(top, r);
        bottom = r;
        left = Math.min(left, c);
        right = Math.max(right, c);
      }
    }
    if (bottom < 0) throw new Error(`${this.name} holds no heights; reconstruct the capture again.`);
    this.corner = [top, left];
    const [h, w] = (this.shape = [bottom - top + 1, right - left + 1]);
    const [x, y, z, relief] = (this.fields = [0, 1, 2, 3].map(() => new Float32Array(h * w).fill(NaN)));
    const [[ta, tb], [tc, td]] = this.turn;
    this.count = 0;
    this.low = [Infinity, Infinity, Infinity];
    this.high = [-Infinity, -Infinity, -Infinity];
    this.highest = 0;
    for (let r = 0; r < h; r++) {
      for (let c = 0; c < w; c++) {
        const k = (r + top) * columns + c + left;
        if (!mask[k] || !Number.isFinite(height[k])) continue;
        const n = r * w + c;
        const px = rays ? rays[0][k] : (c + left - (columns - 1) / 2) * this.pitch;
        const py = rays ? rays[1][k] : ((rows - 1) / 2 - r - top) * this.pitch;
        x[n] = ta * px + tb * py;
        y[n] = tc * px + td * py;
        z[n] = height[k];
        relief[n] = Number.isFinite(ridge[k]) ? ridge[k] : 0;
        this.count++;
        this.highest = Math.max(this.highest, Math.abs(relief[n]));
        [x[n], y[n], z[n]].forEach((v, axis) => {
          if (v < this.low[axis]) this.low[axis] = v;
          if (v > this.high[axis]) this.high[axis] = v;
        });
      }
    }
  }

  #describe(report) {
    const text = (value) => (["string", "number"].includes(typeof value) ? String(value).slice(0, 300) : "");
    const { subject = {}, material } = report.capture ?? {};
    const size = this.high.map((v, k) => v - this.low[k]);
    let stride = 1;
    while (this.count / stride ** 2 > FIRST_VIEW) stride *= 2;
    const strides = [];
    for (let s = stride; s >= 1; s /= 2) strides.push(s);
    const step = this.scaled ? Math.max(1, Math.round(0.1 / this.pitch)) : 4;
    const some = [];
    for (let k = 0; k < this.fields[3].length; k += step * step) if (this.fields[3][k] === this.fields[3][k]) some.push(Math.abs(this.fields[3][k]));
    const widest = some.sort((a, b) => a - b)[Math.floor(0.98 * (some.length - 1))] ?? 0;
    const facts = [
      ["Preset", text(report.preset)],
      ["Size", `${size.map((v) => v.toFixed(this.scaled ? 1 : 0)).join(" x ")} ${this.scaled ? "mm" : "pixels, scale unknown"} (across, along, deep)`],
      ["Values", `${this.count.toLocaleString("en").replaceAll(",", " ")} heights, one every ${this.scaled ? `${(1000 * this.pitch).toFixed(1)} µm` : "pixel"}`],
      ["Material", text(material)],
      ["Reconstructed", text(report.written_at)],
      ["Source", "the folder that was dropped; it stays in this browser"],
    ];
    return {
      key: this.key,
      result: true,
      name: this.name,
      preset: text(report.preset),
      subject: text(subject.id),
      finger: text(subject.finger).replaceAll("_", " "),
      session: text(subject.session),
      warnings: Array.isArray(report.warnings) ? report.warnings.length : 0,
      thumb: this.files.has("preview.png"),
      pitch_mm: this.pitch,
      points: this.count,
      low_mm: this.low,
      high_mm: this.high,
      highest_relief_mm: this.highest,
      units: this.scaled ? ["mm", "µm", 1000] : ["px", "px", 1],
      relief_range_um: this.scaled ? Math.max(1, Math.ceil(1000 * widest)) : Math.max(0.1, Math.ceil(10 * widest) / 10),
      input_size: this.size,
      turn: this.turn,
      strides,
      tiles: Object.fromEntries(strides.map((s) => [s, this.#filled(s)])),
      pictures: PICTURES.filter((name) => this.files.has(name)),
      print: null,
      photos: [],
      facts: facts.filter(([, value]) => value),
      notes: Array.isArray(report.warnings) ? report.warnings.map(text) : [],
    };
  }

  #filled(stride) {
    const [h, w] = this.shape;
    const found = new Set();
    for (let r = 0; r < h; r += stride) {
      for (let c = 0; c < w; c += stride) {
        if (this.fields[2][r * w + c] === this.fields[2][r * w + c]) found.add(Math.floor(r / stride / TILE) * 1e5 + Math.floor(c / stride / TILE));
      }
    }
    return [...found].sort((a, b) => a - b).map((k) => [Math.floor(k / 1e5), k % 1e5]);
  }

  /** @returns {import("./tiles.js").Tile} */
  tile(stride, row, column) {
    const [h, w] = this.shape;
    const rows = Math.min(TILE + 3, Math.ceil(h / stride) + 2 - row * TILE);
    const columns = Math.min(TILE + 3, Math.ceil(w / stride) + 2 - column * TILE);
    const fields = this.fields.map((all) => {
      const some = new Float32Array(rows * columns).fill(NaN);
      for (let r = 0; r < rows; r++) {
        for (let c = 0; c < columns; c++) {
          const [y, x] = [(row * TILE - 1 + r) * stride, (column * TILE - 1 + c) * stride];
          if (y >= 0 && y < h && x >= 0 && x < w) some[r * columns + c] = all[y * w + x];
        }
      }
      return some;
    });
    return { stride, row, column, rows, columns, first: [(row * TILE - 1) * stride + this.corner[0], (column * TILE - 1) * stride + this.corner[1]], fields };
  }

  /** Where a file of the folder is. @param {string} name */
  url(name) {
    if (!this.urls.has(name) && this.files.has(name)) this.urls.set(name, URL.createObjectURL(this.files.get(name)));
    return this.urls.get(name) ?? "";
  }

  /** What the server would answer. @param {string} what @param {any} query */
  answer(what, query) {
    if (what === "") return this.meta;
    if (what === "pick") return { point_mm: this.#pick(query) };
    if (what === "section") return this.#section(query);
    return { minutiae: null, why_not: "Minutiae are found where the folder is named to `splitknit view`." };
  }

  /** Bilinear value of a field, NaN beyond the surface. */
  #sample(field, [column, row]) {
    const [h, w] = this.shape;
    const [c, r] = [Math.floor(column), Math.floor(row)];
    if (!(c >= 0 && r >= 0 && c < w && r < h)) return NaN;
    const [u, v] = [column - c, row - r];
    const all = this.fields[field];
    const at = (j, i, weight) => (weight === 0 ? 0 : j < h && i < w ? weight * all[j * w + i] : NaN);
    return at(r, c, (1 - u) * (1 - v)) + at(r, c + 1, u * (1 - v)) + at(r + 1, c, (1 - u) * v) + at(r + 1, c + 1, u * v);
  }

  /** Column and row where the surface has this x and y. */
  #locate(x, y) {
    const [[a, b], [c, d]] = this.turn;
    const grid = (right, up) => [(a * right + c * up) / this.pitch, -(b * right + d * up) / this.pitch];
    const [c0, r0] = grid(x, y);
    const place = [c0 + (this.size[1] - 1) / 2 - this.corner[1], r0 + (this.size[0] - 1) / 2 - this.corner[0]];
    for (let k = 0; k < 4; k++) {
      const [ex, ey] = [x - this.#sample(0, place), y - this.#sample(1, place)];
      if (!(Math.abs(ex) + Math.abs(ey) > 1e-6)) break;
      const [dc, dr] = grid(ex, ey);
      place[0] += dc;
      place[1] += dr;
    }
    return place;
  }

  #pick({ ox, oy, oz, dx, dy, dz, relief = 1 }) {
    const length = Math.hypot(dx, dy, dz);
    const unit = [dx / length, dy / length, dz / length];
    const margin = this.pitch + Math.abs(relief - 1) * this.highest;
    let [near, far] = [0, Infinity];
    [ox, oy, oz].forEach((o, axis) => {
      const ends = [this.low[axis] - margin, this.high[axis] + margin].map((v) => (v - o) / (unit[axis] || 1e-12));
      near = Math.max(near, Math.min(...ends));
      far = Math.min(far, Math.max(...ends));
    });
    if (!(far > near)) return null;
    const count = Math.min(MAX_SAMPLES, Math.max(16, Math.floor((far - near) / (0.5 * this.pitch))));
    let before = NaN;
    for (let k = 0; k < count; k++) {
      const t = near + ((far - near) * k) / (count - 1);
      const above = oz + t * unit[2] - this.#shown(this.#locate(ox + t * unit[0], oy + t * unit[1]), relief);
      if (before * above <= 0 && before !== above) {
        const hit = t - ((far - near) / (count - 1)) * (above / (above - before));
        const [x, y] = [ox + hit * unit[0], oy + hit * unit[1]];
        const z = this.#sample(2, this.#locate(x, y));
        return Number.isFinite(z) ? [x, y, z] : null;
      }
      before = above;
    }
    return null;
  }

  #shown([c, r], relief) {
    const z = this.#sample(2, [c, r]);
    if (relief === 1) return z;
    const across = (this.#sample(2, [c + 1, r]) - this.#sample(2, [c - 1, r])) / (2 * this.pitch);
    const along = (this.#sample(2, [c, r + 1]) - this.#sample(2, [c, r - 1])) / (2 * this.pitch);
    const facing = 1 / (1 + (across || 0) ** 2 + (along || 0) ** 2);
    return z + (relief - 1) * Math.min(1, 2 * facing) * this.#sample(3, [c, r]);
  }

  #section({ x0, y0, x1, y1 }) {
    const flat = Math.hypot(x1 - x0, y1 - y0);
    if (!(flat >= this.pitch)) return { why_not: "the two points are the same; choose two that are apart." };
    const count = Math.min(MAX_SAMPLES, Math.max(2, Math.ceil(flat / this.pitch))) + 1;
    const cut = { along_mm: [], x_mm: [], y_mm: [], height_mm: [], relief_um: [] };
    for (let k = 0; k < count; k++) {
      const f = k / (count - 1);
      const [x, y] = [x0 + f * (x1 - x0), y0 + f * (y1 - y0)];
      const place = this.#locate(x, y);
      const z = this.#sample(2, place);
      const known = Number.isFinite(z);
      cut.along_mm.push(f * flat);
      cut.x_mm.push(x);
      cut.y_mm.push(y);
      cut.height_mm.push(known ? z : null);
      cut.relief_um.push(known ? (this.scaled ? 1000 : 1) * this.#sample(3, place) : null);
    }
    const known = cut.relief_um.filter((v) => v !== null);
    if (!known.length) return { why_not: "no surface lies between the two points; choose points on the surface." };
    return { ...cut, figures: this.#figures(cut, known, flat) };
  }

  #figures({ along_mm: along, height_mm: height, relief_um: relief }, known, flat) {
    const last = height.length - 1;
    const rise = height[0] === null || height[last] === null ? null : height[last] - height[0];
    let path = 0;
    for (let k = 1; k <= last; k++) path += height[k] === null || height[k - 1] === null ? NaN : Math.hypot(along[k] - along[k - 1], height[k] - height[k - 1]);
    const mean = known.reduce((a, b) => a + b, 0) / known.length;
    const sorted = [...known].sort((a, b) => a - b);
    const percentile = (p) => {
      const at = (p / 100) * (sorted.length - 1);
      const low = Math.floor(at);
      return sorted[low] + (at - low) * ((sorted[low + 1] ?? sorted[low]) - sorted[low]);
    };
    const [ridges, period] = this.scaled ? countRidges(along, relief) : [null, null];
    return {
      flat_mm: flat,
      straight_mm: rise === null ? null : Math.hypot(flat, rise),
      along_surface_mm: Number.isFinite(path) ? path : null,
      height_difference_mm: rise,
      relief_um: percentile(95) - percentile(5),
      relief_rms_um: Math.sqrt(known.reduce((sum, v) => sum + (v - mean) ** 2, 0) / known.length),
      ridges,
      ridge_period_mm: period,
    };
  }
}

/** Ridges by the crossings of the mean of their surroundings; their mean distance. */
function countRidges(along, relief) {
  const sigma = Math.max(RIDGE_SIGMA_MM / (along[1] - along[0]), 0.3);
  const reach = Math.ceil(4 * sigma);
  const weights = Array.from({ length: reach + 1 }, (_, k) => Math.exp(-0.5 * (k / sigma) ** 2));
  const band = relief.map((v, k) => {
    if (v === null) return 0;
    let [sum, weight] = [0, 0];
    for (let n = -reach; n <= reach; n++) {
      const other = relief[k + n];
      if (other == null) continue;
      sum += weights[Math.abs(n)] * other;
      weight += weights[Math.abs(n)];
    }
    return v - sum / weight;
  });
  const known = band.filter((_, k) => relief[k] !== null);
  const mean = known.reduce((a, b) => a + b, 0) / known.length;
  const level = 0.35 * Math.sqrt(known.reduce((sum, v) => sum + (v - mean) ** 2, 0) / known.length);
  if (!(level > 0)) return [0, null];
  const places = [];
  let before = 0;
  band.forEach((v, k) => {
    const state = v > level ? 1 : v < -level ? -1 : 0;
    if (state === 1 && before === -1) places.push(along[k]);
    if (state) before = state;
  });
  return [places.length, places.length < 2 ? null : (places[places.length - 1] - places[0]) / (places.length - 1)];
}
