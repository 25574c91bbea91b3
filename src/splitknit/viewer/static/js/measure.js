// Two points, the distance between them, and the section through the surface: numbers from the server, which has the result's values.
import { getJson } from "./api.js";
import { showChart } from "./chart.js";
import { byId, say, trouble } from "./page.js";

const FIGURES = [
  ["flat_mm", "Distance in the finger plane", "mm", 3],
  ["straight_mm", "Straight distance A to B", "mm", 3],
  ["along_surface_mm", "Along the surface, ridges included", "mm", 3],
  ["height_difference_mm", "Height of B over A", "mm", 3],
  ["relief_um", "Relief, valley to ridge (5–95 %)", "µm", 1],
  ["relief_rms_um", "Relief, rms", "µm", 1],
  ["ridges", "Ridges crossed", "", 0],
  ["ridge_period_mm", "Mean ridge distance", "mm", 3],
];

export class Measure {
  /**
   * @param {() => any[]} metas facts about the results that are shown
   * @param {() => import("./view.js").View[]} views their views; none where the browser cannot draw
   * @param {() => any} alignment of the second result
   */
  constructor(metas, views, alignment) {
    this.metas = metas;
    this.views = views;
    this.alignment = alignment;
    this.points = [];
    this.curves = [];
    byId("cut").addEventListener("click", () => this.#reported(this.#fromFields()));
    byId("across").addEventListener("click", () => this.#reported(this.#middle(0)));
    byId("along").addEventListener("click", () => this.#reported(this.#middle(1)));
    byId("clear").addEventListener("click", () => this.clear());
    byId("curve").addEventListener("change", () => this.#chart());
    byId("csv").addEventListener("click", () => this.#save());
    for (const id of ["x0", "y0", "x1", "y1"]) {
      byId(id).addEventListener("keydown", (event) => {
        if (event.key !== "Enter") return;
        event.preventDefault();
        this.#reported(this.#fromFields());
      });
    }
  }

  clear() {
    this.points = [];
    this.curves = [];
    byId("section").hidden = true;
    for (const id of ["x0", "y0", "x1", "y1"]) byId(id).value = "";
    this.#show();
  }

  /** Report what goes wrong. @param {Promise<void>} work */
  #reported(work) {
    work.catch((error) => trouble(error.message));
  }

  /** A point in a view was chosen. @param {import("./view.js").View} view @param {number} x @param {number} y */
  async choose(view, x, y) {
    const found = await view.pick(x, y);
    if (!found) {
      say("That is beside the finger.");
      return;
    }
    const place = view === this.views()[0] ? found : this.#toFirst(found);
    this.points = this.points.length === 1 ? [this.points[0], place] : [place];
    this.points.forEach(([px, py], k) => this.#fill(k, px, py));
    if (this.points.length === 2) await this.#cut();
    else {
      this.curves = [];
      byId("section").hidden = true;
      byId("x1").value = byId("y1").value = "";
      this.#show();
      say(`A is at ${place[0].toFixed(2)}, ${place[1].toFixed(2)} mm. Choose B.`);
    }
  }

  #fill(k, x, y) {
    byId(`x${k}`).value = x.toFixed(2);
    byId(`y${k}`).value = y.toFixed(2);
  }

  async #fromFields() {
    const numbers = ["x0", "y0", "x1", "y1"].map((id) => byId(id).valueAsNumber);
    if (numbers.some(Number.isNaN)) {
      say("Four numbers are needed: x and y of A and of B, in mm.");
      return;
    }
    this.points = [[numbers[0], numbers[1]], [numbers[2], numbers[3]]];
    await this.#cut();
  }

  /** Through the middle, across (axis 0) or along (axis 1). */
  async #middle(axis) {
    const { low_mm: low, high_mm: high } = this.metas()[0];
    const middle = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
    const reach = (axis === 0 ? 0.36 : 0.4) * (high[axis] - low[axis]);
    this.points = [-reach, reach].map((step) => middle.map((v, k) => (k === axis ? v + step : v)));
    this.points.forEach(([x, y], k) => this.#fill(k, x, y));
    await this.#cut();
  }

  async #cut() {
    const metas = this.metas();
    const cuts = await Promise.all(metas.map((meta, k) => {
      const [a, b] = k === 0 ? this.points : this.points.map((point) => this.#toSecond(point));
      return getJson(`api/result/${meta.key}/section`, { x0: a[0], y0: a[1], x1: b[0], y1: b[1] });
    }));
    if (cuts[0].why_not) {
      this.curves = [];
      byId("section").hidden = true;
      this.#show();
      say(cuts[0].why_not);
      return;
    }
    this.curves = cuts.map((cut, k) => ({ name: metas[k].name, cut })).filter(({ cut }) => !cut.why_not);
    byId("section").hidden = false;
    this.#chart();
    this.#table();
    this.#show();
    const { flat_mm: flat, relief_um: relief } = cuts[0].figures;
    say(`${flat.toFixed(2)} mm in the finger plane; relief ${relief.toFixed(0)} micrometres from valley to ridge.`);
  }

  /** Show points and curves in the views again, as after a change of the relief's exaggeration. */
  refresh() {
    this.#show();
  }

  #show() {
    this.views().forEach((view, k) => {
      const cut = this.curves[k]?.cut ?? null;
      view.showSection(cut, k === 0 ? "a" : "b");
      const ends = cut ? [0, cut.x_mm.length - 1].map((n) => [cut.x_mm[n], cut.y_mm[n], cut.height_mm[n] ?? view.meta.low_mm[2]]) : k === 0 ? this.points.filter((p) => p.length === 3) : [];
      view.showPoints(ends.map((place, n) => ({ text: "AB"[n], place })));
    });
  }

  #chart() {
    if (this.curves.length) showChart(byId("chart"), this.curves, byId("curve").value);
  }

  #table() {
    const body = byId("figures").tBodies[0];
    body.replaceChildren();
    if (this.curves.length > 1) {
      const row = body.insertRow();
      row.append(document.createElement("th"));
      for (const name of ["first, solid", "second, dashed"]) {
        const cell = document.createElement("th");
        cell.scope = "col";
        cell.style.textAlign = "right";
        cell.textContent = name;
        row.append(cell);
      }
    }
    for (const [key, words, unit, digits] of FIGURES) {
      const row = body.insertRow();
      const head = document.createElement("th");
      head.scope = "row";
      head.textContent = words;
      row.append(head);
      for (const { cut } of this.curves) {
        const value = cut.figures[key];
        const cell = row.insertCell();
        cell.dataset.figure = key;
        cell.textContent = value === null ? "–" : `${value.toFixed(digits)} ${unit}`.trim();
      }
    }
  }

  #save() {
    const head = ["along_mm", "x_mm", "y_mm", "height_mm", "relief_um"];
    const { name, cut } = this.curves[0];
    const rows = cut.along_mm.map((_, k) => head.map((key) => cut[key][k] ?? "").join(","));
    save(new Blob([[head.join(","), ...rows].join("\n") + "\n"], { type: "text/csv" }), `${plain(name)}-section.csv`);
  }

  #toSecond([x, y]) {
    const { turn_rad: t, right_mm: r, up_mm: u } = this.alignment() ?? { turn_rad: 0, right_mm: 0, up_mm: 0 };
    const [dx, dy] = [x - r, y - u];
    return [Math.cos(t) * dx + Math.sin(t) * dy, Math.cos(t) * dy - Math.sin(t) * dx];
  }

  #toFirst([x, y, z]) {
    const { turn_rad: t, right_mm: r, up_mm: u, raise_mm: h } = this.alignment() ?? { turn_rad: 0, right_mm: 0, up_mm: 0, raise_mm: 0 };
    return [Math.cos(t) * x - Math.sin(t) * y + r, Math.sin(t) * x + Math.cos(t) * y + u, z + h];
  }
}

/** @param {Blob} blob @param {string} name */
export function save(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** @param {string} name */
export function plain(name) {
  return name.replace(/[^A-Za-z0-9_-]+/g, "-").replace(/^-+|-+$/g, "") || "finger";
}
