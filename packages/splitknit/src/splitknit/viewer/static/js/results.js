// The list of results to choose from.
import { address, dropped, pictureOf } from "./api.js";
import { byId, make } from "./page.js";

export class Results {
  /** @param {any[]} results @param {(key: string) => void} open @param {(key: string) => void} beside */
  constructor(results, open, beside) {
    this.results = results;
    this.open = open;
    this.beside = beside;
    this.current = "";
    byId("filter").addEventListener("input", () => this.draw());
  }

  /** @param {string} [current] key of the result that is shown */
  draw(current = this.current) {
    this.current = current;
    const wanted = byId("filter").value.trim().toLowerCase();
    const found = this.results.filter((one) => [one.name, one.preset, one.subject, one.finger].join(" ").toLowerCase().includes(wanted));
    byId("empty").hidden = this.results.length > 0;
    byId("filter").closest(".bar").hidden = this.results.length === 0;
    byId("results-words").textContent = `${found.length} of ${this.results.length} results`;
    byId("result-list").replaceChildren(...found.map((one) => this.#item(one)));
  }

  #item(one) {
    const item = make("li");
    if (one.key === this.current) item.setAttribute("aria-current", "true");
    if (one.thumb) item.append(make("img", { loading: "lazy", alt: "", src: dropped.has(one.key) ? pictureOf(one.key, "preview.png") : address(`api/result/${one.key}/thumb`) }));
    const facts = [one.preset, one.subject, one.finger, one.session && `session ${one.session}`, one.warnings ? `${one.warnings} note${one.warnings > 1 ? "s" : ""}` : ""];
    item.append(make("b", { textContent: one.name }), make("small", { textContent: facts.filter(Boolean).join(" · ") }));
    const show = make("button", { type: "button", textContent: "Open" });
    show.setAttribute("aria-label", `Open ${one.name}`);
    show.addEventListener("click", () => this.open(one.key));
    const buttons = make("div", { className: "row buttons" }, show);
    if (this.current !== "" && one.key !== this.current && one.result) {
      const beside = make("button", { type: "button", textContent: "Beside" });
      beside.setAttribute("aria-label", `Show ${one.name} beside the one that is open`);
      beside.addEventListener("click", () => this.beside(one.key));
      buttons.append(beside);
    }
    item.append(buttons);
    return item;
  }
}
