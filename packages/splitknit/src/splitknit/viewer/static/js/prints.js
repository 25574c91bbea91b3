// The print, as ink on paper, with its minutiae: circles end, squares fork.
import { about, pictureOf } from "./api.js";
import { byId, make } from "./page.js";

const NS = "http://www.w3.org/2000/svg";

export class Prints {
  /** @param {(key: string, marks: any[] | null, numbers: Map<number, number>) => void} onSurface shows minutiae on the surface, or takes them away */
  constructor(onSurface) {
    this.onSurface = onSurface;
    /** @type {any[]} */
    this.metas = [];
    this.marks = new Map();
    this.pairs = [];
    for (const id of ["show-minutiae", "on-surface", "least"]) byId(id).addEventListener("input", () => this.#draw());
    byId("print-zoom").addEventListener("change", () => this.#size());
  }

  /** @param {any[]} metas one or two results @param {number[][]} pairs of minutiae */
  show(metas, pairs = []) {
    this.metas = metas;
    this.pairs = pairs;
    this.shown = false;
    byId("on-surface").checked = false;
  }

  /** When the tab is opened: fetched only then. */
  async open() {
    if (this.shown) return;
    this.shown = true;
    const box = byId("prints");
    box.classList.toggle("two", this.metas.length > 1);
    box.replaceChildren();
    for (const meta of this.metas) {
      const figure = make("figure");
      box.append(figure);
      if (!meta.print) {
        figure.append(make("p", { textContent: `${meta.name} has no print.` }));
        continue;
      }
      const image = make("img", {
        src: pictureOf(meta.key, "print.png"),
        alt: `Print of ${meta.name}: ridges dark, mirrored as ink on paper, ${meta.print.ppi.toFixed(0)} pixels per inch`,
      });
      const svg = document.createElementNS(NS, "svg");
      svg.setAttribute("viewBox", `-0.5 -0.5 ${meta.print.columns} ${meta.print.rows}`);
      svg.setAttribute("aria-hidden", "true");
      figure.append(make("div", {}, make("div", { className: "sheet" }, image, svg), make("figcaption", {
        textContent: `${meta.name} · ${((meta.print.columns * 25.4) / meta.print.ppi).toFixed(1)} x ${((meta.print.rows * 25.4) / meta.print.ppi).toFixed(1)} mm · ${meta.print.ppi.toFixed(0)} ppi`,
      })));
    }
    this.#size();
    byId("print-words").textContent = "Minutiae are being found …";
    for (const meta of this.metas) {
      if (meta.print && !this.marks.has(meta.key)) this.marks.set(meta.key, await about(meta.key, "minutiae"));
    }
    this.#draw();
  }

  #size() {
    const wanted = byId("print-zoom").value;
    const figures = byId("prints").querySelectorAll("figure");
    figures.forEach((figure, k) => {
      const sheet = figure.querySelector(".sheet");
      const print = this.metas[k]?.print;
      if (!sheet || !print) return;
      figure.classList.toggle("fit", wanted === "fit");
      const room = Math.min((figure.clientWidth - 24) / print.columns, (figure.clientHeight - 64) / print.rows);
      const scale = wanted === "fit" ? Math.max(0.2, room) : Number(wanted) / devicePixelRatio;
      sheet.style.width = `${print.columns * scale}px`;
      sheet.style.height = `${print.rows * scale}px`;
    });
  }

  #draw() {
    const least = byId("least").valueAsNumber;
    byId("least-value").textContent = String(least);
    const words = [];
    this.metas.forEach((meta, side) => {
      const found = this.marks.get(meta.key);
      if (!found) return;
      const numbers = new Map(this.pairs.map((pair, n) => [pair[side], n + 1]));
      const svg = byId("prints").querySelectorAll("figure")[side]?.querySelector("svg");
      if (!found.minutiae) {
        words.push(found.why_not);
        return;
      }
      const some = found.minutiae.map((m, k) => ({ ...m, k })).filter((m) => m.quality >= least);
      svg.replaceChildren();
      if (byId("show-minutiae").checked) for (const m of some) svg.append(...mark(m, numbers.get(m.k)));
      this.onSurface(meta.key, byId("on-surface").checked ? found.minutiae.map((m) => (m.quality >= least ? m : { ...m, place_mm: null })) : null, numbers);
      const ends = some.filter((m) => m.kind === "ending").length;
      words.push(`${this.metas.length > 1 ? `${meta.name}: ` : ""}${ends} endings (circles), ${some.length - ends} bifurcations (squares)`);
    });
    if (this.pairs.length) words.push(`${this.pairs.length} pairs carry the same number`);
    byId("print-words").textContent = words.join(" · ");
  }
}

function mark(m, number) {
  const [x, y] = [m.x_px, m.y_px];
  const [dx, dy] = [Math.cos(m.direction_rad), -Math.sin(m.direction_rad)];
  const shape = m.kind === "ending" ? `M${x - 3.5} ${y}a3.5 3.5 0 1 0 7 0a3.5 3.5 0 1 0 -7 0` : `M${x - 3} ${y - 3}h6v6h-6z`;
  const path = `${shape}M${x + 3.5 * dx} ${y + 3.5 * dy}L${x + 11 * dx} ${y + 11 * dy}`;
  const made = ["halo", m.kind].map((name) => {
    const line = document.createElementNS(NS, "path");
    line.setAttribute("class", name);
    line.setAttribute("d", path);
    return line;
  });
  if (number !== undefined) {
    const text = document.createElementNS(NS, "text");
    text.setAttribute("x", String(x + 5));
    text.setAttribute("y", String(y - 4));
    text.textContent = String(number);
    made.push(text);
  }
  return made;
}
