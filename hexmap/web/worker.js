"use strict";
// The worker's side of planning: it keeps the states of each map and answers one question after the other.

const maps = new Map();

// The graph of a map for a robot; kept until another is asked for.
function graphFor(map, { neighbourhood, radius, weight }) {
  const key = JSON.stringify([neighbourhood, radius, weight]);
  if (map.key !== key) {
    map.key = null;
    const { numbers, lattice } = map;
    if (map.windowOf !== neighbourhood) {
      const moves = numbers.neighbourhoods.find((n) => n.name === neighbourhood) ?? numbers.neighbourhoods[0];
      map.window = new Window(lattice, moves, numbers.low, numbers.high);
      map.states = map.window.fill(numbers.side, numbers.tiles, map.tiles);
      map.windowOf = neighbourhood;
    }
    const reach = Math.max(0.5, 2 * lattice.resolution);
    const surface = map.graph?.window === map.window ? map.graph : null;
    map.graph = new Graph(map.window, map.states, surface).withRadius(radius).withWeight(weight, reach);
    map.key = key;
  }
  return map.graph;
}

// Why a cell cannot be an end of a path, or null.
function obstacleTo(graph, role, flat) {
  if (flat < 0) return `The ${role} lies outside the map.`;
  if (graph.free[flat]) return null;
  const why = ["unknown", "too near to a wall for this robot", "occupied"][graph.states[flat]];
  return `The ${role} is ${why}.`;
}

function answer(map, question) {
  const begin = performance.now(), graph = graphFor(map, question), { window } = graph;
  const prepared = performance.now() - begin;
  const from = window.flat(...question.start), to = window.flat(...question.goal);
  const reason = obstacleTo(graph, "start", from) ?? obstacleTo(graph, "goal", to);
  if (reason) return { reason };
  const started = performance.now();
  const found = question.anyAngle ? anyAngle(graph, from, to) : astar(graph, from, to);
  const ms = performance.now() - started;
  const entered = window.indices(found.entered);
  const numbers = { entered, expansions: found.expansions, ms, prepared };
  if (found.path === null) return { ...numbers, reason: "Nothing leads from the start to the goal." };
  const { path } = found, cells = path.map((flat) => window.index(flat));
  let met = path;
  if (question.anyAngle) {
    const sight = new Sight(graph), listed = new Listing();
    path.forEach((flat, k) => k && sight.sees(path[k - 1], flat, listed));
    met = [...listed.done(), from];
  }
  const points = cells.map(([a, b]) => window.lattice.centre(a, b));
  return { ...numbers, cells, ...measure(points), clearance: graph.clearance(met) };
}

// Length, metres, and turning, radians, of a polyline.
function measure(points) {
  let length = 0, turning = 0, before = null;
  for (let k = 1; k < points.length; k++) {
    const x = points[k][0] - points[k - 1][0], y = points[k][1] - points[k - 1][1];
    length += Math.hypot(x, y);
    if (before) turning += Math.abs(Math.atan2(before[0] * y - before[1] * x, before[0] * x + before[1] * y));
    before = [x, y];
  }
  return { length, turning };
}

function warmUp(map, settings) {
  try {
    graphFor(map, settings).clearance([]);
    // A search over nothing but free cells, so that the code is compiled by the time it is wanted.
    const small = new Window(map.lattice, map.numbers.neighbourhoods[0], [0, 0], [79, 79]);
    const states = small.fill(80, [0, 0], new Uint8Array(6400).fill(1)), corner = small.flat(0, 0);
    for (let k = 0; k < 8; k++) astar(new Graph(small, states), corner, small.flat(79, 9 * k));
  } catch (error) {
    if (!(error instanceof RangeError)) throw error;
  }
}

function serve(message) {
  const { kind, name } = message;
  if (kind === "level") {
    maps.set(name, { numbers: message.numbers, tiles: message.tiles, lattice: new Lattice(message.numbers) });
    // While nobody waits: the first path should not take longer than the others.
    if (message.settings) warmUp(maps.get(name), message.settings);
    return null;
  }
  try {
    return { name, ticket: message.ticket, ...answer(maps.get(name), message) };
  } catch (error) {
    // A window of all cells may be more than a tab gets.
    if (!(error instanceof RangeError)) throw error;
    return { name, ticket: message.ticket, reason: "This level is too large to plan in; take a coarser one." };
  }
}

if (typeof WorkerGlobalScope !== "undefined" && self instanceof WorkerGlobalScope) {
  self.onmessage = ({ data }) => {
    const result = serve(data);
    if (result) self.postMessage(result, result.entered ? [result.entered.buffer] : []);
  };
}
