"""Numba kernels of the canonical search, over padded flat arrays with constant offsets.

``world`` is (free, offsets, swept_starts, swept) of a graph; ``rules`` is (natural, level,
guard_starts, guards, pair_starts, seconds, way_starts, cell_starts, cells) of
:class:`planners.search.canonical_order.Ordering`, with cells as flat offsets from the middle of a pair.
Directions are sets of bits; the bit K marks the start, which every move may follow. No kernel
checks a bound: from a free cell no offset leaves the array, and what an alternative sweeps is
looked at only once its middle is known to be free.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit

from planners.search._shared_kernels import drop_top, may_move, rise

OVERFLOW = -2
_MOST = 2.0**50  # sums up to this are exact in float64, eighths for breaking ties included


@njit(cache=True, nogil=True)
def _is_guarded(free, at, d, rules):
    """Tell whether no pair (d, e) over the cell ``at`` can be forced, as all guards of ``d`` are free."""
    _, _, guard_starts, guards, _, _, _, _, _ = rules
    for i in range(guard_starts[d], guard_starts[d + 1]):  # noqa: SIM110 - a generator is none of Numba's
        if free[at + guards[i]] == 0:
            return False
    return True


@njit(cache=True, nogil=True)
def _forced(world, at, d, rules, known, any_will_do):
    """Return the bits of the moves that are forced after ``d`` over the cell ``at``, without those ``known``."""
    free, offsets, swept_starts, swept = world
    _, _, _, _, pair_starts, seconds, way_starts, cell_starts, cells = rules
    found = np.int64(0)
    for i in range(pair_starts[d], pair_starts[d + 1]):
        e = seconds[i]
        if (known >> e) & 1 or not may_move(free, at, e, offsets, swept_starts, swept):
            continue
        blocked = True
        for w in range(way_starts[i], way_starts[i + 1]):
            clear = True
            for c in range(cell_starts[w], cell_starts[w + 1]):
                if free[at + cells[c]] == 0:
                    clear = False
                    break
            if clear:
                blocked = False
                break
        if blocked:
            found |= np.int64(1) << e
            if any_will_do:
                break
    return found


@njit(cache=True, nogil=True)
def _line(world, at, d, goal, rules, longest):
    """Return how many steps along ``d`` the next jump point is, or 0; and the steps looked at.

    For moves that they themselves alone follow naturally: a jump point is the goal, or where a move
    is forced. A line that is ``longest`` steps long ends there all the same.
    """
    # Taken apart once: each use of a tuple of arrays counts references.
    free, offsets, swept_starts, swept = world
    _, _, guard_starts, guards, _, _, _, _, _ = rules
    step = offsets[d]
    swept_from = swept_starts[d]
    swept_to = swept_starts[d + 1]
    guards_from = guard_starts[d]
    guards_to = guard_starts[d + 1]
    n = 0
    while free[at + step] != 0:
        clear = True
        for i in range(swept_from, swept_to):
            if free[at + swept[i]] == 0:
                clear = False
                break
        if not clear:
            break
        at += step
        n += 1
        if n == longest or at == goal:
            return n, n
        for i in range(guards_from, guards_to):
            if free[at + guards[i]] == 0:
                clear = False
                break
        if not clear and _forced(world, at, d, rules, np.int64(0), True) != 0:
            return n, n
    return 0, n


@njit(cache=True, nogil=True)
def _measure(cell, target, planes, strides, inverse_strides, base):
    """Write the product of each plane with the way from ``target`` (n,) to the cell into ``base`` (F,)."""
    rest = cell
    base[:] = 0.0
    for i in range(strides.shape[0]):
        # Exact, as half a cell is far more than the error of a product below 2^31; a division takes longer.
        x = np.int64((float(rest) + 0.5) * inverse_strides[i])
        rest -= x * strides[i]
        way = float(x - target[i])
        for f in range(base.shape[0]):
            base[f] += planes[f, i] * way


@njit(cache=True, nogil=True)
def _estimate(base, rises, e, steps):
    """Return the gauge of the way after ``steps`` moves ``e``."""
    most = 0.0
    for f in range(base.shape[0]):
        most = max(most, abs(base[f] + steps * rises[e, f]))
    return most


@njit(cache=True, nogil=True)
def search(world, rules, lengths, strides, planes, rises, target, start, goal, scale, longest, known, cells):
    """Search from ``start`` to ``goal`` by A* over canonical moves, along lines to the next jump point.

    Args:
        world: see the head of this file.
        rules: likewise.
        lengths: (K,) of the moves, integers in float64.
        strides: (n,) of the window.
        planes: (F, n) facets of the gauge, one of each opposite pair; (0, n) for no heuristic.
        rises: (K + 1, F) products of the moves with the planes, the last row zero.
        target: (n,) goal in window coordinates.
        start: flat cell.
        goal: flat cell other than the start, or -1 to search everything.
        scale: keys a unit of length.
        longest: steps along a line; 1 for a search that does not jump.
        known: (size,) uint8 zeros; 1 where a cell was reached, and its record written.
        cells: (size,) records: g; seen, the bits of the moves by which the cell was reached at that
            cost; waiting, those of them that have not been followed on yet.

    Returns:
        (cost or infinity or OVERFLOW, expansions, pushes, scanned, edges tried).
    """
    free, offsets, swept_starts, swept = world
    natural, level, _, _, _, _, _, _, _ = rules
    moves = offsets.shape[0]
    inverse_strides = 1.0 / strides
    one = np.int64(1)
    key = np.empty(1024, np.float64)
    cost = np.empty(1024, np.float64)
    node = np.empty(1024, np.int64)
    base = np.empty(planes.shape[0], np.float64)
    best = np.inf
    best_key = np.inf
    expansions = 0
    scanned = 0
    tried = 0
    filtered = False
    below = 1.0 - 1e-13
    known[start] = 1
    cells[start]["g"] = 0.0
    cells[start]["seen"] = one << moves
    cells[start]["waiting"] = one << moves
    _measure(start, target, planes, strides, inverse_strides, base)
    key[0] = np.floor(_estimate(base, rises, moves, 0) * scale + 0.5)
    cost[0] = 0.0
    node[0] = start
    count = 1
    pushes = 1
    while count > 0:
        if key[0] >= best_key and not filtered:
            # The goal comes first among its equals. Keep only what could still be better than it.
            kept = 0
            for i in range(count):
                a = node[i]
                d = cells[a]["g"]
                if np.floor(cost[i]) == d:
                    _measure(a, target, planes, strides, inverse_strides, base)
                    if d + _estimate(base, rises, moves, 0) < best * below:
                        rise(key, cost, node, kept, key[i], cost[i], a)
                        kept += 1
            count = kept
            filtered = True
            continue
        a = node[0]
        d = np.floor(cost[0])
        count = drop_top(key, cost, node, count)
        arrivals = np.int64(cells[a]["waiting"])
        if d != cells[a]["g"] or arrivals == 0:
            continue
        cells[a]["waiting"] = 0
        _measure(a, target, planes, strides, inverse_strides, base)
        if best < np.inf and d + _estimate(base, rises, moves, 0) >= best * below:
            continue
        expansions += 1
        if count + moves > key.shape[0]:
            key = np.append(key, np.empty_like(key))
            cost = np.append(cost, np.empty_like(cost))
            node = np.append(node, np.empty_like(node))
        following = np.int64(0)
        for k in range(moves + 1):
            if (arrivals >> k) & 1:
                following |= natural[k]
        for k in range(moves):
            if (arrivals >> k) & 1 and not _is_guarded(free, a, k, rules):
                following |= _forced(world, a, k, rules, following, False)
        for e in range(moves):
            if (following >> e) & 1 == 0:
                continue
            tried += 1
            b = a + offsets[e]
            if free[b] == 0:
                continue
            steps = 1
            reached = d + lengths[e]
            ahead = _estimate(base, rises, e, 1)
            if reached + ahead >= best * below:
                continue
            if longest == 1 or level[e] > 0:
                if known[b] != 0 and cells[b]["g"] < reached:
                    continue
                if not may_move(free, a, e, offsets, swept_starts, swept):
                    continue
            else:
                steps, looked = _line(world, a, e, goal, rules, longest)
                scanned += looked
                if steps == 0:
                    continue
                b = a + steps * offsets[e]
                reached = d + steps * lengths[e]
                ahead = _estimate(base, rises, e, steps)
                if reached + ahead >= best * below:
                    continue
            to = cells[b]
            if known[b] != 0 and reached >= to["g"]:
                seen = np.int64(to["seen"])
                if reached > to["g"] or (seen >> e) & 1 or b == goal:
                    continue
                to["seen"] = seen | (one << e)
                waiting = np.int64(to["waiting"])
                if waiting != 0:
                    to["waiting"] = waiting | (one << e)
                    continue  # it stands in the queue at this cost
                covered = np.int64(0)
                for k in range(moves):
                    if (seen >> k) & 1:
                        covered |= natural[k]
                if natural[e] & ~covered == 0 and (
                    _is_guarded(free, b, e, rules) or _forced(world, b, e, rules, covered, True) == 0
                ):
                    continue  # nothing follows that has not been followed on from other arrivals
                to["waiting"] = one << e
            else:
                if reached > _MOST:
                    return OVERFLOW, expansions, pushes, scanned, tried
                known[b] = 1
                to["g"] = reached
                to["seen"] = one << e
                to["waiting"] = one << e
                if b == goal:
                    best = reached
                    best_key = np.floor(best * scale + 0.5)
                    continue
            # Of equal f and g those go first that may still turn: a canonical path turns late.
            rise(key, cost, node, count, np.floor((reached + ahead) * scale + 0.5), reached + 0.125 * level[e], b)
            count += 1
            pushes += 1
    return best, expansions, pushes, scanned, tried


@njit(cache=True, nogil=True)
def follow(offsets, lengths, start, goal, known, cells):
    """Return the flat cells from ``goal`` back to ``start``, those that lines went over filled in."""
    out = np.empty(64, np.int64)
    out[0] = goal
    count = 1
    at = goal
    while at != start:
        e = 0
        while (np.int64(cells[at]["seen"]) >> e) & 1 == 0:
            e += 1
        left = cells[at]["g"]
        while True:
            at -= offsets[e]
            left -= lengths[e]
            if count == out.shape[0]:
                out = np.append(out, np.empty(count, np.int64))
            out[count] = at
            count += 1
            # Any cell of the line that was reached at no more than this; that where it began, at the latest.
            if known[at] != 0 and cells[at]["g"] <= left:
                break
    return out[:count].copy()
