"""Figures of planning: ``python -m tests.benchmarks.planning [fields|corners|memory] ...``, all without a name.

fields: from one cell to all others, settled cells a second. A cell is settled when its distance is
final. "search" is the field with the graph at hand, "with graph" makes the graph of the array of
states as well, "with float64" also the distances in metres of the steps. Peers: scipy's Dijkstra on
the same lattice, its matrix made beforehand; dijkstra3d where it is installed, on squares and cubes
with all neighbours.

corners: from corner to corner, and the same against dijkstra3d and networkx on squares and cubes.

memory: bytes a cell of the world, for a box of a hundred million cells (``--cells`` for another
number) and for the largest Warframe map where there is real data. Each in a process of its own.

20 % random obstacles, one thread, the same cells in the same process, medians.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from hexmap.experiments.timing import median_seconds
from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.lattice.lattice import Lattice
from planners import astar, dijkstra
from tests.benchmarks._common import data_folder, table, versions

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


def euclidean_length(cells: np.ndarray) -> float:
    """Return the length of a polyline of cells (M, n)."""
    return float(np.linalg.norm(np.diff(cells.astype(np.int64), axis=0), axis=1).sum())


def corner_peers(repeats: int = 5) -> None:
    """Print the same task by others, on squares with 8 and cubes with 26 neighbours.

    dijkstra3d's Euclidean search is ``dijkstra(..., anisotropy=(1, 1[, 1]))``; its ``compass`` leaves
    the Euclidean search as it is, and its ``bidirectional`` falls back to it. It knows no corner
    rule: its paths squeeze between two blocked cells, are shorter and so end sooner. "no rule" is
    ours without one as well, which is its task to the last digit. networkx keeps our rule, as it
    searches our graph; its heuristic is the octile distance. On the large cube its graph does not
    fit: there both search a small one.
    """
    head = ["peers, 20 % obstacles", "ms", "cost", "their ms, C order", "F order", "their cost", "times ours"]
    rows: list[list[object]] = [[*head, "no rule, ms", "cost", "times ours"]]
    for name, size, shape in (("Z2", 8, (1024, 1024)), ("Z3", 26, (128, 128, 128))):
        try:
            import dijkstra3d
        except ImportError as error:
            print(f"dijkstra3d is left out: {error}")
            break
        n, free = len(shape), states(shape)
        graph = LatticeGraph.from_states(Lattice.named(name), [0] * n, free, neighbourhood=size)
        start, goal = [0] * n, [s - 1 for s in shape]
        loose = LatticeGraph.from_states(Lattice.named(name), [0] * n, free, neighbourhood=size)
        loose.swept, loose.swept_starts = np.empty(0, np.int64), np.zeros(size + 1, np.int64)
        ours = median_seconds(lambda g=graph, a=start, b=goal: astar(g, a, b), repeats)
        without = median_seconds(lambda g=loose, a=start, b=goal: astar(g, a, b), repeats)
        theirs = []
        for order in ("C", "F"):
            cost = np.asarray(np.where(free != 0, 1.0, np.inf), dtype=np.float32, order=order)

            def peer(cost: np.ndarray = cost, n: int = n, shape: tuple[int, ...] = shape) -> np.ndarray:
                end = tuple(s - 1 for s in shape)
                return dijkstra3d.dijkstra(
                    cost, (0,) * n, end, connectivity={2: 8, 3: 26}[n], anisotropy=(1.0,) * n
                )  # fmt: skip

            theirs.append(median_seconds(peer, repeats))
        length, free_length = euclidean_length(peer()), astar(loose, start, goal).cost
        # It adds up in float32.
        assert abs(length - free_length) < 1e-4 * free_length, (length, free_length)
        best = min(theirs)
        rows.append(
            [f"dijkstra3d, {name}-{size}, {' x '.join(map(str, shape))}", 1e3 * ours, astar(graph, start, goal).cost,
             *[1e3 * t for t in theirs], length, best / ours, 1e3 * without, free_length, best / without]
        )  # fmt: skip
    for name, size, shape in (("Z2", 8, (1024, 1024)), ("Z3", 26, (96, 96, 96))):
        import networkx

        n = len(shape)
        graph = LatticeGraph.from_states(Lattice.named(name), [0] * n, states(shape), neighbourhood=size)
        start, goal = [0] * n, [s - 1 for s in shape]
        ours = median_seconds(lambda g=graph, a=start, b=goal: astar(g, a, b), repeats)
        other = graph.to_networkx()
        steps = [math.sqrt(k) for k in range(1, n + 1)]
        # Longest side first: that many moves of each kind.
        rates = [b - a for a, b in zip([0.0, *steps], steps, strict=False)]

        def octile(u: tuple[int, ...], v: tuple[int, ...], rates: list[float] = rates) -> float:
            # A little less: rounding must not estimate a single path above its cost.
            sides = sorted((abs(a - b) for a, b in zip(u, v, strict=True)), reverse=True)
            return (1.0 - 1e-12) * sum(side * rate for side, rate in zip(sides, rates, strict=True))

        begin = time.perf_counter()
        path = networkx.astar_path(other, tuple(start), tuple(goal), heuristic=octile, weight="weight")
        peer_seconds = time.perf_counter() - begin
        least, length = astar(graph, start, goal).cost, euclidean_length(np.array(path))
        assert abs(least - length) < 1e-9 * least
        label = f"networkx, {name}-{size}, {' x '.join(map(str, shape))}"
        rows.append(
            [label, 1e3 * ours, least, 1e3 * peer_seconds, "", length, peer_seconds / ours, "", "", ""]
        )  # fmt: skip
        del other, path
    table(rows)


# ---------------------------------------------------------------------- memory

WORLDS = (("A2", 6), ("Z2", 8), ("A2", 12), ("Z3", 6), ("Z3", 26), ("D3", 12), ("D3*", 8))


def box_free(points: np.ndarray, low: float, high: float) -> np.ndarray:
    """Tell which points (N, n) are free: four of five, by a hash of where they are, and all near the two corners."""
    index = np.floor(points * 1024.0).astype(np.int64).astype(np.uint64)
    mixed = np.zeros(len(points), np.uint64)
    for column in index.T:
        mixed = (mixed ^ column) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= mixed >> np.uint64(29)
    free = (mixed * np.uint64(0xBF58476D1CE4E5B9)) >> np.uint64(40) >= np.uint64(0.2 * 2**24)
    return free | (points < low + 6.0).all(axis=1) | (points > high - 6.0).all(axis=1)


def resident(field: str) -> int:
    """Return a figure of this process, bytes: VmRSS now, VmHWM at most since it was set back."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(field + ":"):
            return 1024 * int(line.split()[1])
    return 0


def one_world(name: str, size: int, cells: int, world_path: str) -> dict[str, float]:
    """Build a graph and search it, in this process: what it took."""
    lattice = Lattice.named(name)
    n = lattice.dim
    warm = LatticeGraph.rasterise(lambda p: np.ones(len(p), bool), lattice, [0.0] * n, [9.0] * n, neighbourhood=size)
    a = np.flatnonzero(warm.free)
    astar(warm, warm.flat_to_index(a[:1])[0], warm.flat_to_index(a[-1:])[0])
    before = resident("VmRSS")
    if world_path:
        from hexmap.io.grids.open_grid import open_grid
        from hexmap.io.grids.scenarios import read_scenario

        world = open_grid(world_path)
        problems = read_scenario(world_path.replace(".3dmap.gz", ".3dmap.3dscen.gz"))
        longest = int(np.argmax(problems.lengths))
        ends = [world.centre(at[longest][None])[0] for at in (problems.starts, problems.goals)]
        amount = math.prod(world.states.shape)
        begin = time.perf_counter()
        graph = world.to_graph(lattice, neighbourhood=size)
    else:
        edge = round(cells ** (1 / n))
        ends = [np.full(n, 2.0), np.full(n, edge - 2.0)]
        amount = edge**n
        begin = time.perf_counter()
        graph = LatticeGraph.rasterise(
            lambda p: box_free(p, 0.0, float(edge)), lattice, [0.0] * n, [float(edge)] * n, neighbourhood=size
        )
    build = time.perf_counter() - begin
    start, goal = lattice.quantise(np.array(ends))
    tracemalloc.start()
    at = resident("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")
    begin = time.perf_counter()
    path = astar(graph, start, goal)
    plan = time.perf_counter() - begin
    return {
        "cells": amount,
        "window": graph.size,
        "graph": graph.memory,
        "built": at - before,
        "reserved": tracemalloc.get_traced_memory()[1],
        "search": resident("VmHWM") - at,
        "build": build,
        "plan": plan,
        "expansions": path.expansions,
        "cost": path.cost,
    }


def memory(cells: int = 10**8) -> None:
    """Print bytes a cell of the world: of the graph, and of a search from corner to corner."""
    head = ["bytes a cell of the world", "cells", "window cells a cell", "graph", "resident"]
    rows: list[list[object]] = [[*head, "search, reserved", "resident", "build, s", "plan, s", "expanded"]]
    tasks = [(name, size, "") for name, size in WORLDS]
    data = data_folder()
    warframe = data / "planning" / "warframe" / "A1.3dmap.gz"
    if warframe.exists():
        tasks += [("Z3", 26, str(warframe)), ("D3", 12, str(warframe)), ("D3*", 8, str(warframe))]
    for name, size, world in tasks:
        command = [sys.executable, "-m", "tests.benchmarks.planning", "--child", json.dumps([name, size, cells, world])]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        label = f"{name}-{size}, {'Warframe A1' if world else 'box'}"
        if done.returncode:
            print(f"{label} is left out: {(done.stderr.strip().splitlines() or ['killed'])[-1]}")
            continue
        r = json.loads(done.stdout.splitlines()[-1])
        amount = r["cells"]
        rows.append(
            [label, amount, r["window"] / amount, *[r[k] / amount for k in ("graph", "built", "reserved", "search")],
             r["build"], r["plan"], r["expansions"]]
        )  # fmt: skip
    table(rows)


def main(arguments: list[str] | None = None) -> None:
    """Print the figures asked for."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.planning", description="Figures of planning.")
    parser.add_argument("figures", nargs="*", help="fields, corners, memory; all without a name")
    parser.add_argument("--cells", type=int, default=10**8, help="of the worlds of the figure memory")
    parser.add_argument("--repeats", type=int, default=5, help="of which the median is printed")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    chosen = parser.parse_args(arguments)
    if chosen.child:
        print(json.dumps(one_world(*json.loads(chosen.child))))
        return
    figures = chosen.figures or ["fields", "corners", "memory"]
    for figure in figures:
        if figure not in ("fields", "corners", "memory"):
            parser.error(f"no figure {figure!r}: fields, corners or memory")
    print(versions("hexmap", "numpy", "numba", "scipy", "dijkstra3d", "networkx"), "\n")
    if "fields" in figures:
        print("millions of settled cells a second\n")
        fields(chosen.repeats)
    if "corners" in figures:
        corners(chosen.repeats)
        corner_peers(chosen.repeats)
    if "memory" in figures:
        memory(chosen.cells)


if __name__ == "__main__":
    main()
