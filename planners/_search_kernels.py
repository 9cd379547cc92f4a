"""Numba kernels of the planners, all over padded flat arrays with constant offsets.

No kernel checks a bound: from a free cell no offset leaves the array (the graph's padding). A move
k leads from the flat cell a to ``a + offsets[k]``, needs that cell free and also the cells
``a + swept[swept_starts[k]:swept_starts[k + 1]]``, and costs ``lengths[k]`` times the mean terrain
of its two ends (an empty terrain array stands for one everywhere).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from planners._shared_kernels import drop_top, gauge, may_move, project, rise

GOAL = 128  # set in ``via`` where a cell is a goal, so that asking costs no further array
MOVE = 127  # the bits of ``via`` that hold the move that reached a cell, plus one; 0 is not reached


@njit(cache=True, nogil=True)
def wavefront(state, offsets, queue, steps, count, goals, most):
    """Write the least number of moves from the first ``count`` cells of ``queue`` into ``steps`` (size,).

    Equal edges need no priority: cells are settled in the order in which they are found. ``state``
    (size,) is 1 where a cell is free and not found; it is used up. ``queue`` has one place more
    than there are free cells. Stops when all ``goals`` are found, or after ``most`` steps.

    Returns how many cells have their steps.
    """
    one = np.uint64(1)
    head = np.uint64(0)
    end = np.uint64(count)
    tail = np.uint64(count)
    d = np.int32(0)
    moves = offsets.shape[0]
    while head < end and d <= most:
        if goals.shape[0] > 0:
            missing = False
            for i in range(goals.shape[0]):
                missing = missing or state[goals[i]] != 0
            if not missing:
                break
        while head < end:
            cell = queue[head]
            head += one
            steps[np.uint64(cell)] = d
            for k in range(moves):
                # Without a branch: written always, kept only if the cell was free and new.
                to = np.uint64(np.int64(cell) + offsets[k])
                queue[tail] = to
                tail += np.uint64(state[to])
                state[to] = 0
        end = tail
        d += np.int32(1)
    if d <= most:  # stopped at the goals: the last front is final too
        while head < end:
            steps[np.uint64(queue[head])] = d
            head += one
    return np.int64(head)


@njit(cache=True, nogil=True)
def _cost(a, b, k, lengths, terrain):
    if terrain.shape[0] == 0:
        return lengths[k]
    return lengths[k] * (0.5 * (terrain[a] + terrain[b]))


@njit(cache=True, nogil=True)
def buckets(
    free, offsets, lengths, swept_starts, swept, terrain, sources, goals, limit, inverse_width, slots, distance
):
    """Write the least cost from ``sources`` into ``distance`` (size,), given as infinite everywhere.

    Where a bucket is no wider than the cheapest move, no move ends in the bucket it began in:
    every cell is final when its bucket's turn comes, and the order within a bucket is free. With
    wider buckets (moves of very different costs) a bucket is emptied again until nothing is added,
    which is as exact and only counts some cells twice.
    Stops when all ``goals`` are final; costs beyond ``limit`` are not entered. What is not final
    at the end is infinite again.

    Returns (expansions, pushes).
    """
    moves = offsets.shape[0]
    heads = np.full(slots, -1, np.int64)
    node = np.empty(1024, np.int64)
    link = np.empty(1024, np.int64)
    used = 0
    spare = np.int64(-1)
    waiting = 0
    settled = 0
    pushes = 0
    for i in range(sources.shape[0]):
        if distance[sources[i]] != 0.0:
            distance[sources[i]] = 0.0
            if used == node.shape[0]:
                node = np.append(node, np.empty(used, np.int64))
                link = np.append(link, np.empty(used, np.int64))
            node[used] = sources[i]
            link[used] = heads[0]
            heads[0] = used
            used += 1
            waiting += 1
            pushes += 1
    turn = np.int64(0)
    while waiting > 0:
        while heads[turn % slots] >= 0:
            entry = heads[turn % slots]
            heads[turn % slots] = -1
            while entry >= 0:
                a = node[entry]
                following = link[entry]
                link[entry] = spare
                spare = entry
                waiting -= 1
                entry = following
                d = distance[a]
                if np.int64(d * inverse_width) != turn:
                    continue  # it was reached at less cost since, and settled in an earlier bucket
                settled += 1
                for k in range(moves):
                    b = a + offsets[k]
                    if free[b] == 0:
                        continue
                    reached = d + _cost(a, b, k, lengths, terrain)
                    old = distance[b]
                    if not (reached < old and reached <= limit):
                        continue
                    if not may_move(free, a, k, offsets, swept_starts, swept):
                        continue
                    distance[b] = reached
                    place = np.int64(reached * inverse_width)
                    if place != turn and old < np.inf and np.int64(old * inverse_width) == place:
                        continue  # it stands in that bucket already
                    if spare >= 0:
                        new = spare
                        spare = link[spare]
                    else:
                        if used == node.shape[0]:
                            node = np.append(node, np.empty(used, np.int64))
                            link = np.append(link, np.empty(used, np.int64))
                        new = np.int64(used)
                        used += 1
                    node[new] = b
                    link[new] = heads[place % slots]
                    heads[place % slots] = new
                    waiting += 1
                    pushes += 1
        if goals.shape[0] > 0:
            missing = False
            for i in range(goals.shape[0]):
                d = distance[goals[i]]
                missing = missing or d == np.inf or np.int64(d * inverse_width) > turn
            if not missing:
                break
        turn += 1
    if waiting > 0:
        for s in range(slots):
            entry = heads[s]
            while entry >= 0:
                a = node[entry]
                if distance[a] < np.inf and np.int64(distance[a] * inverse_width) > turn:
                    distance[a] = np.inf
                entry = link[entry]
    return settled, pushes


@njit(cache=True, nogil=True)
def _parent(values, at, offsets, lengths, swept_starts, swept, free, terrain):
    """Return the lowest move by which the cell ``at`` got its value, or the number of moves at a source."""
    moves = offsets.shape[0]
    value = values[at]
    if not (value > 0 and value < np.inf):
        return moves
    for k in range(moves):
        before = at - offsets[k]
        if free[before] == 0 or not (values[before] >= 0 and values[before] < np.inf):
            continue
        # The very sum of the search, hence equal to the last bit.
        if values[before] + _cost(before, at, k, lengths, terrain) != value:
            continue
        if may_move(free, before, k, offsets, swept_starts, swept):
            return k
    return moves


@njit(cache=True, nogil=True)
def parents(values, out, offsets, lengths, swept_starts, swept, free, terrain):
    """Write for each cell the move that leads to it from its parent; the number of moves where there is none."""
    for at in range(values.shape[0]):
        out[at] = _parent(values, at, offsets, lengths, swept_starts, swept, free, terrain)


@njit(cache=True, nogil=True)
def walk_back(values, at, offsets, lengths, swept_starts, swept, free, terrain):
    """Return the flat cells from ``at`` back to a source."""
    out = np.empty(64, np.int64)
    out[0] = at
    count = 1
    while True:
        k = _parent(values, at, offsets, lengths, swept_starts, swept, free, terrain)
        if k == offsets.shape[0]:
            return out[:count].copy()
        at -= offsets[k]
        if count == out.shape[0]:
            out = np.append(out, np.empty(count, np.int64))
        out[count] = at
        count += 1


@njit(cache=True, nogil=True)
def search(
    free, offsets, lengths, swept_starts, swept, terrain, strides, planes, rises, targets, start, weight, scale, slack,
    g, via,
):  # fmt: skip
    """Search from ``start`` to the nearest cell that ``via`` (size,) marks as a goal, by (weighted) A*.

    Keys are rounded to 1 / ``scale``, far below the cheapest move, so that equal f are equal keys
    and the larger g goes first; what that rounding could hide is looked at again before the
    search ends, so that the cost is exact. There is no closed list: a cell reached at less cost is
    pushed again, which also re-opens it.

    Args:
        free: the graph's cells (size,).
        offsets: its moves (K,).
        lengths: their lengths (K,), metres.
        swept_starts: (K + 1,) where the cells that a move sweeps begin.
        swept: (S,) those cells.
        terrain: (size,) or empty.
        strides: (n,) of the window.
        planes: (F, n) facets of the gauge, one of each opposite pair; (0, n) for no heuristic.
        rises: (K + 1, F) products of the moves with the planes, the last row zero.
        targets: (M, n) goals in window coordinates, for the heuristic.
        start: flat cell, not a goal.
        weight: of the heuristic, at least one.
        scale: keys a metre.
        slack: a little less than one where sums of costs may differ in their last digits by the
            order of the sum: such differences must not open cells again. Else one.
        g: (size,) float64, written where ``via`` is.
        via: (size,) uint8, zero but for the goals' mark.

    Returns:
        (goal or -1, expansions, pushes, a lower bound of the least cost).
    """
    moves = offsets.shape[0]
    key = np.empty(1024, np.float64)
    cost = np.empty(1024, np.float64)
    node = np.empty(1024, np.int64)
    base = np.empty((targets.shape[0], planes.shape[0]), np.float64)
    best = np.inf
    best_key = np.inf
    found = np.int64(-1)
    expansions = 0
    filtered = False
    below = 1.0 - 1e-13
    g[start] = 0.0
    via[start] |= np.uint8(moves + 1)
    project(start, targets, planes, strides, base)
    least = gauge(base, rises, moves)
    key[0] = np.floor(weight * least * scale + 0.5)
    cost[0] = 0.0
    node[0] = start
    count = 1
    pushes = 1
    while count > 0:
        if key[0] >= best_key and not filtered:
            if weight > 1.0:
                break
            # The goal comes first among its equals. Keep only what could still be better than it.
            kept = 0
            for i in range(count):
                c = node[i]
                if cost[i] == g[c]:
                    project(c, targets, planes, strides, base)
                    if cost[i] + gauge(base, rises, moves) < best * below:
                        rise(key, cost, node, kept, key[i], cost[i], c)
                        kept += 1
            count = kept
            filtered = True
            continue
        a = node[0]
        d = cost[0]
        count = drop_top(key, cost, node, count)
        if d != g[a]:
            continue
        project(a, targets, planes, strides, base)
        if filtered and d + gauge(base, rises, moves) >= best * below:
            continue
        expansions += 1
        if count + moves > key.shape[0]:
            key = np.append(key, np.empty_like(key))
            cost = np.append(cost, np.empty_like(cost))
            node = np.append(node, np.empty_like(node))
        for k in range(moves):
            b = a + offsets[k]
            if free[b] == 0:
                continue
            reached = d + _cost(a, b, k, lengths, terrain)
            mark = via[b]
            if (mark & MOVE) != 0 and reached >= g[b] * slack:
                continue
            if not may_move(free, a, k, offsets, swept_starts, swept):
                continue
            if mark & GOAL:
                g[b] = reached
                via[b] = np.uint8(GOAL | (k + 1))
                if reached < best:
                    best = reached
                    best_key = np.floor(best * scale + 0.5)
                    found = b
                continue
            estimate = gauge(base, rises, k)
            if reached + estimate >= best * below:
                continue
            g[b] = reached
            via[b] = np.uint8(k + 1)
            rise(key, cost, node, count, np.floor((reached + weight * estimate) * scale + 0.5), reached, b)
            count += 1
            pushes += 1
    lower = best
    if weight > 1.0:
        # The best path goes through a cell that waits, at its least cost: the least f is a bound.
        for i in range(count):
            if cost[i] == g[node[i]]:
                project(node[i], targets, planes, strides, base)
                lower = min(lower, cost[i] + gauge(base, rises, moves))
    return found, expansions, pushes, lower


@njit(cache=True, nogil=True)
def search_both(
    free, offsets, lengths, swept_starts, swept, terrain, strides, planes, rises, origin, targets, start, goals,
    scale, slack, g, via, g_back, via_back,
):  # fmt: skip
    """Search from ``start`` and back from ``goals`` at once, until the two meet on a shortest path.

    The two sides use opposite potentials, (estimate to the goals - estimate from the start) / 2
    (Ikeda and others, 1994), with which both are Dijkstra's algorithm on the same reduced costs:
    when the two least keys add up to the best path found, it is a shortest one.

    Returns:
        (meeting cell or -1, expansions, pushes, cost).
    """
    moves = offsets.shape[0]
    key0 = np.empty(1024, np.float64)
    cost0 = np.empty(1024, np.float64)
    node0 = np.empty(1024, np.int64)
    key1 = np.empty(1024, np.float64)
    cost1 = np.empty(1024, np.float64)
    node1 = np.empty(1024, np.int64)
    to_goal = np.empty((targets.shape[0], planes.shape[0]), np.float64)
    to_start = np.empty((1, planes.shape[0]), np.float64)
    best = np.inf
    meeting = np.int64(-1)
    expansions = 0
    below = 1.0 - 1e-13
    g[start] = 0.0
    via[start] = moves + 1
    project(start, targets, planes, strides, to_goal)
    key0[0] = np.floor(0.5 * gauge(to_goal, rises, moves) * scale + 0.5)
    cost0[0] = 0.0
    node0[0] = start
    count0 = 1
    pushes = 1
    count1 = 0
    for i in range(goals.shape[0]):
        if via_back[goals[i]] != 0:
            continue
        if count1 == key1.shape[0]:
            key1 = np.append(key1, np.empty_like(key1))
            cost1 = np.append(cost1, np.empty_like(cost1))
            node1 = np.append(node1, np.empty_like(node1))
        g_back[goals[i]] = 0.0
        via_back[goals[i]] = moves + 1
        project(goals[i], origin, planes, strides, to_start)
        first = np.floor(0.5 * gauge(to_start, rises, moves) * scale + 0.5)
        rise(key1, cost1, node1, count1, first, 0.0, goals[i])
        count1 += 1
        pushes += 1
    while count0 > 0 and count1 > 0:
        if key0[0] + key1[0] >= best * scale - 1.5:  # each key was rounded by half at most
            break
        if count0 <= count1:
            a = node0[0]
            d = cost0[0]
            count0 = drop_top(key0, cost0, node0, count0)
            if d != g[a]:
                continue
            if count0 + moves > key0.shape[0]:
                key0 = np.append(key0, np.empty_like(key0))
                cost0 = np.append(cost0, np.empty_like(cost0))
                node0 = np.append(node0, np.empty_like(node0))
            expansions += 1
            project(a, targets, planes, strides, to_goal)
            project(a, origin, planes, strides, to_start)
            for k in range(moves):
                b = a + offsets[k]
                if free[b] == 0:
                    continue
                reached = d + _cost(a, b, k, lengths, terrain)
                if via[b] != 0 and reached >= g[b] * slack:
                    continue
                if not may_move(free, a, k, offsets, swept_starts, swept):
                    continue
                ahead = gauge(to_goal, rises, k)
                if reached + ahead >= best * below:
                    continue
                g[b] = reached
                via[b] = k + 1
                if via_back[b] != 0 and reached + g_back[b] < best:
                    best = reached + g_back[b]
                    meeting = b
                f = reached + 0.5 * (ahead - gauge(to_start, rises, k))
                rise(key0, cost0, node0, count0, np.floor(f * scale + 0.5), reached, b)
                count0 += 1
                pushes += 1
        else:
            a = node1[0]
            d = cost1[0]
            count1 = drop_top(key1, cost1, node1, count1)
            if d != g_back[a]:
                continue
            if count1 + moves > key1.shape[0]:
                key1 = np.append(key1, np.empty_like(key1))
                cost1 = np.append(cost1, np.empty_like(cost1))
                node1 = np.append(node1, np.empty_like(node1))
            expansions += 1
            for k in range(moves):
                b = a - offsets[k]
                if free[b] == 0:
                    continue
                reached = d + _cost(b, a, k, lengths, terrain)
                if via_back[b] != 0 and reached >= g_back[b] * slack:
                    continue
                if not may_move(free, b, k, offsets, swept_starts, swept):
                    continue
                project(b, targets, planes, strides, to_goal)
                project(b, origin, planes, strides, to_start)
                behind = gauge(to_start, rises, moves)
                if reached + behind >= best * below:
                    continue
                g_back[b] = reached
                via_back[b] = k + 1
                if via[b] != 0 and reached + g[b] < best:
                    best = reached + g[b]
                    meeting = b
                f = reached + 0.5 * (behind - gauge(to_goal, rises, moves))
                rise(key1, cost1, node1, count1, np.floor(f * scale + 0.5), reached, b)
                count1 += 1
                pushes += 1
    return meeting, expansions, pushes, best


@njit(cache=True, nogil=True)
def follow(via, offsets, at, sign):
    """Return the flat cells from ``at`` against the moves that reached them (``sign`` -1), or along (+1)."""
    moves = offsets.shape[0]
    out = np.empty(64, np.int64)
    out[0] = at
    count = 1
    while True:
        k = np.int64(via[at] & MOVE) - 1
        if k == moves:
            return out[:count].copy()
        at += sign * offsets[k]
        if count == out.shape[0]:
            out = np.append(out, np.empty(count, np.int64))
        out[count] = at
        count += 1
