"""Numba kernels of Dijkstra's fields: a wavefront on equal edges, buckets on others, and the paths back.

Over the arrays of :class:`planners.search._shared_kernels.GraphArrays`.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit

from planners.search._shared_kernels import drop_top, may_move, move_cost, rise


@njit(cache=True, nogil=True)
def wavefront(state, offsets, queue, steps, count, goals, most):
    """Write the least number of moves from the first ``count`` cells of ``queue`` into ``steps`` (size,).

    Equal edges need no priority: cells are settled in the order in which they are found. ``state``
    (size,) is 1 where a cell is free and not found; it is used up. ``queue`` is one longer
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
def buckets(graph, sources, goals, limit, inverse_width, slots, distance):
    """Write the least cost from ``sources`` into ``distance`` (size,), given as infinite everywhere.

    Where a bucket is no wider than the cheapest move, no move ends in the bucket it began in:
    every cell is final when its bucket's turn comes, and the order within a bucket is free. With
    wider buckets (moves of very different costs) a bucket is emptied again until nothing is added,
    which is as exact and only counts some cells twice.
    Stops when all ``goals`` are final; costs beyond ``limit`` are not entered. What is not final
    at the end is infinite again.

    Returns (expansions, pushes).
    """
    # Taken apart once: each use of a tuple of arrays counts references.
    free, offsets, lengths, swept_starts, swept, terrain = graph
    moves = offsets.shape[0]
    # A ring of buckets, as many as a move can reach; each is a list of entries, in no order.
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
        # The bucket is emptied until no move of its own adds to it any more.
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
                    reached = d + move_cost(a, b, k, lengths, terrain)
                    old = distance[b]
                    if not (reached < old and reached <= limit):
                        continue
                    if not may_move(free, a, k, offsets, swept_starts, swept):
                        continue
                    distance[b] = reached
                    due = np.int64(reached * inverse_width)
                    if due != turn and old < np.inf and np.int64(old * inverse_width) == due:
                        continue  # it stands in that bucket already
                    # At a position that was given back, or at a new one.
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
                    link[new] = heads[due % slots]
                    heads[due % slots] = new
                    waiting += 1
                    pushes += 1
        # A goal is final once its bucket has had its turn.
        if goals.shape[0] > 0:
            missing = False
            for i in range(goals.shape[0]):
                d = distance[goals[i]]
                missing = missing or d == np.inf or np.int64(d * inverse_width) > turn
            if not missing:
                break
        turn += 1
    # Cells that still wait have a cost, but not a final one.
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
def _parent(values, at, graph):
    """Return the lowest move by which the cell ``at`` got its value, or the number of moves at a source."""
    free, offsets, lengths, swept_starts, swept, terrain = graph
    moves = offsets.shape[0]
    value = values[at]
    if not (value > 0 and value < np.inf):
        return moves
    for k in range(moves):
        before = at - offsets[k]
        if free[before] == 0 or not (values[before] >= 0 and values[before] < np.inf):
            continue
        # The very sum of the search, hence equal to the last bit.
        if values[before] + move_cost(before, at, k, lengths, terrain) != value:
            continue
        # A step so cheap that the sum absorbs it leads nowhere nearer: two cells could be each other's parents.
        if values[before] >= value:
            continue
        if may_move(free, before, k, offsets, swept_starts, swept):
            return k
    return moves


@njit(cache=True, nogil=True)
def parents(values, out, graph):
    """Write for each cell the move that leads to it from its parent; the number of moves where there is none.

    Cells that are as far as all they could come from, because a sum absorbed the step, get their parents in rounds,
    each from a cell that has one already: so every chain of parents ends in a source.
    """
    free, offsets, lengths, swept_starts, swept, terrain = graph
    moves = offsets.shape[0]
    level = 0
    for at in range(values.shape[0]):
        out[at] = _parent(values, at, graph)
        if out[at] == moves and values[at] > 0 and values[at] < np.inf:
            level += 1
    if level == 0:
        return
    # Breadth first, from all cells that have a parent, into those of the same value that have none.
    queue = np.empty(values.shape[0], np.int64)
    count = 0
    for at in range(values.shape[0]):
        if free[at] != 0 and (out[at] != moves or values[at] == 0):
            queue[count] = at
            count += 1
    head = 0
    while head < count and level > 0:
        at = queue[head]
        head += 1
        for k in range(moves):
            b = at + offsets[k]
            if free[b] == 0 or out[b] != moves or values[b] != values[at] or not values[b] > 0:
                continue
            if values[at] + move_cost(at, b, k, lengths, terrain) != values[b]:
                continue
            if may_move(free, at, k, offsets, swept_starts, swept):
                out[b] = k
                level -= 1
                queue[count] = b
                count += 1


@njit(cache=True, nogil=True)
def walk_back(values, at, graph):
    """Return the flat cells from ``at`` back to a source."""
    offsets = graph.offsets
    out = np.empty(64, np.int64)
    out[0] = at
    count = 1
    while True:
        k = _parent(values, at, graph)
        if k == offsets.shape[0]:
            return out[:count].copy()
        at -= offsets[k]
        if count == out.shape[0]:
            out = np.append(out, np.empty(count, np.int64))
        out[count] = at
        count += 1


@njit(cache=True, nogil=True)
def follow_parents(parents, at, offsets):
    """Return the flat cells from ``at`` back to a source, by what :func:`parents` has written."""
    out = np.empty(64, np.int64)
    out[0] = at
    count = 1
    while parents[at] != offsets.shape[0]:
        at -= offsets[parents[at]]
        if count == out.shape[0]:
            out = np.append(out, np.empty(count, np.int64))
        out[count] = at
        count += 1
    return out[:count].copy()


@njit(cache=True, nogil=True)
def heap(graph, sources, goals, limit, distance):
    """Write the least cost from ``sources`` into ``distance`` (size,), by a heap; see :func:`buckets` for the rest.

    For moves whose costs differ by more than there can be buckets: each cell is expanded once, whatever they are.

    Returns (expansions, pushes).
    """
    free, offsets, lengths, swept_starts, swept, terrain = graph
    moves = offsets.shape[0]
    key = np.empty(1024 + sources.shape[0], np.float64)
    cost = np.empty(1024 + sources.shape[0], np.float64)
    node = np.empty(1024 + sources.shape[0], np.int64)
    wanted = np.zeros(distance.shape[0] if goals.shape[0] > 0 else 0, np.bool_)
    missing = 0
    for i in range(goals.shape[0]):
        missing += 0 if wanted[goals[i]] else 1
        wanted[goals[i]] = True
    count = 0
    for i in range(sources.shape[0]):
        if distance[sources[i]] != 0.0:
            distance[sources[i]] = 0.0
            rise(key, cost, node, count, 0.0, 0.0, sources[i])
            count += 1
    settled = 0
    pushes = count
    final = np.zeros(distance.shape[0], np.bool_)
    while count > 0:
        a = node[0]
        d = key[0]
        count = drop_top(key, cost, node, count)
        if final[a]:
            continue
        final[a] = True
        settled += 1
        if goals.shape[0] > 0 and wanted[a]:
            missing -= 1
            if missing == 0:
                break
        if count + moves > key.shape[0]:
            key = np.append(key, np.empty_like(key))
            cost = np.append(cost, np.empty_like(cost))
            node = np.append(node, np.empty_like(node))
        for k in range(moves):
            b = a + offsets[k]
            if free[b] == 0 or final[b]:
                continue
            reached = d + move_cost(a, b, k, lengths, terrain)
            if reached < distance[b] and reached <= limit and may_move(free, a, k, offsets, swept_starts, swept):
                distance[b] = reached
                rise(key, cost, node, count, reached, reached, b)
                count += 1
                pushes += 1
    # Cells that still wait have a cost, but not a final one.
    for i in range(count):
        if not final[node[i]]:
            distance[node[i]] = np.inf
    return settled, pushes
