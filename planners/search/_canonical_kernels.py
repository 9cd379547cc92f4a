"""Numba kernels of the canonical search, over arrays like those of the other searches but without terrain.

Directions are sets of bits; the bit K marks the start, which every move may follow. What an
alternative sweeps is looked at only once its middle is known to be free, so that no index leaves the array.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from planners.search._shared_kernels import drop_top, may_move, rise

OVERFLOW = -2
CLEARLY_LESS = 1.0 - 1e-13  # times a cost: an improvement by less is a rounding error
_MOST = 2.0**50  # sums up to this are exact in float64, eighths for breaking ties included


class Passable(NamedTuple):
    """What says whether a move is allowed: four of GraphArrays, for the fewer arrays a call takes the quicker it is."""

    free: np.ndarray
    offsets: np.ndarray
    swept_starts: np.ndarray
    swept: np.ndarray


class Pairs(NamedTuple):
    """The pairs of moves that can be forced, all int64: see :class:`planners.search.canonical_order.Ordering`.

    Guards and cells are flat offsets from the middle of a pair.
    """

    guard_starts: np.ndarray
    guards: np.ndarray
    pair_starts: np.ndarray
    seconds: np.ndarray
    alternative_starts: np.ndarray
    cell_starts: np.ndarray
    cells: np.ndarray


class Rules(NamedTuple):
    """An :class:`planners.search.canonical_order.Ordering` as the kernels take it.

    Attributes:
        natural: (K + 1,) int64.
        level: (K,) int64.
        pairs: Pairs.
    """

    natural: np.ndarray
    level: np.ndarray
    pairs: Pairs


class Estimates(NamedTuple):
    """The gauge of the offset from the goal, see :mod:`planners.search.heuristics`.

    Attributes:
        planes: (F, n) facets of the gauge, one of each opposite pair; (0, n) for no heuristic.
        steps: (K + 1, F) products of the moves with the planes, the last row zero.
        target: (n,) int64 goal in window coordinates.
        strides: (n,) int64 of the window.
        inverse_strides: (n,) float64.
    """

    planes: np.ndarray
    steps: np.ndarray
    target: np.ndarray
    strides: np.ndarray
    inverse_strides: np.ndarray


class Reached(NamedTuple):
    """How each cell was reached.

    Attributes:
        known: (size,) uint8 zeros; 1 where a cell was reached, and its record written.
        records: (size,) g; seen, the bits of the moves by which the cell was reached at that
            cost; waiting, those of them that have not been followed on yet.
    """

    known: np.ndarray
    records: np.ndarray


# ---------------------------------------------------------------------- which moves may follow


@njit(cache=True, nogil=True)
def _is_guarded(free, at, d, guard_starts, guards):
    """Tell whether no pair (d, e) over the cell ``at`` can be forced, as all guards of ``d`` are free."""
    for i in range(guard_starts[d], guard_starts[d + 1]):  # noqa: SIM110 - a generator is none of Numba's
        if free[at + guards[i]] == 0:
            return False
    return True


@njit(cache=True, nogil=True)
def _forced(passable, at, d, pairs, known, any_will_do):
    """Return the bits of the moves that are forced after ``d`` over the cell ``at``, without those ``known``."""
    free, offsets, swept_starts, swept = passable
    _, _, pair_starts, seconds, alternative_starts, cell_starts, cells = pairs
    found = np.int64(0)
    for i in range(pair_starts[d], pair_starts[d + 1]):
        e = seconds[i]
        if (known >> e) & 1 or not may_move(free, at, e, offsets, swept_starts, swept):
            continue
        # Forced where each of its alternatives has a blocked cell.
        blocked = True
        for w in range(alternative_starts[i], alternative_starts[i + 1]):
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
def _line(passable, at, d, goal, pairs, longest):
    """Return how many steps along ``d`` the next jump point is, or 0; and the steps looked at.

    For moves that they themselves alone follow naturally: a jump point is the goal, or where a move
    is forced. A line that is ``longest`` steps long ends there all the same.
    """
    # Taken apart once: each use of a tuple of arrays counts references.
    free, offsets, swept_starts, swept = passable
    guard_starts, guards, _, _, _, _, _ = pairs
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
        # Nothing can be forced while the guards are free: in the open the pairs are not looked at.
        for i in range(guards_from, guards_to):
            if free[at + guards[i]] == 0:
                clear = False
                break
        if not clear and _forced(passable, at, d, pairs, np.int64(0), True) != 0:
            return n, n
    return 0, n


# ---------------------------------------------------------------------- the heuristic


@njit(cache=True, nogil=True)
def _measure(cell, target, planes, strides, inverse_strides, base):
    """Write the product of each plane with the offset of the cell from ``target`` (n,) into ``base`` (F,)."""
    rest = cell
    base[:] = 0.0
    for i in range(strides.shape[0]):
        # Exact, as half a cell is far more than the error of a product below 2^31; a division takes longer.
        x = np.int64((float(rest) + 0.5) * inverse_strides[i])
        rest -= x * strides[i]
        offset = float(x - target[i])
        for f in range(base.shape[0]):
            base[f] += planes[f, i] * offset


@njit(cache=True, nogil=True)
def _estimate(base, heuristic_steps, e, steps):
    """Return the gauge after ``steps`` moves ``e`` from the cell that ``base`` (F,) was measured at."""
    most = 0.0
    for f in range(base.shape[0]):
        most = max(most, abs(base[f] + steps * heuristic_steps[e, f]))
    return most


# ---------------------------------------------------------------------- the search


@njit(cache=True, nogil=True)
def _keep_better(key, cost, node, count, best, records, estimates, base):
    """Keep only the entries whose cells are current and could lead to less than ``best``; return how many."""
    planes, heuristic_steps, target, strides, inverse_strides = estimates
    moves = heuristic_steps.shape[0] - 1
    kept = 0
    for i in range(count):
        a = node[i]
        d = records[a]["g"]
        if np.floor(cost[i]) == d:
            _measure(a, target, planes, strides, inverse_strides, base)
            if d + _estimate(base, heuristic_steps, moves, 0) < best * CLEARLY_LESS:
                rise(key, cost, node, kept, key[i], cost[i], a)
                kept += 1
    return kept


@njit(cache=True, nogil=True)
def search(passable, lengths, rules, estimates, start, goal, scale, longest, reached_cells):
    """Search from ``start`` to ``goal`` by A* over canonical moves, along lines to the next jump point.

    Args:
        passable: Passable.
        lengths: (K,) of the moves, integers in float64.
        rules: Rules.
        estimates: Estimates.
        start: flat cell.
        goal: flat cell other than the start, or -1 to search everything.
        scale: keys a unit of length.
        longest: steps along a line; 1 for a search that does not jump.
        reached_cells: Reached.

    Returns:
        (cost or infinity or OVERFLOW, expansions, pushes, scanned, edges tried).
    """
    # Taken apart once: each use of a tuple of arrays counts references.
    free, offsets, swept_starts, swept = passable
    natural, level, pairs = rules
    guard_starts, guards, _, _, _, _, _ = pairs
    planes, heuristic_steps, target, strides, inverse_strides = estimates
    known, records = reached_cells
    moves = offsets.shape[0]
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
    # The start, from which all moves are natural.
    known[start] = 1
    records[start]["g"] = 0.0
    records[start]["seen"] = one << moves
    records[start]["waiting"] = one << moves
    _measure(start, target, planes, strides, inverse_strides, base)
    key[0] = np.floor(_estimate(base, heuristic_steps, moves, 0) * scale + 0.5)
    cost[0] = 0.0
    node[0] = start
    count = 1
    pushes = 1
    while count > 0:
        # The goal comes first among its equals; what could still be better hides behind equal keys.
        if key[0] >= best_key and not filtered:
            count = _keep_better(key, cost, node, count, best, records, estimates, base)
            filtered = True
            continue
        # The least entry is expanded for the arrivals that have not been followed on yet.
        a = node[0]
        d = np.floor(cost[0])  # without the eighths that break ties
        count = drop_top(key, cost, node, count)
        arrivals = np.int64(records[a]["waiting"])
        if d != records[a]["g"] or arrivals == 0:
            continue
        records[a]["waiting"] = 0
        _measure(a, target, planes, strides, inverse_strides, base)
        if best < np.inf and d + _estimate(base, heuristic_steps, moves, 0) >= best * CLEARLY_LESS:
            continue
        expansions += 1
        if count + moves > key.shape[0]:
            key = np.append(key, np.empty_like(key))
            cost = np.append(cost, np.empty_like(cost))
            node = np.append(node, np.empty_like(node))
        # What may follow these arrivals, naturally or forced. Not a function: its call would cost a third of the time.
        following = np.int64(0)
        for k in range(moves + 1):
            if (arrivals >> k) & 1:
                following |= natural[k]
        for k in range(moves):
            if (arrivals >> k) & 1 and not _is_guarded(free, a, k, guard_starts, guards):
                following |= _forced(passable, a, k, pairs, following, False)
        for e in range(moves):
            if (following >> e) & 1 == 0:
                continue
            tried += 1
            b = a + offsets[e]
            if free[b] == 0:
                continue
            steps = 1
            reached = d + lengths[e]
            ahead = _estimate(base, heuristic_steps, e, 1)
            if reached + ahead >= best * CLEARLY_LESS:
                continue
            # One step, or along a line where the move is followed by itself alone.
            if longest == 1 or level[e] > 0:
                if known[b] != 0 and records[b]["g"] < reached:
                    continue
                if not may_move(free, a, e, offsets, swept_starts, swept):
                    continue
            else:
                steps, looked = _line(passable, a, e, goal, pairs, longest)
                scanned += looked
                if steps == 0:
                    continue
                b = a + steps * offsets[e]
                reached = d + steps * lengths[e]
                ahead = _estimate(base, heuristic_steps, e, steps)
                if reached + ahead >= best * CLEARLY_LESS:
                    continue
            to = records[b]
            if known[b] != 0 and reached >= to["g"]:
                # At the same cost by another move: a further arrival, followed on if anything new can follow it.
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
                    _is_guarded(free, b, e, guard_starts, guards) or _forced(passable, b, e, pairs, covered, True) == 0
                ):
                    continue
                to["waiting"] = one << e
            else:
                # For the first time, or at less cost: earlier arrivals count no more.
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
def follow(offsets, lengths, start, goal, reached_cells):
    """Return the flat cells from ``goal`` back to ``start``, those that lines went over filled in."""
    known, records = reached_cells
    out = np.empty(64, np.int64)
    out[0] = goal
    count = 1
    at = goal
    while at != start:
        # The lowest move by which the cell was reached.
        e = 0
        while (np.int64(records[at]["seen"]) >> e) & 1 == 0:
            e += 1
        left = records[at]["g"]
        while True:
            at -= offsets[e]
            left -= lengths[e]
            if count == out.shape[0]:
                out = np.append(out, np.empty(count, np.int64))
            out[count] = at
            count += 1
            # Any cell of the line that was reached at no more than this; that where it began, at the latest.
            if known[at] != 0 and records[at]["g"] <= left:
                break
    return out[:count].copy()
