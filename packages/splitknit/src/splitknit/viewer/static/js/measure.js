// Two points, the distance between them, and the section through the surface: numbers from the result's own values.
import { about, dropped, getJson } from "./api.js";
import { showChart } from "./chart.js";
import { byId, say, trouble } from "./page.js";

const FIGURES = [
  ["flat_mm", "Distance seen from above", 0, 3],
  ["straight_mm", "Straight distance A to B", 0, 3],
  ["along_surface_mm", "Along the surface, details included", 0, 3],
  ["height_difference_mm", "Height of B over A", 0, 3],
  ["relief_um", "Relief (5–95 %)", 1, 1],
  ["relief_rms_um", "Relief, rms", 1, 1],
  ["ridges", "Ridges crossed", null, 0],
  ["ridge_period_mm", "Mean ridge distance", 0, 3],
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
      say("That is beside the surface.");
      return;
    }
    const place = found;
    this.points = this.points.length === 1 ? [this.points[0], place] : [place];
    this.points.forEach(([px, py], k) => this.#fill(k, px, py));
    if (this.points.length === 2) await this.#cut();
    else {
      this.curves = [];
      byId("section").hidden = true;
      byId("x1").value = byId("y1").value = "";
      this.#show();
      say(`A is at ${place[0].toFixed(2)}, ${place[1].toFixed(2)} ${this.unit(0)}. Choose B.`);
    }
  }

  #fill(k, x, y) {
    byId(`x${k}`).value = x.toFixed(2);
    byId(`y${k}`).value = y.toFixed(2);
  }

  async #fromFields() {
    const numbers = ["x0", "y0", "x1", "y1"].map((id) => byId(id).valueAsNumber);
    if (numbers.some(Number.isNaN)) {
      say(`Four numbers are needed: x and y of A and of B, in ${this.unit(0)}.`);
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
    const [a, b] = this.points;
    const ends = { x0: a[0], y0: a[1], x1: b[0], y1: b[1] };
    const together = metas.length > 1 && !metas.some((meta) => dropped.has(meta.key));
    const cuts = together
      ? (await getJson(`api/pair/${metas[0].key}/${metas[1].key}/section`, ends)).cuts
      : await Promise.all(metas.map((meta) => about(meta.key, "section", ends)));
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
    const fine = this.unit(1) === "px" ? `${relief.toFixed(1)} pixels` : `${relief.toFixed(0)} micrometres`;
    say(`${flat.toFixed(2)} ${this.unit(0)} seen from above; relief ${fine} (5 to 95 %).`);
  }

  /** @param {0 | 1} which of lengths, or of the relief */
  unit(which) {
    return this.metas()[0]?.units[which] ?? ["mm", "µm"][which];
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
    if (!this.curves.length) return;
    const [first, second] = this.curves;
    const choice = byId("curve");
    choice.namedItem("curve-difference").hidden = choice.namedItem("curve-difference").disabled = !(second && this.alignment());
    if (choice.selectedOptions[0].disabled) choice.value = "relief";
    let curves = this.curves;
    if (choice.value === "difference") {
      const parts = this.metas()[0].units[2];
      const apart = first.cut.height_mm.map((v, k) => (v === null || second.cut.height_mm[k] === null ? null : parts * (second.cut.height_mm[k] - v)));
      curves = [{ name: "second − first", cut: { along_mm: first.cut.along_mm, difference_um: apart } }];
    }
    showChart(byId("chart"), curves, choice.value, this.metas()[0].units);
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
    const opaque = this.metas().every(({ facts }) => facts.some(([name, value]) => name === "Material" && value === "opaque"));
    for (const [key, words, unit, digits] of FIGURES) {
      if (opaque && key.startsWith("ridge")) continue;
      const row = body.insertRow();
      const head = document.createElement("th");
      head.scope = "row";
      head.textContent = words;
      row.append(head);
      for (const { cut } of this.curves) {
        const value = cut.figures[key];
        const cell = row.insertCell();
        cell.dataset.figure = key;
        const places = this.unit(0) === "px" && unit === 0 ? 1 : digits;
        cell.textContent = value === null ? "–" : `${value.toFixed(places)} ${unit === null ? "" : this.unit(unit)}`.trim();
      }
    }
  }

  #save() {
    const keys = ["along_mm", "x_mm", "y_mm", "height_mm", "relief_um"];
    const head = keys.map((key) => (this.unit(0) === "px" ? key.replace(/_(mm|um)$/, "_px") : key));
    const { name, cut } = this.curves[0];
    const rows = cut.along_mm.map((_, k) => keys.map((key) => cut[key][k] ?? "").join(","));
    save(new Blob([[head.join(","), ...rows].join("\n") + "\n"], { type: "text/csv" }), `${plain(name)}-section.csv`);
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
  return name.replace(/[^A-Za-z0-9_-]+/g, "-").replace(/^-+|-+$/g, "") || "surface";
}
