"""What all searches need, compiled into each of them: a binary heap, the corner rule, the heuristic.

Numba does not see when a helper in another file was edited: after an edit here delete the caches
of the kernels that use it (``make clean``). The test suite always compiles afresh.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit


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
def rise(key, cost, node, at, k, g, c):
    """Let the entry (k, g, c) rise from the empty place ``at``: least key first, then the larger cost."""
    while at > 0:
        above = (at - 1) >> 1
        if key[above] < k or (key[above] == k and cost[above] >= g):
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
    """Remove the first of ``count`` entries."""
    count -= 1
    k = key[count]
    g = cost[count]
    c = node[count]
    at = 0
    while True:
        below = 2 * at + 1
        if below >= count:
            break
        other = below + 1
        if other < count and (key[other] < key[below] or (key[other] == key[below] and cost[other] > cost[below])):
            below = other
        if k < key[below] or (k == key[below] and g >= cost[below]):
            break
        key[at] = key[below]
        cost[at] = cost[below]
        node[at] = node[below]
        at = below
    key[at] = k
    cost[at] = g
    node[at] = c
    return count


@njit(cache=True, nogil=True)
def project(cell, targets, planes, strides, out):
    """Write the product of each plane with the way from each of ``targets`` (M, n) to ``cell`` into ``out`` (M, F)."""
    n = strides.shape[0]
    for m in range(targets.shape[0]):
        rest = cell
        for f in range(planes.shape[0]):
            out[m, f] = 0.0
        for i in range(n):
            x = rest // strides[i]
            rest -= x * strides[i]
            way = float(x - targets[m, i])
            for f in range(planes.shape[0]):
                out[m, f] += planes[f, i] * way


@njit(cache=True, nogil=True)
def gauge(base, move, k):
    """Return the least gauge over the targets after the move ``k``: ``base`` (M, F), ``move`` (K + 1, F)."""
    least = np.inf
    for m in range(base.shape[0]):
        most = 0.0
        for f in range(base.shape[1]):
            v = abs(base[m, f] + move[k, f])
            if v > most:
                most = v
        if most < least:
            least = most
    return least


@njit(cache=True, nogil=True)
def move_cost(a, b, k, lengths, terrain):
    """Return what the move ``k`` from the flat cell ``a`` to ``b`` costs; no terrain is one everywhere."""
    if terrain.shape[0] == 0:
        return lengths[k]
    return lengths[k] * (0.5 * (terrain[a] + terrain[b]))
