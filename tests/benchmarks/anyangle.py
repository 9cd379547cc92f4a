"""Figures of any-angle planning: lengths over the true optimum, times, and what the search looked at.

In the plane: the MovingAI maps rasterised by the cells' centres at the source resolution, 1/2 and 1/4 of it; the
optimum is that of a point through the source map between the same two points (planners.any_angle.optimum).
Rasters on hexagons can open or shut gaps of the source map: ratios below one are such gaps. In space: the
Warframe maps, against the shortest of the paths that any planner here found. Times are CPU seconds of one
thread. ``python -m tests.benchmarks.anyangle [--queries 100] [map ...]``, maps by name such as arena or Simple.

``hard`` as a name stands for maps on which lines are long or many, corridors, spirals and sparse fields of 500, 1000
and 2000 cells a side: times there are the least of two, A* and any-angle in turn.
"""

from __future__ import annotations

import argparse
import gzip
import time
from pathlib import Path as FilePath

import numpy as np

from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.lattice.lattice import Lattice
from planners import NoPath, astar, shortcut
from planners.any_angle.optimum import AnyAngleOptimum
from planners.any_angle.theta_star import search_path
from tests.benchmarks._common import data_folder, table, versions
from tests.planners import hard

PLANE = (("Z2", 8, 1.0), ("Z2", 8, 0.5), ("A2", 6, 0.5), ("A2", 12, 0.5), ("Z2", 8, 0.25), ("A2", 6, 0.25))
MAPS = ("arena", "den520d", "AR0011SR", "brc202d", "Berlin_0_512", "maze512-8-0", "random512-25-0")
SPACE = (("Z3", 26), ("D3", 18), ("D3*", 14))
HEAD: list[object] = [
    "length / best",
    "queries",
    "mean",
    "95 %",
    "most",
    "of A*",
    "ms",
    "A* ms",
    "expanded",
    "lines",
    "cells",
]


def read_map(folder: FilePath, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the free cells (columns, rows) of a map, and the ends (Q, 2, 2) of its problems."""
    lines = (folder / f"{name}.map").read_text().splitlines()
    free = np.array([[c in ".GS" for c in row] for row in lines[4:]]).T.copy()
    rows = [line.split() for line in (folder / f"{name}.map.scen").read_text().splitlines()[1:] if line.strip()]
    return free, np.array([[int(v) for v in row[4:8]] for row in rows]).reshape(-1, 2, 2)


def read_voxels(folder: FilePath, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the free cells of a map in space, and the ends (Q, 2, 3) of its problems."""
    with gzip.open(folder / f"{name}.3dmap.gz", "rt") as file:
        free = np.ones([int(v) for v in file.readline().split()[1:4]], np.bool_)
        free[tuple(np.loadtxt(file, dtype=np.int64).T)] = False
    with gzip.open(folder / f"{name}.3dmap.3dscen.gz", "rt") as file:
        rows = [line.split() for line in file.read().splitlines()[2:] if line.strip()]
    return free, np.array([[int(v) for v in row[:6]] for row in rows]).reshape(-1, 2, 3)


def rasterise(free: np.ndarray, lattice: Lattice, neighbourhood: int) -> LatticeGraph:
    """Make the graph of cells whose centre lies in a free cell; cell i spans i - 0.5 to i + 0.5."""
    last = np.array(free.shape) - 1

    def free_at(points: np.ndarray) -> np.ndarray:
        return free[tuple(np.clip(np.floor(points + 0.5).astype(np.int64), 0, last).T)]

    inside = 0.5 - 1e-9
    return LatticeGraph.rasterise(
        free_at, lattice, -inside * np.ones(free.ndim), last + inside, neighbourhood=neighbourhood
    )


def one_map(label: str, free: np.ndarray, ends: np.ndarray, kind: tuple[str, int, float], count: int) -> list[object]:
    """Return a row of the table."""
    name, neighbourhood, size = kind
    lattice = Lattice.named(name, size)
    graph = rasterise(free, lattice, neighbourhood)
    optimum = AnyAngleOptimum(free) if free.ndim == 2 else None
    rows: list[list[float]] = []
    for k in np.random.default_rng(0).permutation(len(ends))[:count]:
        cells = lattice.quantise(ends[k].astype(np.float64))
        a, b = graph.index_to_flat(cells).tolist()
        if min(a, b) < 0 or a == b or not (graph.free[a] and graph.free[b]):
            continue
        if not rows:
            search_path(graph, a, b)  # compiles
        begin = time.thread_time()
        cells_on_path, effort = search_path(graph, a, b)
        middle = time.thread_time()
        try:
            path = astar(graph, cells[0], cells[1])
        except NoPath:
            continue
        after = time.thread_time()
        points = graph.centres(cells_on_path)
        length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        try:
            if optimum is not None:
                best = optimum.path(points[0], points[-1]).length
            else:
                raw, _ = search_path(graph, a, b, lazy=False)
                eager = float(np.linalg.norm(np.diff(graph.centres(raw), axis=0), axis=1).sum())
                best = min(length, eager, shortcut(graph, path).length)
        except NoPath:
            continue
        ratios = length / best, length / path.length
        times = 1e3 * (middle - begin), 1e3 * (after - middle)
        rows.append([*ratios, *times, effort.expansions, effort.lines, effort.scanned])
    if not rows:
        return [label, 0, *[""] * (len(HEAD) - 2)]
    r = np.array(rows, dtype=np.float64)
    mean = r.mean(axis=0)
    over = [f"{v:.4f}" for v in (mean[0], np.quantile(r[:, 0], 0.95), r[:, 0].max(), mean[1])]
    return [label, len(r), *over, *[float(v) for v in mean[2:4]], *[int(v) for v in mean[4:]]]


def hard_map(label: str, side: int, name: str, neighbourhood: int) -> list[object]:
    """Return a row of the table of hard maps."""
    states, *ends_of = hard.MAPS[label](side)
    start, goal = (list(end) for end in ends_of)
    graph = LatticeGraph.from_states(Lattice.named(name), [0, 0], states, neighbourhood=neighbourhood)
    source, target = graph.index_to_flat(np.array([start, goal])).tolist()
    moving, straight = [], []
    for _ in range(2):
        begin = time.process_time()
        path = astar(graph, start, goal)
        middle = time.process_time()
        cells, effort = search_path(graph, source, target)
        moving.append(middle - begin)
        straight.append(time.process_time() - middle)
    length = float(np.linalg.norm(np.diff(graph.centres(cells), axis=0), axis=1).sum())
    times = 1e3 * min(moving), 1e3 * min(straight), min(straight) / min(moving)
    return [f"{label}, {name}-{neighbourhood}", side, *times, path.expansions, effort.expansions, f"{length:.2f}"]


def hard_maps() -> None:
    """Print the table of hard maps."""
    rows: list[list[object]] = [["map", "side", "A* ms", "any-angle ms", "times", "A* expands", "expands", "length"]]
    for name, neighbourhood in (("Z2", 8), ("A2", 6)):
        hard_map("1 % blocked", 100, name, neighbourhood)  # compiles
        rows += [hard_map(label, side, name, neighbourhood) for label in hard.MAPS for side in (500, 1000, 2000)]
    table(rows)


def main(arguments: list[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.anyangle")
    parser.add_argument("maps", nargs="*")
    parser.add_argument("--queries", type=int, default=100)
    chosen = parser.parse_args(arguments)
    maps, queries = chosen.maps, chosen.queries
    print(versions("hexmap", "numpy", "numba"), "\n")
    if not maps or "hard" in maps:
        hard_maps()
        maps = [name for name in maps if name != "hard"]
        if chosen.maps and not maps:
            return
    folder = data_folder() / "planning"
    if not folder.is_dir():
        print("any-angle planning is left out: no shared data (set HEXMAP_DATA)")
        return
    rows: list[list[object]] = [HEAD]
    for name in maps or MAPS:
        if name not in MAPS:
            continue
        free, ends = read_map(folder / "movingai", name)
        for kind in PLANE:
            rows.append(one_map(f"{name}, {kind[0]}-{kind[1]}, 1/{1 / kind[2]:g}", free, ends, kind, queries))
    if len(rows) > 1:
        table(rows)
    rows = [HEAD]
    for name in maps or ("Simple", "Complex"):
        if name in MAPS:
            continue
        free, ends = read_voxels(folder / "warframe", name)
        for lattice, neighbourhood in SPACE:
            label = f"{name}, {lattice}-{neighbourhood}"
            rows.append(one_map(label, free, ends, (lattice, neighbourhood, 1.0), queries))
    if len(rows) > 1:
        table(rows)


if __name__ == "__main__":
    main()
