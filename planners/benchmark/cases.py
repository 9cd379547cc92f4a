"""The cases of the planning benchmark: small functions that workers can call.

A finished case is kept only as long as this file and ``source_map.py`` do not change.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import HexmapError
from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.io.grids.grid_map import GridMap
from hexmap.lattice.lattice import Lattice
from hexmap.maps.cell_state import CellState
from planners.benchmark.source_map import Pinches, Walls, grid_coordinates, grid_map_of
from planners.path import NoPath, Path, measure, to_cell

__all__ = ["baseline_case", "grid_case", "open_case", "optimum_case", "planner_named"]

_SAMPLES = 4  # points of a path a source cell at which its distance to walls is measured


Planner: TypeAlias = Callable[[LatticeGraph, Any, Any], Path]


def planner_named(name: str) -> Planner:
    """Return what answers a query."""
    import planners

    if name == "dijkstra":
        return lambda graph, start, goal: planners.dijkstra(graph, start, goals=goal).path_to(goal)
    planner: Planner = getattr(planners, name)
    return planner


def grid_case(case: dict[str, Any], rng: np.random.Generator, shared: Any) -> dict[str, Any]:
    """Rasterise the turned map onto a lattice and answer queries with every planner of the case.

    Lengths, metres, run from the query's own start point through the centres of the cells between to
    its own goal point; the ends are the centres of source cells.
    """
    source = grid_map_of(shared)
    turned = source.turned(math.radians(case["degrees"])) if case["degrees"] else source
    queries = slice(case["first"], case["last"])
    starts = turned.centre(np.asarray(shared["starts"][queries]))
    goals = turned.centre(np.asarray(shared["goals"][queries]))
    begin = time.perf_counter()
    graph = _rasterised(turned, case, shared)
    built = time.perf_counter() - begin
    walls = Walls(np.asarray(shared["states"]))
    return {
        "answers": {
            name: _answers(graph, planner_named(name), starts, goals, turned, walls) for name in case["planners"]
        },
        "window": graph.size,
        "free": int(graph.free.sum()),
        "bytes": graph.memory,
        "build": built,
    }


def _rasterised(grid_map: GridMap, case: dict[str, Any], shared: Any) -> LatticeGraph:
    """Return the graph of a case: cells whose centre is free and, on finer cells, not near a pinch."""
    lattice = Lattice(np.array(shared["bases"][case["lattice"]]))
    lattice = lattice.scaled(grid_map.cell / case["fraction"] / lattice.resolution)
    moves, most = case["moves"], shared["max_cells"]
    if case["fraction"] == 1:
        return grid_map.to_graph(lattice, neighbourhood=moves, max_cells=most)
    pinches = Pinches(grid_map, shared["reach"] * grid_map.cell / case["fraction"])

    def free_at(points: FloatArray) -> NDArray[np.bool_]:
        free = grid_map.free_at(points)
        if free.any():
            free[free] = ~pinches.closed(points[free])
        return np.asarray(free)

    return LatticeGraph.rasterise(free_at, lattice, grid_map.low, grid_map.high, neighbourhood=moves, max_cells=most)


def _answers(
    graph: LatticeGraph, planner: Planner, starts: FloatArray, goals: FloatArray, grid_map: GridMap, walls: Walls
) -> list[dict[str, float] | None]:
    """Return what a planner says to each query, None where there is no path."""
    rows: list[dict[str, float] | None] = []
    for k, (start, goal) in enumerate(zip(starts, goals, strict=True)):
        ends = to_cell(graph, start), to_cell(graph, goal)
        try:
            if k == 0:
                planner(graph, *ends)  # the first call may compile
            path = planner(graph, *ends)
        except NoPath:
            rows.append(None)
            continue
        rows.append(_answer(path, start, goal, grid_map, walls))
    return rows


def _answer(path: Path, start: FloatArray, goal: FloatArray, grid_map: GridMap, walls: Walls) -> dict[str, float]:
    """Return the fields of :class:`planners.benchmark.results.Answer`."""
    line = np.vstack([start, path.points[1:-1], goal])
    keep = np.ones(len(line), np.bool_)
    keep[1:] = (np.diff(line, axis=0) != 0).any(axis=1)
    line = line[keep]
    length, turning = measure(line) if len(line) > 1 else (0.0, 0.0)
    clearance = walls.distance(_along(grid_coordinates(grid_map, line))) * grid_map.cell
    return {
        "length": length,
        "cost": path.cost,
        "turning": turning,
        "clearance": float(clearance.min()),
        "mean_clearance": float(clearance.mean()),
        "expansions": path.expansions,
        "pushes": path.pushes,
        "scanned": path.scanned,
        "seconds": path.seconds,
    }


def _along(line: FloatArray) -> FloatArray:
    """Return points along a polyline (M, n), in cells, a quarter of a cell or less apart."""
    legs = np.diff(line, axis=0)
    steps = np.maximum(1, np.ceil(np.linalg.norm(legs, axis=1) * _SAMPLES)).astype(np.int64)
    leg = np.repeat(np.arange(len(legs)), steps)
    fraction = (np.arange(len(leg)) - np.repeat(np.cumsum(steps) - steps, steps) + 1) / steps[leg]
    return np.vstack([line[:1], line[leg] + legs[leg] * fraction[:, None]])


def baseline_case(case: dict[str, Any], rng: np.random.Generator, shared: Any) -> dict[str, Any]:
    """Answer queries on the source cells themselves, all neighbours: what the publishers did."""
    grid_map = grid_map_of(shared)
    n = grid_map.dim
    graph = LatticeGraph.from_states(
        Lattice(np.eye(n)), [0] * n, (grid_map.states == CellState.FREE).astype(np.uint8), neighbourhood=3**n - 1
    )
    planner = planner_named("astar")

    def one(k: int) -> Path | None:
        try:
            return planner(graph, np.asarray(shared["starts"][k]), np.asarray(shared["goals"][k]))
        except NoPath:
            return None

    with ThreadPoolExecutor(max_workers=shared.get("threads", 1)) as pool:
        paths = list(pool.map(one, range(case["first"], case["last"])))
    costs = [None if path is None else path.cost for path in paths]
    steps: list[list[int] | None] = []
    for path in paths:
        if path is None:
            steps.append(None)
            continue
        axes = np.abs(np.diff(path.cells, axis=0)).sum(axis=1)
        steps.append([int((axes == a).sum()) for a in range(1, n + 1)])
    return {"cost": costs, "steps": steps}


def optimum_case(case: dict[str, Any], rng: np.random.Generator, shared: Any) -> dict[str, Any]:
    """Return the true any-angle optimum, metres, of queries in the plane."""
    from planners.any_angle.optimum import AnyAngleOptimum

    grid_map = grid_map_of(shared)
    optimum = AnyAngleOptimum(grid_map.states == CellState.FREE)
    with contextlib.suppress(NoPath):  # the first call may compile
        optimum.path(*(np.asarray(shared[ends][case["first"]], float) for ends in ("starts", "goals")))
    lengths: list[float | None] = []
    seconds: list[float | None] = []
    for k in range(case["first"], case["last"]):
        try:
            found = optimum.path(np.asarray(shared["starts"][k], float), np.asarray(shared["goals"][k], float))
        except NoPath:
            lengths.append(None)
            seconds.append(None)
            continue
        lengths.append(found.length * grid_map.cell)
        seconds.append(found.seconds)
    return {"length": lengths, "seconds": seconds}


def open_case(case: dict[str, Any], rng: np.random.Generator, shared: Any) -> dict[str, Any]:
    """Measure lengths in an empty window: distance by the moves over the straight one, in all directions."""
    from planners import dijkstra

    lattice = Lattice(np.array(shared["bases"][case["lattice"]]))
    lattice = lattice.scaled(1.0 / lattice.resolution)
    n, radius = lattice.dim, float(case["radius"])
    graph = LatticeGraph.rasterise(
        lambda points: np.ones(len(points), np.bool_), lattice, [-radius - 3] * n, [radius + 3] * n,
        neighbourhood=case["moves"],
    )  # fmt: skip
    field = dijkstra(graph, [0] * n)
    if n == 2:
        angle = rng.uniform(0, 2 * math.pi, case["directions"])
        directions = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    else:
        normal = rng.normal(size=(case["directions"], 3))
        directions = normal / np.linalg.norm(normal, axis=1)[:, None]
    cells = lattice.quantise(radius * directions)
    straight = np.linalg.norm(lattice.centres(cells), axis=1)
    factor = field.distance_to(cells) / straight
    if not np.isfinite(factor).all():
        raise HexmapError("an empty window has cells that no move reaches")
    return {"mean": float(factor.mean()), "worst": float(factor.max()), "sd": float(factor.std())}
