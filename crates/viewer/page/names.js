// Colours and numbers of robots, by their names: the same on every page and after each start.

// r2 before r10.
export const byName = new Intl.Collator("en", { numeric: true }).compare;

// The number at the end of a name; of others one that is made of its letters.
export function colorNumber(name) {
  const digits = /(\d{1,6})$/.exec(name)?.[1];
  if (digits) return Number(digits);
  let hash = 0;
  for (const letter of name) hash = (hash * 31 + letter.codePointAt(0)) % 65521;
  return hash;
}

// The keys 1 to 9 for robots: that at the end of a name, and those left over in the order of names.
export function keysOf(names) {
  const sorted = [...names].sort(byName);
  const keys = new Map();
  const taken = new Set();
  const give = (name, key) => {
    if (keys.has(name) || taken.has(key) || key < 1 || key > 9) return;
    keys.set(name, key);
    taken.add(key);
  };
  for (const name of sorted) give(name, Number(/(?:^|\D)0*([1-9])$/.exec(name)?.[1] ?? 0));
  for (const name of sorted) {
    for (let key = 1; key <= 9 && !keys.has(name) && taken.size < 9; key += 1) give(name, key);
  }
  return keys;
}
