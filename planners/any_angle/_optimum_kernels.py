"""Field of view, taut visibility graph and A* of the any-angle optimum.

Coordinates here: the padded cell (x, y), stored at [y, x], spans x..x+1, y..y+1, so that corners
are integers. All decisions are signs of cross products in float64: without a rounding error for
corners, cell centres and whatever has at most 14 binary digits behind the point.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit

from planners.search._shared_kernels import drop_top, rise

# A leg from or to a point that is no short binary fraction may be off by a rounding error; letting a
# turn pass that is not quite taut adds a longer path to choose from, never a wrong one.
_SLACK = 1e-9


@njit(cache=True, nogil=True)
def tables(free):
    """Return per cell the ends of its run of equal cells in the row, and the convex corners in the order of (y, x)."""
    height, width = free.shape
    low = np.empty((height, width), np.int32)
    high = np.empty((height, width), np.int32)
    for y in range(height):
        for x in range(width):
            low[y, x] = low[y, x - 1] if x > 0 and free[y, x] == free[y, x - 1] else x
        for x in range(width - 1, -1, -1):
            high[y, x] = high[y, x + 1] if x < width - 1 and free[y, x] == free[y, x + 1] else x + 1
    first = np.zeros((height + 1, width + 1), np.int32)
    count = 0
    for y in range(height + 1):
        for x in range(width + 1):
            first[y, x] = count
            if (
                0 < y < height
                and 0 < x < width
                and free[y - 1, x - 1] + free[y - 1, x] + free[y, x - 1] + free[y, x] == 3
            ):
                count += 1
    corners = np.empty((count, 4), np.int32)
    count = 0
    for y in range(1, height):
        for x in range(1, width):
            if free[y - 1, x - 1] + free[y - 1, x] + free[y, x - 1] + free[y, x] == 3:
                corners[count, 0] = x
                corners[count, 1] = y
                # Where its one blocked cell lies.
                corners[count, 2] = 1 if free[y, x] == 0 or free[y - 1, x] == 0 else -1
                corners[count, 3] = 1 if free[y, x] == 0 or free[y, x - 1] == 0 else -1
                count += 1
    return low, high, first, corners


@njit(cache=True, nogil=True)
def run_at(free, y, x):
    """Return a free cell of row ``y`` that has the abscissa ``x`` in its closed span, or -1."""
    c = int(np.floor(x))
    if free[y, c] != 0:
        return c
    if c == x and free[y, c - 1] != 0:
        return c - 1
    return -1


@njit(cache=True, nogil=True)
def look_along(free, first, corners, ax, ay, way, out, count):
    """Append the corners seen along the lattice line through the point, to the right (1) or left (-1)."""
    y = int(ay)
    # The cells between x and the next lattice abscissa on the way.
    cell = int(np.floor(ax)) if way > 0 else int(np.ceil(ax)) - 1
    above = free[y, cell]
    below = free[y - 1, cell]
    while above != 0 or below != 0:
        x = cell + 1 if way > 0 else cell
        v = first[y, x]
        if v < corners.shape[0] and corners[v, 0] == x and corners[v, 1] == y:
            out[count] = v
            count += 1
        cell += way
        # At a double corner neither side goes on.
        above &= free[y, cell]
        below &= free[y - 1, cell]
        if above != 0 or below != 0:
            above = free[y, cell]
            below = free[y - 1, cell]
    return count


@njit(cache=True, nogil=True)
def look_across(free, low, high, first, corners, ax, ay, up, side, cones, runs, out, count):
    """Append the corners seen upwards (``up`` 1) or downwards (-1), of the left (-1), right (1) or both (0) quadrants.

    Row by row: the part of the row's free run that is seen is a closed cone between two directions,
    each through a corner of the map. The next row's runs that share more than a point with this one
    get their parts of the cone; a shared point is a double corner.
    """
    row = int(np.floor(ay)) if up > 0 else int(np.ceil(ay)) - 1
    c = run_at(free, row, ax)
    if c < 0:
        return count
    h = float(row + 1) - ay if up > 0 else ay - float(row)
    cones[0, 0] = float(low[row, c]) - ax if side <= 0 else 0.0
    cones[0, 1] = h
    cones[0, 2] = float(high[row, c]) - ax if side >= 0 else 0.0
    cones[0, 3] = h
    runs[0, 0] = row
    runs[0, 1] = c
    size = 1
    while size > 0:
        size -= 1
        lx = cones[size, 0]
        ly = cones[size, 1]
        rx = cones[size, 2]
        ry = cones[size, 3]
        row = runs[size, 0]
        c = runs[size, 1]
        a = low[row, c]
        b = high[row, c]
        line = row + 1 if up > 0 else row
        h = abs(float(line) - ay)
        x = max(int(np.floor(ax + h * lx / ly)) - 1, a)
        v = first[line, x]
        end = first[line, b + 1] if b + 1 < first.shape[1] else first[line + 1, 0]
        while v < end:
            px = float(corners[v, 0]) - ax
            if rx * h - ry * px < 0.0:
                break
            if lx * h - ly * px <= 0.0:
                out[count] = v
                count += 1
            v += 1
        row += up
        while x < b:
            if free[row, x] != 0:
                a2 = low[row, x]
                b2 = high[row, x]
                px = float(max(a, a2)) - ax
                if rx * h - ry * px < 0.0:
                    break
                mx = lx
                my = ly
                if mx * h - my * px < 0.0:
                    mx = px
                    my = h
                px = float(a2) - ax
                if mx * (h + 1.0) - my * px < 0.0:
                    mx = px
                    my = h + 1.0
                nx = rx
                ny = ry
                px = float(min(b, b2)) - ax
                if nx * h - ny * px > 0.0:
                    nx = px
                    ny = h
                px = float(b2) - ax
                if nx * (h + 1.0) - ny * px > 0.0:
                    nx = px
                    ny = h + 1.0
                if mx * ny - my * nx <= 0.0:
                    cones[size, 0] = mx
                    cones[size, 1] = my
                    cones[size, 2] = nx
                    cones[size, 3] = ny
                    runs[size, 0] = row
                    runs[size, 1] = x
                    size += 1
            x = high[row, x]
    return count


@njit(cache=True, nogil=True)
def look_round(free, low, high, first, corners, ax, ay, cones, runs, out):
    """Write the corners seen from any point into ``out``, of those at which a path could turn; return their number."""
    count = 0
    for way in range(-1, 2, 2):
        count = look_across(free, low, high, first, corners, ax, ay, way, 0, cones, runs, out, count)
        if np.floor(ay) == ay:
            count = look_along(free, first, corners, ax, ay, way, out, count)
    kept = 0
    for i in range(count):
        v = out[i]
        dx = (float(corners[v, 0]) - ax) * corners[v, 2]
        dy = (float(corners[v, 1]) - ay) * corners[v, 3]
        if not ((dx > _SLACK and dy > _SLACK) or (dx < -_SLACK and dy < -_SLACK)):
            out[kept] = v
            kept += 1
    return kept


@njit(cache=True, nogil=True)
def sees(free, low, high, ax, ay, bx, by):
    """Tell whether the leg between two points of the closed free cells stays in them and crosses no double corner."""
    if by < ay:
        ax, ay, bx, by = bx, by, ax, ay
    if ay == by:
        if ax > bx:
            ax, bx = bx, ax
        y = int(np.floor(ay))
        last = int(np.ceil(bx)) - 1
        if y != ay:
            c = run_at(free, y, ax)
            return c >= 0 and high[y, c] >= bx
        cell = int(np.floor(ax))
        above = free[y, cell]
        below = free[y - 1, cell]
        while (above != 0 or below != 0) and cell < last:
            cell += 1
            above &= free[y, cell]
            below &= free[y - 1, cell]
            if above != 0 or below != 0:
                above = free[y, cell]
                below = free[y - 1, cell]
        return above != 0 or below != 0
    dx = bx - ax
    dy = by - ay
    row = int(np.floor(ay))
    last = int(np.ceil(by)) - 1
    c = run_at(free, row, ax)
    if c < 0:
        return False
    a = low[row, c]
    b = high[row, c]
    while row < last:
        row += 1
        h = float(row) - ay
        x = int(np.floor(ax + h * dx / dy))
        found = False
        for c in range(max(x - 1, 0), min(x + 2, free.shape[1])):
            if free[row, c] == 0:
                continue
            left = max(a, low[row, c])
            right = min(b, high[row, c])
            if left < right and dx * h - dy * (float(left) - ax) >= 0.0 and dx * h - dy * (float(right) - ax) <= 0.0:
                a = low[row, c]
                b = high[row, c]
                found = True
                break
        if not found:
            return False
    return a <= bx <= b


@njit(cache=True, nogil=True)
def link(free, low, high, first, corners, begin, end, cones, runs):
    """Return the taut neighbours of the corners ``begin``..``end``: their ends by corner and side, and they.

    With x and y turned so that a corner's blocked cell lies in the first quadrant, a path turns at
    it by coming and leaving in the fourth (side 0, to the left) or by both in the second (side 1).
    The neighbours of a side are in the order of their angle from the wall: from the sharpest turn.
    """
    ends = np.empty((end - begin, 2), np.int64)
    out = np.empty(corners.shape[0], np.int32)
    kept = np.empty(max(1024, 8 * (end - begin)), np.int32)
    key = np.empty(corners.shape[0])
    cost = np.empty(corners.shape[0])
    node = np.empty(corners.shape[0], np.int32)
    total = 0
    for u in range(begin, end):
        ax = float(corners[u, 0])
        ay = float(corners[u, 1])
        qx = np.int64(corners[u, 2])
        qy = np.int64(corners[u, 3])
        for side in range(2):
            up = -qy if side == 0 else qy
            across = qx if side == 0 else -qx
            count = look_across(free, low, high, first, corners, ax, ay, up, across, cones, runs, out, 0)
            if side == 0:
                count = look_along(free, first, corners, ax, ay, qx, out, count)
            good = 0
            for i in range(count):
                v = out[i]
                dx = corners[v, 0] - corners[u, 0]
                dy = corners[v, 1] - corners[u, 1]
                if (side == 0 and dx == 0) or (side == 1 and dy == 0):
                    continue
                ex = dx * corners[v, 2]
                ey = dy * corners[v, 3]
                if (ex >= 0 and ey < 0) or (ex < 0 and ey >= 0):
                    far = float(abs(dx) + abs(dy))
                    rise(key, cost, node, good, float(abs(dy if side == 0 else dx)) / far, -far, v)
                    good += 1
            if total + good > kept.shape[0]:
                more = np.empty(2 * (total + good), np.int32)
                for i in range(total):
                    more[i] = kept[i]
                kept = more
            while good > 0:
                kept[total] = node[0]
                total += 1
                good = drop_top(key, cost, node, good)
            ends[u - begin, side] = total
    return ends, kept[:total]


@njit(cache=True, nogil=True)
def bounds(ends, u, side):
    """Return where the neighbours of a corner and side begin and end."""
    if side > 0:
        return ends[u, 0], ends[u, 1]
    return ends[u - 1, 1] if u > 0 else 0, ends[u, 0]


@njit(cache=True, nogil=True)
def count_taut(corners, ends, near, u, v, side):
    """Return to how many of the neighbours of ``v`` a path from the corner ``u`` that arrives on ``side`` turns."""
    begin, end = bounds(ends, v, side)
    # The sign of the turn in the frame in which the blocked cell lies in the first quadrant.
    turned = corners[v, 2] * corners[v, 3] * (1 - 2 * side)
    dx = np.int64(corners[v, 0] - corners[u, 0]) * turned
    dy = np.int64(corners[v, 1] - corners[u, 1]) * turned
    low = begin
    while low < end:
        i = (low + end) >> 1
        w = near[i]
        if dx * (corners[w, 1] - corners[v, 1]) - dy * (corners[w, 0] - corners[v, 0]) > 0:
            low = i + 1
        else:
            end = i
    return low - begin


@njit(cache=True, nogil=True)
def arrival(corners, u, v):
    """Return the side on which the taut leg from the corner ``u`` comes to ``v``."""
    return 0 if (corners[v, 1] - corners[u, 1]) * corners[v, 3] < 0 else 1


@njit(cache=True, nogil=True)
def find_leg(corners, ends, near, v, side, u):
    """Return the place of ``u`` among the neighbours of ``v`` on ``side``, where it is."""
    begin, end = bounds(ends, v, side)
    turned = corners[v, 2] * corners[v, 3] * (1 - 2 * side)
    dx = np.int64(corners[u, 0] - corners[v, 0]) * turned
    dy = np.int64(corners[u, 1] - corners[v, 1]) * turned
    low = begin
    while low < end:
        i = (low + end) >> 1
        w = near[i]
        if dx * (corners[w, 1] - corners[v, 1]) - dy * (corners[w, 0] - corners[v, 0]) > 0:
            low = i + 1
        else:
            end = i
    while near[low] != u:
        low += 1
    return low


@njit(cache=True, nogil=True)
def find_endless(corners, ends, near):
    """Return which legs taut paths of any length can follow, 1 of each; the others (0) only lead into pockets.

    A leg is of no use but near the goal if no taut leg of use follows it (the levels of Oh and Leong).
    Both lists of a corner are in the order of the angle, so that the legs which arrive on a side
    lose their last continuation one after the other.
    """
    n = ends.shape[0]
    endless = np.ones(near.shape[0], np.uint8)
    first = np.zeros((n, 2), np.int32)  # neighbours of the side without use, from the sharpest turn
    gone = np.zeros((n, 2), np.int32)  # legs arriving on the side without use, from the last one
    waiting = np.ones((n, 2), np.uint8)
    stack = np.empty(2 * n, np.int64)
    for i in range(2 * n):
        stack[i] = i
    size = 2 * n
    while size > 0:
        size -= 1
        v = stack[size] >> 1
        side = stack[size] & 1
        waiting[v, side] = 0
        begin, end = bounds(ends, v, side)
        while begin + first[v, side] < end and endless[begin + first[v, side]] == 0:
            first[v, side] += 1
        back, back_end = bounds(ends, v, 1 - side)
        while back_end - gone[v, side] > back:
            u = near[back_end - gone[v, side] - 1]
            if count_taut(corners, ends, near, u, v, side) > first[v, side]:
                break
            gone[v, side] += 1
            # The way from u to v leaves u on the side on which the way back arrives.
            out = 1 - arrival(corners, v, u)
            endless[find_leg(corners, ends, near, u, out, v)] = 0
            if waiting[u, out] == 0:
                waiting[u, out] = 1
                stack[size] = 2 * u + out
                size += 1
    return endless


@njit(cache=True, nogil=True)
def mark_pockets(corners, ends, near, endless, tx, ty, seen, count, marked, stack):
    """Mark the corners and sides from which legs without use elsewhere lead to the goal, which ``seen`` see."""
    size = 0
    for i in range(count):
        v = seen[i]
        ex = (tx - corners[v, 0]) * corners[v, 2]
        ey = (ty - corners[v, 1]) * corners[v, 3]
        for side in range(2):
            if (ex >= -_SLACK and ey <= _SLACK) if side == 0 else (ex <= _SLACK and ey >= -_SLACK):
                marked[v, side] = 1
                stack[size] = 2 * v + side
                size += 1
    while size > 0:
        size -= 1
        v = stack[size] >> 1
        side = stack[size] & 1
        begin, end = bounds(ends, v, 1 - side)
        for i in range(begin, end):
            u = near[i]
            out = 1 - arrival(corners, v, u)
            if marked[u, out] == 0 and endless[find_leg(corners, ends, near, u, out, v)] == 0:
                marked[u, out] = 1
                stack[size] = 2 * u + out
                size += 1


@njit(cache=True, nogil=True)
def search(
    free, low, high, first, corners, ends, near, endless, sx, sy, tx, ty, cones, runs, g, last, via, out, marked, stack
):
    """Return at how many corners a shortest path between two points turns (-1: none), expansions and pushes.

    ``g`` and ``last`` (way to the goal from corners that see it) come infinite, ``via`` -1 and ``marked``
    zero; ``out`` takes the corners from the goal to the start.
    """
    if sees(free, low, high, sx, sy, tx, ty):
        return 0, 1, 0
    count = look_round(free, low, high, first, corners, tx, ty, cones, runs, out)
    for i in range(count):
        v = out[i]
        last[v] = np.sqrt((tx - corners[v, 0]) ** 2 + (ty - corners[v, 1]) ** 2)
    mark_pockets(corners, ends, near, endless, tx, ty, out, count, marked, stack)
    key = np.empty(1024)
    cost = np.empty(1024)
    node = np.empty(1024, np.int32)
    size = 0
    pushes = 0
    best = np.inf
    best_via = -1
    expansions = 1
    u = -1
    gu = 0.0
    ux = sx
    uy = sy
    count = look_round(free, low, high, first, corners, sx, sy, cones, runs, out)
    while True:
        # The corners to go to: all that the start sees, or the taut ones of one side.
        slack = 0.0
        px = 0.0
        py = 0.0
        side_from = 0
        side_to = 1
        if u >= 0:
            px = sx if via[u] < 0 else float(corners[via[u], 0])
            py = sy if via[u] < 0 else float(corners[via[u], 1])
            px = (ux - px) * corners[u, 2]
            py = (uy - py) * corners[u, 3]
            slack = _SLACK if via[u] < 0 else 0.0
            if px >= -slack and py <= slack:
                side_to = 2 if px <= slack and py >= -slack else 1
            else:
                side_from = 1
                side_to = 2
        for side in range(side_from, side_to):
            begin = 0
            end = count
            if u >= 0:
                begin, end = bounds(ends, u, side)
            for i in range(begin, end):
                v = near[i] if u >= 0 else out[i]
                ex = corners[v, 0] - ux
                ey = corners[v, 1] - uy
                if u >= 0:
                    turn = px * ey * corners[u, 3] - py * ex * corners[u, 2]
                    if side == 1:
                        turn = -turn
                    if turn <= -slack * (abs(px) + abs(py) + 1.0) * (abs(ex) + abs(ey)):
                        break
                    if endless[i] == 0 and marked[v, arrival(corners, u, v)] == 0:
                        continue
                gv = gu + np.sqrt(ex * ex + ey * ey)
                if gv >= g[v]:
                    continue
                rest = np.sqrt((tx - corners[v, 0]) ** 2 + (ty - corners[v, 1]) ** 2)
                if gv + rest >= best:
                    continue
                g[v] = gv
                via[v] = u
                if gv + last[v] < best:
                    best = gv + last[v]
                    best_via = v
                if size == key.shape[0]:
                    keys = np.empty(2 * size)
                    costs = np.empty(2 * size)
                    nodes = np.empty(2 * size, np.int32)
                    for j in range(size):
                        keys[j] = key[j]
                        costs[j] = cost[j]
                        nodes[j] = node[j]
                    key = keys
                    cost = costs
                    node = nodes
                rise(key, cost, node, size, gv + rest, gv, v)
                size += 1
                pushes += 1
        u = -1
        while size > 0 and key[0] < best:
            v = node[0]
            gv = cost[0]
            size = drop_top(key, cost, node, size)
            if gv == g[v]:
                u = v
                gu = gv
                break
        if u < 0:
            break
        ux = float(corners[u, 0])
        uy = float(corners[u, 1])
        expansions += 1
    if best_via < 0:
        return -1, expansions, pushes
    count = 0
    u = best_via
    while u >= 0:
        out[count] = u
        count += 1
        u = via[u]
    return count, expansions, pushes
