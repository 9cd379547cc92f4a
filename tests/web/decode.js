// Reads a page's header and the texts of its first map's levels from standard input and writes what the page makes of
// them: for each level a list of [indices, state, hits, passes] of all cells that are not empty.
const given = JSON.parse(require("fs").readFileSync(0, "utf8"));

async function decode(numbers, text, rule) {
  const cells = new Cells(numbers, await unpack(text), rule), n = numbers.basis.length, found = [];
  for (let t = 0; t < cells.count; t++) {
    const [a, b, c] = numbers.tiles.slice(n * t, n * t + n);
    for (let k = 0; k < numbers.side ** 2; k++) {
      const index = [a * numbers.side + Math.floor(k / numbers.side), b * numbers.side + (k % numbers.side)];
      if (n === 3) index.push(c);
      const { state, hits, passes } = cells.at(...index);
      if (state || hits || passes) found.push([index, state, hits ?? null, passes ?? null]);
    }
  }
  return found;
}

const [map] = given.header.maps;
Promise.all(map.levels.map((numbers, k) => decode(numbers, given.texts[k], map.rule))).then((levels) => {
  process.stdout.write(JSON.stringify(levels));
});
