"""A* between cells of a lattice graph, with a heuristic derived from its moves."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from numbers import Real
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.base.errors import ArgumentError
from hexmap.base.sparse_arrays import sparse_zeros
from planners.path import NoPath, Path, cells_to_flat, make_path, not_connected
from planners.search.heuristics import gauge_planes, least_terrain
from planners.search.nearest import nearest_reachable
from planners.search.pruning import onward_moves

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph
    from planners.search._astar_kernels import Heuristic, OpenList, Scratch
    from planners.search._shared_kernels import GraphArrays

__all__ = ["MOST_MOVES", "astar"]

_MOST_WEIGHT = 1e6  # more is greedy search, and would overflow the queue's keys
_KEY_STEPS = 2.0**32  # keys of the queue a cheapest move
# Lengths are rounded to this fraction of the shortest, so that sums of up to 2^17 of them have no
# rounding error: without that the order of a sum decides ties, and opens cells again by the thousand.
_LENGTH_STEPS = 2.0**36
_SLACK = 1.0 - 1e-13  # the same for terrain, whose costs are what they are
MOST_MOVES = 126  # they share a byte with the goals' mark
_MOST_TARGETS = 16  # goals beyond this cost more to measure than the heuristic saves
_BUCKETS_A_MOVE = 16.0  # of the queue, to the cheapest move: few cells are sorted at a time
_FIRST_QUEUE = 1024  # entries that fit at first
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
    _check(graph, start, goal, weight, heuristic, bidirectional, nearest)
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
    # Answered at once where the components are known already.
    labels = graph.known_components
    if labels is not None and not (labels[goals] == labels[source[0]]).any():
        raise not_connected(start, goal)
    query = _prepare(graph, source, goals, heuristic)
    found = _search_from_both_ends(query) if bidirectional else _search(query, weight)
    if found is None:
        raise not_connected(start, goal)
    seconds = time.perf_counter() - begin
    return make_path(
        graph,
        found.flat,
        clearance=clearance,
        expansions=found.expansions,
        pushes=found.pushes,
        seconds=seconds,
        bound=found.bound,
    )


def _check(
    graph: LatticeGraph,
    start: ArrayLike,
    goal: ArrayLike,
    weight: float,
    heuristic: str | None,
    bidirectional: bool,
    nearest: bool,
) -> None:
    """Raise ArgumentError for what :func:`astar` does not take."""
    if not isinstance(weight, Real) or not 1.0 <= weight <= _MOST_WEIGHT:
        raise ArgumentError(f"the weight of the heuristic must be a number from 1 to {_MOST_WEIGHT:g}, not {weight!r}")
    if heuristic not in (None, "none"):
        raise ArgumentError(f"heuristic must be None (derived from the moves) or 'none', not {heuristic!r}")
    if bidirectional and weight != 1.0:
        raise ArgumentError("a search from both ends takes no weight")
    if len(graph.moves) > MOST_MOVES:
        raise ArgumentError(f"A* takes at most {MOST_MOVES} moves, not {len(graph.moves)}")
    if np.ndim(start) != 1:
        raise ArgumentError(f"A* starts in one cell ({graph.lattice.dim},), not {np.shape(start)}")
    if nearest and np.ndim(goal) != 1:
        raise ArgumentError(f"only one goal has a nearest reachable cell, not {np.shape(goal)}")


# ---------------------------------------------------------------------- prepare


class _Query(NamedTuple):
    """A query, prepared for the kernels of one search or the other.

    Attributes:
        graph: where to go.
        arrays: GraphArrays, the lengths rounded so that their sums are exact.
        planes: (F, n) facets of the gauge times the least terrain; (0, n) for no heuristic.
        start: flat cell.
        goals: (M,) flat cells.
        origin: (1, n) the start in window coordinates.
        targets: (M, n) the goals in window coordinates, a single one without a heuristic.
        scale: keys of the queue a metre.
        slack: see :class:`planners.search._astar_kernels.Tuning`.
    """

    graph: LatticeGraph
    arrays: GraphArrays
    planes: FloatArray
    start: int
    goals: IntArray
    origin: IntArray
    targets: IntArray
    scale: float
    slack: float


class _Found(NamedTuple):
    """The flat cells (M,) of a path, what finding it took, and its cost over the least at most."""

    flat: IntArray
    expansions: int
    pushes: int
    bound: float


def _prepare(graph: LatticeGraph, source: IntArray, goals: IntArray, heuristic: str | None) -> _Query:
    from planners.search import _shared_kernels as kernels

    lengths, slack = graph.lengths, _SLACK
    if graph.terrain is None:
        unit = 2.0 ** np.floor(np.log2(lengths.min() / _LENGTH_STEPS))
        lengths, slack = np.round(lengths / unit) * unit, 1.0
    cheapest = least_terrain(graph)
    planes = gauge_planes(graph.moves, lengths) * cheapest
    if heuristic == "none" or len(goals) > _MOST_TARGETS:
        planes = planes[:0]
    positions = _positions(graph, np.concatenate([source, goals]))
    # Without a heuristic one target is as good as many.
    targets = positions[1:] if len(planes) else positions[1:2]
    return _Query(
        graph=graph,
        arrays=kernels.graph_arrays(graph, lengths),
        planes=planes,
        start=int(source[0]),
        goals=goals,
        origin=positions[:1],
        targets=targets,
        scale=_KEY_STEPS / (float(graph.lengths.min()) * cheapest),
        slack=slack,
    )


def _positions(graph: LatticeGraph, flat: IntArray) -> IntArray:
    """Return flat cells (M,) in window coordinates (M, n)."""
    return np.ascontiguousarray(graph.flat_to_index(flat) - graph.low, dtype=np.int64)


# ---------------------------------------------------------------------- search and reconstruct


def _search_from_both_ends(query: _Query) -> _Found | None:
    """Return a path found from both ends, None where there is none."""
    from planners.search import _astar_kernels, _bidirectional_kernels

    graph, planes = query.graph, query.planes
    steps = np.zeros((len(graph.moves) + 1, len(planes)))
    steps[:-1] = graph.moves @ planes.T
    ahead, behind = (
        _bidirectional_kernels.Side(sparse_zeros(graph.size, np.float64), sparse_zeros(graph.size, np.uint8))
        for _ in range(2)
    )
    meeting, expansions, pushes, _ = _bidirectional_kernels.search_both(
        query.arrays,
        _bidirectional_kernels.Estimates(planes, steps, query.targets, query.origin, graph.strides),
        query.start,
        query.goals,
        query.scale,
        query.slack,
        ahead,
        behind,
    )
    if meeting < 0:
        return None
    there = _astar_kernels.follow(ahead.parent_move, graph.offsets, meeting, -1)[::-1]
    onward = _astar_kernels.follow(behind.parent_move, graph.offsets, meeting, 1)[1:]
    return _Found(np.concatenate([there, onward]), expansions, pushes, 1.0)


def _search(query: _Query, weight: float) -> _Found | None:
    """Return a path found from the start, None where there is none.

    The kernel returns when its open list is full, and goes on with one twice as long.
    """
    from planners.search import _astar_kernels as kernels

    graph = query.graph
    heuristic = _heuristic(query)
    width, slots = _buckets(query, weight)
    tuning = kernels.Tuning(float(weight), query.scale, query.slack, 1.0 / width)
    cells = kernels.Reached(sparse_zeros(graph.size, np.float64), sparse_zeros(graph.size, np.uint8))
    cells.parent_move[query.goals] = kernels.GOAL
    cells.parent_move[query.start] |= len(graph.moves) + 1
    # The start is the one entry of the heap.
    first = float(np.floor(weight * _estimates(heuristic, query.origin)[0] * query.scale + 0.5))
    open_list = kernels.OpenList(
        heads=np.full(slots, -1, np.int64),
        key=np.full(_FIRST_QUEUE, first),
        cost=np.zeros(_FIRST_QUEUE),
        node=np.full(_FIRST_QUEUE, query.start),
        wait=np.empty((_FIRST_QUEUE, 2)),
        link=np.empty((_FIRST_QUEUE, 2), np.int64),
    )
    progress = np.zeros(1, kernels.PROGRESS)
    progress[0] = (1, 0, -1, 0, int(first / width), -1, 0, 1, np.inf, np.inf)
    steady = (query.arrays, kernels.OnwardMoves(*onward_moves(graph)), heuristic, tuning)
    scratch = _scratch(heuristic)
    while not kernels.run_astar(*steady, open_list, scratch, progress, cells):
        longer = (np.concatenate([array, np.empty_like(array)]) for array in open_list[1:])
        open_list = kernels.OpenList(open_list.heads, *longer)
    end = progress[0]
    goal = int(end["goal"])
    if goal < 0:
        return None
    flat = np.ascontiguousarray(kernels.follow(cells.parent_move, graph.offsets, goal, -1)[::-1])
    bound = 1.0
    if weight > 1.0:
        least = _least_cost(query, heuristic, open_list, end, cells.g)
        bound = min(max(float(cells.g[goal]) / least, 1.0), float(weight))
    return _Found(flat, int(end["expansions"]), int(end["pushes"]), bound)


def _heuristic(query: _Query) -> Heuristic:
    """Return the heuristic of a search from the start."""
    from planners.search import _astar_kernels as kernels

    graph, facets = query.graph, len(query.planes)
    planes = np.zeros((graph.lattice.dim, -(-facets // 4) * 4))
    planes[:, :facets] = query.planes.T
    steps = graph.moves @ planes
    reach = float(np.abs(steps).max(initial=0.0)) * (2.0 + 1e-9)
    return kernels.Heuristic(planes, steps, reach, query.targets, graph.strides, 1.0 / graph.strides)


def _buckets(query: _Query, weight: float) -> tuple[float, int]:
    """Return the width of the open list's buckets, in keys, and how many there must be."""
    # f rises by a move's cost and by as much of the heuristic, at most.
    terrain = query.graph.terrain
    dearest = float(query.graph.lengths.max()) * (1.0 if terrain is None else float(terrain.max()))
    span = dearest * (1.0 + weight) * query.scale
    width = max(_KEY_STEPS / _BUCKETS_A_MOVE, span / _MOST_BUCKETS)
    return width, 1 << math.ceil(math.log2(span / width + 3.0))


def _scratch(heuristic: Heuristic) -> Scratch:
    """Return room for the heuristic at one cell."""
    from planners.search import _astar_kernels as kernels

    targets, facets = len(heuristic.targets), heuristic.planes.shape[1]
    return kernels.Scratch(
        base=np.empty((targets, facets)),
        tops=np.empty(targets),
        near_starts=np.zeros(targets + 1, np.int64),
        near_plane=np.empty(targets * facets + 1, np.int64),
        near_base=np.empty(targets * facets + 1),
    )


def _estimates(heuristic: Heuristic, positions: IntArray) -> FloatArray:
    """Return the heuristic (M,) at window coordinates (M, n)."""
    least = np.full(len(positions), np.inf)
    for target in heuristic.targets:
        least = np.minimum(least, np.abs((positions - target) @ heuristic.planes).max(axis=1, initial=0.0))
    return least


def _least_cost(query: _Query, heuristic: Heuristic, open_list: OpenList, end: np.void, g: FloatArray) -> float:
    """Return a lower bound of the least cost after a search with a weight, which ended with ``end``.

    The best path goes through an open cell, at its least cost: the least f without the weight is a bound.
    """
    entries, used = int(end["entries"]), int(end["used"])
    cells = np.concatenate([open_list.node[:entries], open_list.link[:used, 0]])
    costs = np.concatenate([open_list.cost[:entries], open_list.wait[:used, 1]])
    current = costs == g[cells]  # false for positions given back, whose cost is not a number
    cells, costs = cells[current], costs[current]
    f = costs + _estimates(heuristic, _positions(query.graph, cells))
    return float(f.min(initial=float(end["cost"])))


# ---------------------------------------------------------------------- goals


def _goals(graph: LatticeGraph, goal: ArrayLike) -> NDArray[np.int64]:
    """Return the flat goals; of a set those that are free and in the map."""
    cells = np.asarray(goal)
    if cells.ndim != 2 or len(cells) < 2:
        return cells_to_flat(graph, goal, "goal")
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
