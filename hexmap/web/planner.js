"use strict";
// Paths over the free cells of a window: A* with the gauge of the moves, and lazy Theta* with an exact line of sight.
// The same costs as planners.astar and hexmap.graph in Python, with which tests/web compares it. Runs in a worker.

const KEY_STEPS = 2 ** 32; // keys of the queue a cheapest move
const LENGTH_STEPS = 2 ** 36; // lengths are multiples of a fraction of the shortest, so that their sums are exact
const BUCKETS_A_MOVE = 16; // of the queue, to the cheapest move: few cells are sorted at a time
const MOST_BUCKETS = 65536;
const NEARER = 1 - 1e-9; // a clearance this little short of a radius is as large
const BETTER = 1 - 1e-12; // a smaller gain is a rounding error
const TOUCH = 2e-9; // of the cell's width, by which it is taken larger for lines that touch it

// ---------------------------------------------------------------------- the graph

class Graph {
  // states: (size) 0 unknown, 1 free, 2 occupied, laid out as the window says; known: a graph of the same states, for
  // what it has found out.
  constructor(window, states, known = null) {
    this._surface = known?._surface;
    this._blocks = known?._blocks;
    this.window = window;
    this.states = states;
    this.free = new Uint8Array(states.length);
    for (let at = 0; at < states.length; at++) this.free[at] = states[at] & 1; // 1 is free, 2 occupied
    this.terrain = null;
    this.least = 1;
    this.most = 1;
  }

  // The occupied cells that have a face to one that is not: only they can be the nearest one of all.
  get surface() {
    if (this._surface) return this._surface;
    const { states } = this, { faces, shape, pad, stride } = this.window, found = new Listing();
    for (let i = pad[0]; i < shape[0] - pad[0]; i++) {
      for (let at = i * stride + pad[1]; at < (i + 1) * stride - pad[1]; at++) {
        if (states[at] !== 2) continue;
        let buried = true;
        for (let k = 0; k < faces.length && buried; k++) buried = states[at + faces[k]] === 2;
        if (!buried) found.push(at);
      }
    }
    return (this._surface = found.done());
  }

  // The offsets within a distance of a cell, row by row: [a, b, distance of the centre to the cell].
  ball(limit) {
    const { lattice } = this.window, wide = limit + lattice.numbers.covering, found = [];
    const reach = lattice.inverse.map((row) => Math.floor(Math.hypot(...row) * wide));
    for (let a = -reach[0]; a <= reach[0]; a++) {
      for (let b = -reach[1]; b <= reach[1]; b++) {
        const x = lattice.p * a + lattice.q * b, y = lattice.r * a + lattice.s * b;
        if (Math.hypot(x, y) >= wide * 1.000001) continue;
        const away = lattice.distanceToCell(x, y);
        if (away < limit) found.push([a, b, away]);
      }
    }
    return found;
  }

  // Block the cells whose centre is nearer than a radius to an occupied cell.
  withRadius(radius) {
    const { shape, stride } = this.window;
    // What is near in a row is one run of cells, as balls around convex cells are convex.
    const rows = new Map();
    for (const [a, b] of radius > 0 ? this.ball(radius * NEARER) : []) {
      const row = rows.get(a);
      if (row) row[1] = b;
      else rows.set(a, [b, b]);
    }
    for (const at of this.surface) {
      const i = Math.floor(at / stride), j = at - i * stride;
      for (const [a, [first, last]] of rows) {
        if (i + a < 0 || i + a >= shape[0]) continue;
        const row = (i + a) * stride;
        this.free.fill(0, row + Math.max(0, j + first), row + Math.max(0, Math.min(shape[1], j + last + 1)));
      }
    }
    return this;
  }

  // Make a cell at a distance d < reach from an occupied one cost 1 + weight (1 - d / reach)^2 times as much.
  withWeight(weight, reach) {
    if (!(weight > 0)) return this;
    const { shape, stride, size } = this.window, away = new Float64Array(size).fill(reach);
    const ball = this.ball(reach);
    for (const at of this.surface) {
      const i = Math.floor(at / stride), j = at - i * stride;
      for (const [a, b, d] of ball) {
        if (i + a < 0 || j + b < 0 || i + a >= shape[0] || j + b >= shape[1]) continue;
        const to = at + a * stride + b;
        if (d < away[to]) away[to] = d;
      }
    }
    this.least = Infinity;
    for (let at = 0; at < size; at++) {
      if (this.free[at] === 0) continue;
      const near = 1 - away[at] / reach;
      away[at] = 1 + weight * near * near;
      this.least = Math.min(this.least, away[at]);
      this.most = Math.max(this.most, away[at]);
    }
    if (this.least === Infinity) this.least = 1;
    this.terrain = away;
    return this;
  }

  // The least distance, metres, from the centres of flat cells to an occupied cell; Infinity where there is none.
  clearance(cells) {
    const { window } = this, side = 16;
    this._blocks ??= blocksOf(this.surface, window, side);
    let best = Infinity;
    for (const at of cells) {
      const [a, b] = window.index(at);
      best = nearestBody(this._blocks, window, side, a - window.low[0], b - window.low[1], best);
    }
    return best;
  }
}

// Flat cells by blocks of side x side of them: those of block k are listed from starts[k] to starts[k + 1].
function blocksOf(cells, window, side) {
  const across = Math.ceil(window.shape[1] / side), down = Math.ceil(window.shape[0] / side);
  const starts = new Int32Array(across * down + 1), listed = new Int32Array(cells.length), { stride } = window;
  const blockOf = (at) => {
    const i = Math.floor(at / stride);
    return Math.floor(i / side) * across + Math.floor((at - i * stride) / side);
  };
  for (let k = 0; k < cells.length; k++) starts[blockOf(cells[k]) + 1]++;
  for (let k = 0; k < across * down; k++) starts[k + 1] += starts[k];
  const next = starts.slice();
  for (let k = 0; k < cells.length; k++) listed[next[blockOf(cells[k])]++] = cells[k];
  return { starts, listed, across, down };
}

// The distance from the cell (i, j) of the window to the nearest cell in blocks, or one of at least "best".
function nearestBody({ starts, listed, across, down }, window, side, i, j, best) {
  const bi = Math.floor(i / side), bj = Math.floor(j / side), { lattice } = window, { covering } = lattice.numbers;
  for (let ring = 0; ring <= Math.max(across, down); ring++) {
    if (((ring - 1) * side + 1) * lattice.height - covering >= best) break;
    for (let u = bi - ring; u <= bi + ring; u++) {
      if (u < 0 || u >= down) continue;
      const step = Math.abs(u - bi) === ring ? 1 : Math.max(1, 2 * ring);
      for (let v = bj - ring; v <= bj + ring; v += step) {
        if (v < 0 || v >= across) continue;
        for (let k = starts[u * across + v]; k < starts[u * across + v + 1]; k++) {
          const row = Math.floor(listed[k] / window.stride), a = i - row, b = j - (listed[k] - row * window.stride);
          const x = lattice.p * a + lattice.q * b, y = lattice.r * a + lattice.s * b;
          const limit = best + covering;
          if (x * x + y * y < limit * limit) best = Math.min(best, lattice.distanceToCell(x, y));
        }
      }
    }
  }
  return best;
}

// ---------------------------------------------------------------------- the open list

// Entries (key, cost, node) in buckets of keys; only those of the bucket whose turn it is lie in a heap, the least key
// first and of equal keys the larger cost. Keys may fall below those that were taken by rounding only.
class OpenList {
  constructor(width, span) {
    this.inverse = 1 / width;
    this.slots = 2 ** Math.ceil(Math.log2(span / width + 3));
    this.heads = new Int32Array(this.slots).fill(-1);
    // Entries that wait, in a list for each bucket.
    this.waits = { key: new Float64Array(4096), cost: new Float64Array(4096), node: new Int32Array(4096) };
    this.link = new Int32Array(4096);
    // The heap, whose numbers lie side by side.
    this.heap = { key: new Float64Array(1024), cost: new Float64Array(1024), node: new Int32Array(1024) };
    this.count = this.used = this.waiting = 0;
    this.spare = this.turn = -1;
    this.cost = this.node = 0;
  }

  push(key, cost, node) {
    const due = Math.floor(key * this.inverse);
    if (this.turn < 0) this.turn = due;
    if (due <= this.turn) return this.rise(key, cost, node);
    let entry = this.spare;
    if (entry >= 0) this.spare = this.link[entry];
    else if ((entry = this.used++) === this.link.length) {
      this.waits = longer(this.waits);
      this.link = longer({ link: this.link }).link;
    }
    this.waits.key[entry] = key;
    this.waits.cost[entry] = cost;
    this.waits.node[entry] = node;
    const slot = due & (this.slots - 1);
    this.link[entry] = this.heads[slot];
    this.heads[slot] = entry;
    this.waiting++;
  }

  rise(k, c, n) {
    if (this.count === this.heap.key.length) this.heap = longer(this.heap);
    const { key, cost, node } = this.heap;
    let at = this.count++;
    while (at > 0) {
      const up = (at - 1) >> 1;
      if (key[up] < k || (key[up] === k && cost[up] >= c)) break;
      key[at] = key[up];
      cost[at] = cost[up];
      node[at] = node[up];
      at = up;
    }
    key[at] = k;
    cost[at] = c;
    node[at] = n;
  }

  // Make the heap, which is empty, of the entries of the next bucket that has any.
  turnOver() {
    const { key, cost, node } = this.waits, { link } = this;
    this.turn++;
    const slot = this.turn & (this.slots - 1);
    let later = -1;
    for (let entry = this.heads[slot]; entry >= 0; ) {
      const next = link[entry];
      if (Math.floor(key[entry] * this.inverse) > this.turn) {
        // Of a later round: keys that rise by more than the span share slots.
        link[entry] = later;
        later = entry;
      } else {
        this.rise(key[entry], cost[entry], node[entry]);
        this.waiting--;
        link[entry] = this.spare;
        this.spare = entry;
      }
      entry = next;
    }
    this.heads[slot] = later;
  }

  // Take the least entry: whether there was one; its cost and node are then those of the list.
  pop() {
    while (this.count === 0) {
      if (this.waiting === 0) return false;
      this.turnOver();
    }
    const { key, cost, node } = this.heap, last = --this.count;
    this.cost = cost[0];
    this.node = node[0];
    const k = key[last], c = cost[last];
    let at = 0;
    for (let down = 1; down < last; down = 2 * at + 1) {
      const right = down + 1, k2 = right < last ? key[right] : Infinity;
      if (k2 < key[down] || (k2 === key[down] && cost[right] > cost[down])) down = right;
      if (k < key[down] || (k === key[down] && c >= cost[down])) break;
      key[at] = key[down];
      cost[at] = cost[down];
      node[at] = node[down];
      at = down;
    }
    key[at] = k;
    cost[at] = c;
    node[at] = node[last];
    return true;
  }
}

// The same arrays, twice as long.
function longer(arrays) {
  return Object.fromEntries(Object.entries(arrays).map(([name, short]) => {
    const long = new short.constructor(2 * short.length);
    long.set(short);
    return [name, long];
  }));
}

// Whole numbers in the order in which they came.
class Listing {
  constructor() {
    this.values = new Int32Array(1024);
    this.length = 0;
  }

  push(value) {
    if (this.length === this.values.length) {
      const longer = new Int32Array(2 * this.length);
      longer.set(this.values);
      this.values = longer;
    }
    this.values[this.length++] = value;
  }

  done() {
    return this.values.slice(0, this.length);
  }
}

// ---------------------------------------------------------------------- A*

// Rows p with max |p v| = the gauge of v in the hull of {move / its length}: a cost that no path undercuts. In the
// plane the moves divided by their lengths lie on a circle, so that neighbours in angle span the facets.
function gaugePlanes(window, lengths) {
  const { lattice, moves } = window;
  const angle = ([a, b]) => Math.atan2(lattice.r * a + lattice.s * b, lattice.p * a + lattice.q * b);
  const order = moves.map((move, k) => [angle(move), k]).sort((m, n) => m[0] - n[0]).map((m) => m[1]);
  const planes = [];
  order.forEach((k, at) => {
    const n = order[(at + 1) % order.length], [a, b] = moves[k], [c, d] = moves[n], det = a * d - b * c;
    const u = (lengths[k] * d - lengths[n] * b) / det, v = (lengths[n] * a - lengths[k] * c) / det;
    if (u > 1e-12 || (Math.abs(u) <= 1e-12 && v > 0)) planes.push([u, v]);
  });
  // What was rounded away must not let a single move be estimated above its cost.
  const shares = moves.flatMap(([a, b], k) => planes.map(([u, v]) => Math.abs(u * a + v * b) / lengths[k]));
  const excess = Math.max(1, ...shares);
  return planes.map(([u, v]) => [u / excess, v / excess]);
}

// The cheapest path between two flat cells: {path, entered, expansions}; path is null where there is none.
function astar(graph, start, goal) {
  const { window, free, terrain } = graph, { offsets, swept, sweptStarts, stride, moves } = window;
  const shortest = Math.min(...window.lengths), unit = 2 ** Math.floor(Math.log2(shortest / LENGTH_STEPS));
  const lengths = terrain ? window.lengths : window.lengths.map((v) => Math.round(v / unit) * unit);
  const slack = terrain ? 1 - 1e-13 : 1;
  const planes = gaugePlanes(window, lengths).map(([u, v]) => [u * graph.least, v * graph.least]);
  const many = planes.length, count = moves.length;
  const steps = Float64Array.from(moves.flatMap(([a, b]) => planes.map(([u, v]) => u * a + v * b)));
  const us = Float64Array.from(planes, (p) => p[0]), vs = Float64Array.from(planes, (p) => p[1]);
  const base = new Float64Array(many);
  const goalI = Math.floor(goal / stride), goalJ = goal - goalI * stride;
  const scale = KEY_STEPS / (shortest * graph.least);
  const span = Math.max(...lengths) * graph.most * 2 * scale;
  const open = new OpenList(Math.max(KEY_STEPS / BUCKETS_A_MOVE, span / MOST_BUCKETS), span);
  const { g, mark } = window.scratch, touched = new Listing(), entered = new Listing();
  const measure = (at) => {
    const i = Math.floor(at / stride), j = at - i * stride;
    let most = 0;
    for (let f = 0; f < many; f++) {
      base[f] = us[f] * (i - goalI) + vs[f] * (j - goalJ);
      most = Math.max(most, Math.abs(base[f]));
    }
    return most;
  };
  mark[start] = count + 1;
  g[start] = 0;
  touched.push(start);
  open.push(Math.floor(measure(start) * scale + 0.5), 0, start);
  let found = false;
  while (open.pop()) {
    const a = open.node, d = open.cost;
    if (d !== g[a]) continue;
    if (a === goal) {
      found = true;
      break;
    }
    entered.push(a);
    measure(a);
    for (let k = 0; k < count; k++) {
      const b = a + offsets[k];
      if (free[b] === 0) continue;
      const reached = d + (terrain ? lengths[k] * (0.5 * (terrain[a] + terrain[b])) : lengths[k]);
      if (mark[b] !== 0 && reached >= g[b] * slack) continue;
      let shut = false;
      for (let s = sweptStarts[k]; s < sweptStarts[k + 1]; s++) shut = shut || free[a + swept[s]] === 0;
      if (shut) continue;
      let most = 0;
      for (let f = 0, s = k * many; f < many; f++, s++) most = Math.max(most, Math.abs(base[f] + steps[s]));
      if (mark[b] === 0) touched.push(b);
      g[b] = reached;
      mark[b] = k + 1;
      open.push(Math.floor((reached + most) * scale + 0.5), reached, b);
    }
  }
  let path = null;
  if (found) {
    path = [goal];
    for (let at = goal; mark[at] !== count + 1; path.push(at)) at -= offsets[mark[at] - 1];
    path.reverse();
  }
  for (let k = 0; k < touched.length; k++) mark[touched.values[k]] = 0;
  return { path, entered: entered.done(), expansions: entered.length };
}

// The cost of a path of moves, metres times the terrain, summed without a rounding error that would show.
function costOf(graph, path) {
  const { offsets, lengths } = graph.window, { terrain } = graph;
  const numbers = new Map(Array.from(offsets, (offset, k) => [offset, k]));
  let sum = 0, rest = 0;
  for (let k = 1; k < path.length; k++) {
    const length = lengths[numbers.get(path[k] - path[k - 1])];
    const term = terrain ? length * (0.5 * (terrain[path[k - 1]] + terrain[path[k]])) : length;
    const next = sum + term;
    rest += sum >= term ? sum - next + term : term - next + sum;
    sum = next;
  }
  return sum + rest;
}
