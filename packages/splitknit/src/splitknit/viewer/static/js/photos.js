// Photographs, straight from their folder: one large, the lights switched by slider, keys, or by dragging the lamp.
import { address } from "./api.js";
import { byId, make, say } from "./page.js";

const BANDS = { white: "White light", white_crossed: "White light, crossed films", nir: "Near infrared" };
const NS = "http://www.w3.org/2000/svg";
const PLAY_MS = 400;

export class Photos {
  constructor() {
    this.at = 0;
    byId("photo-before").addEventListener("click", () => this.#show(this.at - 1));
    byId("photo-after").addEventListener("click", () => this.#show(this.at + 1));
    byId("photo-at").addEventListener("input", () => this.#show(byId("photo-at").valueAsNumber - 1));
    byId("photo-play").addEventListener("click", () => this.#play(!this.timer));
    byId("photo-bright").addEventListener("input", () => this.#brighten());
    byId("photos").addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (!step || event.target instanceof HTMLInputElement) return;
      event.preventDefault();
      this.#show(this.at + step);
    });
    byId("copy").addEventListener("click", async () => {
      await navigator.clipboard.writeText(byId("command").textContent);
      byId("copy").textContent = "Copied";
      setTimeout(() => (byId("copy").textContent = "Copy"), 2000);
    });
    const map = byId("lights");
    for (const kind of ["pointerdown", "pointermove"]) {
      map.addEventListener(kind, (event) => {
        if (event.buttons & 1) this.#aim(event);
      });
    }
  }

  /** @param {any} meta */
  show(meta) {
    this.meta = meta;
    this.shown = false;
    this.#play(false);
    if (!meta.result) this.open();
  }

  open() {
    if (this.shown) return;
    this.shown = true;
    this.images = new Map();
    const { photos, name, command = "", notes, facts } = this.meta;
    byId("photos-words").textContent = photos.length
      ? `${photos.length} photographs of ${name}, one for each light, straight from their folder.`
      : "The photographs are not at hand. Start `splitknit view` with --capture FOLDER to see them.";
    byId("light-table").hidden = photos.length === 0;
    byId("photo-about").hidden = !command;
    byId("command").textContent = command;
    byId("photo-plain").hidden = !this.meta.plain;
    byId("photo-notes").replaceChildren(...(command ? notes : []).map((note) => make("li", { textContent: note })));
    const rows = command ? facts : [];
    byId("photo-facts").tBodies[0].replaceChildren(...rows.map(([key, value]) => make("tr", {}, make("th", { scope: "row", textContent: key }), make("td", { textContent: value }))));
    byId("photo-at").max = String(photos.length);
    let band = "";
    byId("photo-grid").replaceChildren(...photos.flatMap((photo, k) => {
      const image = make("img", { loading: "lazy", alt: "", src: this.#source(k, 320) });
      const button = make("button", { type: "button" }, image, make("span", { textContent: `${photo.number + 1} · ${photo.name}` }));
      button.setAttribute("aria-label", `Show photograph ${k + 1}, ${photo.name}`);
      button.addEventListener("click", () => {
        this.#show(k);
        byId("light-table").scrollIntoView({ block: "nearest" });
      });
      const head = photo.band !== band ? [make("h2", { textContent: BANDS[photo.band] ?? photo.band })] : [];
      band = photo.band;
      return [...head, button];
    }));
    if (photos.length) this.#show(0);
  }

  #source(k, width) {
    return address(`api/result/${this.meta.key}/photo/${k}`, { width });
  }

  #image(k) {
    if (!this.images.has(k)) this.images.set(k, make("img", { src: this.#source(k, 1400), alt: `Photograph ${k + 1}, ${this.meta.photos[k].name}` }));
    return this.images.get(k);
  }

  #show(k) {
    const { photos } = this.meta;
    this.at = (k + photos.length) % photos.length;
    const photo = photos[this.at];
    const image = this.#image(this.at);
    const change = () => {
      if (image === this.#image(this.at)) byId("photo-large").replaceChildren(image);
      this.#brighten();
      this.#image((this.at + 1) % photos.length); // fetched ahead
    };
    if (byId("photo-large").childElementCount) image.decode().then(change, change);
    else change();
    const words = [`${this.at + 1} of ${photos.length}`, `${BANDS[photo.band] ?? photo.band} ${photo.number + 1}`, photo.name, fromWhere(photo.light)].filter(Boolean).join(" · ");
    byId("photo-words").textContent = words;
    byId("photo-at").value = String(this.at + 1);
    byId("photo-at-value").textContent = String(this.at + 1);
    byId("photo-at").setAttribute("aria-valuetext", words);
    byId("photo-grid").querySelectorAll("button").forEach((button, n) => button.toggleAttribute("aria-current", n === this.at));
    if (!this.timer) say(words);
    this.#map();
  }

  /** Where the lights of this band are: overhead in the middle, level with the object at the rim. */
  #map() {
    const { photos } = this.meta;
    const { band } = photos[this.at];
    const map = byId("lights");
    const some = photos.map((photo, k) => ({ ...photo, k })).filter((photo) => photo.light && photo.band === band);
    map.parentElement.hidden = some.length === 0;
    map.replaceChildren(...some.sort((a) => (a.k === this.at ? 1 : -1)).map(({ light: [x, y], k }) => {
      const dot = document.createElementNS(NS, "circle");
      const values = { cx: 46 * x, cy: -46 * y, r: k === this.at ? 6 : 3.5, class: k === this.at ? "on" : "" };
      for (const [name, value] of Object.entries(values)) dot.setAttribute(name, String(value));
      return dot;
    }));
  }

  #aim(event) {
    const { photos } = this.meta;
    const box = byId("lights").getBoundingClientRect();
    const [x, y] = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height].map((v) => (2 * v - 1) / 0.92);
    const far = ({ light, band }) => (light && band === photos[this.at].band ? Math.hypot(light[0] - x, light[1] + y) : Infinity);
    const nearest = photos.reduce((best, photo, k) => (far(photo) < far(photos[best]) ? k : best), this.at);
    if (nearest !== this.at) this.#show(nearest);
  }

  #brighten() {
    const times = byId("photo-bright").valueAsNumber;
    byId("photo-bright-value").textContent = `${times} x`;
    const image = byId("photo-large").firstElementChild;
    if (image) image.style.filter = times === 1 ? "" : `brightness(${times})`;
  }

  #play(on) {
    clearInterval(this.timer);
    this.timer = on ? setInterval(() => (byId("photos").hidden ? this.#play(false) : this.#show(this.at + 1)), PLAY_MS) : 0;
    byId("photo-play").textContent = on ? "Stop" : "Play";
  }
}

/** @param {number[] | null} light unit vector towards it */
function fromWhere(light) {
  if (!light) return "";
  const azimuth = Math.round(((Math.atan2(light[1], light[0]) * 180) / Math.PI + 360) % 360) % 360;
  return `light from ${azimuth}°, ${Math.round((Math.asin(light[2]) * 180) / Math.PI)}° high`;
}
