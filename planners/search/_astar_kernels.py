"""Numba kernels of A*, all over padded flat arrays with constant offsets.

No kernel checks a bound: from a free cell no offset leaves the array (the graph's padding). A move
k leads from the flat cell a to ``a + offsets[k]``, needs that cell free and also the cells
``a + swept[swept_starts[k]:swept_starts[k + 1]]``, and costs ``lengths[k]`` times the mean terrain
of its two ends (an empty terrain array stands for one everywhere).
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit

from planners.search._shared_kernels import drop_top, gauge, may_move, move_cost, project, rise

GOAL = 128  # set in ``via`` where a cell is a goal, so that asking costs no further array
MOVE = 127  # the bits of ``via`` that hold the move that reached a cell, plus one; 0 is not reached


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
            way = float(x - targets[m, i])
            for f in range(facets):
                base[m, f] += across[i, f] * way
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


@njit(cache=True, nogil=True)
def _rise(key, cost, node, count, k, g, c):
    """Add an entry after ``count`` others like ``rise``, with unsigned indices."""
    one = np.uint64(1)
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
def _drop_top(key, cost, node, count):
    """Remove the first of ``count`` entries like ``drop_top``, with unsigned indices.

    The lesser of two entries is chosen without a branch, which no processor could predict.
    """
    one = np.uint64(1)
    last = np.uint64(count - 1)
    k = key[last]
    g = cost[last]
    c = node[last]
    key[last] = np.inf
    at = np.uint64(0)
    below = one
    while below < last:
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


@njit(cache=True, nogil=True)
def advance(
    free, offsets, lengths, swept_starts, swept, terrain, strides, inverse_strides, planes, rises, reach, targets,
    onward_starts, onward, weight, scale, slack, inverse_width, heads, key, cost, node, wait, link,
    base, tops, near_starts, near_plane, near_base, counts, bests, g, via,
):  # fmt: skip
    """Go on with a (weighted) A* to the nearest cell that ``via`` marks as a goal, until it ends or its queue is full.

    The queue is a ring of buckets over f, of which the one whose turn it is is a heap: f never
    falls by more than rounding (the heuristic is consistent), so that all other entries wait
    unsorted. Keys are f rounded to 1 / ``scale``, far below the cheapest move, so that equal f are
    equal keys and the larger g goes first; what that rounding could hide is looked at before the
    search ends, so that the cost is exact. There is no closed list: a cell reached at less cost is
    pushed again, which also re-opens it. The caller makes the arrays longer: in a loop that could
    replace an array Numba counts its references at each turn.

    Args:
        free: the graph's cells (size,).
        offsets: its moves (K,).
        lengths: their lengths (K,), metres.
        swept_starts: (K + 1,) where the cells that a move sweeps begin.
        swept: (S,) those cells.
        terrain: (size,) or empty.
        strides: (n,) of the window.
        inverse_strides: (n,) float64.
        planes: (n, F) facets of the gauge, one of each opposite pair, F a multiple of four (zeros
            fill it up); (n, 0) for no heuristic.
        rises: (K, F) products of the moves with the planes.
        reach: a little more than twice the greatest of them.
        targets: (M, n) goals in window coordinates, for the heuristic.
        onward_starts: (K + 2,) where in ``onward`` the moves worth a try after each move begin, and at the start.
        onward: those moves.
        weight: of the heuristic, at least one.
        scale: keys a metre.
        slack: a little less than one where sums of costs may differ in their last digits by the
            order of the sum: such differences must not open cells again. Else one.
        inverse_width: buckets a key.
        heads: first entry that waits in each bucket, or -1; a power of two of them, more than f rises by in one move.
        key: of the heap's entries; as long as ``wait``, for all that waits may come to stand in one bucket.
        cost: their g.
        node: their cells.
        wait: (N, 2) key and g of the entries that wait; g is not a number where there is none.
        link: (N, 2) int64, their cells and which entry follows.
        base: (M, F) for this function's use, as are the next four.
        tops: (M,).
        near_starts: (M + 1,).
        near_plane: (M F + 1,) int64.
        near_base: (M F + 1,).
        counts: (8,) int64: entries in the heap, places used among those that wait, the first spare
            one, how many wait, the bucket whose turn it is, the goal or -1, expansions, pushes.
        bests: (2,) cost and key of the goal.
        g: (size,) float64, written where ``via`` is.
        via: (size,) uint8, zero but for the goals' mark and the start's move, which is K + 1.

    Returns:
        Whether the search has ended.
    """
    below = 1.0 - 1e-13
    one = np.uint64(1)  # unsigned indices cannot count from the end: nothing to test
    moves = offsets.shape[0]
    facets = planes.shape[1]
    mask = heads.shape[0] - 1
    plain = terrain.shape[0] == 0
    count, used, spare, waiting, turn = counts[0], counts[1], counts[2], counts[3], counts[4]
    found, expansions, pushes = counts[5], counts[6], counts[7]
    best, best_key = bests[0], bests[1]
    ended = True
    while True:
        if count == 0:
            if waiting == 0:
                break
            turn += 1
            while heads[turn & mask] < 0:
                turn += 1
            entry = heads[turn & mask]
            heads[turn & mask] = -1
            while entry >= 0:
                e = np.uint64(entry)
                c = link[e, 0]
                if wait[e, 1] == g[np.uint64(c)]:
                    _rise(key, cost, node, count, wait[e, 0], wait[e, 1], c)
                    count += 1
                waiting -= 1
                following = link[e, 1]
                wait[e, 1] = np.nan
                link[e, 1] = spare
                spare = entry
                entry = following
            continue
        top = key[0]
        # A goal comes first among its equals, but for what rounding has made equal.
        if top > best_key or (top == best_key and weight > 1.0):
            break
        if count + moves >= key.shape[0] or used + moves > link.shape[0]:
            ended = False
            break
        a = node[0]
        d = cost[0]
        count = _drop_top(key, cost, node, count)
        if d != g[np.uint64(a)]:
            continue
        least = _measure(a, targets, planes, strides, inverse_strides, base, tops)
        if top == best_key and d + least >= best * below:
            continue
        expansions += 1
        # Only planes near the greatest can be the greatest after one move.
        nears = 0
        c = 0
        for m in range(targets.shape[0]):
            if tops[m] > least + reach:
                continue
            for f in range(facets):
                near_base[c] = base[m, f]
                near_plane[c] = f
                c += np.int64(abs(base[m, f]) >= tops[m] - reach)
            nears += 1
            near_starts[nears] = c
        arrival = np.uint64(via[np.uint64(a)] & MOVE) - one
        for j in range(np.uint64(onward_starts[arrival]), np.uint64(onward_starts[arrival + one])):
            k = np.uint64(onward[j])
            to = a + offsets[k]
            b = np.uint64(to)
            if free[b] == 0:
                continue
            reached = d + (lengths[k] if plain else lengths[k] * (0.5 * (terrain[a] + terrain[b])))
            mark = via[b]
            if (mark & MOVE) != 0 and reached >= g[b] * slack:
                continue
            shut = False
            for i in range(np.uint64(swept_starts[k]), np.uint64(swept_starts[k + one])):
                if free[np.uint64(a + swept[i])] == 0:
                    shut = True
                    break
            if shut:
                continue
            if mark & GOAL:
                g[b] = reached
                via[b] = np.uint8(GOAL) | np.uint8(k + one)
                if reached < best:
                    best = reached
                    best_key = np.floor(best * scale + 0.5)
                    found = to
                continue
            estimate = np.inf
            for m in range(nears):
                most = 0.0
                for i in range(np.uint64(near_starts[m]), np.uint64(near_starts[m + 1])):
                    most = max(most, abs(near_base[i] + rises[k, np.uint64(near_plane[i])]))
                estimate = min(estimate, most)
            if reached + estimate >= best * below:
                continue
            g[b] = reached
            via[b] = np.uint8(k + one)
            pushes += 1
            f_key = np.floor((reached + weight * estimate) * scale + 0.5)
            due = np.int64(f_key * inverse_width)
            if due <= turn:
                _rise(key, cost, node, count, f_key, reached, to)
                count += 1
                continue
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
    counts[0], counts[1], counts[2], counts[3], counts[4] = count, used, spare, waiting, turn
    counts[5], counts[6], counts[7] = found, expansions, pushes
    bests[0], bests[1] = best, best_key
    return ended


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
                reached = d + move_cost(a, b, k, lengths, terrain)
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
                reached = d + move_cost(b, a, k, lengths, terrain)
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


@njit(cache=True, nogil=True)
def nearest_in_ball(labels, label, first, inner, pad, strides, basis, rows, point, place, radius, any_one):
    """Return the cell of a component that is nearest to a point, and its distance; -1 if none is in the ball.

    Goes through the rows of the window (lines along the last index) in the order of the flat array,
    on each only through the part in the ball, which shrinks with what is found. With ``any_one``
    the first cell in the ball is returned, which is the lowest.

    Args:
        labels: (size,) int32 component of each cell.
        label: the one wanted.
        first: (n,) index of the first inner cell.
        inner: (n,) inner cells along each index.
        pad: (n,) width of the padding.
        strides: (n,).
        basis: (n, n) of the lattice, columns.
        rows: (n,) lengths of the rows of the inverse basis.
        point: (n,) metres.
        place: (n,) the point in index coordinates.
        radius: metres.
        any_one: the first found will do.
    """
    n = strides.shape[0]
    last = n - 1
    low = np.empty(last, np.int64)
    wide = np.empty(last, np.int64)
    total = np.int64(1)
    for i in range(last):
        reach = rows[i] * radius * (1.0 + 1e-9) + 1e-6
        begin = max(np.ceil(place[i] - reach), float(first[i]))
        end = min(np.floor(place[i] + reach), float(first[i] + inner[i] - 1))
        if begin > end:
            return np.int64(-1), np.inf
        low[i] = np.int64(begin)
        wide[i] = np.int64(end) - low[i] + 1
        total *= wide[i]
    along = 0.0
    for j in range(n):
        along += basis[j, last] * basis[j, last]
    from_point = np.empty(n, np.float64)
    best = radius * radius
    found = np.int64(-1)
    for row in range(total):
        rest = row
        flat = pad[last]
        for j in range(n):
            from_point[j] = -point[j]
        for i in range(last - 1, -1, -1):
            x = rest % wide[i]
            rest //= wide[i]
            x += low[i]
            flat += (x - first[i] + pad[i]) * strides[i]
            for j in range(n):
                from_point[j] += basis[j, i] * x
        # The row's points are from_point + t times the last basis vector; the nearest is at t = foot.
        foot = 0.0
        for j in range(n):
            foot -= from_point[j] * basis[j, last]
        foot /= along
        across = 0.0
        for j in range(n):
            v = from_point[j] + foot * basis[j, last]
            across += v * v
        half = best * (1.0 + 1e-9) - across
        if half < 0.0:
            continue
        half = np.sqrt(half / along) + 1e-6
        begin = max(np.ceil(foot - half), float(first[last]))
        end = min(np.floor(foot + half), float(first[last] + inner[last] - 1))
        if begin > end:
            continue
        for t in range(np.int64(begin), np.int64(end) + 1):
            if labels[flat + t - first[last]] != label:
                continue
            square = 0.0
            for j in range(n):
                v = from_point[j] + basis[j, last] * t
                square += v * v
            if square < best or (square == best and found < 0):
                best = square
                found = flat + t - first[last]
                if any_one:
                    return found, np.sqrt(best)
    return found, np.sqrt(best)
