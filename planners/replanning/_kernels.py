"""Numba kernels of replanning, over padded flat arrays with constant offsets like those of the other searches.

Costs are whole numbers, so that no sum has a rounding error and equal costs are equal. The search
goes from the goal to the start; every move has its opposite, which sweeps the same cells.

**What holds between searches.** ``via`` is zero where a cell is not reached. A reached cell's ``g``
is at least that of its parent plus the move between them, and that move is allowed: ``g`` is never
below the true cost, and the parents form a tree, for ``g`` falls on the way to its root. And a
reached cell that is not open offers no neighbour a lesser ``g`` than it has. Then the start's ``g``
is the least cost as soon as no open cell has a smaller key: on a cheapest path from the goal, the
last cell of those that have the true cost is open or the start, and its key is no larger.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit

from planners.search._shared_kernels import drop_top, may_move, rise

OPEN = 128  # set in ``via`` where the moves of a cell have yet to be tried
MOVE = 127  # the bits of ``via`` that hold the move that reached a cell, plus one
ROOT = 127  # these bits at the goal


@njit(cache=True, nogil=True)
def cost_of(a, b, k, lengths, scaled, terrain):
    """Return what the move k between the cells a and b costs, never less than ``lengths[k]``."""
    if terrain.shape[0] == 0:
        return lengths[k]
    return max(lengths[k], np.int64(np.rint(scaled[k] * (0.5 * (terrain[a] + terrain[b])))))


@njit(cache=True, nogil=True)
def project(cell, start, planes, strides, out):
    """Write the product of each plane with the way from the cell ``start`` (n,) to ``cell`` into ``out`` (F,)."""
    out[:] = 0
    rest = cell
    for i in range(strides.shape[0]):
        x = rest // strides[i]
        rest -= x * strides[i]
        way = x - start[i]
        for f in range(planes.shape[0]):
            out[f] += planes[f, i] * way


@njit(cache=True, nogil=True)
def gauge(base, rises, k):
    """Return the gauge of the way with the products ``base`` (F,) after the move k."""
    most = np.int64(0)
    for f in range(base.shape[0]):
        v = abs(base[f] + rises[k, f])
        if v > most:
            most = v
    return most


@njit(cache=True, nogil=True)
def _room(key, cost, node, count, more):
    if count + more > key.shape[0]:
        more = max(more, key.shape[0])
        key = np.append(key, np.empty(more, np.int64))
        cost = np.append(cost, np.empty(more, np.int64))
        node = np.append(node, np.empty(more, np.int64))
    return key, cost, node


@njit(cache=True, nogil=True)
def rekey(key, cost, node, count, place, strides, planes, rises, g, via):
    """Give the open cells the keys of the start ``place`` (n,), each once; returns how many entries there are."""
    moves = rises.shape[0] - 1
    base = np.empty(planes.shape[0], np.int64)
    kept = 0
    for i in range(count):
        a = node[i]
        if via[a] & OPEN and g[a] == cost[i]:
            via[a] &= np.uint8(MOVE)
            node[kept] = a
            kept += 1
    for i in range(kept):
        a = node[i]
        via[a] |= np.uint8(OPEN)
        project(a, place, planes, strides, base)
        rise(key, cost, node, i, g[a] + gauge(base, rises, moves), g[a], a)
    return kept


@njit(cache=True, nogil=True)
def search(
    free, offsets, lengths, scaled, swept_starts, swept, terrain, strides, planes, rises,
    start, place, km, key, cost, node, count, g, via, most,
):  # fmt: skip
    """Try the moves of open cells, least key first, until the start's cost is final or no cell is open.

    Args:
        free: the graph's cells (size,).
        offsets: its moves (K,).
        lengths: (K,) int64 the least that each move costs.
        scaled: (K,) float64 what it costs on a terrain of one.
        swept_starts: (K + 1,) where the cells that a move sweeps begin.
        swept: (S,) those cells.
        terrain: (size,) or empty.
        strides: (n,) of the window.
        planes: (F, n) int64 facets of the gauge of ``lengths``, one of each opposite pair.
        rises: (K + 1, F) int64 products of the moves with the planes, the last row zero.
        start: flat cell.
        place: (n,) the start in window coordinates.
        km: what moves of the start have added to all keys. A key in the queue may be too small, and
            is put right when its turn comes (Koenig and Likhachev 2002).
        key: the queue, least key first, then the largest cost; entries may be stale.
        cost: g of each entry when it was made.
        node: its cell.
        count: entries.
        g: (size,) int64, written where ``via`` is not zero.
        via: (size,) uint8.
        most: stop after so many expansions; the search can go on from there.

    Returns:
        (key, cost, node, count, expansions, pushes).
    """
    moves = offsets.shape[0]
    base = np.empty(planes.shape[0], np.int64)
    expansions = 0
    pushes = 0
    while count > 0 and expansions < most:
        if via[start] != 0 and key[0] >= g[start] + km:
            break
        a = node[0]
        d = cost[0]
        stood = key[0]
        count = drop_top(key, cost, node, count)
        if (via[a] & OPEN) == 0 or g[a] != d:
            continue
        project(a, place, planes, strides, base)
        now = d + gauge(base, rises, moves) + km
        key, cost, node = _room(key, cost, node, count, moves)
        if stood < now:
            rise(key, cost, node, count, now, d, a)
            count += 1
            pushes += 1
            continue
        via[a] &= np.uint8(MOVE)
        expansions += 1
        for k in range(moves):
            b = a + offsets[k]
            if free[b] == 0:
                continue
            reached = d + cost_of(a, b, k, lengths, scaled, terrain)
            if via[b] != 0 and reached >= g[b]:
                continue
            if not may_move(free, a, k, offsets, swept_starts, swept):
                continue
            g[b] = reached
            via[b] = np.uint8(OPEN | (k + 1))
            rise(key, cost, node, count, reached + gauge(base, rises, k) + km, reached, b)
            count += 1
            pushes += 1
    return key, cost, node, count, expansions, pushes


@njit(cache=True, nogil=True)
def enclosed(free, offsets, swept_starts, swept, start, goal, most):
    """Tell whether moves lead from ``start`` to at most ``most`` cells, and the ``goal`` is not among them."""
    seen = np.zeros(free.shape[0], np.uint8)
    queue = np.empty(most + 1, np.int64)
    queue[0] = start
    seen[start] = 1
    head = 0
    count = 1
    while head < count:
        a = queue[head]
        head += 1
        for k in range(offsets.shape[0]):
            b = a + offsets[k]
            if seen[b] == 0 and may_move(free, a, k, offsets, swept_starts, swept):
                if b == goal or count > most:
                    return False
                seen[b] = 1
                queue[count] = b
                count += 1
    return start != goal


@njit(cache=True, nogil=True)
def _least(a, free, offsets, lengths, scaled, swept_starts, swept, terrain, g, via):
    """Return the least cost (or -1) that reached neighbours offer the cell ``a``, and the move by which."""
    best = np.int64(-1)
    move = 0
    for k in range(offsets.shape[0]):
        before = a - offsets[k]
        if via[before] == 0:
            continue
        reached = g[before] + cost_of(before, a, k, lengths, scaled, terrain)
        if (best < 0 or reached < best) and may_move(free, before, k, offsets, swept_starts, swept):
            best = reached
            move = k
    return best, move


@njit(cache=True, nogil=True)
def _held(a, free, offsets, lengths, scaled, swept_starts, swept, terrain, g, via):
    """Tell whether some neighbour still holds ``g`` of the reached cell ``a``, and make that its parent."""
    mark = via[a] & MOVE
    if mark == ROOT:
        return True
    moves = offsets.shape[0]
    for i in range(-1, moves):
        k = mark - 1 if i < 0 else i
        before = a - offsets[k]
        if via[before] == 0 or g[before] >= g[a]:
            continue
        if g[before] + cost_of(before, a, k, lengths, scaled, terrain) > g[a]:
            continue
        if may_move(free, before, k, offsets, swept_starts, swept):
            via[a] = np.uint8((via[a] & OPEN) | (k + 1))
            return True
    return False


@njit(cache=True, nogil=True)
def _doubt_children(a, offsets, via, doubted, doubts):
    moves = offsets.shape[0]
    if doubts + moves > doubted.shape[0]:
        doubted = np.append(doubted, np.empty_like(doubted))
    for k in range(moves):
        b = a + offsets[k]
        if (via[b] & MOVE) == k + 1:
            doubted[doubts] = b
            doubts += 1
    return doubted, doubts


@njit(cache=True, nogil=True)
def amend(
    free, offsets, lengths, scaled, swept_starts, swept, terrain, strides, planes, rises,
    place, km, key, cost, node, count, g, via, known, touched, priced, limit,
):  # fmt: skip
    """Make the tree and the queue true again after changes of cells.

    Where a cell loses the move from its parent, another neighbour may hold its cost as well: then
    it only changes parents. Where none does, the cell is cut off, and its children are doubted in
    turn. What was cut off takes the best that its neighbours outside offer, and is open.

    ``known`` (size,) holds the states that the tree stands for and is brought up to date; ``touched``
    are cells whose state may differ from it, repetitions allowed, never the goal; ``priced`` those
    whose terrain may have changed. When more than ``limit`` cells are cut off it gives up, and all
    must be planned anew. The others are as in :func:`search`.

    Returns:
        (key, cost, node, count, cells cut off or -1, pushes).
    """
    moves = offsets.shape[0]
    base = np.empty(planes.shape[0], np.int64)
    doubted = np.empty(max(256, 2 * moves + swept.shape[0]), np.int64)
    doubts = 0
    lost = np.empty(256, np.int64)
    cut = 0
    pushes = 0
    for i in range(touched.shape[0]):
        c = touched[i]
        if free[c] != 0 or known[c] == 0:
            continue
        if via[c] != 0:
            via[c] = 0
            doubted, doubts = _doubt_children(c, offsets, via, doubted, doubts)
        while doubts + swept.shape[0] > doubted.shape[0]:
            doubted = np.append(doubted, np.empty_like(doubted))
        for k in range(moves):
            for j in range(swept_starts[k], swept_starts[k + 1]):
                b = c - swept[j] + offsets[k]
                if (via[b] & MOVE) == k + 1:
                    doubted[doubts] = b
                    doubts += 1
    for i in range(priced.shape[0]):
        c = priced[i]
        if via[c] != 0:
            doubted, doubts = _doubt_children(c, offsets, via, doubted, doubts)
            if doubts == doubted.shape[0]:
                doubted = np.append(doubted, np.empty_like(doubted))
            doubted[doubts] = c
            doubts += 1
    while doubts > 0:
        doubts -= 1
        a = doubted[doubts]
        if via[a] == 0 or _held(a, free, offsets, lengths, scaled, swept_starts, swept, terrain, g, via):
            continue
        if cut == limit:
            return key, cost, node, count, -1, pushes
        if cut == lost.shape[0]:
            lost = np.append(lost, np.empty_like(lost))
        lost[cut] = a
        cut += 1
        via[a] = 0
        doubted, doubts = _doubt_children(a, offsets, via, doubted, doubts)
    # All offers first: what one cell cut off takes must not be passed on to the next, half true.
    offer = np.empty(cut, np.int64)
    by = np.empty(cut, np.uint8)
    for i in range(cut):
        offer[i], by[i] = _least(lost[i], free, offsets, lengths, scaled, swept_starts, swept, terrain, g, via)
    key, cost, node = _room(key, cost, node, count, cut)
    for i in range(cut):
        if offer[i] < 0:
            continue
        a = lost[i]
        g[a] = offer[i]
        via[a] = np.uint8(OPEN | (by[i] + 1))
        project(a, place, planes, strides, base)
        rise(key, cost, node, count, g[a] + gauge(base, rises, moves) + km, g[a], a)
        count += 1
        pushes += 1
    for i in range(touched.shape[0] + priced.shape[0]):
        fresh = i < touched.shape[0]
        c = touched[i] if fresh else priced[i - touched.shape[0]]
        if free[c] == 0 or (fresh and known[c] != 0):
            continue
        best, k = _least(c, free, offsets, lengths, scaled, swept_starts, swept, terrain, g, via)
        if best >= 0 and (via[c] == 0 or best < g[c]):
            key, cost, node = _room(key, cost, node, count, 1)
            g[c] = best
            via[c] = np.uint8(OPEN | (k + 1))
            project(c, place, planes, strides, base)
            rise(key, cost, node, count, best + gauge(base, rises, moves) + km, best, c)
            count += 1
            pushes += 1
        if not fresh:
            if via[c] != 0:  # its moves may be cheaper
                key, cost, node = _room(key, cost, node, count, 1)
                via[c] |= np.uint8(OPEN)
                project(c, place, planes, strides, base)
                rise(key, cost, node, count, g[c] + gauge(base, rises, moves) + km, g[c], c)
                count += 1
                pushes += 1
            continue
        key, cost, node = _room(key, cost, node, count, swept.shape[0])
        for k in range(moves):
            for j in range(swept_starts[k], swept_starts[k + 1]):
                a = c - swept[j]
                b = a + offsets[k]
                if via[a] == 0 or free[b] == 0:
                    continue
                reached = g[a] + cost_of(a, b, k, lengths, scaled, terrain)
                if via[b] != 0 and reached >= g[b]:
                    continue
                if not may_move(free, a, k, offsets, swept_starts, swept):
                    continue
                g[b] = reached
                via[b] = np.uint8(OPEN | (k + 1))
                project(b, place, planes, strides, base)
                rise(key, cost, node, count, reached + gauge(base, rises, moves) + km, reached, b)
                count += 1
                pushes += 1
    for i in range(touched.shape[0]):
        known[touched[i]] = free[touched[i]]
    return key, cost, node, count, cut, pushes


@njit(cache=True, nogil=True)
def follow(via, offsets, at):
    """Return the flat cells from the reached cell ``at`` to the goal."""
    out = np.empty(64, np.int64)
    out[0] = at
    count = 1
    while (via[at] & MOVE) != ROOT:
        at -= offsets[(via[at] & MOVE) - 1]
        if count == out.shape[0]:
            out = np.append(out, np.empty(count, np.int64))
        out[count] = at
        count += 1
    return out[:count].copy()


@njit(cache=True, nogil=True)
def stands(route, free, offsets, swept_starts, swept):
    """Tell whether all moves along the flat cells ``route`` are allowed from its first cell, which is free, on."""
    for i in range(route.shape[0] - 1):
        way = route[i + 1] - route[i]
        for k in range(offsets.shape[0]):
            if offsets[k] == way:
                if not may_move(free, route[i], k, offsets, swept_starts, swept):
                    return False
                break
    return True
