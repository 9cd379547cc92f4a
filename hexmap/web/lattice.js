"use strict";
// Lattices of the plane as the page's header describes them, and windows of their cells. Runs in the page, in the
// worker and in Node. Cells are pairs of indices in the lattice's own basis; coordinates are metres.

class Lattice {
  constructor(numbers) {
    this.numbers = numbers;
    const [[p, q], [r, s]] = numbers.basis;
    Object.assign(this, { p, q, r, s });
    const det = p * s - q * r;
    this.ip = s / det;
    this.iq = -q / det;
    this.ir = -r / det;
    this.is = p / det;
    this.inverse = [[this.ip, this.iq], [this.ir, this.is]];
    [this.x0, this.y0] = numbers.origin;
    this.candidates = numbers.candidates;
    this.resolution = numbers.resolution;
    // How many metres at least one index more or less is away, whatever the other one is.
    this.height = 1 / Math.max(Math.hypot(this.ip, this.iq), Math.hypot(this.ir, this.is));
  }

  centre(a, b) {
    return [this.x0 + this.p * a + this.q * b, this.y0 + this.r * a + this.s * b];
  }

  distance(a, b) {
    return Math.hypot(this.p * a + this.q * b, this.r * a + this.s * b);
  }

  coordinates(x, y) {
    const u = x - this.x0, v = y - this.y0;
    return [this.ip * u + this.iq * v, this.ir * u + this.is * v];
  }

  // The cell whose centre is nearest to a point: of equally near ones the lexicographically lower.
  quantise(x, y) {
    let [u, v] = this.coordinates(x, y);
    u = Math.round(u * 2 ** 32) / 2 ** 32;
    v = Math.round(v * 2 ** 32) / 2 ** 32;
    const a = Math.floor(u), b = Math.floor(v);
    let best = Infinity, found = null;
    for (const [i, j] of this.candidates) {
      const du = u - a - i, dv = v - b - j;
      const d = (this.p * du + this.q * dv) ** 2 + (this.r * du + this.s * dv) ** 2;
      if (d < best - 1e-10 * this.resolution ** 2) {
        best = d;
        found = [a + i, b + j];
      }
    }
    return found;
  }

  // Distance from the displacement (x, y), metres, to the closed cell around the origin; 0 in it.
  distanceToCell(x, y) {
    const corners = this.numbers.vertices, n = corners.length;
    let inside = true, best = Infinity;
    for (let k = 0; k < n; k++) {
      const [ax, ay] = corners[k], [bx, by] = corners[(k + 1) % n];
      const ex = bx - ax, ey = by - ay;
      inside = inside && ex * (y - ay) - ey * (x - ax) >= 0;
      const t = Math.min(1, Math.max(0, ((x - ax) * ex + (y - ay) * ey) / (ex * ex + ey * ey)));
      best = Math.min(best, Math.hypot(x - ax - t * ex, y - ay - t * ey));
    }
    return inside ? 0 : best;
  }

  // The edges of the cell, one of each direction, in index coordinates: the cell is the sum of their halves.
  get generators() {
    const corners = this.numbers.vertices, found = [];
    corners.forEach(([ax, ay], k) => {
      const [bx, by] = corners[(k + 1) % corners.length];
      const x = bx - ax, y = by - ay, near = 1e-8 * this.resolution;
      const known = ([u, v]) => Math.min(Math.hypot(x - u, y - v), Math.hypot(x + u, y + v)) < near;
      if (Math.hypot(x, y) > 1e-10 * this.resolution && !found.some(known)) found.push([x, y]);
    });
    return found.map(([x, y]) => [this.ip * x + this.iq * y, this.ir * x + this.is * y]);
  }
}

// A window of cells with a blocked padding around it, wide enough that no move leads out of the array: the state of a
// cell lies at (a - low[0]) * stride + b - low[1], and moves are constant offsets.
class Window {
  constructor(lattice, neighbourhood, low, high) {
    this.lattice = lattice;
    this.moves = neighbourhood.moves;
    this.lengths = Float64Array.from(neighbourhood.lengths);
    const reach = [...this.moves, ...lattice.numbers.faces, ...neighbourhood.swept.flat()];
    this.pad = [0, 1].map((k) => Math.max(...reach.map((v) => Math.abs(v[k]))));
    this.low = [low[0] - this.pad[0], low[1] - this.pad[1]];
    this.shape = [0, 1].map((k) => high[k] - low[k] + 1 + 2 * this.pad[k]);
    this.stride = this.shape[1];
    this.size = this.shape[0] * this.shape[1];
    const flat = ([a, b]) => a * this.stride + b;
    this.offsets = Int32Array.from(this.moves, flat);
    this.faces = Int32Array.from(lattice.numbers.faces, flat);
    this.swept = Int32Array.from(neighbourhood.swept.flat(), flat);
    this.sweptStarts = new Int32Array(this.moves.length + 1);
    neighbourhood.swept.forEach((cells, k) => (this.sweptStarts[k + 1] = this.sweptStarts[k] + cells.length));
  }

  // The flat position of a cell, -1 outside the window and in its padding.
  flat(a, b) {
    const i = a - this.low[0], j = b - this.low[1];
    const inside = i >= this.pad[0] && j >= this.pad[1] && i < this.shape[0] - this.pad[0];
    return inside && j < this.shape[1] - this.pad[1] ? i * this.stride + j : -1;
  }

  index(flat) {
    const i = Math.floor(flat / this.stride);
    return [i + this.low[0], flat - i * this.stride + this.low[1]];
  }

  // The indices of flat positions, a and b in turn.
  indices(flats) {
    const out = new Int32Array(2 * flats.length), { stride } = this, [a, b] = this.low;
    for (let k = 0; k < flats.length; k++) {
      const i = Math.floor(flats[k] / stride);
      out[2 * k] = i + a;
      out[2 * k + 1] = flats[k] - i * stride + b;
    }
    return out;
  }

  // Room for searches, given back clean; pages of memory that no search touches cost nothing.
  get scratch() {
    const { size } = this;
    this._scratch ??= { g: new Float64Array(size), parent: new Int32Array(size), mark: new Uint8Array(size) };
    return this._scratch;
  }

  // Copy square tiles of states into the window's own array.
  fill(side, corners, tiles) {
    const states = new Uint8Array(this.size);
    for (let t = 0; t * 2 < corners.length; t++) {
      const a = corners[2 * t] * side - this.low[0], b = corners[2 * t + 1] * side - this.low[1];
      const from = Math.max(0, this.pad[1] - b), to = Math.min(side, this.shape[1] - this.pad[1] - b);
      for (let i = Math.max(0, this.pad[0] - a); i < side && a + i < this.shape[0] - this.pad[0]; i++) {
        const row = (t * side + i) * side;
        if (to > from) states.set(tiles.subarray(row + from, row + to), (a + i) * this.stride + b + from);
      }
    }
    return states;
  }
}
