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
  const sight = new Sight(graph), found = theta(graph, sight, start, goal, Math.max(1024, moved.expansions));
  const length = (path) => path.reduce((sum, at, k) => (k ? sum + sight.distance(path[k - 1], at) : 0), 0);
  let path = tighten(graph, sight, found.path);
  if (length(path) > length(moved.path)) path = tighten(graph, sight, moved.path);
  return { path, entered: found.entered, expansions: found.expansions };
}

// Lazy Theta* (Nash, Koenig and Tovey, 2010); a cell whose parent does not see it also tries its neighbours' parents, and
// is opened again where a shorter way to it turns up. There is a path.
function theta(graph, sight, start, goal, limit) {
  const { free, window } = graph, { offsets, lengths, swept, sweptStarts } = window;
  const { g, parent, mark } = window.scratch, touched = new Listing(), entered = new Listing();
  const shortest = Math.min(...window.lengths), scale = KEY_STEPS / shortest;
  let weight = 1, stage = 0, most = limit;
  const key = (at, cost) => Math.floor((cost + weight * sight.distance(at, goal)) * scale + 0.5);
  const makeList = () => {
    const span = Math.max(...window.lengths) * 4 * scale;
    return new OpenList(KEY_STEPS / BUCKETS_A_MOVE, span + 64 * KEY_STEPS);
  };
  const shut = (from, k) => {
    for (let s = sweptStarts[k]; s < sweptStarts[k + 1]; s++) if (free[from + swept[s]] === 0) return true;
    return false;
  };
  let open = makeList();
  const reach = (at, cost, by, state) => {
    if (mark[at] === 0) touched.push(at);
    g[at] = cost;
    parent[at] = by;
    mark[at] = state;
    open.push(key(at, cost), cost, at);
  };
  // The best parent that is known to see a cell: an expanded neighbour, or the parent of one.
  const findParent = (at, refused) => {
    let best = Infinity, by = -1;
    const tried = [refused];
    for (let k = 0; k < offsets.length; k++) {
      const from = at - offsets[k];
      if ((mark[from] & EXPANDED) === 0 || g[from] + lengths[k] >= best || shut(from, k)) continue;
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
  };
  reach(start, 0, start, SEEN | SURE);
  while (open.pop()) {
    const a = open.node;
    if (open.cost !== g[a]) continue;
    if ((mark[a] & SURE) === 0) {
      // Only hoped for so far: now that its turn has come, look.
      mark[a] |= SURE;
      if (!sight.sees(parent[a], a)) {
        const [cost, by] = findParent(a, parent[a]);
        reach(a, cost, by, mark[a]);
        continue;
      }
    }
    if (a === goal) break;
    mark[a] |= EXPANDED;
    entered.push(a);
    const p = parent[a];
    for (let k = 0; k < offsets.length; k++) {
      const b = a + offsets[k];
      if (free[b] === 0 || b === p || (mark[b] !== 0 && parent[b] === p)) continue;
      let cost = g[p] + sight.distance(p, b);
      if ((mark[b] !== 0 && cost >= g[b] * BETTER) || shut(a, k)) continue;
      if ((mark[b] & SURE) === 0) {
        reach(b, cost, p, SEEN);
        continue;
      }
      // What a line is known to give is not replaced by what is only hoped for.
      let by = p;
      if (!sight.sees(p, b)) {
        by = a;
        cost = g[a] + lengths[k];
        if (cost >= g[b] * BETTER) continue;
      }
      reach(b, cost, by, mark[b]);
    }
    if (entered.length > most && stage < WEIGHTS.length) {
      // In sparse fields hardly any cell is much worse than the best: go on with a weight.
      weight = WEIGHTS[stage++];
      most += Math.floor(limit / 4);
      const rest = [];
      while (open.pop()) if (open.cost === g[open.node]) rest.push(open.node);
      open = makeList();
      rest.map((at) => [key(at, g[at]), at]).sort((m, n) => m[0] - n[0]).forEach(([k, at]) => open.push(k, g[at], at));
    }
  }
  const path = [goal];
  for (let at = goal; at !== start; path.push(at)) at = parent[at];
  for (let k = 0; k < touched.length; k++) mark[touched.values[k]] = 0;
  return { path: path.reverse(), entered: entered.done(), expansions: entered.length };
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
