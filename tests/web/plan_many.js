// Reads {level, states, low, high, neighbourhood, settings, queries} from standard input, after the page's planner, and
// writes for each setting (radius, weight, reach, anyAngle) and query the path that the page would find.
const given = JSON.parse(require("fs").readFileSync(0, "utf8"));
const lattice = new Lattice(given.level);
const window_ = new Window(lattice, given.neighbourhood, given.low, given.high);
const states = new Uint8Array(window_.size);
const inner = Buffer.from(given.states, "base64");
const wide = given.high[1] - given.low[1] + 1;
inner.forEach((state, k) => {
  states[window_.flat(given.low[0] + Math.floor(k / wide), given.low[1] + (k % wide))] = state;
});
const answers = given.settings.map(({ radius, weight, reach, anyAngle: any }) => {
  const graph = new Graph(window_, states).withRadius(radius).withWeight(weight, reach);
  return given.queries.map(([start, goal]) => {
    const from = window_.flat(...start), to = window_.flat(...goal);
    if (from < 0 || to < 0 || !graph.free[from] || !graph.free[to]) return { blocked: true };
    const found = any ? anyAngle(graph, from, to) : astar(graph, from, to);
    if (found.path === null) return { cost: null };
    const cells = found.path.map((at) => window_.index(at));
    const cost = any ? null : costOf(graph, found.path);
    return { cost, cells, clearance: graph.clearance(found.path), expansions: found.expansions };
  });
});
process.stdout.write(JSON.stringify(answers));
