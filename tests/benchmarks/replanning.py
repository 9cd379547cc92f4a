"""Replanning against planning anew: one change, what a sensor sees, and a robot that discovers its map.

Times are of the processor (other work on the machine counts little) for all that a user waits for:
noting the changes and the path, all of Python included. "anew" is
A* on the graph as it is then, made outside the timer, and the canonical search where there is one;
costs are compared every time. ``python -m tests.benchmarks.replanning [fraction]`` takes a fraction of the repetitions.
"""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.lattice.lattice import Lattice
from planners import NoPath, astar
from planners.replanning.replanner import Replanner
from tests.benchmarks._common import table, versions

SETTINGS = [("A2", None, 1024), ("Z2", 8, 1024), ("D3", 12, 96), ("D3*", 8, 96), ("Z3", 26, 96)]
HILLY = [("A2", None, 512)]
OBSTACLES = 0.2
SEEDS = (2, 5, 6)  # of starts and goals; a rare bad case depends on them more than on the change


def _canonical() -> Callable[..., Any] | None:
    """Return the canonical search where it exists."""
    try:
        return getattr(importlib.import_module("planners.search.canonical"), "canonical", None)
    except ImportError:
        return None


class Race:
    """Times of repairs and of planning anew, case by case."""

    def __init__(self) -> None:
        self.times: dict[str, list[float]] = {"repair": [], "astar": [], "canonical": []}
        self.canonical = _canonical()

    def run(self, robot: Replanner, change: Callable[[], None], start: Any, goal: Any, anew: bool = True) -> Any:
        begin = time.thread_time()
        change()
        try:
            path = robot.path()
        except NoPath:
            path = None
        self.times["repair"].append(time.thread_time() - begin)
        if anew:
            graph = robot.graph
            for name, planner in (("astar", astar), ("canonical", self.canonical)):
                if planner is None or (name == "canonical" and graph.terrain is not None):
                    continue
                begin = time.thread_time()
                try:
                    other = planner(graph, start, goal)
                except NoPath:
                    other = None
                self.times[name].append(time.thread_time() - begin)
                assert (path is None) == (other is None)
                assert path is None or abs(path.cost - other.cost) <= 1e-12 * other.cost
        return path

    def row(self, label: str) -> list[object]:
        t = {name: np.array(v) * 1e3 for name, v in self.times.items()}
        out: list[object] = [label, len(t["repair"])]
        out += [float(np.median(t["repair"])), float(t["repair"].mean()), float(t["repair"].max())]
        for name in ("astar", "canonical"):
            if len(t[name]) == 0:
                out += ["-"] * 5
                continue
            out += [float(np.median(t[name])), float(t[name].mean()), float(t[name].max())]
            out += [float(out[-3] / out[2]), float(out[-2] / out[3])]
        return out


HEAD = ["change", "runs", "median ms", "mean ms", "worst ms"]
HEAD += ["A* median", "mean", "worst", "x median", "x total"]
HEAD += ["canonical median", "mean", "worst", "x median", "x total"]


def _window(name: str, neighbourhood: Any, side: int, obstacles: float, seed: int) -> LatticeGraph:
    rng = np.random.default_rng(seed)
    lattice = Lattice.named(name)
    free = rng.random((side,) * lattice.dim) >= obstacles
    return LatticeGraph.from_states(lattice, np.zeros(lattice.dim, int), free, neighbourhood=neighbourhood)


def _ends(graph: LatticeGraph, rng: np.random.Generator) -> tuple[Any, Any]:
    """Return a start and a goal near the ends of a longest diagonal that are connected."""
    side, n = int(graph.inner_shape[0]), graph.lattice.dim
    corners = np.array([[(side - 1) * ((c >> i) & 1) for i in range(n)] for c in range(2 ** (n - 1))])
    apart = [np.linalg.norm(graph.lattice.centres((side - 1 - 2 * c)[None])) for c in corners]
    low = corners[int(np.argmax(apart))]
    while True:
        shift = rng.integers(side // 20, side // 10, (2, n))
        start = np.where(low == 0, shift[0], side - 1 - shift[0])
        goal = np.where(low == 0, side - 1 - shift[1], shift[1])
        if graph.connected(start, goal):
            return start, goal


def _near(graph: LatticeGraph, at: Any, radius: int) -> Any:
    """Return the cells (M, n) of the window within some steps of an index."""
    n = len(at)
    box = np.indices((2 * radius + 1,) * n).reshape(n, -1).T - radius
    reach = radius * np.linalg.norm(graph.lattice.centres(np.eye(n, dtype=int)), axis=1).min()
    cells = np.asarray(at) + box[np.linalg.norm(graph.lattice.centres(box), axis=1) <= reach * 1.000001]
    return cells[graph.index_to_flat(cells) >= 0]


KINDS = ["on the path, anywhere", "on the path, near robot", "one cell anywhere", "100 near the robot"]


def changes(graph: LatticeGraph, runs: int) -> list[list[object]]:
    """Time changes of all kinds, so many for each of the seeds."""
    races = {kind: Race() for kind in [*KINDS, "first plan"]}
    for seed in SEEDS:
        _change(graph, runs, seed, races)
    return [race.row(kind) for kind, race in races.items()]


def _change(graph: LatticeGraph, runs: int, seed: int, races: dict[str, Race]) -> None:
    rng = np.random.default_rng(seed)
    start, goal = _ends(graph, rng)
    radius = 8 if graph.lattice.dim == 2 else 4
    robot = Replanner(graph, start, goal)
    path = races["first plan"].run(robot, lambda: None, start, goal)
    for kind in KINDS:
        race = races[kind]
        for _ in range(runs):
            if kind.startswith("on the path") and path is not None:
                far = len(path) - 1 if kind.endswith("anywhere") else min(len(path) - 1, 30)
                cell = path.cells[rng.integers(1, far)][None]
                race.run(robot, lambda cell=cell: robot.block(cell), start, goal)
                path = race.run(robot, lambda cell=cell: robot.free(cell), start, goal)
            elif kind == "one cell anywhere":
                cell = rng.integers(0, graph.inner_shape, (1, graph.lattice.dim))
                if (cell == start).all() or (cell == goal).all():
                    continue
                state = robot.graph.free[graph.index_to_flat(cell)] == 0
                path = race.run(robot, lambda cell=cell, state=state: robot.set_cells(cell, state), start, goal)
            else:
                cells = rng.permutation(_near(graph, start, radius))
                cells = cells[(cells != start).any(axis=1)][:100]
                state = rng.random(len(cells)) >= OBSTACLES
                path = race.run(robot, lambda c=cells, s=state: robot.set_cells(c, s), start, goal)


def drives(truth: LatticeGraph, known: float, every: int) -> list[object]:
    """Drive through a map of whose obstacles a fraction is known; planning anew is timed at every so many steps."""
    race = Race()
    for seed in SEEDS[:2]:
        _drive(truth, known, seed, every, race)
    return race.row(f"drive, {known:.0%} known")


def _drive(truth: LatticeGraph, known: float, seed: int, every: int, race: Race) -> None:
    rng = np.random.default_rng(seed)
    start, goal = _ends(truth, rng)
    radius = 8 if truth.lattice.dim == 2 else 4
    believed = truth._derived(truth.free.copy(), truth.terrain)
    inner = believed.inner_states()
    inner[rng.random(inner.shape) >= known] = 1
    robot = Replanner(believed, start, goal)
    first = len(race.times["repair"])
    at, step = start, 0
    while (at != goal).any():
        seen = _near(truth, at, radius)
        state = truth.free[truth.index_to_flat(seen)] != 0

        def change(at: Any = at, seen: Any = seen, state: Any = state) -> None:
            robot.move_to(at)
            robot.set_cells(seen, state)

        path = race.run(robot, change, at, goal, anew=step % every == every // 2)
        at = path.cells[1]
        step += 1
    del race.times["repair"][first]  # the first plan is no repair


def main(arguments: list[str] | None = None) -> None:
    given = sys.argv[1:] if arguments is None else arguments
    fraction = float(given[0]) if given else 1.0
    print("# Replanning\n")
    print(versions("hexmap", "numpy", "numba"), "\n")
    print("x: how many times as long planning anew takes, of medians and of totals (of the drives, of means)\n")
    small = _window("A2", None, 16, 0.0, 0)
    changes(small, 1)  # compiles
    for name, neighbourhood, side in SETTINGS + HILLY:
        graph = _window(name, neighbourhood, side, OBSTACLES, 1)
        hilly = (name, neighbourhood, side) in HILLY
        if hilly:
            graph = graph.with_terrain(np.random.default_rng(1).uniform(1.0, 2.0, tuple(graph.inner_shape)))
        rows: list[list[object]] = [list(HEAD)]
        rows += changes(graph, max(int((20 if hilly else 40) * fraction), 2))
        every = max(int((20 if graph.lattice.dim == 3 else 100) / fraction), 1)
        rows += [drives(graph, known, every) for known in (0.5, 0.9)]
        size = " x ".join([str(side)] * graph.lattice.dim)
        print(f"{name}, {len(graph.moves)} moves, {size}, 20% obstacles{', terrain of 1 to 2' * hilly}\n")
        table(rows)


if __name__ == "__main__":
    main()
