// Small things of the page that several modules need.

/** @param {string} id @returns {any} */
export const byId = (id) => document.getElementById(id);

/** Announce to screen readers. @param {string} words */
export function say(words) {
  byId("said").textContent = words;
  const hint = byId("measure-hint");
  if (hint) hint.textContent = words;
}

/** @param {string} words of what went wrong; none takes the message away */
export function trouble(words) {
  const box = byId("trouble");
  box.hidden = !words;
  box.textContent = words;
}

/** @param {string} kind @param {Record<string, any>} [values] @param {...(Node | string)} children */
export function make(kind, values = {}, ...children) {
  const element = Object.assign(document.createElement(kind), values);
  element.append(...children);
  return element;
}
