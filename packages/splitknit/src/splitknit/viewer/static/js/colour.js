// Colour maps that colour-blind readers can distinguish; the same stops as the report's (io/pictures.py).

/** Cividis (Nunez, Anderton and Renslow 2018). */
const CIVIDIS = [
  [0, 34, 78], [8, 51, 112], [53, 69, 108], [79, 87, 108], [102, 105, 112], [125, 124, 120],
  [148, 142, 119], [174, 163, 113], [200, 184, 102], [229, 207, 82], [254, 232, 56],
];
/** Blue for low, white for zero, orange for high. */
const DIVERGING = [[5, 48, 97], [67, 147, 195], [247, 247, 247], [253, 174, 97], [165, 60, 10]];
const GREY = [[0, 0, 0], [255, 255, 255]];

const STOPS = { height: CIVIDIS, relief: DIVERGING, difference: DIVERGING, albedo: GREY, specular: GREY };

/**
 * @param {"height" | "relief" | "difference" | "albedo" | "specular"} name
 * @param {number} count
 * @returns {Uint8Array} RGBA of `count` colours
 */
export function ramp(name, count = 256) {
  const stops = STOPS[name];
  const table = new Uint8Array(4 * count);
  for (let k = 0; k < count; k++) {
    const place = (k / (count - 1)) * (stops.length - 1);
    const low = Math.min(Math.floor(place), stops.length - 2);
    for (let c = 0; c < 3; c++) {
      table[4 * k + c] = Math.round(stops[low][c] + (place - low) * (stops[low + 1][c] - stops[low][c]));
    }
    table[4 * k + 3] = 255;
  }
  return table;
}

/**
 * Show what the colours mean; as text too, for those who do not see them.
 * @param {HTMLElement} box
 * @param {string} colour
 * @param {any} meta facts about the result
 * @param {any} apart figures of the difference, or null
 */
export function showLegend(box, colour, meta, apart) {
  box.replaceChildren();
  box.hidden = colour === "clay" || (colour === "difference" && !apart);
  if (box.hidden) return;
  const [unit, fine, parts] = meta.units;
  const ends = (most) => [`−${most.toFixed(parts === 1 && most < 10 ? 1 : 0)}`, `+${most.toFixed(parts === 1 && most < 10 ? 1 : 0)}`];
  const around = (most, words) => [ends(most)[0], words, ends(most)[1]];
  const texts = {
    height: ["0", "height", `${(meta.high_mm[2] - meta.low_mm[2]).toFixed(1)} ${unit}`],
    relief: around(meta.relief_range_um, `relief, ${fine}`),
    difference: apart ? around(apart.range_um, `second − first, ${fine}`) : [],
    albedo: ["dark", "albedo", "bright"],
    specular: ["dark", "specular image", "bright"],
    normals: ["red: right", "green: tip", "blue: camera"],
  }[colour];
  if (colour !== "normals") {
    const canvas = document.createElement("canvas");
    canvas.width = 256;
    canvas.height = 1;
    const image = new ImageData(new Uint8ClampedArray(ramp(/** @type {any} */ (colour))), 256, 1);
    canvas.getContext("2d").putImageData(image, 0, 0);
    box.append(canvas);
  }
  const words = document.createElement("div");
  for (const text of texts) words.append(Object.assign(document.createElement("span"), { textContent: text }));
  box.append(words);
  box.setAttribute("aria-label", `Colour scale: ${texts.join(", ")}`);
}
