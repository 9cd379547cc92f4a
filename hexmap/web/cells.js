"use strict";
// The cells of a level: unpacked, asked for one by one, and as textures.

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

class Cells {
  constructor(numbers, bytes, rule) {
    this.side = numbers.side;
    this.shift = Math.log2(numbers.side);
    this.corners = numbers.tiles;
    this.count = numbers.tiles.length / 2;
    const size = this.count * this.side ** 2, { planes } = numbers;
    if (planes.states) {
      this.states = bytes;
    } else {
      this.passes = undoPrediction(joinPlanes(bytes, 0, planes.passes, size), this.side);
      this.hits = joinPlanes(bytes, planes.passes * size, planes.hits, size);
      this.states = statesBy(rule, this.hits, this.passes);
    }
    // Which layer a tile has: 1 for the first, 0 for none.
    const ta = this.corners.filter((_, k) => k % 2 === 0), tb = this.corners.filter((_, k) => k % 2 === 1);
    this.tableLow = [Math.min(...ta), Math.min(...tb)];
    this.tableShape = [Math.max(...ta) - this.tableLow[0] + 1, Math.max(...tb) - this.tableLow[1] + 1];
    this.table = new Uint16Array(this.tableShape[0] * this.tableShape[1]);
    ta.forEach((a, k) => (this.table[(a - this.tableLow[0]) * this.tableShape[1] + tb[k] - this.tableLow[1]] = k + 1));
  }

  // What is known of a cell: {state, hits, passes}; counts are undefined in maps of others.
  at(a, b) {
    const { side } = this, i = Math.floor(a / side) - this.tableLow[0], j = Math.floor(b / side) - this.tableLow[1];
    const inside = i >= 0 && j >= 0 && i < this.tableShape[0] && j < this.tableShape[1];
    const layer = inside ? this.table[i * this.tableShape[1] + j] : 0;
    const counted = this.hits !== undefined;
    if (layer === 0) return counted ? { state: 0, hits: 0, passes: 0 } : { state: 0 };
    const flat = ((layer - 1) * side + (a - (i + this.tableLow[0]) * side)) * side + b - (j + this.tableLow[1]) * side;
    return { state: this.states[flat], hits: this.hits?.[flat], passes: this.passes?.[flat] };
  }

  // The states of boxes of 2 x 2 cells of a level of detail, of which the greatest counts: occupied before free before
  // unknown. So no wall vanishes from a view of the whole.
  halved(states, side) {
    const half = side / 2, out = new Uint8Array(states.length / 4);
    for (let row = 0, to = 0; row < states.length; row += 2 * side) {
      for (let at = row; at < row + side; at += 2, to++) {
        const m = states[at] > states[at + 1] ? states[at] : states[at + 1];
        const n = states[at + side] > states[at + side + 1] ? states[at + side] : states[at + side + 1];
        out[to] = m > n ? m : n;
      }
    }
    return [out, half];
  }
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
