"""Numba kernels of A* from one end, over the arrays of :class:`planners.search._shared_kernels.GraphArrays`."""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from planners.search._shared_kernels import drop_top, rise

GOAL = 128  # set in ``parent_move`` where a cell is a goal, so that asking costs no further array
MOVE = 127  # its bits that hold the move that reached a cell, plus one; 0 is not reached
CLEARLY_LESS = 1.0 - 1e-13  # times a cost: an improvement by less is a rounding error

# What a search has come to, kept from one call of the kernel to the next.
PROGRESS = np.dtype(
    [
        ("entries", np.int64),  # in the heap
        ("used", np.int64),  # positions of the waiting list ever taken
        ("spare", np.int64),  # the first position of those given back, or -1
        ("waiting", np.int64),  # entries that wait
        ("turn", np.int64),  # the bucket that is the heap now
        ("goal", np.int64),  # the best goal reached, or -1
        ("expansions", np.int64),
        ("pushes", np.int64),
        ("cost", np.float64),  # of the goal
        ("cost_key", np.float64),  # the same as a key
    ]
)


class OnwardMoves(NamedTuple):
    """The moves worth trying after each move, see :mod:`planners.search.pruning`.

    Attributes:
        starts: (K + 2,) int64, where those after each move begin, and at the start of a path (K).
        moves: int64, those moves.
    """

    starts: np.ndarray
    moves: np.ndarray


class Heuristic(NamedTuple):
    """The gauge of the offset to the nearest of M targets, see :mod:`planners.search.heuristics`.

    Attributes:
        planes: (n, F) facets of the gauge, one of each opposite pair, F a multiple of four (zeros
            fill it up); (n, 0) for no heuristic.
        steps: (K, F) products of the moves with the planes.
        reach: a little more than twice the greatest of them.
        targets: (M, n) int64 goals in window coordinates.
        strides: (n,) int64 of the window.
        inverse_strides: (n,) float64.
    """

    planes: np.ndarray
    steps: np.ndarray
    reach: float
    targets: np.ndarray
    strides: np.ndarray
    inverse_strides: np.ndarray


class Tuning(NamedTuple):
    """Numbers of a search.

    Attributes:
        weight: of the heuristic, at least one.
        scale: keys a metre.
        slack: a little less than one where sums of costs may differ in their last digits by the
            order of the sum: such differences must not open cells again. Else one.
        inverse_width: buckets a key.
    """

    weight: float
    scale: float
    slack: float
    inverse_width: float


class OpenList(NamedTuple):
    """A ring of buckets over f, of which the one whose turn it is is a heap; all other entries wait unsorted.

    Attributes:
        heads: first entry that waits in each bucket, or -1; a power of two of them, more than f rises by in one move.
        key: of the heap's entries; as long as ``wait``, for all that waits may come to stand in one bucket.
        cost: their g.
        node: their cells.
        wait: (N, 2) key and g of the entries that wait; g is not a number where there is none.
        link: (N, 2) int64, their cells and which entry follows.
    """

    heads: np.ndarray
    key: np.ndarray
    cost: np.ndarray
    node: np.ndarray
    wait: np.ndarray
    link: np.ndarray


class Scratch(NamedTuple):
    """Room for the heuristic at the cell that is expanded, for M targets and F planes.

    Attributes:
        base: (M, F) the planes' values.
        tops: (M,) the greatest of each target.
        near_starts: (M + 1,) int64, where the planes near the greatest begin for each target that counts.
        near_plane: (M F + 1,) int64, those planes.
        near_base: (M F + 1,) their values.
    """

    base: np.ndarray
    tops: np.ndarray
    near_starts: np.ndarray
    near_plane: np.ndarray
    near_base: np.ndarray


class Reached(NamedTuple):
    """How each cell was reached.

    Attributes:
        g: (size,) float64 the cost, written where ``parent_move`` is.
        parent_move: (size,) uint8, zero but for the goals' mark and the start's move, which is K + 1.
    """

    g: np.ndarray
    parent_move: np.ndarray


# ---------------------------------------------------------------------- the heuristic
# What is asked for every move is inlined by Numba itself: a call with so many arrays costs more than what it does.


@njit(cache=True, nogil=True)
def _measure(cell, targets, across, strides, inverse_strides, base, tops):
    """Write the planes' values at a cell into ``base`` (M, F), each target's gauge into ``tops``; return the least."""
    facets = across.shape[1]
    least = np.inf
    for m in range(targets.shape[0]):
        for f in range(facets):
            base[m, f] = 0.0
        rest = cell
        for i in range(strides.shape[0]):
            # Exact, as half a cell is far more than the error of a product below 2^31; a division takes longer.
            x = np.int64((float(rest) + 0.5) * inverse_strides[i])
            rest -= x * strides[i]
            offset = float(x - targets[m, i])
            for f in range(facets):
                base[m, f] += across[i, f] * offset
        # Four at a time, for one would wait for the other.
        m0 = 0.0
        m1 = 0.0
        m2 = 0.0
        m3 = 0.0
        for f in range(0, facets, 4):
            m0 = max(m0, abs(base[m, f]))
            m1 = max(m1, abs(base[m, f + 1]))
            m2 = max(m2, abs(base[m, f + 2]))
            m3 = max(m3, abs(base[m, f + 3]))
        tops[m] = max(max(m0, m1), max(m2, m3))
        least = min(least, tops[m])
    return least


@njit(cache=True, nogil=True, inline="always")
def _near_planes(base, tops, least, reach, near_starts, near_plane, near_base):
    """Note the planes that can be the greatest after one move; return of how many targets there are any.

    One move changes a plane's value by half of ``reach`` at most, so that only those within ``reach``
    of the greatest count, and only the targets within ``reach`` of the nearest.
    """
    nears = 0
    c = 0
    for m in range(base.shape[0]):
        if tops[m] > least + reach:
            continue
        for f in range(base.shape[1]):
            # Without a branch: written always, kept only if it is near.
            near_base[c] = base[m, f]
            near_plane[c] = f
            c += np.int64(abs(base[m, f]) >= tops[m] - reach)
        nears += 1
        near_starts[nears] = c
    return nears


@njit(cache=True, nogil=True, inline="always")
def _estimate(nears, near_starts, near_plane, near_base, steps, k):
    """Return the heuristic after the move k from the cell whose near planes were noted."""
    one = np.uint64(1)
    estimate = np.inf
    for m in range(np.uint64(nears)):
        most = 0.0
        for i in range(np.uint64(near_starts[m]), np.uint64(near_starts[m + one])):
            most = max(most, abs(near_base[i] + steps[k, np.uint64(near_plane[i])]))
        estimate = min(estimate, most)
    return estimate


# ---------------------------------------------------------------------- the open list


@njit(cache=True, nogil=True)
def _heap_of_bucket(open_list, bucket, g, spare):
    """Make the heap, which is empty, of the entries that wait in a bucket and are not out of date.

    Returns:
        (entries in the heap, first spare position, entries taken).
    """
    heads, key, cost, node, wait, link = open_list
    count = 0
    taken = 0
    entry = heads[bucket]
    heads[bucket] = -1
    while entry >= 0:
        e = np.uint64(entry)
        c = link[e, 0]
        if wait[e, 1] == g[np.uint64(c)]:
            rise(key, cost, node, count, wait[e, 0], wait[e, 1], c)
            count += 1
        taken += 1
        following = link[e, 1]
        wait[e, 1] = np.nan
        link[e, 1] = spare
        spare = entry
        entry = following
    return count, spare, taken


# ---------------------------------------------------------------------- the search


@njit(cache=True, nogil=True)
def run_astar(graph, onward, heuristic, tuning, open_list, scratch, progress, reached_cells):
    """Go on with a (weighted) A* to the nearest goal until it ends or its open list is full.

    f never falls by more than rounding (the heuristic is consistent), so that all entries but those
    of the bucket whose turn it is can wait unsorted. Keys are f rounded to 1 / ``scale``, far below
    the cheapest move, so that equal f are equal keys and the larger g goes first; what that rounding
    could hide is looked at before the search ends, so that the cost is exact. There is no closed
    list: a cell reached at less cost is pushed again, which also re-opens it. The caller makes the
    arrays longer: in a loop that could replace an array Numba counts its references at each turn.

    Args:
        graph: GraphArrays.
        onward: OnwardMoves.
        heuristic: Heuristic.
        tuning: Tuning.
        open_list: OpenList.
        scratch: Scratch.
        progress: (1,) of PROGRESS, where the search stands.
        reached_cells: Reached.

    Returns:
        Whether the search has ended.
    """
    one = np.uint64(1)  # unsigned indices cannot count from the end: nothing to test
    # Taken apart once: each use of a tuple of arrays counts references.
    free, offsets, lengths, swept_starts, swept, terrain = graph
    onward_starts, onward_moves = onward
    planes, steps, reach, targets, strides, inverse_strides = heuristic
    weight, scale, slack, inverse_width = tuning
    heads, key, cost, node, wait, link = open_list
    base, tops, near_starts, near_plane, near_base = scratch
    g, parent_move = reached_cells
    moves = offsets.shape[0]
    mask = heads.shape[0] - 1
    plain = terrain.shape[0] == 0
    # Counters in local variables, which stay in registers.
    state = progress[0]
    count = state["entries"]
    used = state["used"]
    spare = state["spare"]
    waiting = state["waiting"]
    turn = state["turn"]
    found = state["goal"]
    expansions = state["expansions"]
    pushes = state["pushes"]
    best = state["cost"]
    best_key = state["cost_key"]
    ended = True
    while True:
        # The next bucket that is not empty becomes the heap when the heap is used up.
        if count == 0:
            if waiting == 0:
                break
            turn += 1
            while heads[turn & mask] < 0:
                turn += 1
            count, spare, taken = _heap_of_bucket(open_list, turn & mask, g, spare)
            waiting -= taken
            continue
        # A goal comes first among its equals, but for what rounding has made equal.
        top = key[0]
        if top > best_key or (top == best_key and weight > 1.0):
            break
        # Room for all that one expansion can push, else the caller makes the arrays longer.
        if count + moves >= key.shape[0] or used + moves > link.shape[0]:
            ended = False
            break
        # The least entry is expanded, unless its cell was reached at less cost since.
        a = node[0]
        d = cost[0]
        count = drop_top(key, cost, node, count)
        if d != g[np.uint64(a)]:
            continue
        least = _measure(a, targets, planes, strides, inverse_strides, base, tops)
        if top == best_key and d + least >= best * CLEARLY_LESS:
            continue
        expansions += 1
        nears = _near_planes(base, tops, least, reach, near_starts, near_plane, near_base)
        # Only moves that can follow the one that led here on a cheapest path.
        arrival = np.uint64(parent_move[np.uint64(a)] & MOVE) - one
        for j in range(np.uint64(onward_starts[arrival]), np.uint64(onward_starts[arrival + one])):
            k = np.uint64(onward_moves[j])
            to = a + offsets[k]
            b = np.uint64(to)
            if free[b] == 0:
                continue
            # Cheap tests first: most moves lead to cells that were reached at no more cost.
            reached = d + (lengths[k] if plain else lengths[k] * (0.5 * (terrain[a] + terrain[b])))
            mark = parent_move[b]
            if (mark & MOVE) != 0 and reached >= g[b] * slack:
                continue
            shut = False
            for i in range(np.uint64(swept_starts[k]), np.uint64(swept_starts[k + one])):
                if free[np.uint64(a + swept[i])] == 0:
                    shut = True
                    break
            if shut:
                continue
            # A goal needs no entry: nothing is looked for beyond it.
            if mark & GOAL:
                g[b] = reached
                parent_move[b] = np.uint8(GOAL) | np.uint8(k + one)
                if reached < best:
                    best = reached
                    best_key = np.floor(best * scale + 0.5)
                    found = to
                continue
            estimate = _estimate(nears, near_starts, near_plane, near_base, steps, k)
            if reached + estimate >= best * CLEARLY_LESS:
                continue
            g[b] = reached
            parent_move[b] = np.uint8(k + one)
            pushes += 1
            f_key = np.floor((reached + weight * estimate) * scale + 0.5)
            due = np.int64(f_key * inverse_width)
            if due <= turn:
                rise(key, cost, node, count, f_key, reached, to)
                count += 1
                continue
            # Entries for later go in front of their bucket's list, at a position given back if there is one.
            entry = spare
            if entry >= 0:
                spare = link[np.uint64(entry), 1]
            else:
                entry = used
                used += 1
            e = np.uint64(entry)
            wait[e, 0] = f_key
            wait[e, 1] = reached
            link[e, 0] = to
            link[e, 1] = heads[due & mask]
            heads[due & mask] = entry
            waiting += 1
    state["entries"] = count
    state["used"] = used
    state["spare"] = spare
    state["waiting"] = waiting
    state["turn"] = turn
    state["goal"] = found
    state["expansions"] = expansions
    state["pushes"] = pushes
    state["cost"] = best
    state["cost_key"] = best_key
    return ended


@njit(cache=True, nogil=True)
def follow(parent_move, offsets, at, sign):
    """Return the flat cells from ``at`` against the moves that reached them (``sign`` -1), or along (+1)."""
    # Counted first: an array that grows takes half a second to compile.
    moves = offsets.shape[0]
    count = 1
    cell = at
    k = np.int64(parent_move[cell] & MOVE) - 1
    while k != moves:
        cell += sign * offsets[k]
        k = np.int64(parent_move[cell] & MOVE) - 1
        count += 1
    out = np.empty(count, np.int64)
    out[0] = at
    for i in range(1, count):
        out[i] = out[i - 1] + sign * offsets[np.int64(parent_move[out[i - 1]] & MOVE) - 1]
    return out
