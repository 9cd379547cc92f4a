"""Numba kernel of A* from both ends, over the arrays of :class:`planners.search._shared_kernels.GraphArrays`."""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from planners.search._shared_kernels import drop_top, gauge, may_move, move_cost, project, rise

CLEARLY_LESS = 1.0 - 1e-13  # times a cost: an improvement by less is a rounding error


class Estimates(NamedTuple):
    """The gauge of the offsets to the targets and from the start, see :mod:`planners.search.heuristics`.

    Attributes:
        planes: (F, n) facets of the gauge, one of each opposite pair; (0, n) for no heuristic.
        steps: (K + 1, F) products of the moves with the planes, the last row zero.
        targets: (M, n) int64 goals in window coordinates.
        origin: (1, n) int64 the start.
        strides: (n,) int64 of the window.
    """

    planes: np.ndarray
    steps: np.ndarray
    targets: np.ndarray
    origin: np.ndarray
    strides: np.ndarray


class Side(NamedTuple):
    """How the cells were reached from one end.

    Attributes:
        g: (size,) float64 the cost, written where ``parent_move`` is.
        parent_move: (size,) uint8 the move, plus one; K + 1 at the end itself, 0 where not reached.
    """

    g: np.ndarray
    parent_move: np.ndarray


class Heap(NamedTuple):
    """Open cells of one side: float64 keys, float64 costs and int64 flat cells."""

    key: np.ndarray
    cost: np.ndarray
    node: np.ndarray


@njit(cache=True, nogil=True)
def _with_room(heap, count, more):
    """Return the heap, twice as long where ``more`` entries would not fit after ``count``."""
    if count + more <= heap.key.shape[0]:
        return heap
    return Heap(
        np.append(heap.key, np.empty_like(heap.key)),
        np.append(heap.cost, np.empty_like(heap.cost)),
        np.append(heap.node, np.empty_like(heap.node)),
    )


@njit(cache=True, nogil=True)
def _expand_forward(a, d, heap, count, graph, estimates, side, other, meeting, best, scale, slack, at_goal, at_start):
    """Try the moves from the cell ``a`` of cost ``d``; see :func:`search_both` for the rest.

    Returns:
        (entries, pushes, meeting cell, cost of the path over it).
    """
    key, cost, node = heap
    free, offsets, lengths, swept_starts, swept, terrain = graph
    planes, steps, targets, origin, strides = estimates
    g, parent_move = side
    g_back, back_move = other
    pushes = 0
    # What both estimates are at the cell; each move adds its steps.
    project(a, targets, planes, strides, at_goal)
    project(a, origin, planes, strides, at_start)
    for k in range(offsets.shape[0]):
        b = a + offsets[k]
        if free[b] == 0:
            continue
        reached = d + move_cost(a, b, k, lengths, terrain)
        if parent_move[b] != 0 and reached >= g[b] * slack:
            continue
        if not may_move(free, a, k, offsets, swept_starts, swept):
            continue
        ahead = gauge(at_goal, steps, k)
        if reached + ahead >= best * CLEARLY_LESS:
            continue
        g[b] = reached
        parent_move[b] = k + 1
        # The two sides meet here; the best of all such cells is kept.
        if back_move[b] != 0 and reached + g_back[b] < best:
            best = reached + g_back[b]
            meeting = b
        # The key is g and this side's potential.
        f = reached + 0.5 * (ahead - gauge(at_start, steps, k))
        rise(key, cost, node, count, np.floor(f * scale + 0.5), reached, b)
        count += 1
        pushes += 1
    return count, pushes, meeting, best


@njit(cache=True, nogil=True)
def _expand_backward(a, d, heap, count, graph, estimates, side, other, meeting, best, scale, slack, at_goal, at_start):
    """Try the moves that lead to the cell ``a``, ``d`` from a goal; like :func:`_expand_forward`."""
    key, cost, node = heap
    free, offsets, lengths, swept_starts, swept, terrain = graph
    planes, steps, targets, origin, strides = estimates
    g_back, back_move = side
    g, parent_move = other
    moves = offsets.shape[0]
    pushes = 0
    for k in range(moves):
        b = a - offsets[k]
        if free[b] == 0:
            continue
        reached = d + move_cost(b, a, k, lengths, terrain)
        if back_move[b] != 0 and reached >= g_back[b] * slack:
            continue
        if not may_move(free, b, k, offsets, swept_starts, swept):
            continue
        # Projected anew: the steps are those of moves, not of moves taken back.
        project(b, targets, planes, strides, at_goal)
        project(b, origin, planes, strides, at_start)
        behind = gauge(at_start, steps, moves)
        if reached + behind >= best * CLEARLY_LESS:
            continue
        g_back[b] = reached
        back_move[b] = k + 1
        if parent_move[b] != 0 and reached + g[b] < best:
            best = reached + g[b]
            meeting = b
        f = reached + 0.5 * (behind - gauge(at_goal, steps, moves))
        rise(key, cost, node, count, np.floor(f * scale + 0.5), reached, b)
        count += 1
        pushes += 1
    return count, pushes, meeting, best


@njit(cache=True, nogil=True)
def search_both(graph, estimates, start, goals, scale, slack, ahead, behind):
    """Search from ``start`` and back from ``goals`` at once, until the two meet on a shortest path.

    The two sides use opposite potentials, (estimate to the goals - estimate from the start) / 2
    (Ikeda and others, 1994), with which both are Dijkstra's algorithm on the same reduced costs:
    when the two least keys add up to the best path found, it is a shortest one.

    Args:
        graph: GraphArrays.
        estimates: Estimates.
        start: flat cell.
        goals: (M,) flat cells.
        scale: keys a metre.
        slack: a little less than one where equal sums may differ in their last digits, else one.
        ahead: Side of the start.
        behind: Side of the goals.

    Returns:
        (meeting cell or -1, expansions, pushes, cost).
    """
    moves = graph.offsets.shape[0]
    g, parent_move = ahead
    g_back, back_move = behind
    at_goal = np.empty((estimates.targets.shape[0], estimates.planes.shape[0]), np.float64)
    at_start = np.empty((1, estimates.planes.shape[0]), np.float64)
    heap0 = Heap(np.empty(1024, np.float64), np.empty(1024, np.float64), np.empty(1024, np.int64))
    heap1 = Heap(np.empty(1024, np.float64), np.empty(1024, np.float64), np.empty(1024, np.int64))
    # The start on one side; on the other all goals, each once.
    g[start] = 0.0
    parent_move[start] = moves + 1
    project(start, estimates.targets, estimates.planes, estimates.strides, at_goal)
    heap0.key[0] = np.floor(0.5 * gauge(at_goal, estimates.steps, moves) * scale + 0.5)
    heap0.cost[0] = 0.0
    heap0.node[0] = start
    count0 = 1
    pushes = 1
    count1 = 0
    for i in range(goals.shape[0]):
        if back_move[goals[i]] != 0:
            continue
        heap1 = _with_room(heap1, count1, 1)
        g_back[goals[i]] = 0.0
        back_move[goals[i]] = moves + 1
        project(goals[i], estimates.origin, estimates.planes, estimates.strides, at_start)
        first = np.floor(0.5 * gauge(at_start, estimates.steps, moves) * scale + 0.5)
        rise(heap1.key, heap1.cost, heap1.node, count1, first, 0.0, goals[i])
        count1 += 1
        pushes += 1
    best = np.inf
    meeting = np.int64(-1)
    expansions = 0
    while count0 > 0 and count1 > 0:
        if heap0.key[0] + heap1.key[0] >= best * scale - 1.5:  # each key was rounded by half at most
            break
        # The side with fewer open cells goes on: where one end lies in a pocket it is soon used up.
        if count0 <= count1:
            a = heap0.node[0]
            d = heap0.cost[0]
            count0 = drop_top(heap0.key, heap0.cost, heap0.node, count0)
            if d != g[a]:
                continue
            heap0 = _with_room(heap0, count0, moves)
            count0, pushed, meeting, best = _expand_forward(
                a, d, heap0, count0, graph, estimates, ahead, behind, meeting, best, scale, slack,
                at_goal, at_start,
            )  # fmt: skip
        else:
            a = heap1.node[0]
            d = heap1.cost[0]
            count1 = drop_top(heap1.key, heap1.cost, heap1.node, count1)
            if d != g_back[a]:
                continue
            heap1 = _with_room(heap1, count1, moves)
            count1, pushed, meeting, best = _expand_backward(
                a, d, heap1, count1, graph, estimates, behind, ahead, meeting, best, scale, slack,
                at_goal, at_start,
            )  # fmt: skip
        expansions += 1
        pushes += pushed
    return meeting, expansions, pushes, best
