// A section as a curve: SVG, with a cursor for pointer and keys.
const NS = "http://www.w3.org/2000/svg";
const WIDTH = 340, HEIGHT = 170, LEFT = 40, RIGHT = 8, BOTTOM = 28;

function element(name, attributes, text) {
  const made = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  if (text !== undefined) made.textContent = text;
  return made;
}

/** @param {number} low @param {number} high @param {number} count @returns {number[]} round numbers between */
export function ticks(low, high, count) {
  const raw = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= raw);
  const first = Math.ceil(low / step - 1e-9);
  const found = [];
  for (let k = first; k * step <= high + 1e-9 * step; k++) found.push(Number((k * step).toPrecision(10)));
  return found;
}

/**
 * @param {HTMLElement} box
 * @param {{name: string, cut: any}[]} curves one or two sections
 * @param {"relief" | "height" | "difference"} kind
 * @param {string[]} units of heights and of the relief
 * @param {(k: number | null) => void} [pointed] receives which sample of the first curve the cursor is on
 */
export function showChart(box, curves, kind, units, pointed = () => {}) {
  const TOP = curves.length > 1 ? 22 : 8; // room for names
  const field = { relief: "relief_um", height: "height_mm", difference: "difference_um" }[kind];
  const lowest = kind === "height" ? Math.min(...curves.flatMap(({ cut }) => cut.height_mm.filter((v) => v !== null))) : 0;
  const series = curves.map(({ name, cut }) => ({ name, x: cut.along_mm, y: cut[field].map((v) => (v === null ? null : v - lowest)) }));
  const known = series.flatMap(({ y }) => y.filter((v) => v !== null));
  let [low, high] = [Math.min(...known), Math.max(...known)];
  const room = 0.05 * (high - low || 1);
  low -= room;
  high += room;
  const length = series[0].x[series[0].x.length - 1];
  const toX = (v) => LEFT + (v / length) * (WIDTH - LEFT - RIGHT);
  const toY = (v) => TOP + ((high - v) / (high - low)) * (HEIGHT - TOP - BOTTOM);
  const unit = units[kind === "height" ? 0 : 1];
  const svg = element("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", tabindex: 0 });
  svg.setAttribute("aria-label", `Section of the ${kind}: ${known.length ? `${Math.min(...known).toFixed(2)} to ${Math.max(...known).toFixed(2)} ${unit}` : "none"} over ${length.toFixed(2)} ${units[0]}. Left and right keys read values.`);
  for (const v of ticks(low, high, 6)) {
    svg.append(element("line", { class: "axis", x1: LEFT, x2: WIDTH - RIGHT, y1: toY(v), y2: toY(v) }));
    svg.append(element("text", { x: LEFT - 4, y: toY(v) + 3.5, "text-anchor": "end" }, String(v)));
  }
  for (const v of ticks(0, length, 5)) {
    svg.append(element("line", { class: "axis", x1: toX(v), x2: toX(v), y1: HEIGHT - BOTTOM, y2: HEIGHT - BOTTOM + 3 }));
    svg.append(element("text", { x: toX(v), y: HEIGHT - BOTTOM + 13, "text-anchor": "middle" }, String(v)));
  }
  svg.append(element("text", { x: WIDTH - RIGHT, y: HEIGHT - 3, "text-anchor": "end" }, `${units[0]} from A`));
  svg.append(element("text", { x: 2, y: HEIGHT - 3 }, unit));
  series.forEach(({ x, y }, side) => {
    let path = "";
    let pen = "M";
    y.forEach((v, k) => {
      if (v === null) pen = "M";
      else {
        path += `${pen}${toX(x[k]).toFixed(1)} ${toY(v).toFixed(1)}`;
        pen = "L";
      }
    });
    svg.append(element("path", { class: "ab"[side], d: path }));
  });
  if (series.length > 1) {
    series.forEach(({ name }, side) => {
      const at = LEFT + 6 + side * 150;
      svg.append(element("line", { class: "ab"[side], x1: at, x2: at + 18, y1: 8, y2: 8 }));
      svg.append(element("text", { x: at + 22, y: 11.5 }, name.length > 20 ? `…${name.slice(-19)}` : name));
    });
  }
  const cursor = element("line", { class: "cursor", y1: TOP, y2: HEIGHT - BOTTOM, visibility: "hidden" });
  const reading = element("text", { x: (WIDTH + LEFT) / 2, y: HEIGHT - 3, "text-anchor": "middle" }, "");
  svg.append(cursor, reading);
  let at = -1;
  const read = (k) => {
    at = Math.max(0, Math.min(series[0].x.length - 1, k));
    cursor.setAttribute("visibility", "visible");
    cursor.setAttribute("x1", String(toX(series[0].x[at])));
    cursor.setAttribute("x2", String(toX(series[0].x[at])));
    const values = series.map(({ y }) => (y[at] == null ? "–" : y[at].toFixed(kind === "height" ? 3 : 1)));
    reading.textContent = `${series[0].x[at].toFixed(2)} ${units[0]}: ${values.join(" | ")} ${unit}`;
    pointed(at);
  };
  svg.addEventListener("pointermove", (event) => {
    const place = svg.getBoundingClientRect();
    const fraction = (((event.clientX - place.left) / place.width) * WIDTH - LEFT) / (WIDTH - LEFT - RIGHT);
    read(Math.round(fraction * (series[0].x.length - 1)));
  });
  svg.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!step) return;
    event.preventDefault();
    read(at + step * (event.shiftKey ? 20 : 2));
  });
  box.replaceChildren(svg);
}
