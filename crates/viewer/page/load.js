// Loads a large file, and shows how far it is.

const byId = (id) => document.getElementById(id);

// The bytes of an answer.
export async function load(path) {
  const response = await fetch(path);
  if (!response.ok) throw new Error(`${path}: ${response.status}`);
  const all = Number(response.headers.get("content-length") ?? 0);
  if (!all || !response.body) return response.arrayBuffer();
  const bar = byId("loading");
  bar.hidden = false;
  bar.value = 0;
  const bytes = new Uint8Array(all);
  let count = 0;
  try {
    for (const reader = response.body.getReader(); ;) {
      const { done, value } = await reader.read();
      if (done) break;
      bytes.set(value, count);
      count += value.length;
      bar.value = count / all;
    }
  } finally {
    bar.hidden = true;
  }
  if (count < all) throw new Error(`${path}: the connection ended`);
  return bytes.buffer;
}
