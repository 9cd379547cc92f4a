"""A* between cells of a lattice graph, with a heuristic derived from its moves; many queries at once."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.errors import ArgumentError
from planners.heuristics import gauge_planes, least_terrain
from planners.path import NoPath, Path, cells_to_flat, make_path

if TYPE_CHECKING:
    from hexmap.graph import LatticeGraph

__all__ = ["astar", "plan_many"]

_KEY_STEPS = 2.0**32  # keys of the queue a cheapest move
# Lengths are rounded to this part of the shortest, so that sums of up to 2^17 of them have no
# rounding error: without that the order of a sum decides ties, and opens cells again by the thousand.
_LENGTH_STEPS = 2.0**36
_SLACK = 1.0 - 1e-13  # the same for terrain, whose costs are what they are
_MOST_MOVES = 126  # they share a byte with the goals' mark
_MOST_TARGETS = 16  # goals beyond this cost more to measure than the heuristic saves


def astar(
    graph: LatticeGraph,
    start: ArrayLike,
    goal: ArrayLike,
    *,
    weight: float = 1.0,
    heuristic: Literal["none"] | None = None,
    bidirectional: bool = False,
    clearance: NDArray[np.float64] | None = None,
) -> Path:
    """Return a cheapest path from ``start`` to ``goal``, or to the nearest of many goals.

    The heuristic is the gauge of the convex hull of {move / its cost} times the least terrain:
    admissible and consistent on every lattice (see :mod:`planners.heuristics`). Among cells of
    equal f the one with the larger g goes first. Costs are sums in float64 without a rounding error;
    the search itself tells paths apart that differ by more than 1e-11 of a move.

    Args:
        graph: where to go.
        start: a cell's index (n,).
        goal: a cell's index (n,), or the indices (M, n) of a set of goals. Blocked ones and those
            outside the map are left out of a set, as long as one remains.
        weight: of the heuristic; more than 1 searches less, and the path's ``bound`` says how far
            its cost can be above the least: never more than ``weight`` times.
        heuristic: "none" searches without (Dijkstra's algorithm); so do sets of more than 16 goals.
        bidirectional: search from both ends until they meet; the cost is the same.
        clearance: (size,) metres, of which the path's least is reported.

    Raises:
        NoPath: an end is blocked or outside the map, or nothing connects them.
        ArgumentError: an option is out of its range.

    Examples:
        >>> from hexmap.graph import LatticeGraph
        >>> from hexmap.lattice import Lattice
        >>> graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], np.ones((3, 5), np.uint8))
        >>> astar(graph, [0, 0], [2, 4]).cost
        6.0
    """
    if not (np.isfinite(weight) and weight >= 1.0):
        raise ArgumentError(f"the weight of the heuristic must be a number of 1 or more, not {weight!r}")
    if heuristic not in (None, "none"):
        raise ArgumentError(f"heuristic must be None (derived from the moves) or 'none', not {heuristic!r}")
    if bidirectional and weight != 1.0:
        raise ArgumentError("a search from both ends takes no weight")
    if len(graph.moves) > _MOST_MOVES:
        raise ArgumentError(f"A* takes at most {_MOST_MOVES} moves, not {len(graph.moves)}")
    if np.ndim(start) != 1:
        raise ArgumentError(f"A* starts in one cell ({graph.lattice.dim},), not {np.shape(start)}")
    source = cells_to_flat(graph, start, "start")
    goals = _goals(graph, goal)
    begin = time.perf_counter()
    if (goals == source[0]).any():
        return make_path(graph, source, clearance=clearance, seconds=time.perf_counter() - begin)
    # Answered at once where somebody has looked for the components already.
    labels = getattr(graph, "_labels", None)
    if labels is not None and not (labels[goals] == labels[source[0]]).any():
        raise _not_connected(start, goal)
    from planners import _search_kernels as kernels

    lengths = graph.lengths
    if graph.terrain is None:
        unit = 2.0 ** np.floor(np.log2(lengths.min() / _LENGTH_STEPS))
        lengths = np.round(lengths / unit) * unit
    slack = 1.0 if graph.terrain is None else _SLACK
    planes = gauge_planes(graph.moves, lengths) * least_terrain(graph)
    if heuristic == "none" or len(goals) > _MOST_TARGETS:
        planes = planes[:0]
    n = graph.lattice.dim
    rises = np.zeros((len(graph.moves) + 1, len(planes)))
    rises[:-1] = graph.moves @ planes.T
    places = [np.ascontiguousarray(graph.flat_to_index(f) - graph.low, dtype=np.int64) for f in (source, goals)]
    # Without a heuristic one target is as good as many.
    targets = places[1] if len(planes) else np.zeros((1, n), np.int64)
    terrain = np.empty(0) if graph.terrain is None else graph.terrain
    arrays = (graph.free, graph.offsets, lengths, graph.swept_starts, graph.swept, terrain, graph.strides)
    scale = _KEY_STEPS / (float(graph.lengths.min()) * least_terrain(graph))
    g, via = np.empty(graph.size), np.zeros(graph.size, np.uint8)
    bound = 1.0
    if bidirectional:
        g_back, via_back = np.empty(graph.size), np.zeros(graph.size, np.uint8)
        meeting, expansions, pushes, _ = kernels.search_both(
            *arrays, planes, rises, places[0], targets, source[0], goals, scale, slack, g, via, g_back, via_back
        )
        if meeting < 0:
            raise _not_connected(start, goal)
        ahead = kernels.follow(via, graph.offsets, meeting, -1)[::-1]
        flat = np.concatenate([ahead, kernels.follow(via_back, graph.offsets, meeting, 1)[1:]])
    else:
        via[goals] = kernels.GOAL
        found, expansions, pushes, lower = kernels.search(
            *arrays, planes, rises, targets, source[0], float(weight), scale, slack, g, via
        )
        if found < 0:
            raise _not_connected(start, goal)
        flat = np.ascontiguousarray(kernels.follow(via, graph.offsets, found, -1)[::-1])
        bound = min(max(g[found] / lower, 1.0), float(weight))
    seconds = time.perf_counter() - begin
    return make_path(
        graph,
        flat,
        clearance=clearance,
        expansions=expansions,
        pushes=pushes,
        seconds=seconds,
        bound=bound,
    )


def _goals(graph: LatticeGraph, goal: ArrayLike) -> NDArray[np.int64]:
    """Return the flat goals; of a set those that are free and in the map."""
    cells = np.asarray(goal)
    if cells.ndim != 2 or len(cells) < 2:
        return cells_to_flat(graph, cells, "goal")
    kept = []
    first: NoPath | None = None
    for cell in cells:
        try:
            kept.append(cells_to_flat(graph, cell, "goal"))
        except NoPath as error:
            first = first or error
    if not kept:
        assert first is not None
        raise first
    return np.unique(np.concatenate(kept))


def _not_connected(start: ArrayLike, goal: ArrayLike) -> NoPath:
    cells = np.atleast_2d(np.asarray(goal))
    to = str(tuple(cells[0].tolist())) if len(cells) == 1 else f"any of {len(cells)} goals"
    return NoPath("not connected", f"nothing leads from {tuple(np.asarray(start).tolist())} to {to}")


def plan_many(
    graph: LatticeGraph,
    starts: ArrayLike,
    goals: ArrayLike,
    workers: int | None = None,
    *,
    planner: Callable[[LatticeGraph, ArrayLike, ArrayLike], Path] = astar,
) -> list[Path | NoPath]:
    """Return the paths from each of ``starts`` (Q, n) to each of ``goals`` (Q, n), in their order.

    Where there is no path, its place holds the :class:`NoPath` that says why. The queries run in
    threads, which the kernels do not block; all but ``seconds`` is the same for any number of them.

    Args:
        graph: where to go.
        starts: cells' indices.
        goals: cells' indices, as many.
        workers: threads; None for as many as there are processors.
        planner: what answers one query.

    Raises:
        ArgumentError: shapes that do not fit, or no worker.
    """
    a, b = np.asarray(starts), np.asarray(goals)
    if a.shape != b.shape or a.ndim != 2:
        raise ArgumentError(f"queries need starts and goals of the same shape (Q, n), not {a.shape} and {b.shape}")
    workers = (os.cpu_count() or 1) if workers is None else workers
    if workers < 1:
        raise ArgumentError(f"queries need at least one worker, not {workers}")
    # Computed once, before the threads would each do it.
    least_terrain(graph)
    if len(a):
        graph.components()

    def one(query: int) -> Path | NoPath:
        try:
            return planner(graph, a[query], b[query])
        except NoPath as error:
            return error

    if workers == 1 or len(a) < 2:
        return [one(q) for q in range(len(a))]
    # The first one alone: it compiles the kernels.
    first = one(0)
    with ThreadPoolExecutor(max_workers=workers) as pool:
        return [first, *pool.map(one, range(1, len(a)))]
