// The page: which results are shown, and the text about them. The address behind # holds the same, so that it can be kept.
import { about, address, catalogue as coming, dropped, getJson, pictureOf } from "./api.js";
import { showLegend } from "./colour.js";
import { listen } from "./keys.js";
import { Light } from "./light.js";
import { Measure, plain, save } from "./measure.js";
import { byId, make, trouble } from "./page.js";
import { showPeople } from "./people.js";
import { Photos } from "./photos.js";
import { Prints } from "./prints.js";
import { Results } from "./results.js";
import { getFirst } from "./tiles.js";
import { View } from "./view.js";

const TABS = ["surface", "print", "photos", "results", "people"];
const look = { colour: "clay", relief: 1, contours: 0, azimuth: 135, elevation: 39, lamp: "camera", tool: "turn" };
/** @type {any[]} facts about what is shown */
let metas = [];
/** @type {View[]} */
let views = [];
/** @type {any} */
let alignment = null;
/** @type {any} how much the second differs from the first */
let apart = null;
let shown = { result: "", beside: "" };
let turnOfMind = 0;
let contourStep = 0.5;
/** @type {any[]} what there is to choose from */
let listed = [];

const applyLook = () => views.forEach((view) => void view.apply().catch((error) => trouble(error.message)));
const light = new Light(look, applyLook);
const measure = new Measure(() => metas, () => views, () => alignment);
const photos = new Photos();
const prints = new Prints((key, marks, numbers) => views.filter((view) => view.meta.key === key).forEach((view) => view.showMinutiae(marks, numbers)));
/** @type {Results} */
let results;

/** @returns {{result: string, beside: string, tab: string}} */
function wanted() {
  const words = new URLSearchParams(location.hash.slice(1));
  return { result: words.get("result") ?? "", beside: words.get("beside") ?? "", tab: words.get("tab") ?? "" };
}

function go(change) {
  const words = new URLSearchParams(Object.entries({ ...wanted(), ...change }).filter(([, value]) => value !== ""));
  location.hash = words.toString();
}

async function start() {
  const catalogue = await coming;
  title(catalogue.title);
  listed = catalogue.results;
  results = new Results(listed, (key) => go({ result: key, beside: "", tab: "surface" }), (key) => go({ beside: key, tab: "surface" }));
  byId("tab-people").hidden = !catalogue.people;
  if (catalogue.people) showPeople(catalogue.people);
  offer();
  addEventListener("hashchange", () => void follow());
  if (!wanted().result && catalogue.chosen.length) {
    const [result, beside = ""] = catalogue.chosen;
    history.replaceState(null, "", `#${new URLSearchParams({ result, ...(beside && { beside }) })}`);
  }
  await follow();
}

function title(words) {
  byId("title").textContent = words;
  document.title = words ? `${words} · splitknit` : "splitknit";
}

/** All results, to choose from. */
function offer() {
  const choices = listed.filter((one) => one.result).map((one) => make("option", { value: one.key, textContent: [one.name, one.preset].filter(Boolean).join(" · ") }));
  byId("other").replaceChildren(make("option", { value: "", textContent: "nothing" }), ...choices);
  byId("beside").hidden = choices.length < 2;
}

/** Results that were dropped or chosen. @param {() => Promise<{path: string, file: File}[]>} coming */
async function take(coming) {
  trouble("");
  try {
    const { Dropped, resultsIn } = await import("./dropped.js");
    const found = resultsIn(await coming());
    if (!found.length) throw new Error("No height.npz is in there: drop a folder that `splitknit reconstruct` wrote. Photographs: start `splitknit view FOLDER`.");
    const keys = [];
    for (const { name, files } of found) {
      const one = new Dropped(`dropped${dropped.size}`, name, files);
      await one.read();
      dropped.set(one.key, one);
      listed.push(one.meta);
      keys.push(one.key);
    }
    offer();
    go(keys.length > 1 ? { result: "", beside: "", tab: "results" } : { result: keys[0], beside: "", tab: "surface" });
  } catch (error) {
    trouble(error.message);
  }
}

/** Show what the address names. */
async function follow() {
  const want = wanted();
  const first = byId("tab-people").hidden ? "results" : "people";
  const only = listed.find((one) => one.key === want.result)?.result === false;
  showTab(only ? "photos" : TABS.includes(want.tab) ? want.tab : want.result ? "surface" : first);
  for (const tab of ["surface", "print"]) byId(`tab-${tab}`).hidden = want.result === "" || only;
  byId("tab-photos").hidden = want.result === "";
  byId("tab-results").hidden = listed.length === 1 || !byId("tab-people").hidden;
  if (want.result !== shown.result || want.beside !== shown.beside) {
    shown = { result: want.result, beside: want.beside };
    try {
      await open(want.result, want.beside);
    } catch (error) {
      trouble(error.message);
    }
  }
  results.draw(want.result);
  openTab();
}

async function open(key, beside) {
  const turn = ++turnOfMind;
  trouble("");
  views.forEach((view) => view.dispose());
  views = [];
  metas = [];
  alignment = apart = null;
  delete document.body.dataset.pair;
  measure.clear();
  document.body.dataset.state = "loading";
  if (key === "") return;
  byId("view-a").replaceChildren(make("p", { className: "wait", textContent: "Reading …" }));
  byId("view-b").hidden = beside === "";
  const keys = [key, beside].filter((one) => one !== "");
  const gone = keys.find((one) => one.startsWith("dropped") && !dropped.has(one));
  if (gone) throw new Error("A folder that was dropped is forgotten when the page is loaded again: drop it again.");
  if (listed.find((one) => one.key === key)?.result === false) {
    photos.show(await about(key));
    document.body.dataset.state = "ready";
    return;
  }
  const points = keys.map(getFirst);
  points.forEach((coming) => coming.catch(() => {})); // what fails is said where it is used
  const found = await Promise.all(keys.map((one) => about(one)));
  if (turn !== turnOfMind) return;
  metas = found;
  performance.mark("facts are here");
  describe(metas[0]);
  title(metas.map((meta) => meta.name).join(" | "));
  prints.show(metas);
  photos.show(metas[0]);
  for (const [k, meta] of metas.entries()) {
    try {
      views.push(new View(byId(k === 0 ? "view-a" : "view-b"), meta, look, k === 0 && !keys.some((one) => dropped.has(one)) ? beside : ""));
    } catch {
      pictureInstead(byId(k === 0 ? "view-a" : "view-b"), meta);
    }
  }
  views.forEach(attend);
  await Promise.all(views.map((view) => view.load(points[metas.indexOf(view.meta)])));
  if (turn !== turnOfMind) return;
  await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
  performance.mark("first view");
  document.body.dataset.state = "ready";
  byId("other").value = beside;
  byId("alignment").textContent = "";
  if (metas.length > 1) await pair(turn);
}

/** Lay the second finger on the first. */
async function pair(turn) {
  if (metas.some((meta) => dropped.has(meta.key))) {
    byId("alignment").textContent = "Results that were dropped are shown as they lie. To see their difference, name both to `splitknit view`.";
    document.body.dataset.pair = "none";
    return;
  }
  byId("alignment").textContent = "They are being laid on each other …";
  const found = await getJson(`api/pair/${metas[0].key}/${metas[1].key}`);
  if (turn !== turnOfMind) return;
  if (!found.alignment) {
    byId("alignment").textContent = `They could not be laid on each other and are shown as they lie: ${found.why_not}`;
    document.body.dataset.pair = "none";
    return;
  }
  alignment = found.alignment;
  views[1]?.align(alignment);
  if (views[1] && byId("linked").checked) views[1].follow(views[0]);
  const deg = (angle) => `${((angle * 180) / Math.PI).toFixed(1)}°`;
  const how = {
    photographs: "Both are from the same photographs: laid on each other pixel by pixel, raised to the same mean height.",
    ridges: `Laid on each other by one rigid motion, found by the ridges, then fitted to heights and relief: similarity of the ridges ${alignment.similarity?.toFixed(2)} over ${alignment.overlap_mm2?.toFixed(0)} mm², turned by ${deg(alignment.turn_rad)}, tilted by ${deg(alignment.tilt_rad)}.`,
  }[alignment.how];
  apart = found.difference;
  const [unit, fine] = metas[0].units;
  const told = apart && `Second − first along the camera's axis: rms ${apart.rms_um.toFixed(1)} ${fine}, 95 % within ${apart.within_um.toFixed(1)} ${fine}, over ${apart.area_mm2.toFixed(0)} ${unit}²; reliefs differ by ${apart.relief_rms_um.toFixed(1)} ${fine} rms.`;
  const fit = found.pairs.length ? `${found.pairs.length} pairs of minutiae fit (Print).` : "";
  byId("alignment").textContent = [how, told, fit].filter(Boolean).join(" ");
  offerColours();
  prints.show(metas, found.pairs);
  openTab();
  document.body.dataset.pair = alignment.how;
}

/** @param {View} view */
function attend(view) {
  view.listeners.camera.push(() => {
    if (byId("linked").checked) views.filter((other) => other !== view).forEach((other) => other.follow(view));
  });
  listen(view, look, light, (one) => void choose(one, one.box.clientWidth / 2, one.box.clientHeight / 2));
  light.follow(view.canvas, () => look.tool === "light");
  let down = null;
  view.canvas.addEventListener("pointerdown", (event) => (down = { x: event.clientX, y: event.clientY }));
  view.canvas.addEventListener("pointerup", (event) => {
    const still = down && Math.hypot(event.clientX - down.x, event.clientY - down.y) < 5;
    down = null;
    if (look.tool !== "measure" || !still || event.button !== 0) return;
    const box = view.canvas.getBoundingClientRect();
    void choose(view, event.clientX - box.left, event.clientY - box.top);
  });
  useTool();
}

async function choose(view, x, y) {
  try {
    await measure.choose(view, x, y);
  } catch (error) {
    trouble(error.message);
  }
}

function useTool() {
  for (const view of views) {
    view.controls.enabled = look.tool !== "light";
    view.box.classList.toggle("measure", look.tool === "measure");
    view.box.classList.toggle("light", look.tool === "light");
    view.box.querySelector(".cross")?.remove();
    if (look.tool === "measure") view.box.append(make("div", { className: "cross" }));
  }
}

/** Facts and files of the first result. */
function describe(meta) {
  const rows = meta.facts.map(([name, value]) => make("tr", {}, make("th", { scope: "row", textContent: name }), make("td", { textContent: value })));
  byId("facts").tBodies[0].replaceChildren(...rows);
  byId("notes").replaceChildren(...meta.notes.map((note) => make("li", { textContent: note })));
  offerColours();
  for (const option of byId("other").options) option.disabled = option.value === meta.key;
  const [unit, , parts] = meta.units;
  contourStep = parts === 1 ? 10 ** Math.round(Math.log10((meta.high_mm[2] - meta.low_mm[2]) / 20)) : 0.5;
  byId("contour-step").textContent = `${contourStep} ${unit}`;
  document.querySelectorAll("[data-unit]").forEach((one) => (one.textContent = unit));
  look.contours = byId("contours").checked ? contourStep : 0;
  links();
}

function offerColours() {
  const [meta] = metas;
  for (const option of byId("colour").options) {
    const picture = ["normals", "albedo", "specular"].includes(option.value);
    option.disabled = (picture && !meta.pictures.includes(`${option.value}.png`)) || (option.value === "difference" && !apart);
  }
  if (byId("colour").selectedOptions[0].disabled) byId("colour").value = look.colour = "clay";
  showLegend(byId("legend"), look.colour, meta, apart);
}

function links() {
  const own = dropped.has(shown.result);
  const mesh = ["phalange.ply", "surface.ply"].find((name) => own && pictureOf(shown.result, name));
  for (const kind of ["ply", "stl", "glb"]) {
    const link = byId(`save-${kind}`);
    link.hidden = own && !(kind === "ply" && mesh);
    link.href = own ? (mesh ? pictureOf(shown.result, mesh) : "") : address(`api/result/${shown.result}/export/${kind}`, { step: byId("step").value });
    link.download = own ? (mesh ?? "") : "";
  }
  byId("step").parentElement.hidden = own;
}

/** Without WebGL there is still the picture that was written with the result. */
function pictureInstead(box, meta) {
  trouble("This browser cannot draw in 3D here (WebGL is off); a picture is shown instead. Sections, print and photographs work.");
  box.replaceChildren(make("img", { className: "instead", src: pictureOf(meta.key, "preview.png"), alt: `Shaded views of ${meta.name}` }));
}

function showTab(name) {
  for (const tab of TABS) {
    byId(tab).hidden = tab !== name;
    byId(`tab-${tab}`).setAttribute("aria-selected", String(tab === name));
    byId(`tab-${tab}`).tabIndex = tab === name ? 0 : -1;
  }
}

/** What is fetched only when it is looked at. */
function openTab() {
  if (!shown.result) return;
  if (!byId("print").hidden && metas.length) prints.open().catch((error) => trouble(error.message));
  if (!byId("photos").hidden) photos.open();
}

for (const tab of TABS) byId(`tab-${tab}`).addEventListener("click", () => go({ tab }));
byId("tabs").addEventListener("keydown", (event) => {
  const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  if (!step) return;
  const there = TABS.filter((tab) => !byId(`tab-${tab}`).hidden);
  const at = there.findIndex((tab) => byId(`tab-${tab}`) === document.activeElement);
  byId(`tab-${there[(at + step + there.length) % there.length]}`).focus();
});
byId("panel").addEventListener("submit", (event) => event.preventDefault());
document.querySelectorAll('input[name="tool"]').forEach((input) => input.addEventListener("change", () => {
  look.tool = input.value;
  useTool();
}));
document.querySelectorAll("[data-from]").forEach((button) => button.addEventListener("click", () => views[0]?.lookFrom(button.dataset.from)));
byId("colour").addEventListener("change", () => {
  look.colour = byId("colour").value;
  if (views[0]) showLegend(byId("legend"), look.colour, views[0].meta, apart);
  applyLook();
});
byId("relief").addEventListener("input", () => {
  look.relief = byId("relief").valueAsNumber;
  byId("relief-value").textContent = `${look.relief} x`;
  applyLook();
  measure.refresh();
});
byId("contours").addEventListener("change", () => {
  look.contours = byId("contours").checked ? contourStep : 0;
  applyLook();
});
byId("other").addEventListener("change", () => go({ beside: byId("other").value }));
byId("linked").addEventListener("change", () => {
  if (byId("linked").checked && views[1]) views[1].follow(views[0]);
});
byId("step").addEventListener("change", links);
byId("save-png").addEventListener("click", async () => {
  for (const view of views) save(await view.png(), `${plain(view.meta.name)}.png`);
});
addEventListener("resize", () => {
  if (!byId("print").hidden) byId("print-zoom").dispatchEvent(new Event("change"));
});

byId("open-folder").addEventListener("change", (event) => {
  const files = [...event.target.files].map((file) => ({ path: file.webkitRelativePath || file.name, file }));
  event.target.value = "";
  if (files.length) void take(async () => files);
});
for (const kind of ["dragenter", "dragover", "dragleave", "drop"]) {
  addEventListener(kind, (event) => {
    if (![...(event.dataTransfer?.types ?? [])].includes("Files")) return;
    event.preventDefault();
    document.body.classList.toggle("over", kind === "dragenter" || kind === "dragover");
    if (kind === "drop") {
      const entries = [...event.dataTransfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean); // gone when the event ends
      void take(async () => (await import("./dropped.js")).filesOf(entries));
    }
  });
}

performance.mark("page is here");
start().catch((error) => trouble(error.message));
