"""Field of view, taut visibility graph and A* of the any-angle optimum.

Coordinates here: the padded cell (x, y), stored at [y, x], spans x..x+1, y..y+1, so that corners
are integers. All decisions are signs of cross products in float64: without a rounding error for
corners, cell centres and whatever has at most 14 binary digits behind the point.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planners.search._shared_kernels import drop_top, rise

# A leg from or to a point that is no short binary fraction may be off by a rounding error; letting a
# turn pass that is not quite taut adds a longer path to choose from, never a wrong one.
_SLACK = 1e-9


class PlaneMap(NamedTuple):
    """A map as runs of equal cells, and its convex corners.

    Attributes:
        free: (height, width) uint8, padded by blocked cells.
        low: (height, width) int32, where the run of a cell begins in its row.
        high: (height, width) int32, where it ends.
        first: (height + 1, width + 1) int32, the number of the first corner at (y, x) or after it.
        corners: (C, 4) int32 x, y and in which direction the blocked cell lies, 1 or -1 along x and y; in
            the order of (y, x).
    """

    free: NDArray[np.uint8]
    low: NDArray[np.int32]
    high: NDArray[np.int32]
    first: NDArray[np.int32]
    corners: NDArray[np.int32]


class Legs(NamedTuple):
    """The taut legs between corners, those of a corner by the side on which it is left (:func:`link`).

    Attributes:
        ends: (C, 2) int64, where the neighbours of a corner and side end in ``near`` (:func:`bounds`).
        near: (L,) int32 neighbours.
        endless: (L,) uint8, what :func:`find_endless` returned.
    """

    ends: NDArray[np.int64]
    near: NDArray[np.int32]
    endless: NDArray[np.uint8]


class View(NamedTuple):
    """Scratch of a look around: the parts of the view that wait, and the corners that were seen.

    Attributes:
        cones: (P, 4) float64, the directions (x, y) of the left and of the right end of what is seen of a run.
        runs: (P, 2) int32, the row of the run and one of its cells.
        seen: (C,) int32 corners.
    """

    cones: NDArray[np.float64]
    runs: NDArray[np.int32]
    seen: NDArray[np.int32]


class Labels(NamedTuple):
    """What a search knows of the corners.

    Attributes:
        g: (C,) float64 length of the shortest path found to a corner; infinite before a search.
        last: (C,) float64 length of the leg from a corner to the goal where it sees the goal; infinite before.
        parent: (C,) int32 the corner before, -1 for the start.
        marked: (C, 2) uint8, corners and sides from which legs into a pocket lead to the goal; zero before.
        stack: (2 C,) int32 scratch.
    """

    g: NDArray[np.float64]
    last: NDArray[np.float64]
    parent: NDArray[np.int32]
    marked: NDArray[np.uint8]
    stack: NDArray[np.int32]


# ---------------------------------------------------------------------- the map


@njit(cache=True, nogil=True)
def tables(free):
    """Return the :class:`PlaneMap` of padded cells."""
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
    return PlaneMap(free, low, high, first, corners)


# ---------------------------------------------------------------------- the field of view


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
def look_along(free, first, corners, ax, ay, step, seen, count):
    """Append the corners seen along the lattice line through the point, to the right (1) or left (-1)."""
    y = int(ay)
    # The cells between x and the next lattice abscissa in that direction.
    cell = int(np.floor(ax)) if step > 0 else int(np.ceil(ax)) - 1
    above = free[y, cell]
    below = free[y - 1, cell]
    while above != 0 or below != 0:
        x = cell + 1 if step > 0 else cell
        v = first[y, x]
        if v < corners.shape[0] and corners[v, 0] == x and corners[v, 1] == y:
            seen[count] = v
            count += 1
        cell += step
        # At a double corner neither side goes on.
        above &= free[y, cell]
        below &= free[y - 1, cell]
        if above != 0 or below != 0:
            above = free[y, cell]
            below = free[y - 1, cell]
    return count


@njit(cache=True, nogil=True)
def narrow(lx, ly, rx, ry, left, right, left2, right2, h):
    """Return the part of a cone between two directions, l and r, that passes a gap and enters the run behind it.

    Two runs of cells touch on the line at the height ``h``: seen from the eye, the one before it spans
    ``left`` to ``right`` and the one behind it ``left2`` to ``right2``. Whatever of that run is seen on its far
    line, at the height h + 1, has passed the gap; an end of the run behind may narrow the cone further there.
    Directions stay those of corners of the map, so that all signs are exact.
    """
    px = max(left, left2)
    if lx * h - ly * px < 0.0:
        lx = px
        ly = h
    if lx * (h + 1.0) - ly * left2 < 0.0:
        lx = left2
        ly = h + 1.0
    px = min(right, right2)
    if rx * h - ry * px > 0.0:
        rx = px
        ry = h
    if rx * (h + 1.0) - ry * right2 > 0.0:
        rx = right2
        ry = h + 1.0
    return lx, ly, rx, ry


@njit(cache=True, nogil=True)
def look_across(plane, ax, ay, up, side, view, count):
    """Append the corners seen upwards (``up`` 1) or downwards (-1), of the left (-1), right (1) or both (0) quadrants.

    Row by row: the part of the row's free run that is seen is a closed cone between two directions,
    each through a corner of the map. The next row's runs that share more than a point with this one
    get their parts of the cone; a shared point is a double corner.
    """
    free, low, high, first, corners = plane
    cones, runs, seen = view
    row = int(np.floor(ay)) if up > 0 else int(np.ceil(ay)) - 1
    c = run_at(free, row, ax)
    if c < 0:
        return count
    # The cone of the eye's own run, cut off at the vertical for one quadrant.
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
        # The corners on the run's far line that lie in the cone. They are in the order of x; the search for the
        # first begins one cell early, because the abscissa is rounded.
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
                seen[count] = v
                count += 1
            v += 1
        # The runs behind that line, from left to right: what is seen of each waits for its turn.
        row += up
        while x < b:
            if free[row, x] != 0:
                a2 = low[row, x]
                b2 = high[row, x]
                if rx * h - ry * (float(max(a, a2)) - ax) < 0.0:
                    break
                mx, my, nx, ny = narrow(lx, ly, rx, ry, float(a) - ax, float(b) - ax, float(a2) - ax, float(b2) - ax, h)
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
def look_round(plane, ax, ay, view):
    """Find the corners seen from any point, of those at which a path could turn; return their number."""
    corners, seen = plane.corners, view.seen
    count = 0
    for step in range(-1, 2, 2):
        count = look_across(plane, ax, ay, step, 0, view, count)
        if np.floor(ay) == ay:
            count = look_along(plane.free, plane.first, corners, ax, ay, step, seen, count)
    # Seen from the quadrant of the blocked cell or the one opposite, a corner cannot be turned at.
    kept = 0
    for i in range(count):
        v = seen[i]
        dx = (float(corners[v, 0]) - ax) * corners[v, 2]
        dy = (float(corners[v, 1]) - ay) * corners[v, 3]
        if not ((dx > _SLACK and dy > _SLACK) or (dx < -_SLACK and dy < -_SLACK)):
            seen[kept] = v
            kept += 1
    return kept


@njit(cache=True, nogil=True)
def sees(free, low, high, ax, ay, bx, by):
    """Tell whether the leg between two points of the closed free cells stays in them and crosses no double corner."""
    if by < ay:
        ax, ay, bx, by = bx, by, ax, ay
    # A level leg: within a row it stays in one run; on a line between two rows one side must be free all along.
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
    # Row by row: the leg goes from run to run by a gap of some width that it passes or touches.
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
        # The abscissa is rounded: the cell on either side may be the one.
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


# ---------------------------------------------------------------------- the graph of taut legs


@njit(cache=True, nogil=True)
def link(plane, begin, end, view):
    """Return the taut neighbours of the corners ``begin``..``end``: their ends by corner and side, and they.

    With x and y turned so that a corner's blocked cell lies in the first quadrant, a path turns at
    it by coming and leaving in the fourth (side 0, to the left) or by both in the second (side 1).
    The neighbours of a side are in the order of their angle from the wall: from the sharpest turn.
    """
    corners, seen = plane.corners, view.seen
    ends = np.empty((end - begin, 2), np.int64)
    kept = np.empty(max(1024, 8 * (end - begin)), np.int32)
    # A heap sorts the neighbours of a side: by the angle, then the farthest first.
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
            count = look_across(plane, ax, ay, up, across, view, 0)
            if side == 0:
                # The wall itself belongs to this side.
                count = look_along(plane.free, plane.first, corners, ax, ay, qx, seen, count)
            good = 0
            for i in range(count):
                v = seen[i]
                dx = corners[v, 0] - corners[u, 0]
                dy = corners[v, 1] - corners[u, 1]
                if (side == 0 and dx == 0) or (side == 1 and dy == 0):
                    continue  # on the border between the sides, and the other one's
                # Taut at its far end too: it comes in the quadrants from which one can turn there.
                ex = dx * corners[v, 2]
                ey = dy * corners[v, 3]
                if (ex >= 0 and ey < 0) or (ex < 0 and ey >= 0):
                    far = float(abs(dx) + abs(dy))
                    rise(key, cost, node, good, float(abs(dy if side == 0 else dx)) / far, -far, v)
                    good += 1
            if total + good > kept.shape[0]:
                more = np.empty(2 * (total + good), np.int32)
                more[:total] = kept[:total]
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
    # By halves: the neighbours are in the order of their angle.
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
    """Return the position of ``u`` among the neighbours of ``v`` on ``side``, where it is."""
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
    # Others may lie in the same direction.
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
    # Begin with all legs of use, and let each corner and side that loses some tell those before it.
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
        # The sharpest turns are the ones that a leg arriving here can lose last.
        begin, end = bounds(ends, v, side)
        while begin + first[v, side] < end and endless[begin + first[v, side]] == 0:
            first[v, side] += 1
        back, back_end = bounds(ends, v, 1 - side)
        while back_end - gone[v, side] > back:
            u = near[back_end - gone[v, side] - 1]
            if count_taut(corners, ends, near, u, v, side) > first[v, side]:
                break
            gone[v, side] += 1
            # The leg from u to v leaves u on the side on which the leg back arrives.
            out = 1 - arrival(corners, v, u)
            endless[find_leg(corners, ends, near, u, out, v)] = 0
            if waiting[u, out] == 0:
                waiting[u, out] = 1
                stack[size] = 2 * u + out
                size += 1
    return endless


# ---------------------------------------------------------------------- the search


@njit(cache=True, nogil=True)
def mark_pockets(corners, legs, tx, ty, seen, count, labels):
    """Mark the corners and sides from which legs without use elsewhere lead to the goal, which ``seen`` see.

    Also ``labels.last`` of the corners that see the goal.
    """
    ends, near, endless = legs
    last, marked, stack = labels.last, labels.marked, labels.stack
    # The corners that see the goal, by the side on which they may be left for it.
    size = 0
    for i in range(count):
        v = seen[i]
        last[v] = np.sqrt((tx - corners[v, 0]) ** 2 + (ty - corners[v, 1]) ** 2)
        ex = (tx - corners[v, 0]) * corners[v, 2]
        ey = (ty - corners[v, 1]) * corners[v, 3]
        for side in range(2):
            if (ex >= -_SLACK and ey <= _SLACK) if side == 0 else (ex <= _SLACK and ey >= -_SLACK):
                marked[v, side] = 1
                stack[size] = 2 * v + side
                size += 1
    # Back along the legs that are not endless; all others are searched anyway.
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
def twice_as_long(values):
    """Return ``values`` (N,) in an array (2 N,)."""
    longer = np.empty(2 * values.shape[0], values.dtype)
    longer[: values.shape[0]] = values
    return longer


@njit(cache=True, nogil=True)
def sides_to_leave(px, py, slack):
    """Return the sides, ``begin``..``end``, on which a path that arrives by (px, py) may leave a corner."""
    if px >= -slack and py <= slack:
        return 0, 2 if px <= slack and py >= -slack else 1
    return 1, 2


@njit(cache=True, nogil=True)
def search(plane, legs, sx, sy, tx, ty, view, labels):
    """Return at how many corners a shortest path between two points turns (-1: none), expansions and pushes.

    A* over the taut legs with the straight-line distance to (tx, ty). The start and the goal are no corners:
    the legs of the start are those to all corners it sees, and a corner that sees the goal makes a path as
    soon as it is reached, so that the search ends where no entry of the queue can be better than the best of these.
    ``view.seen`` takes the corners of the path, from the goal to the start.
    """
    free, low, high, _, corners = plane
    ends, near, endless = legs
    g, last, parent, marked, _ = labels
    seen = view.seen
    if sees(free, low, high, sx, sy, tx, ty):
        return 0, 1, 0
    count = look_round(plane, tx, ty, view)
    mark_pockets(corners, legs, tx, ty, seen, count, labels)
    key = np.empty(1024)
    cost = np.empty(1024)
    node = np.empty(1024, np.int32)
    size = 0
    pushes = 0
    best = np.inf  # length of the best path found, and its last corner
    best_corner = -1
    expansions = 1
    u = -1  # the start
    gu = 0.0
    ux = sx
    uy = sy
    count = look_round(plane, sx, sy, view)
    while True:
        # The corners to go to: all that the start sees, or the taut ones of one side, or of both where the leg
        # that arrives runs along the border between them.
        slack = 0.0
        px = 0.0
        py = 0.0
        side_from, side_to = 0, 1
        if u >= 0:
            # The direction of arrival, turned so that the blocked cell lies in the first quadrant. From the start
            # it may be off by a rounding error; between corners it is exact.
            before = parent[u]
            px = (ux - (sx if before < 0 else float(corners[before, 0]))) * corners[u, 2]
            py = (uy - (sy if before < 0 else float(corners[before, 1]))) * corners[u, 3]
            slack = _SLACK if before < 0 else 0.0
            side_from, side_to = sides_to_leave(px, py, slack)
        for side in range(side_from, side_to):
            begin = 0
            end = count
            if u >= 0:
                begin, end = bounds(ends, u, side)
            for i in range(begin, end):
                v = near[i] if u >= 0 else seen[i]
                ex = corners[v, 0] - ux
                ey = corners[v, 1] - uy
                if u >= 0:
                    # From the sharpest turn on: after the first leg that is not taut none is.
                    turn = px * ey * corners[u, 3] - py * ex * corners[u, 2]
                    if side == 1:
                        turn = -turn
                    if turn <= -slack * (abs(px) + abs(py) + 1.0) * (abs(ex) + abs(ey)):
                        break
                    if endless[i] == 0 and marked[v, arrival(corners, u, v)] == 0:
                        continue  # into a pocket that does not hold the goal
                gv = gu + np.sqrt(ex * ex + ey * ey)
                if gv >= g[v]:
                    continue
                rest = np.sqrt((tx - corners[v, 0]) ** 2 + (ty - corners[v, 1]) ** 2)
                if gv + rest >= best:
                    continue
                g[v] = gv
                parent[v] = u
                if gv + last[v] < best:
                    best = gv + last[v]
                    best_corner = v
                if size == key.shape[0]:
                    key = twice_as_long(key)
                    cost = twice_as_long(cost)
                    node = twice_as_long(node)
                rise(key, cost, node, size, gv + rest, gv, v)
                size += 1
                pushes += 1
        # The next corner whose entry is not stale.
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
    if best_corner < 0:
        return -1, expansions, pushes
    count = 0
    u = best_corner
    while u >= 0:
        seen[count] = u
        count += 1
        u = parent[u]
    return count, expansions, pushes
