"""Figures 1 of planning: fields from one cell to all others, settled cells a second, against the peers.

20 % random obstacles, one thread, the same cells in the same process, medians. A cell is settled when
its distance is final. "search" is the field with the graph at hand, "with graph" makes the graph of
the array of states as well, "with float64" also the distances in metres of the steps. Peers: scipy's
Dijkstra on the same lattice, its matrix made beforehand; dijkstra3d where it is installed, on
squares and cubes with all neighbours.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from hexmap.graph import LatticeGraph
from hexmap.lattice import Lattice
from planners import astar, dijkstra
from tests.benchmarks._timing import median_seconds, table, versions

FIELDS = (
    ("A2", 6, (1024, 1024)),
    ("Z2", 4, (1024, 1024)),
    ("Z2", 8, (1024, 1024)),
    ("A2", 12, (1024, 1024)),
    ("D3", 12, (128, 128, 128)),
    ("D3*", 8, (128, 128, 128)),
    ("Z3", 6, (128, 128, 128)),
    ("Z3", 26, (128, 128, 128)),
    ("D3", 18, (128, 128, 128)),
    ("D3*", 14, (128, 128, 128)),
)


def states(shape: tuple[int, ...], obstacles: float = 0.2, seed: int = 0) -> np.ndarray:
    """Random cells, free around two corners and the middle."""
    free = (np.random.default_rng(seed).random(shape) >= obstacles).astype(np.uint8)
    for at in ([0] * len(shape), [s // 2 for s in shape], [s - 4 for s in shape]):
        free[tuple(slice(a, a + 4) for a in at)] = 1
    return free


def fields(repeats: int = 5) -> None:
    """Print millions of settled cells a second, from the middle to all."""
    rows: list[list[object]] = [
        ["one to all, 20 % obstacles", "settled", "search", "with graph", "with float64", "scipy", "times scipy"]
    ]
    for name, size, shape in FIELDS:
        lattice, free = Lattice.named(name), states(shape)
        middle = [s // 2 for s in shape]

        def make(lattice: Lattice = lattice, free: np.ndarray = free, size: int = size) -> LatticeGraph:
            return LatticeGraph.from_states(lattice, [0] * lattice.dim, free, neighbourhood=size)

        graph = make()
        field = dijkstra(graph, middle)
        search = median_seconds(lambda g=graph, m=middle: dijkstra(g, m), repeats)
        whole = median_seconds(lambda make=make, m=middle: dijkstra(make(), m), repeats)
        metres = median_seconds(lambda make=make, m=middle: dijkstra(make(), m).distance, repeats)
        from scipy.sparse.csgraph import dijkstra as scipy_dijkstra

        matrix, nodes = graph.to_csr()
        at = int(np.searchsorted(nodes, graph.index_to_flat(np.array([middle]))[0]))
        peer = median_seconds(lambda m=matrix, at=at: scipy_dijkstra(m, indices=at), 1)
        expected = scipy_dijkstra(matrix, indices=at)
        np.testing.assert_allclose(field.distance[nodes], expected, rtol=1e-9)
        settled = field.settled / 1e6
        rates = [settled / t for t in (search, whole, metres, peer)]
        rows.append([f"{name}-{size}, {' x '.join(map(str, shape))}", field.settled, *rates, rates[2] / rates[3]])
    try:
        import dijkstra3d

        for shape in ((1024, 1024), (128, 128, 128)):
            free = states(shape)
            cost = np.where(free != 0, 1.0, np.inf).astype(np.float32)
            source = tuple(s // 2 for s in shape)
            t = median_seconds(lambda c=cost, s=source: dijkstra3d.distance_field(c, source=s), repeats)
            found = int(np.isfinite(dijkstra3d.distance_field(cost, source=source)).sum())
            rate = found / t / 1e6
            rows.append([f"dijkstra3d, {' x '.join(map(str, shape))}", found, rate, rate, rate, "", ""])
    except ImportError as error:
        print(f"dijkstra3d is left out: {error}")
    table(rows)


def corners(repeats: int = 5) -> None:
    """Print milliseconds from corner to corner."""
    head = ["corner to corner, 20 % obstacles", "ms", "both ends, ms", "no heuristic, ms", "expanded", "both", "none"]
    rows: list[list[object]] = [head]
    for name, size, shape in FIELDS:
        lattice = Lattice.named(name)
        graph = LatticeGraph.from_states(lattice, [0] * lattice.dim, states(shape), neighbourhood=size)
        start, goal = [0] * len(shape), [s - 1 for s in shape]
        try:
            found = [
                astar(graph, start, goal),
                astar(graph, start, goal, bidirectional=True),
                astar(graph, start, goal, heuristic="none"),
            ]
        except ValueError as error:
            print(f"{name}-{size} is left out: {error}")
            continue
        assert np.ptp([path.cost for path in found]) < 1e-9 * found[0].cost
        times = [
            median_seconds(lambda g=graph, a=start, b=goal: astar(g, a, b), repeats),
            median_seconds(lambda g=graph, a=start, b=goal: astar(g, a, b, bidirectional=True), repeats),
            median_seconds(lambda g=graph, a=start, b=goal: astar(g, a, b, heuristic="none"), 1),
        ]
        label = f"{name}-{size}, {' x '.join(map(str, shape))}"
        rows.append([label, *[1e3 * t for t in times], *[path.expansions for path in found]])
    table(rows)


def main() -> None:
    """Print all tables."""
    print(versions("hexmap", "numpy", "numba", "scipy", "dijkstra3d"), "\n")
    print("millions of settled cells a second\n")
    fields()
    corners()


if __name__ == "__main__":
    main()
