"use strict";
// The cells of a level: unpacked, asked for one by one, and as textures. And lattices of space, which are only shown.

// Text in base64, deflated: its bytes.
async function unpack(text) {
  const packed = Uint8Array.fromBase64?.(text.trim()) ?? Uint8Array.from(atob(text.trim()), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// An array that holds whole numbers of so many bytes.
function arrayFor(planes, size) {
  return new (planes === 1 ? Uint8Array : planes === 2 ? Uint16Array : planes <= 4 ? Uint32Array : Float64Array)(size);
}

// Numbers from byte planes, the lowest bytes first.
function joinPlanes(bytes, begin, planes, size) {
  if (planes === 1) return bytes.subarray(begin, begin + size);
  const out = arrayFor(planes, size);
  for (let k = planes - 1; k >= 0; k--) {
    const plane = bytes.subarray(begin + k * size, begin + (k + 1) * size);
    for (let i = 0; i < size; i++) out[i] = out[i] * 256 + plane[i];
  }
  return out;
}

// Undo what was predicted, tile by tile: see hexmap/web/tiles.py. The result takes the place of what is given.
function undoPrediction(values, side) {
  for (let row = 0; row < values.length; row += side) {
    const first = row % (side * side) === 0;
    let left = 0, corner = 0;
    for (let at = row; at < row + side; at++) {
      const coded = values[at], above = first ? 0 : values[at - side];
      const low = left < above ? left : above, high = left < above ? above : left;
      const guess = corner >= high ? low : corner <= low ? high : left + above - corner;
      left = guess + (coded % 2 ? -(coded + 1) / 2 : coded / 2);
      values[at] = left;
      corner = above;
    }
  }
  return values;
}

const SHEET = 512; // cells along a side of the sheets that hold small tiles

// Cells in square tiles along the first two indices; in space a tile has one third index. Of a lattice of the plane the
// third index is 0 throughout.
class Cells {
  constructor(numbers, bytes, rule) {
    const { planes } = numbers, n = numbers.basis.length;
    this.side = numbers.side;
    this.shift = Math.log2(numbers.side);
    this.count = numbers.tiles.length / n;
    this.abreast = n === 2 ? 1 : SHEET / numbers.side;
    // Boxes of cells at several heights would show what is not in the slice.
    this.details = n === 2 ? this.shift : 0;
    const size = this.count * this.side ** 2;
    if (planes.states) {
      this.states = bytes;
    } else {
      this.passes = undoPrediction(joinPlanes(bytes, 0, planes.passes, size), this.side);
      this.hits = joinPlanes(bytes, planes.passes * size, planes.hits, size);
      this.states = statesBy(rule, this.hits, this.passes);
    }
    // Which number a tile has: 1 for the first, 0 for none.
    const along = (k) => Array.from({ length: this.count }, (_, t) => (k < n ? numbers.tiles[n * t + k] : 0));
    const corners = [0, 1, 2].map(along);
    this.tableLow = corners.map((v) => v.reduce((low, x) => Math.min(low, x)));
    this.tableShape = corners.map((v, k) => v.reduce((high, x) => Math.max(high, x)) - this.tableLow[k] + 1);
    this.table = new Uint16Array(this.tableShape.reduce((product, v) => product * v));
    for (let t = 0; t < this.count; t++) this.table[this.place(...corners.map((v) => v[t]))] = t + 1;
  }

  // Where a tile stands in the table, -1 outside it.
  place(...tile) {
    const [i, j, l] = tile.map((v, k) => v - this.tableLow[k]), [a, b, c] = this.tableShape;
    return i < 0 || j < 0 || l < 0 || i >= a || j >= b || l >= c ? -1 : (i * b + j) * c + l;
  }

  // What is known of a cell: {state, hits, passes}; counts are undefined in maps of others.
  at(a, b, c = 0) {
    const { side } = this, ta = Math.floor(a / side), tb = Math.floor(b / side), place = this.place(ta, tb, c);
    const number = place < 0 ? 0 : this.table[place];
    if (number === 0) return this.hits ? { state: 0, hits: 0, passes: 0 } : { state: 0 };
    const flat = ((number - 1) * side + (a - ta * side)) * side + b - tb * side;
    return { state: this.states[flat], hits: this.hits?.[flat], passes: this.passes?.[flat] };
  }

  // The states as layers of a texture: a tile each, or small ones side by side.
  sheets() {
    const { side, abreast, count, states } = this;
    if (abreast === 1) return { states, side, layers: count };
    const layers = Math.ceil(count / abreast ** 2), out = new Uint8Array(layers * SHEET ** 2);
    for (let t = 0; t < count; t++) {
      const layer = Math.floor(t / abreast ** 2), row = Math.floor(t / abreast) % abreast, column = t % abreast;
      for (let i = 0; i < side; i++) {
        const from = (t * side + i) * side;
        out.set(states.subarray(from, from + side), (layer * SHEET + row * side + i) * SHEET + column * side);
      }
    }
    return { states: out, side: SHEET, layers };
  }
}

// The states of boxes of 2 x 2 cells, and how many they are along a side: the greatest counts, occupied before free
// before unknown, so that no wall vanishes from a view of the whole.
function halved(states, side) {
  const out = new Uint8Array(states.length / 4);
  for (let row = 0, to = 0; row < states.length; row += 2 * side) {
    for (let at = row; at < row + side; at += 2, to++) {
      const m = states[at] > states[at + 1] ? states[at] : states[at + 1];
      const n = states[at + side] > states[at + side + 1] ? states[at + side] : states[at + side + 1];
      out[to] = m > n ? m : n;
    }
  }
  return [out, side / 2];
}

// The rule of hexmap.maps.StateRule: 0 unknown, 1 free, 2 occupied.
function statesBy(rule, hits, passes) {
  const states = new Uint8Array(hits.length);
  for (let k = 0; k < states.length; k++) {
    const h = hits[k], p = passes[k];
    if (h >= rule.min_hits && h / (h + p) >= rule.min_ratio) states[k] = 2;
    else if (p >= rule.min_passes) states[k] = 1;
  }
  return states;
}

class SpatialLattice {
  constructor(numbers) {
    this.numbers = numbers;
    this.resolution = this.height = numbers.resolution;
    const [[a, b, c], [d, e, f], [g, h, i]] = numbers.basis;
    const det = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g);
    this.inverse = [
      [e * i - f * h, c * h - b * i, b * f - c * e],
      [f * g - d * i, a * i - c * g, c * d - a * f],
      [d * h - e * g, b * g - a * h, a * e - b * d],
    ].map((row) => row.map((v) => v / det));
  }

  coordinates(...point) {
    const moved = point.map((v, k) => v - this.numbers.origin[k]);
    return this.inverse.map((row) => row.reduce((sum, v, k) => sum + v * moved[k], 0));
  }

  // The cell whose centre is nearest to a point.
  quantise(x, y, z) {
    const u = this.coordinates(x, y, z), low = u.map(Math.floor);
    let best = Infinity, found = null;
    for (const offset of this.numbers.candidates) {
      const rest = u.map((v, k) => v - low[k] - offset[k]);
      const d = this.numbers.basis.reduce((sum, row) => sum + row.reduce((x_, v, k) => x_ + v * rest[k], 0) ** 2, 0);
      if (d < best - 1e-10 * this.resolution ** 2) {
        best = d;
        found = low.map((v, k) => v + offset[k]);
      }
    }
    return found;
  }
}
