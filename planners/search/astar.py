"""A* between cells of a lattice graph, with a heuristic derived from its moves; many queries at once."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError
from planners.path import NoPath, Path, _not_connected, cells_to_flat, make_path
from planners.search.heuristics import gauge_planes, least_terrain
from planners.search.nearest import nearest_reachable
from planners.search.sparse_arrays import blank

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph

__all__ = ["astar"]

_MOST_WEIGHT = 1e6  # more is greedy search, and would overflow the queue's keys
_KEY_STEPS = 2.0**32  # keys of the queue a cheapest move
# Lengths are rounded to this part of the shortest, so that sums of up to 2^17 of them have no
# rounding error: without that the order of a sum decides ties, and opens cells again by the thousand.
_LENGTH_STEPS = 2.0**36
_SLACK = 1.0 - 1e-13  # the same for terrain, whose costs are what they are
_MOST_MOVES = 126  # they share a byte with the goals' mark
_MOST_TARGETS = 16  # goals beyond this cost more to measure than the heuristic saves
_BUCKETS_A_MOVE = 16.0  # of the queue, to the cheapest move: few cells are sorted at a time
_FIRST_QUEUE = 1024  # entries that fit at first
_MOST_ONWARD = 64  # moves of which every pair is looked at
_MOST_BUCKETS = 1 << 16  # where terrain or moves differ by more they are wider


def astar(
    graph: LatticeGraph,
    start: ArrayLike,
    goal: ArrayLike,
    *,
    weight: float = 1.0,
    heuristic: Literal["none"] | None = None,
    bidirectional: bool = False,
    clearance: NDArray[np.float64] | None = None,
    nearest: bool = False,
) -> Path:
    """Return a cheapest path from ``start`` to ``goal``, or to the nearest of many goals.

    The heuristic is the gauge of the convex hull of {move / its cost} times the least terrain:
    admissible and consistent on every lattice (see :mod:`planners.search.heuristics`). Among cells of
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
        nearest: go to the reachable cell whose centre is nearest to the goal's where the goal is
            blocked, outside the map or not connected; the path's ``goal_reached`` is false then.

    Raises:
        NoPath: an end is blocked or outside the map, or nothing connects them.
        ArgumentError: an option is out of its range.

    Examples:
        >>> import numpy as np
        >>> from hexmap.graph import LatticeGraph
        >>> from hexmap.lattice import Lattice
        >>> from planners import astar
        >>> graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], np.ones((3, 5), np.uint8))
        >>> astar(graph, [0, 0], [2, 4]).cost
        6.0
    """
    if not 1.0 <= weight <= _MOST_WEIGHT:
        raise ArgumentError(f"the weight of the heuristic must be a number from 1 to {_MOST_WEIGHT:g}, not {weight!r}")
    if heuristic not in (None, "none"):
        raise ArgumentError(f"heuristic must be None (derived from the moves) or 'none', not {heuristic!r}")
    if bidirectional and weight != 1.0:
        raise ArgumentError("a search from both ends takes no weight")
    if len(graph.moves) > _MOST_MOVES:
        raise ArgumentError(f"A* takes at most {_MOST_MOVES} moves, not {len(graph.moves)}")
    if np.ndim(start) != 1:
        raise ArgumentError(f"A* starts in one cell ({graph.lattice.dim},), not {np.shape(start)}")
    if nearest and np.ndim(goal) != 1:
        raise ArgumentError(f"only one goal has a nearest reachable cell, not {np.shape(goal)}")
    source = cells_to_flat(graph, start, "start")
    if nearest:
        cell = _replaced(graph, start, goal)
        if cell is not None:
            path = astar(
                graph, start, cell, weight=weight, heuristic=heuristic, bidirectional=bidirectional, clearance=clearance
            )
            return replace(path, goal_reached=False)
    goals = _goals(graph, goal)
    begin = time.perf_counter()
    if (goals == source[0]).any():
        return make_path(graph, source, clearance=clearance, seconds=time.perf_counter() - begin)
    # Answered at once where somebody has looked for the components already.
    labels = getattr(graph, "_labels", None)
    if labels is not None and not (labels[goals] == labels[source[0]]).any():
        raise _not_connected(start, goal)
    from planners.search import _astar_kernels as kernels

    lengths = graph.lengths
    if graph.terrain is None:
        unit = 2.0 ** np.floor(np.log2(lengths.min() / _LENGTH_STEPS))
        lengths = np.round(lengths / unit) * unit
    slack = 1.0 if graph.terrain is None else _SLACK
    cheapest = least_terrain(graph)
    planes = gauge_planes(graph.moves, lengths) * cheapest
    if heuristic == "none" or len(goals) > _MOST_TARGETS:
        planes = planes[:0]
    n = graph.lattice.dim
    places = [np.ascontiguousarray(graph.flat_to_index(f) - graph.low, dtype=np.int64) for f in (source, goals)]
    # Without a heuristic one target is as good as many.
    targets = places[1] if len(planes) else np.zeros((1, n), np.int64)
    terrain = np.empty(0) if graph.terrain is None else graph.terrain
    arrays = (graph.free, graph.offsets, lengths, graph.swept_starts, graph.swept, terrain, graph.strides)
    scale = _KEY_STEPS / (float(graph.lengths.min()) * cheapest)
    g, via = blank(graph.size, np.float64), blank(graph.size, np.uint8)
    bound = 1.0
    if bidirectional:
        rises = np.zeros((len(graph.moves) + 1, len(planes)))
        rises[:-1] = graph.moves @ planes.T
        g_back, via_back = blank(graph.size, np.float64), blank(graph.size, np.uint8)
        meeting, expansions, pushes, _ = kernels.search_both(
            *arrays, planes, rises, places[0], targets, source[0], goals, scale, slack, g, via, g_back, via_back
        )
        if meeting < 0:
            raise _not_connected(start, goal)
        ahead = kernels.follow(via, graph.offsets, meeting, -1)[::-1]
        flat = np.concatenate([ahead, kernels.follow(via_back, graph.offsets, meeting, 1)[1:]])
    else:
        via[goals] = kernels.GOAL
        padded = np.zeros((n, -(-len(planes) // 4) * 4))
        padded[:, : len(planes)] = planes.T
        # f rises by a move's cost and by as much of the heuristic, at most.
        dearest = float(graph.lengths.max()) * (1.0 if graph.terrain is None else float(terrain.max()))
        span = dearest * (1.0 + weight) * scale
        width = max(_KEY_STEPS / _BUCKETS_A_MOVE, span / _MOST_BUCKETS)
        slots = 1 << math.ceil(math.log2(span / width + 3.0))
        queue = (weight, scale, slack, width, slots)
        found, expansions, pushes, lower = _search(
            arrays, padded, targets, _onward_moves(graph), int(source[0]), *queue, graph.moves, g, via
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


def _search(
    arrays: tuple[Any, ...],
    planes: NDArray[np.float64],
    targets: NDArray[np.int64],
    onward: tuple[NDArray[np.int64], NDArray[np.int64]],
    start: int,
    weight: float,
    scale: float,
    slack: float,
    width: float,
    slots: int,
    moves: NDArray[np.int64],
    g: NDArray[np.float64],
    via: NDArray[np.uint8],
) -> tuple[int, int, int, float]:
    """Run the kernel ``advance``, which says what the arguments are, with a queue that grows.

    Returns:
        (goal or -1, expansions, pushes, a lower bound of the least cost).
    """
    from planners.search import _astar_kernels as kernels

    strides = arrays[-1]
    rises = moves @ planes
    reach = float(np.abs(rises).max(initial=0.0)) * (2.0 + 1e-9)
    size = targets.shape[0] * planes.shape[1]
    room = (
        np.empty((len(targets), planes.shape[1])),
        np.empty(len(targets)),
        np.zeros(len(targets) + 1, np.int64),
        np.empty(size + 1, np.int64),
        np.empty(size + 1),
    )

    def estimate(cells: NDArray[np.int64]) -> NDArray[np.float64]:
        places, rest = np.empty((len(cells), len(strides))), cells
        for i, stride in enumerate(strides):
            places[:, i], rest = rest // stride, rest % stride
        least = np.full(len(cells), np.inf)
        for target in targets:
            least = np.minimum(least, np.abs((places - target) @ planes).max(axis=1, initial=0.0))
        return least

    heads = np.full(slots, -1, np.int64)
    first = float(np.floor(weight * estimate(np.array([start]))[0] * scale + 0.5))
    key, cost, node = np.full(_FIRST_QUEUE, first), np.zeros(_FIRST_QUEUE), np.full(_FIRST_QUEUE, start)
    wait, link = np.empty((_FIRST_QUEUE, 2)), np.empty((_FIRST_QUEUE, 2), np.int64)
    counts = np.array([1, 0, -1, 0, int(first / width), -1, 0, 1], np.int64)
    bests = np.full(2, np.inf)
    g[start] = 0.0
    via[start] |= len(moves) + 1
    steady = (*arrays, 1.0 / strides, planes, rises, reach, targets, *onward, float(weight), scale, slack, 1.0 / width)
    written = (*room, counts, bests, g, via)
    while not kernels.advance(*(*steady, heads, key, cost, node, wait, link, *written)):
        key, cost, node, wait, link = (np.concatenate([a, np.empty_like(a)]) for a in (key, cost, node, wait, link))
    lower = float(bests[0])
    if weight > 1.0:
        # The best path goes through a cell that waits, at its least cost: the least f is a bound.
        cells = np.concatenate([node[: counts[0]], link[: counts[1], 0]])
        costs = np.concatenate([cost[: counts[0]], wait[: counts[1], 1]])
        waits = costs == g[cells]
        lower = float((costs[waits] + estimate(cells[waits])).min(initial=lower))
    return int(counts[5]), int(counts[6]), int(counts[7]), lower


def _onward_moves(graph: LatticeGraph) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the moves worth a try after each of the moves, and at the start, as starts (K + 2,) and moves.

    After the move k the move m is not, where a strictly shorter way from the cell before both leads
    to the cell after both through cells that are free if k and m are allowed: no cheapest path has
    the two in a row. Jump point search calls the others natural or forced neighbours (Harabor and
    Grastien, 2011); here they follow from moves, lengths and the corner rule of any lattice. Terrain
    could make the shorter way dearer: with it all are tried.
    """
    moves = len(graph.moves)
    if graph.terrain is not None or moves > _MOST_ONWARD:
        return np.arange(moves + 2, dtype=np.int64) * moves, np.tile(np.arange(moves, dtype=np.int64), moves + 1)
    # No cell is swept beyond the padding, so that flat offsets tell which it is.
    at = np.unravel_index(graph.swept + graph.pad @ graph.strides, tuple(int(s) for s in graph.shape))
    swept = np.stack(at, axis=1) - graph.pad
    return _onward(
        tuple(map(tuple, graph.moves.tolist())),
        tuple(graph.lengths.tolist()),
        tuple(map(tuple, swept.tolist())),
        tuple(graph.swept_starts.tolist()),
    )


_Vector: TypeAlias = tuple[int, ...]


@lru_cache(maxsize=64)
def _onward(
    moves: tuple[_Vector, ...], lengths: tuple[float, ...], swept: tuple[_Vector, ...], starts: tuple[int, ...]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    number = {move: k for k, move in enumerate(moves)}
    sweeps = [swept[starts[k] : starts[k + 1]] for k in range(len(moves))]

    def plus(a: _Vector, b: _Vector) -> _Vector:
        return tuple(x + y for x, y in zip(a, b, strict=True))

    def straight(a: _Vector, b: _Vector, open_cells: set[_Vector]) -> float:
        """Return the length of the move from a to b, infinite if there is none or it is not known to be free."""
        k = number.get(tuple(y - x for x, y in zip(a, b, strict=True)))
        if k is None or not all(plus(a, s) in open_cells for s in sweeps[k]):
            return math.inf
        return lengths[k]

    rows: list[list[int]] = []
    for k, first in enumerate(moves):
        rows.append([])
        origin = (0,) * len(first)
        for m, second in enumerate(moves):
            end = plus(first, second)
            known = {origin, first, end, *sweeps[k], *(plus(first, s) for s in sweeps[m])}
            ways = [
                straight(origin, c, known) + (0.0 if c == end else straight(c, end, known)) for c in known - {origin}
            ]
            if end != origin and min(ways) >= (lengths[k] + lengths[m]) * (1.0 - 1e-9):
                rows[-1].append(m)
    rows.append(list(range(len(moves))))
    onward_starts = np.cumsum([0, *map(len, rows)]).astype(np.int64)
    onward = np.array([m for row in rows for m in row], dtype=np.int64)
    return onward_starts, onward


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


def _replaced(graph: LatticeGraph, start: ArrayLike, goal: ArrayLike) -> NDArray[np.int32] | None:
    """Return the reachable cell (n,) nearest to the goal's centre; None where the goal is reachable itself."""
    try:
        flat = cells_to_flat(graph, goal, "goal")
    except NoPath:
        pass
    else:
        labels = graph.components()
        if labels[flat[0]] == labels[cells_to_flat(graph, start, "start")[0]]:
            return None
    return nearest_reachable(graph, start, graph.lattice.basis @ np.asarray(goal, dtype=np.float64))


