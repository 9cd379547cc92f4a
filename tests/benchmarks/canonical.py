"""Figures 2 of planning: canonical search against A*, its costs against Dijkstra's on many random queries.

    python -m tests.benchmarks.canonical [check] [ties] [edges] [maps]

"check": 10,000 and more random queries a lattice and neighbourhood, obstacles 0 to 60 %, with and without
jumping. "ties": entries in the queue on A2-6 at 5 % random obstacles, also against an A* that breaks ties
between equal f otherwise. "edges": moves tried a node in a search of everything. "maps": the published maps,
seeded queries between connected cells, means over the same queries in one process, one thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import sys
import time

import numpy as np
from numba import njit

from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.graph.moves import Neighbourhood
from hexmap.io.grids.open_grid import open_grid
from hexmap.lattice.lattice import Lattice
from planners import NoPath, astar, dijkstra
from planners.search._shared_kernels import drop_top, gauge, may_move, project, rise
from planners.search.canonical import canonical, search_flat
from planners.search.heuristics import gauge_planes
from tests.benchmarks._common import data_folder, table, versions
from tests.lattices import CASES

NAMED = (
    ("A2", 6), ("A2", 12), ("D3*", 8), ("D3*", 14), ("D3", 12), ("D3", 18), ("Z2", 4), ("Z2", 8), ("Z3", 6), ("Z3", 26),
)  # fmt: skip
NEIGHBOURHOODS: tuple[Neighbourhood, ...] = ("nearest", "faces", "extended")
OBSTACLES = (0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
LARGER_G, SMALLER_G, FIRST_IN = 1, -1, 0


@njit(cache=True, nogil=True)
def _plain_astar(  # type: ignore[no-untyped-def]
    free, offsets, swept_starts, swept, strides, planes, heuristic_steps, targets, start, goal, ties, g, closed
):
    """Search by A* over moves of length 1; of equal f the larger g, the smaller g or the first entry goes first."""
    key = np.empty(1024, np.float64)
    tie = np.empty(1024, np.float64)
    node = np.empty(1024, np.int64)
    base = np.empty((1, planes.shape[0]), np.float64)
    g[start] = 0.0
    project(start, targets, planes, strides, base)
    rise(key, tie, node, 0, gauge(base, heuristic_steps, offsets.shape[0]), 0.0, start)
    count = 1
    pushes = 1
    while count > 0:
        a = node[0]
        count = drop_top(key, tie, node, count)
        if closed[a]:
            continue
        closed[a] = 1
        if a == goal:
            break
        if count + offsets.shape[0] > key.shape[0]:
            key = np.append(key, np.empty_like(key))
            tie = np.append(tie, np.empty_like(tie))
            node = np.append(node, np.empty_like(node))
        project(a, targets, planes, strides, base)
        for k in range(offsets.shape[0]):
            b = a + offsets[k]
            reached = g[a] + 1.0
            if free[b] == 0 or reached >= g[b] or not may_move(free, a, k, offsets, swept_starts, swept):
                continue
            g[b] = reached
            f = np.rint((reached + gauge(base, heuristic_steps, k)) * 1e6)
            rise(key, tie, node, count, f, ties * reached if ties != 0 else -float(pushes), b)
            count += 1
            pushes += 1
    return g[goal], pushes


def plain_astar(graph: LatticeGraph, start: np.ndarray, goal: np.ndarray, ties: int) -> tuple[float, int]:
    """Return moves and entries of the A* above, on equal edges."""
    ones = np.ones(len(graph.moves))
    planes = np.array(gauge_planes(graph.moves, ones))
    heuristic_steps = np.vstack([graph.moves @ planes.T, np.zeros((1, len(planes)))])
    a, b = graph.index_to_flat(np.array([start, goal]))
    targets = np.ascontiguousarray(goal[None] - graph.low, dtype=np.int64)
    cost, pushes = _plain_astar(
        graph.free, graph.offsets, graph.swept_starts, graph.swept, graph.strides, planes, heuristic_steps, targets,
        a, b, ties, np.full(graph.size, np.inf), np.zeros(graph.size, np.uint8),
    )  # fmt: skip
    return cost, pushes


def check(queries: int = 10_000) -> None:
    """Print how many costs differ from Dijkstra's; none may."""
    todo: list[tuple[Lattice, Neighbourhood]] = [(Lattice.named(name, 0.1), size) for name, size in NAMED]
    todo += [(Lattice.named(name, 0.1), size) for name, size in (("Z2", 16), ("A2", 24), ("Z3", 18), ("D3*", 26))]
    todo += [(case.lattice, nb) for case in CASES[5:] for nb in NEIGHBOURHOODS]
    rows: list[list[object]] = [["costs against Dijkstra", "queries", "with a path", "differ", "seconds"]]
    for lattice, neighbourhood in todo:
        rng = np.random.default_rng(7)
        asked, connected, differ = 0, 0, 0
        begin = time.perf_counter()
        while asked < queries:
            shape = rng.integers(3, 40, 2) if lattice.dim == 2 else rng.integers(2, 13, 3)
            states = (rng.random(shape) >= rng.choice(OBSTACLES)).astype(np.uint8)
            if not states.any():
                continue
            graph = LatticeGraph.from_states(
                lattice, rng.integers(-9, 9, lattice.dim), states, neighbourhood=neighbourhood
            )
            free = np.flatnonzero(graph.free)
            start = graph.flat_to_index(rng.choice(free, 1))[0]
            distance = dijkstra(graph, start).distance
            to = rng.choice(free, 25)
            for flat, goal in zip(to.tolist(), graph.flat_to_index(to), strict=True):
                least = float(distance[flat])
                for jump in (True, False):
                    try:
                        cost = canonical(graph, start, goal, jump=jump).cost
                    except NoPath:
                        cost = np.inf
                    differ += not (cost == least or abs(cost - least) <= 1e-10 * least)
                asked += 1
                connected += least < np.inf
        label = f"{lattice.name}-{neighbourhood}"
        rows.append([label, asked, connected, differ, time.perf_counter() - begin])
    table(rows)


def ties(queries: int = 100) -> None:
    """Print entries in the queue, sums over random queries."""
    rows: list[list[object]] = [
        ["A2-6, 1024 x 1024, random queries", "jumping", "canonical", "A*", "larger g", "first in", "smaller g",
         "A* / jumping", "first in / jumping", "smaller g / jumping"]
    ]  # fmt: skip
    for obstacles in (0.05, 0.2):
        rng = np.random.default_rng(1)
        states = (np.random.default_rng(0).random((1024, 1024)) >= obstacles).astype(np.uint8)
        graph = LatticeGraph.from_states(Lattice.named("A2"), [0, 0], states)
        labels = graph.components()
        largest = np.flatnonzero(labels == np.bincount(labels[labels >= 0]).argmax())
        sums = np.zeros(6)
        for _ in range(queries):
            a, b = graph.flat_to_index(rng.choice(largest, 2)).astype(np.int64)
            found = [canonical(graph, a, b), canonical(graph, a, b, jump=False), astar(graph, a, b)]
            others = [plain_astar(graph, a, b, by) for by in (LARGER_G, FIRST_IN, SMALLER_G)]
            costs = [*(path.cost for path in found), *(cost * graph.lengths[0] for cost, _ in others)]
            assert np.ptp(costs) <= 1e-9 * max(costs)
            sums += [*(path.pushes for path in found), *(pushes for _, pushes in others)]
        ratios = [sums[k] / sums[0] for k in (2, 4, 5)]
        rows.append([f"{obstacles:.0%} obstacles", *(sums / queries), *ratios])
    table(rows)


def edges() -> None:
    """Print the moves tried a node, from the middle to everything."""
    shares = (0.0, 0.05, 0.2)
    rows: list[list[object]] = [["moves tried a node", "all", *(f"{share:.0%}" for share in shares)]]
    for name, size in NAMED:
        lattice = Lattice.named(name)
        side = 400 if lattice.dim == 2 else 50
        row: list[object] = [f"{name}-{size}", size]
        for share in shares:
            states = (np.random.default_rng(2).random((side,) * lattice.dim) >= share).astype(np.uint8)
            middle = [side // 2] * lattice.dim
            states[tuple(middle)] = 1
            graph = LatticeGraph.from_states(lattice, [0] * lattice.dim, states, neighbourhood=size)
            found = search_flat(graph, int(graph.index_to_flat(np.array([middle]))[0]), -1, jump=False)
            row.append(found.tried / dijkstra(graph, middle).settled)
        rows.append(row)
    table(rows)


def maps(queries: int = 60) -> None:
    """Print milliseconds, entries and expansions on the published maps."""
    data = data_folder()
    flat: list[tuple[str, int, float]] = [("Z2", 8, 1.0), ("A2", 6, 0.5), ("A2", 12, 0.5)]
    solid: list[tuple[str, int, float]] = [("Z3", 26, 1.0), ("D3", 12, 1.0), ("D3*", 14, 1.0)]
    files = [(path, flat) for path in sorted(data.glob("planning/movingai/*.map"))]
    files += [(path, solid) for path in sorted(data.glob("planning/warframe/*.3dmap.gz"), reverse=True)]
    head: list[object] = [
        "map", "free cells", "A* ms", "ordering", "jumping", "A* / jumping", "A* pushes", "ordering", "jumping",
        "A* expanded", "ordering", "jumping", "scanned",
    ]  # fmt: skip
    rows = [head]
    for path, layouts in files:
        world = open_grid(path)
        large = world.states.size > 20_000_000
        for name, size, resolution in layouts:
            graph = world.to_graph(Lattice.named(name, resolution), neighbourhood=size)
            labels = graph.components()
            largest = np.flatnonzero(labels == np.bincount(labels[labels >= 0]).argmax())
            rng = np.random.default_rng(11)
            count = queries // 6 if large else queries
            sums = np.zeros((3, 4))
            for query in range(-1, count):
                a, b = graph.flat_to_index(rng.choice(largest, 2))
                found = [astar(graph, a, b), canonical(graph, a, b, jump=False), canonical(graph, a, b)]
                assert np.ptp([one.cost for one in found]) <= 1e-9 * found[0].cost
                if query >= 0:  # the first one warms up
                    sums += [[1e3 * one.seconds, one.pushes, one.expansions, one.scanned] for one in found]
            t, p, e, s = (sums / count).T
            label = f"{path.name.split('.')[0]} {name}-{size}"
            counts = [int(c) for c in np.rint([*p, *e, s[2]])]
            rows.append([label, int(graph.free.sum()), *t.tolist(), float(t[0] / t[2]), *counts])
        table(rows)
        rows = [head]


def main(arguments: list[str] | None = None) -> None:
    """Print the tables asked for, all without a name."""
    print(versions("hexmap", "numpy", "numba"), "\n")
    parts = {"check": check, "ties": ties, "edges": edges, "maps": maps}
    for name in [name for name in (sys.argv[1:] if arguments is None else arguments) if name in parts] or parts:
        parts[name]()


if __name__ == "__main__":
    main()
