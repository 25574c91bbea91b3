// A gallery: people, their fingers, and the ridges that a template holds.
import { address } from "./api.js";
import { byId, make } from "./page.js";

/** @param {any[]} people rows of the gallery */
export function showPeople(people) {
  const draw = () => {
    const wanted = byId("people-filter").value.trim().toLowerCase();
    const found = people.filter((one) => `${one.person} ${one.finger} ${one.session}`.toLowerCase().includes(wanted));
    const names = [...new Set(found.map((one) => one.person))];
    byId("people-words").textContent = `${names.length} people, ${found.length} enrolled fingers. A picture shows what the template keeps: ridges dark, tip up, as the camera sees them.`;
    byId("people-list").replaceChildren(...names.flatMap((name) => [
      make("h2", { textContent: name }),
      make("ul", {}, ...found.filter((one) => one.person === name).map(item)),
    ]));
  };
  byId("people-filter").addEventListener("input", draw);
  draw();
}

function item(one) {
  const words = `${one.finger.replaceAll("_", " ")}, session ${one.session}`;
  const made = make("li");
  if (one.acquired) made.append(make("img", { loading: "lazy", alt: `Ridges of ${one.person}, ${words}`, src: address(`api/people/${one.row}`) }));
  made.append(make("div", { textContent: words }), make("small", { textContent: one.acquired ? `${one.area_mm2.toFixed(0)} mm²` : "failure to acquire" }));
  return made;
}
