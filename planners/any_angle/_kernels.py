"""Numba kernels of the any-angle planner: line of sight on any lattice, lazy Theta*, and making paths taut.

Which cells a segment from 0 to v touches depends on v alone. The Voronoi cell V of every lattice of
the plane and of space is a zonotope, the sum of the segments z_e / 2 to -z_e / 2 (Fedorov), and the cell around
c != 0, v is touched exactly if

* c lies in the shadow of V along v: |det(c, z_e, v)| <= sum over d of |det(z_d, z_e, v)| / 2 for all e (in the
  plane |det(c, v)| <= sum over d of |det(z_d, v)| / 2), and
* 0 < c G v < v G v: a point t v of the closed cell of c is no nearer to 0 than to c, so that
  2 t (c G v) >= c G c, and the same from the other end.

So the touched cells of a layer across v are the lattice points of one polygon that moves along, and a
row of them is an interval. There are no ties to break and no steps that add up rounding errors.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit

from planners.search._shared_kernels import drop_top, may_move, rise

SEEN = np.uint8(1)  # has a g, perhaps by a parent that does not see it
SURE = np.uint8(2)  # its parent is known to see it
DONE = np.uint8(4)  # expanded with its present g
EXPANDED = np.uint8(8)  # expanded once: its g never rises
SHIFT = 2  # blocks of rooms are 4 cells wide
CHECK = 4  # layers until the room is looked up again where there was none
SLIDES = 1000  # of one turning cell in a row
_BETTER = 1.0 - 1e-12  # less of a gain is none


@njit(cache=True, nogil=True)
def walk(view, free, room, at, v, values, alike, out):
    """Look at the cells that the segment from the cell ``at`` to ``at + v`` touches, the ends included.

    Args:
        view: the lattice and the window (see ``planners.any_angle.theta_star.View``).
        free: (size,) states.
        room: what :func:`rooms` returned, or empty: where it is wide, cells are not looked at one by one.
        at: (n,) the start in window coordinates.
        v: (n,) way to the end, which lies in the window as well.
        values: (size,) or empty; a cell is as good as not free where it differs from ``alike``.
        alike: that value.
        out: flat cells are written here if it has any room; it must have enough.

    Returns:
        the number of cells (and entries of ``room``) looked at, negative where the last of them is not free.
    """
    strides = view.strides
    generators = view.generators
    work = view.work
    n = strides.shape[0]
    count = generators.shape[0]
    base = np.int64(0)
    major = 0
    for i in range(n):
        base += at[i] * strides[i]
        if abs(v[i]) > abs(v[major]):
            major = i
    listing = out.shape[0] > 0
    compare = values.shape[0] > 0
    long = v[major]
    if long == 0:
        if listing:
            out[0] = base
        if free[base] == 0 or (compare and values[base] != alike):
            return -1
        return 1
    inner = n - 1 if major != n - 1 else n - 2
    middle = 3 - major - inner if n == 3 else inner
    grow = 1.0 + view.touch
    slope_inner = v[inner] / long
    slope_middle = 0.0
    reach_middle = 0.0
    stride_middle = np.int64(0)
    strips = 0
    if n == 2:
        total = 0.0
        for e in range(count):
            total += abs(generators[e, inner] - generators[e, major] * slope_inner)
        work[0, 0] = 0.0
        work[1, 0] = 0.5 * total * grow
        strips = 1
    else:
        slope_middle = v[middle] / long
        stride_middle = strides[middle]
        total = 0.0
        for e in range(count):
            total += abs(generators[e, middle] - generators[e, major] * slope_middle)
        reach_middle = 0.5 * total * grow
        for e in range(count):
            # The shadow's side along z_e, in coordinates of the layer.
            z_middle = generators[e, middle] - generators[e, major] * slope_middle
            z_inner = generators[e, inner] - generators[e, major] * slope_inner
            if abs(z_middle) <= 1e-9 * reach_middle:
                continue  # along the row, where reach_middle bounds, or along v
            total = 0.0
            for d in range(count):
                y = generators[d, middle] - generators[d, major] * slope_middle
                x = generators[d, inner] - generators[d, major] * slope_inner
                total += abs(x * z_middle - y * z_inner)
            work[0, strips] = z_inner / z_middle
            work[1, strips] = 0.5 * total * grow / abs(z_middle)
            strips += 1
    total = 0.0
    for e in range(count):
        total += abs(generators[e, inner] - generators[e, major] * slope_inner)
    spread = np.int64(np.ceil(max(reach_middle, 0.5 * total) + 0.51))
    skipping = room.shape[0] > 0 and not listing and not compare
    least = view.least
    vgv = 0.0
    rate_major = 0.0
    rate_middle = 0.0
    rate_inner = 0.0
    for i in range(n):
        rate = 0.0
        for k in range(n):
            rate += view.gram[i, k] * v[k]
        vgv += rate * v[i]
        if i == major:
            rate_major = rate
        elif i == inner:
            rate_inner = rate
        else:
            rate_middle = rate
    step = 1 if long > 0 else -1
    length = abs(long)
    margin = np.int64(np.floor(view.reach[major] + 1e-6))
    seen = 0
    stride_major = strides[major]
    stride_inner = strides[inner]
    at_major = at[major]
    at_inner = at[inner]
    at_middle = at[middle] if n == 3 else np.int64(0)
    block_major = view.block_strides[major]
    block_inner = view.block_strides[inner]
    block_middle = view.block_strides[middle] if n == 3 else np.int64(0)
    layer = -margin
    check = np.int64(0)
    while layer <= length + margin:
        i = layer * step
        if skipping and check <= layer <= length:
            block = ((at_major + i) >> SHIFT) * block_major
            block += ((at_inner + np.int64(np.floor(i * slope_inner + 0.5))) >> SHIFT) * block_inner
            if n == 3:
                block += ((at_middle + np.int64(np.floor(i * slope_middle + 0.5))) >> SHIFT) * block_middle
            seen += 1
            # All cells this far along each index are free, and the line strays by no more than it advances.
            skip = ((np.int64(room[block]) - 1) << SHIFT) - spread
            if skip >= 0:
                layer += skip + 1
                continue
            check = layer + CHECK
        layer += 1
        near_end = layer <= margin + 1 or layer > length - margin
        centre_middle = i * slope_middle
        centre_inner = i * slope_inner
        first = np.int64(np.ceil(centre_middle - reach_middle))
        for j in range(first, np.int64(np.floor(centre_middle + reach_middle)) + 1):
            y = j - centre_middle
            low = -np.inf
            high = np.inf
            for s in range(strips):
                x = work[0, s] * y
                low = max(low, x - work[1, s])
                high = min(high, x + work[1, s])
            flat = base + i * stride_major + j * stride_middle
            start = np.int64(np.ceil(centre_inner + low))
            for k in range(start, np.int64(np.floor(centre_inner + high)) + 1):
                if near_end and not (i == 0 and k == 0 and j == 0):
                    q = i * rate_major + j * rate_middle + k * rate_inner
                    end = i == long and k == v[inner] and (n == 2 or j == v[middle])
                    if (q < least or q > vgv - least) and not end:
                        continue
                if view.guard:
                    inside = (
                        0 <= at_major + i < view.shape[major]
                        and 0 <= at_inner + k < view.shape[inner]
                        and (n == 2 or 0 <= at_middle + j < view.shape[middle])
                    )
                    if not inside:
                        return -seen - 1
                cell = flat + k * stride_inner
                if listing:
                    out[seen] = cell
                seen += 1
                if free[cell] == 0 or (compare and values[cell] != alike):
                    return -seen
    return seen


@njit(cache=True, nogil=True)
def rooms(view, free):
    """Return for each block of cells, 4 along each index, how far the nearest block with a cell that is not free is.

    Counted in blocks, diagonal steps as one, 254 at most, 0 for such a block itself; in ``view.block_strides``
    the blocks lie in memory.
    """
    n = view.strides.shape[0]
    layers = view.shape[0] if n == 3 else np.int64(1)
    rows = view.shape[n - 2]
    columns = view.shape[n - 1]
    deep = (layers + 3) >> SHIFT
    high = (rows + 3) >> SHIFT
    wide = (columns + 3) >> SHIFT
    out = np.full(deep * high * wide, 254, np.uint8)
    for x in range(layers):
        for y in range(rows):
            line = ((x >> SHIFT) * high + (y >> SHIFT)) * wide
            begin = (x * rows + y) * columns
            for z in range(columns):
                if free[begin + z] == 0:
                    out[line + (z >> SHIFT)] = 0
    # What lies before a block in the order of memory, then what lies behind (Rosenfeld and Pfaltz, 1968).
    for sweep in range(2):
        for m in range(out.shape[0]):
            at = m if sweep == 0 else out.shape[0] - 1 - m
            least = np.int64(out[at])
            if least == 0:
                continue
            z = at % wide
            y = (at // wide) % high
            x = at // (wide * high)
            for dx in range(-1, 2):
                for dy in range(-1, 2):
                    for dz in range(-1, 2):
                        other = (dx * high + dy) * wide + dz
                        if (other >= 0) != (sweep == 1) or other == 0:
                            continue
                        if 0 <= x + dx < deep and 0 <= y + dy < high and 0 <= z + dz < wide:
                            least = min(least, np.int64(out[at + other]) + 1)
                        elif n == 3 or dx == 0:
                            least = min(least, 1)  # outside nothing is free
            out[at] = least
    return out


@njit(cache=True, nogil=True)
def sights(view, free, room, starts, ends, inside, out):
    """Write for each pair of ``starts`` and ``ends`` (M, n), window coordinates, whether one sees the other.

    Returns:
        the number of cells looked at.
    """
    n = starts.shape[1]
    v = np.empty(n, np.int64)
    none = np.empty(0, np.float64)
    nowhere = np.empty(0, np.int64)
    scanned = 0
    for m in range(starts.shape[0]):
        if not inside[m]:
            continue
        for i in range(n):
            v[i] = ends[m, i] - starts[m, i]
        seen = walk(view, free, room, starts[m], v, none, 0.0, nowhere)
        scanned += abs(seen)
        out[m] = seen > 0
    return scanned


@njit(cache=True, nogil=True)
def place(strides, flat, out):
    """Write the window coordinates of a flat cell."""
    rest = flat
    for i in range(strides.shape[0] - 1):
        x = rest // strides[i]
        out[i] = x
        rest -= x * strides[i]
    out[strides.shape[0] - 1] = rest


@njit(cache=True, nogil=True)
def between(view, a, b, at, v):
    """Return the distance of the flat cells ``a`` and ``b``, metres; write the place of ``a`` and the way to ``b``."""
    n = view.strides.shape[0]
    place(view.strides, b, v)
    place(view.strides, a, at)
    for i in range(n):
        v[i] -= at[i]
    return norm(view.basis, v)


@njit(cache=True, nogil=True)
def norm(basis, v):
    """Return the length of the way ``v`` (n,) in index coordinates, metres."""
    n = v.shape[0]
    total = 0.0
    for r in range(n):
        x = 0.0
        for c in range(n):
            x += basis[r, c] * v[c]
        total += x * x
    return np.sqrt(total)


@njit(cache=True, nogil=True)
def search(
    view, free, offsets, lengths, steps, swept_starts, swept, start, goal, scale, lazy, g, parent, mark, counts
):  # fmt: skip
    """Search from ``start`` to ``goal`` by Theta*; return whether there is a path, written in ``parent``.

    A cell is reached from its neighbour's parent if that sees it, else from the neighbour (Nash and
    others, 2007); whether it does is looked up when the cell is expanded (lazily; Nash, Koenig and
    Tovey, 2010). A cell that has been expanded is only ever reached anew by a line that is free, and
    then expanded again. So g of expanded cells never rises, every neighbour of an expanded cell has
    an entry of at most g + the move, and the argument for A* holds: the path is at most as long as the
    shortest one of moves.

    Args:
        view: see :func:`walk`.
        free: the graph's cells (size,).
        offsets: its moves (K,).
        lengths: their lengths (K,), metres.
        steps: (K, n) the moves, metres.
        swept_starts: (K + 1,) where the cells that a move sweeps begin.
        swept: (S,) those cells.
        start: flat cell.
        goal: flat cell.
        scale: keys a metre.
        lazy: whether lines are looked along late.
        g: (size,) float64, written where ``mark`` is.
        parent: (size,) int32, the same.
        mark: (size,) uint8, zero.
        counts: (4,) int64: expansions, pushes, lines of sight, cells looked at on them.
    """
    n = view.strides.shape[0]
    moves = offsets.shape[0]
    key = np.empty(1024, np.float64)
    cost = np.empty(1024, np.float64)
    node = np.empty(1024, np.int64)
    at = np.empty(n, np.int64)
    v = np.empty(n, np.int64)
    ahead = np.empty(n, np.float64)
    behind = np.empty(n, np.float64)
    none = np.empty(0, np.float64)
    nowhere = np.empty(0, np.int64)
    room = np.empty(0, np.uint8)
    tried = np.empty(moves + 1, np.int64)
    g[start] = 0.0
    parent[start] = start
    mark[start] = SEEN | SURE
    key[0] = np.floor(between(view, start, goal, at, v) * scale + 0.5)
    cost[0] = 0.0
    node[0] = start
    count = 1
    expansions = 0
    pushes = 1
    looks = 0
    scanned = 0
    found = False
    while count > 0:
        a = node[0]
        d = cost[0]
        count = drop_top(key, cost, node, count)
        if d != g[a] or (mark[a] & DONE) != 0:
            continue
        if count + moves + 1 > key.shape[0]:
            key = np.append(key, np.empty_like(key))
            cost = np.append(cost, np.empty_like(cost))
            node = np.append(node, np.empty_like(node))
        # Worth making once as many cells have been looked at as it takes.
        if room.shape[0] == 0 and scanned > free.shape[0] >> 2:
            room = rooms(view, free)
        if (mark[a] & SURE) == 0:
            before = np.int64(parent[a])
            between(view, before, a, at, v)
            seen = walk(view, free, room, at, v, none, 0.0, nowhere)
            looks += 1
            scanned += abs(seen)
            mark[a] |= SURE
            if seen < 0:
                best = np.inf
                for k in range(moves):
                    b = a - offsets[k]
                    if (mark[b] & EXPANDED) == 0 or g[b] + lengths[k] >= best:
                        continue
                    if may_move(free, b, k, offsets, swept_starts, swept):
                        best = g[b] + lengths[k]
                        parent[a] = b
                tried[0] = before
                many = 1
                for k in range(moves):
                    b = a - offsets[k]
                    if (mark[b] & EXPANDED) == 0:
                        continue
                    p = np.int64(parent[b])
                    known = False
                    for i in range(many):
                        known = known or tried[i] == p
                    if known:
                        continue
                    tried[many] = p
                    many += 1
                    reached = g[p] + between(view, p, a, at, v)
                    if reached < best * _BETTER:
                        seen = walk(view, free, room, at, v, none, 0.0, nowhere)
                        looks += 1
                        scanned += abs(seen)
                        if seen > 0:
                            best = reached
                            parent[a] = p
                g[a] = best
                h = np.floor((best + between(view, a, goal, at, v)) * scale + 0.5)
                if count > 0 and h > key[0]:
                    rise(key, cost, node, count, h, best, a)
                    count += 1
                    pushes += 1
                    continue
        mark[a] |= DONE | EXPANDED
        expansions += 1
        if a == goal:
            found = True
            break
        p = np.int64(parent[a])
        base = g[p]
        between(view, p, a, at, v)
        for r in range(n):
            behind[r] = 0.0
            for c in range(n):
                behind[r] += view.basis[r, c] * v[c]
        between(view, a, goal, at, v)
        for r in range(n):
            ahead[r] = 0.0
            for c in range(n):
                ahead[r] += view.basis[r, c] * v[c]
        d = g[a]
        for k in range(moves):
            b = a + offsets[k]
            if free[b] == 0 or b == p:
                continue
            total = 0.0
            for r in range(n):
                x = behind[r] + steps[k, r]
                total += x * x
            reached = base + np.sqrt(total)
            old = mark[b]
            if old != 0 and reached >= g[b] * _BETTER:
                continue
            if not may_move(free, a, k, offsets, swept_starts, swept):
                continue
            by = p
            if not lazy or (old & SURE) != 0:
                between(view, p, b, at, v)
                seen = walk(view, free, room, at, v, none, 0.0, nowhere)
                looks += 1
                scanned += abs(seen)
                if seen < 0:
                    by = a
                    reached = d + lengths[k]
                    if old != 0 and reached >= g[b] * _BETTER:
                        continue
                mark[b] = SEEN | SURE | (old & EXPANDED)
            else:
                mark[b] = SEEN
            g[b] = reached
            parent[b] = by
            total = 0.0
            for r in range(n):
                x = ahead[r] - steps[k, r]
                total += x * x
            rise(key, cost, node, count, np.floor((reached + np.sqrt(total)) * scale + 0.5), reached, b)
            count += 1
            pushes += 1
    counts[0] = expansions
    counts[1] = pushes
    counts[2] = looks
    counts[3] = scanned
    return found


@njit(cache=True, nogil=True)
def follow(parent, at):
    """Return the flat cells from the start to ``at``."""
    out = np.empty(64, np.int64)
    out[0] = at
    count = 1
    while parent[at] != at:
        at = np.int64(parent[at])
        if count == out.shape[0]:
            out = np.append(out, np.empty(count, np.int64))
        out[count] = at
        count += 1
    return out[:count][::-1].copy()


@njit(cache=True, nogil=True)
def _sees(view, free, a, b, at, v, counts):
    """Tell whether the flat cell ``a`` sees ``b``; ``counts`` (4,) as of :func:`search`."""
    nothing = np.empty(0, np.uint8)
    none = np.empty(0, np.float64)
    nowhere = np.empty(0, np.int64)
    between(view, a, b, at, v)
    seen = walk(view, free, nothing, at, v, none, 0.0, nowhere)
    counts[2] += 1
    counts[3] += abs(seen)
    return seen > 0


@njit(cache=True, nogil=True)
def _pull(view, free, way, window, at, v, counts):
    """Return the shortest way through a subset of ``way`` (M,) that leaves out less than ``window`` cells in a row."""
    m = way.shape[0]
    cost = np.empty(m, np.float64)
    last = np.empty(m, np.int64)
    cost[0] = 0.0
    last[0] = 0
    for j in range(1, m):
        cost[j] = cost[j - 1] + between(view, way[j - 1], way[j], at, v)
        last[j] = j - 1
        for i in range(max(j - window, 0), j - 1):
            straight = cost[i] + between(view, way[i], way[j], at, v)
            if straight < cost[j] * _BETTER and _sees(view, free, way[i], way[j], at, v, counts):
                cost[j] = straight
                last[j] = i
    count = 1
    j = m - 1
    while j > 0:
        j = last[j]
        count += 1
    out = np.empty(count, np.int64)
    j = m - 1
    for i in range(count - 1, -1, -1):
        out[i] = way[j]
        j = last[j]
    return out


@njit(cache=True, nogil=True)
def _slide(view, free, way, near, at, v, counts):
    """Move each inner cell of ``way`` (M,) by the flat offsets ``near`` (K,) as long as that shortens."""
    for i in range(1, way.shape[0] - 1):
        p = way[i - 1]
        r = way[i + 1]
        for _ in range(SLIDES):
            q = way[i]
            least = (between(view, p, q, at, v) + between(view, q, r, at, v)) * _BETTER
            best = q
            for k in range(near.shape[0]):
                b = q + near[k]
                if free[b] == 0 or b in (p, r):
                    continue
                length = between(view, p, b, at, v) + between(view, b, r, at, v)
                if length < least and _sees(view, free, p, b, at, v, counts) and _sees(view, free, b, r, at, v, counts):
                    least = length
                    best = b
            if best == q:
                break
            way[i] = best


@njit(cache=True, nogil=True)
def _part(view, a, b, share, at, v):
    """Return the flat cell whose index is nearest to a ``share`` of the way from ``a`` to ``b``."""
    between(view, a, b, at, v)
    cell = a
    for i in range(v.shape[0]):
        cell += np.int64(np.floor(share * v[i] + 0.5)) * view.strides[i]
    return cell


@njit(cache=True, nogil=True)
def _cut(view, free, way, at, v, counts):
    """Return ``way`` (M,) with its corners cut, by two cells on the legs for one, where that is free and shorter."""
    out = np.empty(2 * way.shape[0], np.int64)
    out[0] = way[0]
    count = 1
    for i in range(1, way.shape[0] - 1):
        p = out[count - 1]
        q = way[i]
        r = way[i + 1]
        length = between(view, p, q, at, v) + between(view, q, r, at, v)
        share = 0.5
        done = False
        while share > 0.01 and not done:
            for variant in range(3):
                x = q if variant == 2 else _part(view, q, p, share, at, v)
                y = q if variant == 1 else _part(view, q, r, share, at, v)
                if free[x] == 0 or free[y] == 0 or x in (y, p) or y == r:
                    continue
                new = between(view, p, x, at, v) + between(view, x, y, at, v) + between(view, y, r, at, v)
                if new >= length * _BETTER:
                    continue
                if (
                    _sees(view, free, x, y, at, v, counts)
                    and _sees(view, free, p, x, at, v, counts)
                    and _sees(view, free, y, r, at, v, counts)
                ):
                    out[count] = x
                    out[count + 1] = y
                    count += 2
                    done = True
                    break
            share *= 0.5
        if not done:
            out[count] = q
            count += 1
    out[count] = way[way.shape[0] - 1]
    return out[: count + 1].copy()


@njit(cache=True, nogil=True)
def tighten(view, free, way, near, rounds, window, counts):
    """Return ``way`` (M,) made shorter: cells left out, moved to neighbours, and corners cut, until nothing helps.

    Args:
        view: see :func:`walk`.
        free: the graph's cells (size,).
        way: flat turning cells, each of which sees the next.
        near: flat offsets of the cells that a turning cell may slide to.
        rounds: at most.
        window: cells left out in a row are fewer.
        counts: as of :func:`search`; raised.
    """
    n = view.strides.shape[0]
    at = np.empty(n, np.int64)
    v = np.empty(n, np.int64)
    way = _pull(view, free, way, window, at, v, counts)
    for _ in range(rounds):
        if way.shape[0] < 3:
            break
        before = 0.0
        for i in range(way.shape[0] - 1):
            before += between(view, way[i], way[i + 1], at, v)
        way = _cut(view, free, way, at, v, counts)
        _slide(view, free, way, near, at, v, counts)
        way = _pull(view, free, way, window, at, v, counts)
        after = 0.0
        for i in range(way.shape[0] - 1):
            after += between(view, way[i], way[i + 1], at, v)
        if after >= before * _BETTER:
            break
    return way


@njit(cache=True, nogil=True)
def touched(view, free, a, b):
    """Return the flat cells that the segment between the flat cells ``a`` and ``b`` touches; it is free."""
    n = view.strides.shape[0]
    at = np.empty(n, np.int64)
    v = np.empty(n, np.int64)
    nothing = np.empty(0, np.uint8)
    none = np.empty(0, np.float64)
    between(view, a, b, at, v)
    out = np.empty(abs(walk(view, free, nothing, at, v, none, 0.0, np.empty(0, np.int64))), np.int64)
    walk(view, free, nothing, at, v, none, 0.0, out)
    return out


@njit(cache=True, nogil=True)
def farthest(view, free, terrain, way, so_far, first):
    """Return the last cell of ``way`` (M,) up to which the cell ``first`` sees every one, and the length to it.

    With terrain, (size,) or empty, it counts as seen only across its own kind, and a line only where it
    costs no more than the way, whose cost up to each cell is ``so_far`` (M,).
    """
    n = view.strides.shape[0]
    at = np.empty(n, np.int64)
    v = np.empty(n, np.int64)
    nothing = np.empty(0, np.uint8)
    nowhere = np.empty(0, np.int64)
    alike = terrain[way[first]] if terrain.shape[0] > 0 else 1.0
    best = first + 1
    best_cost = so_far[first + 1] - so_far[first]
    for j in range(first + 2, way.shape[0]):
        straight = between(view, way[first], way[j], at, v) * alike
        if walk(view, free, nothing, at, v, terrain, alike, nowhere) < 0:
            break
        if straight <= (so_far[j] - so_far[first]) * (1.0 + 1e-12):
            best = j
            best_cost = straight
    return best, best_cost
