"""What all searches need, compiled into each of them: the graph's arrays, the heap, the corner rule, the heuristic.

Numba does not notice when a helper in another file was edited: after an edit here delete the caches
of the kernels that use it (``make clean``). The test suite keeps its compiled kernels in a folder named
after the content of all kernel files, so that it never runs yesterday's.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit


class GraphArrays(NamedTuple):
    """A lattice graph as the kernels take it, over padded flat arrays.

    No kernel checks a bound: from a free cell no offset leaves the array (the graph's padding). A
    move k leads from the flat cell a to ``a + offsets[k]``, needs that cell free and also the cells
    ``a + swept[swept_starts[k]:swept_starts[k + 1]]``, and costs ``lengths[k]`` times the mean
    terrain of its two ends.

    Attributes:
        free: (size,) uint8, 1 where a cell is free.
        offsets: (K,) int64 of the moves.
        lengths: (K,) of the moves, metres or any other unit of cost.
        swept_starts: (K + 1,) int64, where the cells that a move sweeps begin.
        swept: (S,) int64 those cells, from the start of the move.
        terrain: (size,) float64 multipliers of cost, or (0,) where they are one everywhere.
    """

    free: np.ndarray
    offsets: np.ndarray
    lengths: np.ndarray
    swept_starts: np.ndarray
    swept: np.ndarray
    terrain: np.ndarray


def graph_arrays(graph, lengths=None):
    """Return the arrays of a lattice graph, with other ``lengths`` (K,) of its moves if any are given."""
    return GraphArrays(
        graph.free,
        graph.offsets,
        graph.lengths if lengths is None else lengths,
        graph.swept_starts,
        graph.swept,
        np.empty(0) if graph.terrain is None else graph.terrain,
    )


# ---------------------------------------------------------------------- the graph


@njit(cache=True, nogil=True)
def may_move(free, at, k, offsets, swept_starts, swept):
    """Tell whether the move ``k`` leads from the flat cell ``at``: its end and all it sweeps are free."""
    if free[at + offsets[k]] == 0:
        return False
    for i in range(swept_starts[k], swept_starts[k + 1]):  # noqa: SIM110 - a generator is none of Numba's
        if free[at + swept[i]] == 0:
            return False
    return True


@njit(cache=True, nogil=True)
def move_cost(a, b, k, lengths, terrain):
    """Return what the move ``k`` from the flat cell ``a`` to ``b`` costs; no terrain is one everywhere."""
    if terrain.shape[0] == 0:
        return lengths[k]
    return lengths[k] * (0.5 * (terrain[a] + terrain[b]))


# ---------------------------------------------------------------------- the heap: least key first, then largest cost


@njit(cache=True, nogil=True)
def rise(key, cost, node, count, k, g, c):
    """Add the entry (k, g, c) after ``count`` others; the arrays have room for it."""
    one = np.uint64(1)  # unsigned indices cannot count from the end of an array: Numba tests nothing
    at = np.uint64(count)
    while at > 0:
        above = (at - one) >> one
        if (key[above] < k) | ((key[above] == k) & (cost[above] >= g)):
            break
        key[at] = key[above]
        cost[at] = cost[above]
        node[at] = node[above]
        at = above
    key[at] = k
    cost[at] = g
    node[at] = c


@njit(cache=True, nogil=True)
def drop_top(key, cost, node, count):
    """Remove the first of ``count`` entries; returns how many are left."""
    one = np.uint64(1)
    # The last entry sinks from the top. Its old position keeps a copy: where that is chosen as the lesser of
    # two the entry is no worse than itself and stays, so that a lone last entry needs no test of its own.
    last = np.uint64(count - 1)
    k = key[last]
    g = cost[last]
    c = node[last]
    at = np.uint64(0)
    below = one
    while below < last:
        # The lesser of two entries is chosen without a branch, which no processor could predict.
        other = below + one
        below += np.uint64((key[other] < key[below]) | ((key[other] == key[below]) & (cost[other] > cost[below])))
        if (k < key[below]) | ((k == key[below]) & (g >= cost[below])):
            break
        key[at] = key[below]
        cost[at] = cost[below]
        node[at] = node[below]
        at = below
        below = at + at + one
    key[at] = k
    cost[at] = g
    node[at] = c
    return count - 1


# ---------------------------------------------------------------------- the heuristic


@njit(cache=True, nogil=True)
def project(cell, targets, planes, strides, out):
    """Write the product of each plane with the offset of ``cell`` from each target (M, n) into ``out`` (M, F)."""
    n = strides.shape[0]
    for m in range(targets.shape[0]):
        rest = cell
        for f in range(planes.shape[0]):
            out[m, f] = 0.0
        for i in range(n):
            x = rest // strides[i]
            rest -= x * strides[i]
            offset = float(x - targets[m, i])
            for f in range(planes.shape[0]):
                out[m, f] += planes[f, i] * offset


@njit(cache=True, nogil=True)
def gauge(base, heuristic_steps, k):
    """Return the least gauge over the targets after the move k: ``base`` (M, F), ``heuristic_steps`` (K + 1, F)."""
    least = np.inf
    for m in range(base.shape[0]):
        most = 0.0
        for f in range(base.shape[1]):
            v = abs(base[m, f] + heuristic_steps[k, f])
            if v > most:
                most = v
        if most < least:
            least = most
    return least
