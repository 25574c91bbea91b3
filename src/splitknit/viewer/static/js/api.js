// What is asked of the server. Addresses are relative: they carry the token of this session.

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
  let answer;
  try {
    answer = await fetch(address(path, query));
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

/** @param {string} path @returns {Promise<ImageBitmap>} */
export async function getPicture(path) {
  const blob = await (await ask(path)).blob();
  return createImageBitmap(blob, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
}
