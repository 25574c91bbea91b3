// What is asked of the server, or of a result that was dropped onto the page. Addresses are relative: they carry the
// token of this session.

/** Results that were dropped onto the page, by key. @type {Map<string, import("./dropped.js").Dropped>} */
export const dropped = new Map();

/** What the first view needs is asked for at once, while the library that draws is still being read. */
const ahead = new Map();
export const catalogue = getJson("api/catalogue");
catalogue
  .then(({ chosen, results }) => {
    const key = new URLSearchParams(location.hash.slice(1)).get("result") ?? chosen[0];
    if (!results.find((one) => one.key === key)?.result) return;
    for (const path of [`api/result/${key}`, `api/result/${key}/first`]) {
      const coming = fetch(address(path));
      coming.catch(() => {}); // said where it is used
      ahead.set(address(path), coming);
    }
  })
  .catch(() => {});

/**
 * @param {string} path
 * @param {Record<string, string | number>} [query]
 * @returns {string}
 */
export function address(path, query = {}) {
  const url = new URL(path, document.baseURI);
  for (const [name, value] of Object.entries(query)) url.searchParams.set(name, String(value));
  return url.href;
}

/** @param {string} path @param {Record<string, string | number>} [query] */
async function ask(path, query) {
  const url = address(path, query);
  const coming = ahead.get(url);
  ahead.delete(url);
  let answer;
  try {
    answer = await (coming ?? fetch(url));
  } catch {
    throw new Error("The server no longer answers. Start `splitknit view` again.");
  }
  if (!answer.ok) throw new Error((await answer.text()).trim() || `The server answered ${answer.status}.`);
  return answer;
}

/** @param {string} path @param {Record<string, string | number>} [query] @returns {Promise<any>} */
export async function getJson(path, query) {
  return (await ask(path, query)).json();
}

/** @param {string} path @returns {Promise<ArrayBuffer>} */
export async function getBytes(path) {
  return (await ask(path)).arrayBuffer();
}

/** About a result: "" for its facts, "pick", "section", "minutiae". @param {string} key @param {string} [what] */
export async function about(key, what = "", query = {}) {
  const own = dropped.get(key);
  return own ? own.answer(what, query) : getJson(`api/result/${key}${what && "/"}${what}`, query);
}

/** Where a picture of a result is. @param {string} key @param {string} name */
export function pictureOf(key, name) {
  return dropped.get(key)?.url(name) ?? address(`api/result/${key}/picture/${name}`);
}

/** @param {string} key @param {string} name @returns {Promise<ImageBitmap>} */
export async function getPicture(key, name) {
  const own = dropped.get(key)?.files.get(name);
  return bitmap(own ?? (await (await ask(`api/result/${key}/picture/${name}`)).blob()));
}

/** How much higher the second is than the first. @returns {Promise<ImageBitmap>} */
export async function getDifference(first, second) {
  return bitmap(await (await ask(`api/pair/${first}/${second}/difference`)).blob());
}

function bitmap(blob) {
  return createImageBitmap(blob, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
}
