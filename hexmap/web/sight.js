"use strict";
// Straight lines between cells: which cells they touch, lazy Theta* over them, and making paths taut.

// What the line of sight needs of a window. Which cells a line from 0 to v touches depends on v alone: those c in the
// shadow of the cell along v for which 0 < c G v < v G v, and the ends (see planners/any_angle/_kernels.py).
class Sight {
  constructor(graph) {
    const { window } = graph, { lattice } = window;
    Object.assign(this, { window, free: graph.free, generators: lattice.generators });
    const { p, q, r, s } = lattice;
    this.gram = [p * p + r * r, p * q + r * s, q * q + s * s];
    this.reach = [0, 1].map((k) => 0.5 * this.generators.reduce((sum, z) => sum + Math.abs(z[k]), 0));
    this.least = lattice.numbers.inradius ** 2;
    this.guard = [0, 1].some((k) => Math.floor(this.reach[k] + 1e-6) > window.pad[k]);
  }

  distance(from, to) {
    const { stride, lattice } = this.window, i = Math.floor(from / stride), k = Math.floor(to / stride);
    return lattice.distance(k - i, to - k * stride - (from - i * stride));
  }

  // Whether every cell that the line between two flat cells touches is free; they are listed, if a list is given.
  sees(from, to, listed) {
    const { free, gram, window } = this, { stride, shape } = window;
    const i0 = Math.floor(from / stride), j0 = from - i0 * stride;
    const a = Math.floor(to / stride) - i0, b = to - (i0 + a) * stride - j0;
    if (listed) listed.push(from);
    if (a === 0 && b === 0) return free[from] !== 0;
    const first = Math.abs(b) > Math.abs(a) ? 1 : 0;
    const long = first ? b : a, slope = first ? a / b : b / a;
    let width = 0;
    for (const z of this.generators) width += Math.abs(z[1 - first] - z[first] * slope);
    const half = 0.5 * width * (1 + TOUCH), margin = Math.floor(this.reach[first] + 1e-6);
    const rateA = gram[0] * a + gram[1] * b, rateB = gram[1] * a + gram[2] * b, whole = rateA * a + rateB * b;
    const step = long > 0 ? 1 : -1, length = Math.abs(long);
    for (let layer = -margin; layer <= length + margin; layer++) {
      const i = layer * step, middle = i * slope, nearEnd = layer <= margin || layer > length - margin - 1;
      for (let k = Math.ceil(middle - half); k <= middle + half; k++) {
        const u = first ? k : i, v = first ? i : k;
        if (u === 0 && v === 0) {
          if (free[from] === 0) return false;
          continue;
        }
        if (nearEnd && !(u === a && v === b)) {
          const along = u * rateA + v * rateB;
          if (along < this.least || along > whole - this.least) continue;
        }
        if (this.guard && (i0 + u < 0 || j0 + v < 0 || i0 + u >= shape[0] || j0 + v >= shape[1])) return false;
        const at = from + u * stride + v;
        if (free[at] === 0) return false;
        if (listed) listed.push(at);
      }
    }
    return true;
  }
}

const SEEN = 1, SURE = 2, EXPANDED = 4;
const WEIGHTS = [1.003, 1.01, 1.03]; // of the straight distance, of a search that takes longer than A*
const ROUNDS = 20; // of making a path taut

// A short path of straight lines at any angle between two flat cells, never longer than that of moves: what astar
// returns, with the turning cells as the path.
function anyAngle(graph, start, goal) {
  const moved = astar(graph, start, goal);
  if (moved.path === null || start === goal) return moved;
  const sight = new Sight(graph), found = new Theta(graph, sight, goal, Math.max(1024, moved.expansions)).run(start);
  const length = (path) => path.reduce((sum, at, k) => (k ? sum + sight.distance(path[k - 1], at) : 0), 0);
  let path = tighten(graph, sight, found.path);
  if (length(path) > length(moved.path)) path = tighten(graph, sight, moved.path);
  return { path, entered: found.entered, expansions: found.expansions };
}

// Lazy Theta* (Nash, Koenig and Tovey, 2010); a cell whose parent does not see it also tries its neighbours' parents,
// and is opened again where a shorter way to it turns up.
class Theta {
  // limit: cells that may be entered before the straight distance gets a weight.
  constructor(graph, sight, goal, limit) {
    const { window } = graph;
    Object.assign(this, { sight, goal, window, free: graph.free, weight: 1, stage: 0, limit, most: limit });
    Object.assign(this, window.scratch); // g, parent and mark
    this.scale = KEY_STEPS / Math.min(...window.lengths);
    this.touched = new Listing();
    this.entered = new Listing();
    this.makeList();
  }

  makeList() {
    this.open = new OpenList(KEY_STEPS / BUCKETS_A_MOVE, Math.max(...this.window.lengths) * 4 * this.scale);
  }

  key(at) {
    return Math.floor((this.g[at] + this.weight * this.sight.distance(at, this.goal)) * this.scale + 0.5);
  }

  reach(at, cost, by, state) {
    if (this.mark[at] === 0) this.touched.push(at);
    this.g[at] = cost;
    this.parent[at] = by;
    this.mark[at] = state;
    this.open.push(this.key(at), cost, at);
  }

  // Whether something stands in the way of a move from a cell.
  shut(from, move) {
    const { swept, sweptStarts } = this.window;
    for (let s = sweptStarts[move]; s < sweptStarts[move + 1]; s++) if (this.free[from + swept[s]] === 0) return true;
    return false;
  }

  // The best parent that is known to see a cell, with the cost by it: an expanded neighbour, or the parent of one.
  findParent(at) {
    const { g, mark, parent, sight } = this, { offsets, lengths } = this.window, tried = [parent[at]];
    let best = Infinity, by = -1;
    for (let k = 0; k < offsets.length; k++) {
      const from = at - offsets[k];
      if ((mark[from] & EXPANDED) === 0 || g[from] + lengths[k] >= best || this.shut(from, k)) continue;
      best = g[from] + lengths[k];
      by = from;
    }
    for (let k = 0; k < offsets.length; k++) {
      const from = at - offsets[k];
      if ((mark[from] & EXPANDED) === 0 || tried.includes(parent[from])) continue;
      const p = parent[from], cost = g[p] + sight.distance(p, at);
      tried.push(p);
      if (cost < best * BETTER && sight.sees(p, at)) {
        best = cost;
        by = p;
      }
    }
    return [best, by];
  }

  // Try all moves from a cell: straight on from its parent, or where that does not see their ends, from the cell.
  expand(a) {
    const { free, g, mark, parent, sight } = this, { offsets, lengths } = this.window, p = parent[a];
    mark[a] |= EXPANDED;
    this.entered.push(a);
    for (let k = 0; k < offsets.length; k++) {
      const b = a + offsets[k];
      if (free[b] === 0 || b === p || (mark[b] !== 0 && parent[b] === p)) continue;
      const cost = g[p] + sight.distance(p, b);
      if ((mark[b] !== 0 && cost >= g[b] * BETTER) || this.shut(a, k)) continue;
      // What a line is known to give is not replaced by what is only hoped for.
      if ((mark[b] & SURE) === 0) this.reach(b, cost, p, SEEN);
      else if (sight.sees(p, b)) this.reach(b, cost, p, mark[b]);
      else if (g[a] + lengths[k] < g[b] * BETTER) this.reach(b, g[a] + lengths[k], a, mark[b]);
    }
  }

  // Go on with a weight: in sparse fields hardly any cell is much worse than the best.
  weigh() {
    this.weight = WEIGHTS[this.stage++];
    this.most += Math.floor(this.limit / 4);
    const rest = [];
    while (this.open.pop()) if (this.open.cost === this.g[this.open.node]) rest.push(this.open.node);
    this.makeList();
    const keyed = rest.map((at) => [this.key(at), at]).sort((m, n) => m[0] - n[0]);
    for (const [key, at] of keyed) this.open.push(key, this.g[at], at);
  }

  // The path from a flat cell to the goal, which there is.
  run(start) {
    const { g, mark, parent, goal } = this;
    this.reach(start, 0, start, SEEN | SURE);
    while (this.open.pop()) {
      const a = this.open.node;
      if (this.open.cost !== g[a]) continue;
      if ((mark[a] & SURE) === 0) {
        // Only hoped for so far: now that its turn has come, look.
        mark[a] |= SURE;
        if (!this.sight.sees(parent[a], a)) {
          const [cost, by] = this.findParent(a);
          this.reach(a, cost, by, mark[a]);
          continue;
        }
      }
      if (a === goal) break;
      this.expand(a);
      if (this.entered.length > this.most && this.stage < WEIGHTS.length) this.weigh();
    }
    const path = [goal];
    for (let at = goal; at !== start; path.push(at)) at = parent[at];
    for (let k = 0; k < this.touched.length; k++) mark[this.touched.values[k]] = 0;
    return { path: path.reverse(), entered: this.entered.done(), expansions: this.entered.length };
  }
}

// Leave out turning cells, and move them by a step or two, as long as that shortens the path.
function tighten(graph, sight, path) {
  const { free } = graph, { offsets, faces } = graph.window;
  const one = [...new Set([...offsets, ...faces])], two = one.flatMap((u) => one.map((v) => u + v));
  const near = [...new Set([...one, ...two])].sort((u, v) => u - v);
  let cells = path.slice();
  for (let round = 0; round < ROUNDS; round++) {
    let better = false;
    for (let k = 0; k + 2 < cells.length; k++) {
      for (let last = Math.min(cells.length - 1, k + 8); last > k + 1; last--) {
        if (!sight.sees(cells[k], cells[last])) continue;
        cells.splice(k + 1, last - k - 1);
        better = true;
        break;
      }
    }
    for (let k = 1; k + 1 < cells.length; k++) {
      const before = cells[k - 1], after = cells[k + 1];
      let best = sight.distance(before, cells[k]) + sight.distance(cells[k], after);
      for (const offset of near) {
        const at = cells[k] + offset;
        if (at < 0 || at >= free.length || free[at] === 0) continue;
        const length = sight.distance(before, at) + sight.distance(at, after);
        if (length < best * BETTER && sight.sees(before, at) && sight.sees(at, after)) {
          cells[k] = at;
          best = length;
          better = true;
          break;
        }
      }
    }
    if (!better) break;
  }
  return cells;
}
