// The photographs a result was made from, straight from the capture's folder.
import { address } from "./api.js";
import { byId, make } from "./page.js";

const BANDS = { white: "White light", nir: "Near infrared" };

export class Photos {
  constructor() {
    this.at = 0;
    byId("photo-before").addEventListener("click", () => this.#large(this.at - 1));
    byId("photo-after").addEventListener("click", () => this.#large(this.at + 1));
    byId("photo-large").addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (step) this.#large(this.at + step);
    });
  }

  /** @param {any} meta */
  show(meta) {
    this.meta = meta;
    this.shown = false;
  }

  open() {
    if (this.shown) return;
    this.shown = true;
    const grid = byId("photo-grid");
    grid.replaceChildren();
    const { photos, key } = this.meta;
    byId("photos-words").textContent = photos.length
      ? `${photos.length} photographs of ${this.meta.name}, one for each LED, as they lie in the capture's folder.`
      : "The photographs are not at hand. Start `splitknit view` with --capture FOLDER to see them.";
    let band = "";
    photos.forEach((photo, k) => {
      if (photo.band !== band) {
        band = photo.band;
        grid.append(make("h2", { textContent: BANDS[band] ?? band }));
      }
      const image = make("img", { loading: "lazy", alt: "", src: address(`api/result/${key}/photo/${k}`, { width: 320 }) });
      const button = make("button", { type: "button" }, image, make("span", { textContent: `LED ${photo.number + 1} · ${photo.name}` }));
      button.addEventListener("click", () => this.#large(k));
      grid.append(button);
    });
  }

  #large(k) {
    const { photos, key } = this.meta;
    this.at = (k + photos.length) % photos.length;
    const photo = photos[this.at];
    const words = `${BANDS[photo.band] ?? photo.band}, LED ${photo.number + 1} (${photo.name})`;
    const dialog = byId("photo-large");
    const image = dialog.querySelector("img");
    image.src = address(`api/result/${key}/photo/${this.at}`, { width: 1600 });
    image.alt = `Photograph of the finger: ${words}`;
    dialog.querySelector("figcaption").textContent = `${this.at + 1} of ${photos.length}: ${words}`;
    if (!dialog.open) dialog.showModal();
  }
}
