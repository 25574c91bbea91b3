// The live page: asks for the newest frame again and again, colours its heights, and shows the one under the pointer.
import { ramp } from "./colour.js";
import { byId, make, trouble } from "./page.js";

const meta = await (await fetch("api/live")).json();
const map = byId("heights");
/** What is shown: heights in um, their size, and the facts of the frame. */
let shown = { rows: 0, columns: 0, heights: new Float32Array(0), facts: {} };
let held = false;
let at = null;
/** Ends of the colours, um; they follow the frames slowly, so that colours do not flicker. */
let ends = null;

document.title = `${meta.source} · splitknit live`;
byId("title").textContent = meta.title;
for (const button of document.querySelectorAll("[data-action]")) {
  button.hidden = !meta.actions.includes(button.id);
  button.addEventListener("click", () => act(button.id));
}

async function act(path) {
  const answer = await fetch(`api/live/${path}`, { method: "POST" }).catch(() => null);
  if (!answer) return trouble("The server no longer answers. Start `splitknit view` again.");
  const words = answer.ok ? (await answer.json()).done : (await answer.text()).trim();
  byId("said").textContent = words;
  return answer.ok;
}

async function hold() {
  if (!(await act(`hold?on=${held ? 0 : 1}`))) return;
  held = !held;
  byId("hold").textContent = held ? "Go on" : "Freeze";
  byId("hold").setAttribute("aria-pressed", String(held));
}
byId("hold").addEventListener("click", hold);
addEventListener("keydown", (event) => {
  if (event.key === " " && !/BUTTON|SELECT|INPUT/.test(document.activeElement?.tagName ?? "")) {
    event.preventDefault();
    hold();
  }
});

/** Colour stops of the chosen look, and where zero and full lie. */
function look() {
  const colour = byId("colour").value;
  const fixed = Number(byId("range").value);
  let [low, high] = ends;
  if (fixed) [low, high] = colour === "relief" ? [-fixed, fixed] : [ends[0], ends[0] + fixed];
  else if (colour === "relief") [low, high] = [-Math.max(-low, high), Math.max(-low, high)];
  return { colour, low, high: Math.max(high, low + 0.1) };
}

/** Follow the 1st and 99.8th percentile of a sample. */
function follow(heights) {
  const sample = heights.filter((value, k) => k % 37 === 0 && Number.isFinite(value)).sort();
  if (!sample.length) return;
  const now = [sample[Math.floor(0.01 * sample.length)], sample[Math.floor(0.998 * (sample.length - 1))]];
  ends = ends && !held ? ends.map((old, k) => old + 0.3 * (now[k] - old)) : now;
}

function draw() {
  const { rows, columns, heights } = shown;
  if (!rows || !ends) return;
  const { colour, low, high } = look();
  const image = new ImageData(columns, rows);
  const pixels = new Uint32Array(image.data.buffer);
  const table = new Uint32Array(ramp(colour === "shaded" ? "albedo" : colour).buffer);
  const scale = 255 / (high - low);
  if (colour === "shaded") {
    const gain = 1 / (1000 * meta.pitch_mm); // um a pixel to slope
    for (let k = columns; k < pixels.length; k++) {
      const slope = (heights[k] - heights[k - 1] + (heights[k] - heights[k - columns])) * gain;
      pixels[k] = table[Math.max(0, Math.min(255, 140 + 180 * slope)) | 0];
    }
  } else for (let k = 0; k < pixels.length; k++) pixels[k] = table[Math.max(0, Math.min(255, (heights[k] - low) * scale)) | 0];
  map.width = columns;
  map.height = rows;
  map.getContext("2d").putImageData(image, 0, 0);
  byId("map").hidden = byId("look").hidden = byId("value").hidden = false;
  const legend = byId("legend");
  legend.hidden = colour === "shaded";
  const strip = new ImageData(new Uint8ClampedArray(table.buffer), 256, 1);
  byId("ramp").getContext("2d").putImageData(strip, 0, 0);
  const [least, , most] = legend.querySelectorAll("span");
  least.textContent = low.toFixed(0);
  most.textContent = high.toFixed(0);
  legend.setAttribute("aria-label", `Colour scale: ${low.toFixed(0)} to ${high.toFixed(0)} µm`);
  drawScale();
  showValue();
}

/** Where the map is drawn in its canvas's box (object-fit: contain), CSS pixels. */
function fit() {
  const box = map.getBoundingClientRect();
  const scale = Math.min(box.width / shown.columns, box.height / shown.rows);
  return { scale, left: box.left + (box.width - scale * shown.columns) / 2, top: box.top + (box.height - scale * shown.rows) / 2 };
}

function drawScale() {
  const bar = document.querySelector(".live .scale");
  const px = fit().scale / meta.pitch_mm; // CSS pixels a mm
  const steps = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20];
  const length = steps.find((one) => one * px > 60) ?? 50;
  bar.querySelector("span").textContent = length < 1 ? `${length * 1000} µm` : `${length} mm`;
  bar.querySelector("i").style.width = `${length * px}px`;
  bar.hidden = false;
}

function showValue() {
  if (!at) return;
  const [column, row] = at;
  const value = shown.heights[row * shown.columns + column];
  byId("height").textContent = Number.isFinite(value) ? `${value.toFixed(1)} µm` : "–";
  byId("place").textContent = `${(column * meta.pitch_mm).toFixed(3)}, ${((shown.rows - 1 - row) * meta.pitch_mm).toFixed(3)} mm`;
}

function point(column, row) {
  const within = (value, count) => Math.max(0, Math.min(count - 1, Math.round(value)));
  at = [within(column, shown.columns), within(row, shown.rows)];
  showValue();
}
map.tabIndex = 0;
map.addEventListener("pointermove", (event) => {
  const { scale, left, top } = fit();
  point((event.clientX - left) / scale - 0.5, (event.clientY - top) / scale - 0.5);
});
map.addEventListener("keydown", (event) => {
  const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  if (!step) return;
  event.preventDefault();
  const [column, row] = at ?? [shown.columns / 2, shown.rows / 2];
  const far = event.shiftKey ? 10 : 1;
  point(column + far * step[0], row + far * step[1]);
});
for (const id of ["colour", "range"]) byId(id).addEventListener("change", draw);
addEventListener("resize", draw);

function facts(frame) {
  const rows = { ...meta.facts, ...frame.facts, "frames dropped": frame.dropped };
  byId("facts").tBodies[0].replaceChildren(
    ...Object.entries(rows).map(([name, value]) => make("tr", {}, make("th", { scope: "row", textContent: name }), make("td", { textContent: String(value) }))),
  );
  byId("rate").textContent = held ? "frozen" : `${frame.per_second.toFixed(1)} frames a second`;
}

async function photograph(bytes) {
  const picture = await createImageBitmap(new Blob([bytes], { type: "image/jpeg" }));
  const canvas = byId("camera");
  canvas.width = picture.width;
  canvas.height = picture.height;
  canvas.getContext("2d").drawImage(picture, 0, 0);
}

/** One frame after the other: the next is asked for when this one is drawn, and never more than one is on its way. */
for (;;) {
  let answer;
  try {
    answer = await fetch(`api/live/frame?after=${shown.facts.number ?? 0}`);
    if (!answer.ok) throw new Error((await answer.text()).trim());
  } catch (error) {
    trouble(error instanceof TypeError ? "The server no longer answers. Start `splitknit view` again." : error.message);
    document.body.dataset.state = "ended";
    break;
  }
  const body = await answer.arrayBuffer();
  if (!body.byteLength) continue;
  const frame = JSON.parse(answer.headers.get("X-Frame"));
  const count = frame.rows * frame.columns;
  shown = { rows: frame.rows, columns: frame.columns, heights: new Float32Array(body, 0, count), facts: frame };
  follow(shown.heights);
  draw();
  facts(frame);
  await photograph(body.slice(4 * count));
  document.body.dataset.state = "ready";
  document.body.dataset.frames = String(Number(document.body.dataset.frames ?? 0) + 1);
  await new Promise(requestAnimationFrame); // nothing is asked for while the page is hidden
}
