"""The cases of the planning benchmark: small functions that workers can call.

They stand alone because a finished case is kept only as long as this file does not change.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import HexmapError
from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.io.grids.grid_map import GridMap
from hexmap.lattice.lattice import Lattice
from hexmap.maps.cell_state import CellState
from planners.path import NoPath, Path, measure, to_cell

_SAMPLES = 4  # points of a path a source cell at which its distance to walls is measured
_NEAREST = {2: 24, 3: 96}  # blocked cells among which the nearest is; exact up to a cell's width of clearance


def world_of(shared: Any) -> GridMap:
    """Return the source map that a worker was given."""
    return GridMap(
        states=np.asarray(shared["states"]),
        cell=float(shared["cell"]),
        origin=np.array(shared["origin"]),
        yaw=float(shared["yaw"]),
    )


class Pinches:
    """Points and edges of the source map where blocked cells touch only there, and free cells face each other across.

    No path may slip through between them: on the square grid the corner rule forbids it, but two cells
    of a finer or turned lattice may be neighbours right across. Two such cells, a move of length d
    apart, see the pinch at a right angle or more, so that the nearer of them is at most d / sqrt(2)
    from it: a world that is closed that far around every pinch leaks on no lattice.
    """

    def __init__(self, world: GridMap, radius: float) -> None:
        """Find them; ``radius`` metres around each is closed, less than half a source cell."""
        self.world = world
        self.radius = radius
        # Vertices between the cells, the border included: vertex v touches the cells v - 1 and v.
        free = np.pad(world.states == CellState.FREE, 1)
        n = world.dim
        self.masks: list[tuple[tuple[int, ...], NDArray[np.bool_]]] = []
        for size in range(2, n + 1):
            for axes in itertools.combinations(range(n), size):
                self.masks.append((axes, _pinched(free, axes)))

    def closed(self, points: FloatArray) -> NDArray[np.bool_]:
        """Tell for each of ``points`` (N, n), metres, whether it is too near to a pinch."""
        w = self.world
        u = grid_coordinates(w, points)  # cell i spans i to i + 1
        vertex = np.rint(u).astype(np.int64)
        layer = np.floor(u).astype(np.int64)
        gap = (u - vertex) * w.cell
        out = np.zeros(len(points), np.bool_)
        for axes, mask in self.masks:
            # Along the other axes a pinch reaches through a whole cell.
            at = np.where(np.isin(np.arange(w.dim), axes), vertex, layer + 1)
            at = np.clip(at, 0, np.array(mask.shape) - 1)
            near = (gap[:, list(axes)] ** 2).sum(axis=1) < self.radius**2
            out |= near & mask[tuple(at.T)]
        return out


def _pinched(free: NDArray[np.bool_], axes: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return where the 2^k cells around a vertex of ``axes`` fall into free parts that touch only there.

    ``free`` is padded by one cell; the answer is by vertex along ``axes`` and by padded cell along the others.
    """
    k = len(axes)
    corners = list(itertools.product((0, 1), repeat=k))

    def part(corner: tuple[int, ...]) -> NDArray[np.bool_]:
        cut = [slice(None)] * free.ndim
        for axis, c in zip(axes, corner, strict=True):
            cut[axis] = slice(c, free.shape[axis] - 1 + c)
        return free[tuple(cut)]

    code = np.zeros(part(corners[0]).shape, np.uint32)
    for bit, corner in enumerate(corners):
        code |= part(corner).astype(np.uint32) << np.uint32(bit)
    table = np.zeros(1 << len(corners), np.bool_)
    for pattern in range(len(table)):
        cells = [c for bit, c in enumerate(corners) if pattern >> bit & 1]
        if len(cells) < 2:
            continue
        seen, todo = {cells[0]}, [cells[0]]
        while todo:
            a = todo.pop()
            for b in cells:
                if b not in seen and sum(x != y for x, y in zip(a, b, strict=True)) == 1:
                    seen.add(b)
                    todo.append(b)
        table[pattern] = len(seen) < len(cells)
    return np.asarray(table[code])


def grid_coordinates(world: GridMap, points: FloatArray) -> FloatArray:
    """Return points (N, n), metres, in units of the source cells: cell i spans i to i + 1."""
    shifted = points - world.origin
    c, s = math.cos(world.yaw), math.sin(world.yaw)
    out = shifted.copy()
    out[:, 0] = c * shifted[:, 0] + s * shifted[:, 1]
    out[:, 1] = -s * shifted[:, 0] + c * shifted[:, 1]
    return out / world.cell


class Walls:
    """How far points are from the nearest blocked source cell, a true square or cube."""

    def __init__(self, states: NDArray[np.uint8]) -> None:
        """Find the blocked cells that a free cell touches; those around the map count too."""
        blocked = np.pad(states != CellState.FREE, 1, constant_values=True)
        inner = np.ones_like(blocked)
        for shift in itertools.product((-1, 0, 1), repeat=states.ndim):
            inner &= np.roll(blocked, shift, axis=tuple(range(states.ndim)))
        cells = np.argwhere(blocked & ~inner) - 1
        self.centres = cells + 0.5
        self.tree = cKDTree(self.centres)

    def distance(self, u: FloatArray) -> FloatArray:
        """Return the distances (N,) of points (N, n), all in units of the cells."""
        k = min(_NEAREST[u.shape[1]], len(self.centres))
        _, near = self.tree.query(u, k=k)
        gap = np.maximum(np.abs(u[:, None] - self.centres[near.reshape(len(u), k)]) - 0.5, 0.0)
        return np.asarray(np.sqrt((gap**2).sum(axis=2)).min(axis=1))


def planner_named(name: str) -> Callable[[LatticeGraph, Any, Any], Path]:
    """Return what answers a query."""
    import planners

    if name == "dijkstra":
        return lambda graph, start, goal: planners.dijkstra(graph, start, goals=goal).path_to(goal)
    planner: Callable[[LatticeGraph, Any, Any], Path] = getattr(planners, name)
    return planner


def grid_case(case: dict[str, Any], rng: np.random.Generator, shared: Any) -> dict[str, Any]:
    """Rasterise the turned world onto a lattice and answer queries with every planner of the case.

    Lengths, metres, run from the query's own start point through the centres of the cells between to
    its own goal point; the ends are the centres of source cells.
    """
    source = world_of(shared)
    world = source.turned(math.radians(case["degrees"])) if case["degrees"] else source
    lattice = Lattice(np.array(shared["bases"][case["lattice"]]))
    lattice = lattice.scaled(source.cell / case["fraction"] / lattice.resolution)
    queries = slice(case["first"], case["last"])
    starts = world.centre(np.asarray(shared["starts"][queries]))
    goals = world.centre(np.asarray(shared["goals"][queries]))
    begin = time.perf_counter()
    pinches = Pinches(world, shared["reach"] * source.cell / case["fraction"]) if case["fraction"] > 1 else None

    def free_at(points: FloatArray) -> NDArray[np.bool_]:
        free = world.free_at(points)
        if pinches is not None and free.any():
            free[free] = ~pinches.closed(points[free])
        return np.asarray(free)

    if pinches is None:
        graph = world.to_graph(lattice, neighbourhood=case["moves"], max_cells=shared["max_cells"])
    else:
        graph = LatticeGraph.rasterise(
            free_at, lattice, world.low, world.high, neighbourhood=case["moves"], max_cells=shared["max_cells"]
        )
    built = time.perf_counter() - begin
    walls = Walls(np.asarray(shared["states"]))
    answers: dict[str, list[Any]] = {}
    for name in case["planners"]:
        planner = planner_named(name)
        rows: list[Any] = []
        for k, (start, goal) in enumerate(zip(starts, goals, strict=True)):
            ends = to_cell(graph, start), to_cell(graph, goal)
            try:
                if k == 0:
                    planner(graph, *ends)  # the first call may compile
                path = planner(graph, *ends)
            except NoPath:
                rows.append(None)
                continue
            rows.append(_answer(path, start, goal, world, walls))
        answers[name] = rows
    return {
        "answers": answers,
        "window": graph.size,
        "free": int(graph.free.sum()),
        "bytes": graph.memory,
        "build": built,
    }


def _answer(path: Path, start: FloatArray, goal: FloatArray, world: GridMap, walls: Walls) -> dict[str, float]:
    line = np.vstack([start, path.points[1:-1], goal])
    keep = np.ones(len(line), np.bool_)
    keep[1:] = (np.diff(line, axis=0) != 0).any(axis=1)
    line = line[keep]
    length, turning = measure(line) if len(line) > 1 else (0.0, 0.0)
    clearance = walls.distance(_along(grid_coordinates(world, line))) * world.cell
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
    parts = [line[:1]]
    for a, b in itertools.pairwise(line):
        steps = max(1, math.ceil(float(np.linalg.norm(b - a)) * _SAMPLES))
        parts.append(a + (b - a) * (np.arange(1, steps + 1)[:, None] / steps))
    return np.vstack(parts)


def ruler_case(case: dict[str, Any], rng: np.random.Generator, shared: Any) -> dict[str, Any]:
    """Answer queries on the source cells themselves, all neighbours: what the publishers did."""
    world = world_of(shared)
    n = world.dim
    graph = LatticeGraph.from_states(
        Lattice(np.eye(n)), [0] * n, (world.states == CellState.FREE).astype(np.uint8), neighbourhood=3**n - 1
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
    straight: list[list[int] | None] = []
    for path in paths:
        if path is None:
            straight.append(None)
            continue
        axes = np.abs(np.diff(path.cells, axis=0)).sum(axis=1)
        straight.append([int((axes == a).sum()) for a in range(1, n + 1)])
    return {"cost": costs, "steps": straight}


def optimum_case(case: dict[str, Any], rng: np.random.Generator, shared: Any) -> dict[str, Any]:
    """Return the true any-angle optimum, metres, of queries in the plane."""
    from planners.any_angle.optimum import AnyAngleOptimum

    world = world_of(shared)
    ruler = AnyAngleOptimum(world.states == CellState.FREE)
    with contextlib.suppress(NoPath):  # the first call may compile
        ruler.path(*(np.asarray(shared[ends][case["first"]], float) for ends in ("starts", "goals")))
    lengths: list[float | None] = []
    seconds: list[float | None] = []
    for k in range(case["first"], case["last"]):
        try:
            found = ruler.path(np.asarray(shared["starts"][k], float), np.asarray(shared["goals"][k], float))
        except NoPath:
            lengths.append(None)
            seconds.append(None)
            continue
        lengths.append(found.length * world.cell)
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


def largest_component(states: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return the source cells (M, n) of the largest free part, by faces."""
    from scipy.ndimage import label

    labels, count = label(states == CellState.FREE)
    if count == 0:
        return np.empty((0, states.ndim), np.int64)
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return np.argwhere(labels == int(sizes.argmax()))


def random_queries(states: NDArray[np.uint8], count: int, seed: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return seeded random starts and goals (count, n) in the largest free part of a map."""
    cells = largest_component(states)
    if len(cells) < 2:
        return np.empty((0, states.ndim), np.int64), np.empty((0, states.ndim), np.int64)
    rng = np.random.default_rng([seed, 7])
    first = rng.integers(0, len(cells), count)
    second = (first + rng.integers(1, len(cells), count)) % len(cells)
    return cells[first], cells[second]


__all__ = ["grid_case", "open_case", "optimum_case", "random_queries", "ruler_case"]
