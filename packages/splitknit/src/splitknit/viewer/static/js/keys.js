// The keyboard: while a surface has the focus; and ? anywhere, which lists the keys.
import { byId } from "./page.js";
import { COLOURS } from "./material.js";

const TURN = (5 * Math.PI) / 180;

/**
 * @param {import("./view.js").View} view
 * @param {any} look
 * @param {import("./light.js").Light} light
 * @param {(view: import("./view.js").View) => void} mark chooses the middle of the view as a point
 */
export function listen(view, look, light, mark) {
  view.canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (arrow && event.shiftKey) view.shift(30 * arrow[0], 30 * arrow[1]);
    else if (arrow) view.turn(TURN * arrow[0], TURN * arrow[1]);
    else if (event.key === "+" || event.key === "=") view.zoom(1.25);
    else if (event.key === "-") view.zoom(0.8);
    else if (event.key === "0") view.lookFrom("top");
    else if (event.key === "a" || event.key === "d") light.set({ azimuth: look.azimuth + (event.key === "a" ? 10 : -10) });
    else if (event.key === "w" || event.key === "s") light.set({ elevation: look.elevation + (event.key === "w" ? 5 : -5) });
    else if (event.key === "[" || event.key === "]") change("relief", Math.min(10, Math.max(0, look.relief + (event.key === "]" ? 0.5 : -0.5))));
    else if (event.key === "c") change("colour", nextColour(look.colour));
    else if (event.key === "l") byId("lamp").click();
    else if (event.key === "m") document.querySelector(`input[name="tool"][value="${look.tool === "measure" ? "turn" : "measure"}"]`).click();
    else if (event.key === "Enter" && look.tool === "measure") mark(view);
    else return;
    event.preventDefault();
  });
}

addEventListener("keydown", (event) => {
  const types = event.target instanceof HTMLInputElement && ["text", "number", "search"].includes(event.target.type);
  if (event.key !== "?" || types || document.querySelector("dialog[open]")) return;
  event.preventDefault();
  byId("help").showModal();
});
byId("show-help").addEventListener("click", () => byId("help").showModal());

function change(id, value) {
  byId(id).value = value;
  for (const event of ["input", "change"]) byId(id).dispatchEvent(new Event(event, { bubbles: true }));
}

function nextColour(colour) {
  const there = [...byId("colour").options].filter((option) => !option.disabled).map((option) => option.value);
  return there[(there.indexOf(colour) + 1) % there.length] ?? COLOURS[0];
}
