"""Numba kernels of the global matcher: branch and bound over intervals of angles and boxes of shifts.

A node of level k is a cell of rotations (an interval of yaw; in space also a patch of tilts) and a box of 2^k shifts
along every basis axis. For a cell of rotations the arc of each point lies in a small box of lattice cells; the
largest weight in that box, swept over the node's shifts, stands in one entry of the occupancy pyramid. The sum over
the points is never less than the score of any pose in the node (``lattices.md``, "Exact matching over all real
angles").

Level 0 is exact. For one shift the score is piecewise constant in the yaw and changes only where a point crosses a face
of its cell, at angles with a closed form; a sweep over these finds the maximum over the whole interval.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

# What the state of a search holds; it lies in an array so that a search can be stopped and carried on.
BEST, ROOT, USED, NODES, LEAVES, CLOSED = 0, 1, 2, 3, 4, 5
# Why the kernel returned.
DONE, PAUSED, FULL = 0, 1, 2
# Crossings that are nearer than this, radians, are taken to be at once: float64 cannot order them.
SAME_ANGLE = 1e-10
# How often a sum looks whether it can still become what is asked for.
STRIDE = 8


class ScanArrays(NamedTuple):
    """The scan, its most telling points first.

    ``points`` (P, n) in metres, ``waves`` (P, n, 2) the X and Y of each coordinate X cos(yaw) + Y sin(yaw) of the
    upright sensor's points, ``weights`` (P,) at most 257, ``rest`` (P + 1,) what each point and all after it can score,
    ``stops`` (K,) after how many points a sum is looked at: often enough that 255 times their weight fits 16 bits.
    """

    points: np.ndarray
    waves: np.ndarray
    weights: np.ndarray
    rest: np.ndarray
    stops: np.ndarray


class LatticeArrays(NamedTuple):
    """The lattice: basis and inverse (n, n), the cell's reach along each axis, and its faces as vectors."""

    basis: np.ndarray
    inverse: np.ndarray
    half: np.ndarray
    faces: np.ndarray
    normals: np.ndarray


class RotationArrays(NamedTuple):
    """The rotations: ``count`` units of ``unit`` radians of yaw from ``first`` on, in groups by level, and the tilts.

    ``continuous`` says whether a unit is an interval or a single angle. ``tilts`` (T, n, n) are rotations, each the
    centre of a patch of ``radius`` (T,) radians; those of level k are numbers ``tilt_start[k]`` up to
    ``tilt_start[k + 1]``, and the patches inside patch t are ``children[child_start[t]:child_start[t + 1]]``.
    """

    first: float
    unit: float
    count: int
    continuous: bool
    group: np.ndarray
    tilts: np.ndarray
    radius: np.ndarray
    tilt_start: np.ndarray
    children: np.ndarray
    child_start: np.ndarray


class RegionArrays(NamedTuple):
    """Where to look: shifts from ``low`` on, ``blocks`` of 2^(top + 1) along each axis, centres in a box, outside a
    ball.

    ``box`` (2, n) are corners in metres. ``allowed`` marks the blocks of each level that hold a shift that may be
    taken, those of level k from ``allowed_start[k]`` on, row-major in ``allowed_shape[k]`` (n,), counted from
    ``allowed_low``; where it is empty, all may. Poses within ``apart[0]`` metres of ``away`` (n,) and ``apart[1]``
    radians of the rotation ``turned`` (n, n) are left out; ``apart`` of -1 leaves out none.
    """

    low: np.ndarray
    blocks: np.ndarray
    top: int
    box: np.ndarray
    allowed: np.ndarray
    allowed_low: np.ndarray
    allowed_start: np.ndarray
    allowed_shape: np.ndarray
    away: np.ndarray
    turned: np.ndarray
    apart: np.ndarray


class Arcs(NamedTuple):
    """Slots for cells of rotations: what their points' arcs touch, kept until another cell wants the slot.

    ``tag`` (S,) says which cell of rotations a slot holds and ``covered`` (S,) whether the pyramid's tables reach
    over all its boxes; ``rows`` (S, P, n) is where each point's box begins, as a place in the tables' addresses;
    ``kind`` (P,) is room for which size of box that is.
    Slots of level 0 also hold the cells in which the points begin, ``exact`` (S0, P, n), and the crossings: ``begin``
    (S0, P + 1) where each point's begin, ``entered`` (S0, E, n) the cells entered, ``angle`` (S0, E) where, ``owner``
    (S0, E) whose, ``order`` (S0, E) sorted by angle.
    """

    tag: np.ndarray
    covered: np.ndarray
    rows: np.ndarray
    kind: np.ndarray
    exact_tag: np.ndarray
    exact: np.ndarray
    begin: np.ndarray
    entered: np.ndarray
    angle: np.ndarray
    owner: np.ndarray
    order: np.ndarray


class Stack(NamedTuple):
    """Nodes that wait: level, yaw group, tilt, low corner of the shifts, bound."""

    level: np.ndarray
    yaw: np.ndarray
    tilt: np.ndarray
    shift: np.ndarray
    bound: np.ndarray


@njit(cache=True, nogil=True)
def _yaw_range(rotations, level, q):
    """Return the first and the last yaw of a cell of rotations."""
    group = rotations.group[level]
    begin = q * group
    end = min(begin + group, rotations.count)
    if not rotations.continuous:
        end -= 1
    return rotations.first + begin * rotations.unit, rotations.first + end * rotations.unit


@njit(cache=True, nogil=True)
def _wave_range(X, Y, c0, s0, c1, s1, half_turn):
    """Return the least and the largest X cos(yaw) + Y sin(yaw) over an interval given by the cosines and sines of its
    ends.
    """
    u0 = X * c0 + Y * s0
    u1 = X * c1 + Y * s1
    least = min(u0, u1)
    most = max(u0, u1)
    # The slope at both ends tells whether the interval holds the top or the bottom of the wave.
    d0 = Y * c0 - X * s0
    d1 = Y * c1 - X * s1
    if half_turn:
        most = np.sqrt(X * X + Y * Y)
        least = -most
    elif d0 >= 0.0 and d1 <= 0.0:
        most = np.sqrt(X * X + Y * Y)
    elif d0 <= 0.0 and d1 >= 0.0:
        least = -np.sqrt(X * X + Y * Y)
    return least, most


@njit(cache=True, nogil=True)
def _variant(windows, needed):
    """Return the smallest of a level's boxes that holds ``needed`` indices, the largest where none does."""
    variant = 0
    while variant < windows.shape[0] - 1 and windows[variant] < needed:
        variant += 1
    return variant


@njit(cache=True, nogil=True)
def _box_arcs_plane(waves, reach0, reach1, c0, s0, c1, s1, half_turn, windows, level, first, kind):
    """Write where the box of cells that each point's arc can touch begins, and which of the tables' boxes holds it;
    tell whether one does for all points.

    A point of the cell around c has |u - c| at most ``reach`` along an axis.
    """
    covered = True
    size = (np.int64(1) << level) - 1
    for p in range(waves.shape[0]):
        # One table serves both axes, so the wider of the two ranges says which.
        least, most = _wave_range(waves[p, 0, 0], waves[p, 0, 1], c0, s0, c1, s1, half_turn)
        first0 = np.int64(np.ceil(least - reach0))
        widest = np.int64(np.floor(most + reach0)) - first0 + 1
        least, most = _wave_range(waves[p, 1, 0], waves[p, 1, 1], c0, s0, c1, s1, half_turn)
        first1 = np.int64(np.ceil(least - reach1))
        widest = max(widest, np.int64(np.floor(most + reach1)) - first1 + 1)
        variant = _variant(windows, widest + size)
        covered &= windows[variant] >= widest + size
        kind[p] = variant
        first[p, 0] = first0
        first[p, 1] = first1
    return covered


@njit(cache=True, nogil=True)
def _box_arcs_space(scan, lattice, rotations, windows, level, tilt, c0, s0, c1, s1, half_turn, first, kind):
    """The same in space, where a tilt by at most w moves a point by at most 2 |p| sin(w / 2)."""
    chord = 2.0 * np.sin(0.5 * min(rotations.radius[tilt], np.pi))
    T = rotations.tilts[tilt]
    points, inverse, half = scan.points, lattice.inverse, lattice.half
    size = (np.int64(1) << level) - 1
    covered = True
    for p in range(points.shape[0]):
        x = T[0, 0] * points[p, 0] + T[0, 1] * points[p, 1] + T[0, 2] * points[p, 2]
        y = T[1, 0] * points[p, 0] + T[1, 1] * points[p, 1] + T[1, 2] * points[p, 2]
        z = T[2, 0] * points[p, 0] + T[2, 1] * points[p, 1] + T[2, 2] * points[p, 2]
        # The patch of tilts moves every point by its share of the chord, whichever way it leans.
        sway = chord * np.sqrt(x * x + y * y + z * z)
        widest = np.int64(1)
        for a in range(3):
            X = inverse[a, 0] * x + inverse[a, 1] * y
            Y = inverse[a, 1] * x - inverse[a, 0] * y
            least, most = _wave_range(X, Y, c0, s0, c1, s1, half_turn)
            rise = inverse[a, 2] * z
            reach = half[a] + 1e-9 + sway * half[3 + a]
            begin = np.int64(np.ceil(least + rise - reach))
            widest = max(widest, np.int64(np.floor(most + rise + reach)) - begin + 1)
            first[p, a] = begin
        variant = _variant(windows, widest + size)
        covered &= windows[variant] >= widest + size
        kind[p] = variant
    return covered


@njit(cache=True, nogil=True)
def _box_arcs(scan, lattice, rotations, windows, level, q, tilt, first, kind):
    """Write where the box of cells that each point's arc can touch begins, and which of the tables' boxes holds it;
    tell whether one does for all points.
    """
    low_yaw, high_yaw = _yaw_range(rotations, level, q)
    c0, s0 = np.cos(low_yaw), np.sin(low_yaw)
    c1, s1 = np.cos(high_yaw), np.sin(high_yaw)
    half_turn = high_yaw - low_yaw >= np.pi
    if scan.points.shape[1] == 2:
        return _box_arcs_plane(
            scan.waves, lattice.half[0] + 1e-9, lattice.half[1] + 1e-9, c0, s0, c1, s1, half_turn, windows, level,
            first, kind,
        )  # fmt: skip
    return _box_arcs_space(scan, lattice, rotations, windows, level, tilt, c0, s0, c1, s1, half_turn, first, kind)


@njit(cache=True, nogil=True)
def arc_boxes(scan, lattice, rotations, windows, level, yaw, tilt, first, kind, covered):
    """Write the boxes of many cells of rotations of a level, ``yaw`` (B,) and ``tilt`` (B,): where they begin into
    ``first`` (B, P, n), which of the tables' boxes holds them into ``kind`` (B, P), and whether one does for all points
    into ``covered`` (B,).
    """
    for b in range(yaw.shape[0]):
        covered[b] = _box_arcs(scan, lattice, rotations, windows, level, yaw[b], tilt[b], first[b], kind[b])


@njit(cache=True, nogil=True)
def _nearest_cell(lattice, x, cell):
    """Write the cell around ``x``: round, then step across faces until the point lies inside all of them."""
    n = x.shape[0]
    for a in range(n):
        u = 0.0
        for b in range(n):
            u += lattice.inverse[a, b] * x[b]
        cell[a] = np.int64(np.rint(u))
    for _ in range(64):
        far = 1e-12
        through = -1
        for f in range(lattice.faces.shape[0]):
            beyond = 0.0
            size = 0.0
            for b in range(n):
                centre = 0.0
                for a in range(n):
                    centre += lattice.basis[b, a] * cell[a]
                v = lattice.normals[f, b]
                beyond += v * (x[b] - centre)
                size += v * v
            beyond = beyond / size - 0.5
            if beyond > far:
                far = beyond
                through = f
        if through < 0:
            return
        for a in range(n):
            cell[a] += lattice.faces[through, a]


@njit(cache=True, nogil=True)
def _exact_arcs(scan, lattice, rotations, q, tilt, cells, begin, entered, angle, owner, order):
    """Follow each point through the cells of its arc; return the number of crossings, -1 where there is no room.

    On a face f the point satisfies |v_f| |p| cos(yaw - phase) = v_f . c + |v_f|^2 / 2 with the height taken off; it
    leaves through the face whose outward crossing comes first.
    """
    n = scan.points.shape[1]
    low_yaw, high_yaw = _yaw_range(rotations, 0, q)
    T = rotations.tilts[tilt]
    used = 0
    c0, s0 = np.cos(low_yaw), np.sin(low_yaw)
    x = np.empty(n)
    start = np.empty(n)
    cell = np.empty(n, np.int64)
    for p in range(scan.points.shape[0]):
        begin[p] = used
        for a in range(n):
            start[a] = 0.0
            for b in range(n):
                start[a] += T[a, b] * scan.points[p, b]
        x[0] = c0 * start[0] - s0 * start[1]
        x[1] = s0 * start[0] + c0 * start[1]
        if n == 3:
            x[2] = start[2]
        _nearest_cell(lattice, x, cell)
        for a in range(n):
            cells[p, a] = cell[a]
        # A stated angle is one rotation: there is nothing to follow.
        if not rotations.continuous:
            continue
        radius = np.sqrt(start[0] * start[0] + start[1] * start[1])
        now = low_yaw
        while True:
            soonest = high_yaw
            through = -1
            cn, sn = np.cos(now), np.sin(now)
            for f in range(lattice.faces.shape[0]):
                v0, v1 = lattice.normals[f, 0], lattice.normals[f, 1]
                flat = np.sqrt(v0 * v0 + v1 * v1)
                level = 0.5 * (v0 * v0 + v1 * v1)
                for a in range(n):
                    level += (v0 * lattice.basis[0, a] + v1 * lattice.basis[1, a]) * cell[a]
                if n == 3:
                    v2 = lattice.normals[f, 2]
                    level += 0.5 * v2 * v2 - v2 * start[2]
                    for a in range(n):
                        level += v2 * lattice.basis[2, a] * cell[a]
                swing = flat * radius
                # How far inside the face the point is now: it cannot get there sooner than at full speed.
                along = v0 * (cn * start[0] - sn * start[1]) + v1 * (sn * start[0] + cn * start[1])
                if level - along > swing * (soonest - now) or swing <= abs(level):
                    continue
                # Outward: the wave rises through the level, at phase - acos.
                phase = np.arctan2(v1, v0) - np.arctan2(start[1], start[0])
                at = phase - np.arccos(level / swing)
                at += 2.0 * np.pi * np.ceil((now - at - 1e-12) / (2.0 * np.pi))
                # A face just crossed inward is crossed outward again only later; numbers may say "just now".
                if at < now:
                    at = now
                if at < soonest:
                    slope = v1 * (np.cos(at) * start[0] - np.sin(at) * start[1]) - v0 * (
                        np.sin(at) * start[0] + np.cos(at) * start[1]
                    )
                    if slope > 0.0:
                        soonest = at
                        through = f
            if through < 0:
                break
            # What is found must fit; the caller comes again with more room.
            if used >= angle.shape[0]:
                return -1
            for a in range(n):
                cell[a] += lattice.faces[through, a]
                entered[used, a] = cell[a]
            angle[used] = soonest
            owner[used] = p
            used += 1
            now = soonest
    begin[scan.points.shape[0]] = used
    order[:used] = np.argsort(angle[:used], kind="mergesort")
    return used


@njit(cache=True, nogil=True)
def _bounds(packed, address, unit, weights, rest, stops, rows, shift, floor, out):
    """Write the bounds of the 2^n sibling blocks from ``shift`` on into ``out``; return the largest.

    One look-up a point bounds all siblings: a byte each, added up in lanes of 16 bits. Once not even the best of them
    can pass ``floor``, what is returned is less than the truth allows but does not pass it either. Arrays come one by
    one here: to take one out of a tuple costs as much as thirty look-ups.
    """
    mask = np.uint64(0x00FF00FF00FF00FF)
    lane = np.uint64(0xFFFF)
    siblings = out.shape[0]
    out[:] = 0
    p = 0
    best = np.int64(0)
    if siblings == 4:
        s0, s1 = shift[0], shift[1]
        for k in range(stops.shape[0]):
            even = np.uint64(0)
            odd = np.uint64(0)
            while p < stops[k]:
                at = address[np.uint32(rows[p, 0] + s0)] + address[np.uint32(rows[p, 1] + s1)]
                v = np.uint64(packed[np.uint32(at)])
                w = weights[p]
                even += (v & mask) * w
                odd += ((v >> np.uint64(8)) & mask) * w
                p += 1
            out[0] += np.int64(even & lane)
            out[1] += np.int64(odd & lane)
            out[2] += np.int64(even >> np.uint64(16))
            out[3] += np.int64(odd >> np.uint64(16))
            best = max(max(out[0], out[1]), max(out[2], out[3])) * unit + rest[p]
            if best <= floor:
                return best
    else:
        s0, s1, s2 = shift[0], shift[1], shift[2]
        for k in range(stops.shape[0]):
            even = np.uint64(0)
            odd = np.uint64(0)
            while p < stops[k]:
                at = address[np.uint32(rows[p, 0] + s0)] + address[np.uint32(rows[p, 1] + s1)]
                at += address[np.uint32(rows[p, 2] + s2)]
                v = np.uint64(packed[np.uint32(at)])
                w = weights[p]
                even += (v & mask) * w
                odd += ((v >> np.uint64(8)) & mask) * w
                p += 1
            best = 0
            for c in range(0, 8, 2):
                out[c] += np.int64((even >> np.uint64(8 * c)) & lane)
                out[c + 1] += np.int64((odd >> np.uint64(8 * c)) & lane)
                best = max(best, out[c], out[c + 1])
            best = best * unit + rest[p]
            if best <= floor:
                return best
    for c in range(siblings):
        out[c] *= unit
    return best


@njit(cache=True, nogil=True)
def _weight(tables, cell, shift):
    """Return the weight of one cell of the finest table."""
    at = np.int64(0)
    for a in range(cell.shape[0]):
        at += tables.cell_address[a * tables.length + cell[a] + shift[a] - tables.low[a]]
    return np.int64(tables.cells[at])


@njit(cache=True, nogil=True)
def _sweep(scan, tables, cells, begin, entered, angle, owner, order, first, last, shift, current, result):
    """Find the yaw of the largest score between ``first`` and ``last``; return the score and the closed bound.

    ``result`` receives the ends of the widest interval on which the score is reached. Between crossings the score is
    constant. Where several crossings come at once, a point on the face might be counted on either side: the closed
    bound takes the better side of each, the score only what holds on an open interval.
    """
    count = scan.points.shape[0]
    # The score at the beginning of the interval, and what each point adds to it.
    total = np.int64(0)
    for p in range(count):
        current[p] = _weight(tables, cells[p], shift)
        total += scan.weights[p] * current[p]
    best = np.int64(-1)
    closed = total
    since = first
    used = begin[count]
    e = 0
    while True:
        until = last if e >= used else angle[order[e]]
        wide = until - since > SAME_ANGLE or (best < 0 and e >= used)
        if wide and (total > best or (total == best and until - since > result[1] - result[0])):
            best = total
            result[0] = since
            result[1] = until
        if e >= used:
            break
        # All crossings that float64 cannot tell apart.
        before = total
        gain = np.int64(0)
        while e < used and angle[order[e]] - until <= SAME_ANGLE:
            k = order[e]
            p = owner[k]
            value = _weight(tables, entered[k], shift)
            change = scan.weights[p] * (value - current[p])
            current[p] = value
            total += change
            gain += max(change, 0)
            since = angle[k]
            e += 1
        closed = max(closed, before + gain)
    return best, max(closed, best)


@njit(cache=True, nogil=True)
def _tag(level, q, tilt):
    """Return the number of a cell of rotations."""
    return (np.int64(tilt) << 32) | (np.int64(level) << 26) | np.int64(q)


@njit(cache=True, nogil=True)
def _slot_number(level, q, tilt, slots):
    """Return the slot in which a cell of rotations lies where it lies in any."""
    # Neighbours differ in a few low bits; the product spreads them over all.
    return np.int64(
        (np.uint64(_tag(level, q, tilt)) * np.uint64(0x9E3779B97F4A7C15) >> np.uint64(32)) % np.uint64(slots)
    )


@njit(cache=True, nogil=True)
def _exact_slot(scan, lattice, rotations, arcs, q, tilt):
    """Return the slot of a cell of rotations of level 0, filled; -1 where its crossings have no room."""
    tag = (np.int64(tilt) << 32) | np.int64(q)
    slot = _slot_number(0, q, tilt, arcs.exact_tag.shape[0])
    if arcs.exact_tag[slot] != tag:
        arcs.exact_tag[slot] = -1
        used = _exact_arcs(
            scan, lattice, rotations, q, tilt, arcs.exact[slot], arcs.begin[slot], arcs.entered[slot],
            arcs.angle[slot], arcs.owner[slot], arcs.order[slot],
        )  # fmt: skip
        if used < 0:
            return -1
        arcs.exact_tag[slot] = tag
    return slot


@njit(cache=True, nogil=True)
def _exact_boxes(windows, cells, begin, entered, low, kind):
    """Write where the box of the cells that each point really touches begins, and which of the tables' boxes holds it;
    tell whether one does for all points.
    """
    n = cells.shape[1]
    covered = True
    for p in range(cells.shape[0]):
        widest = np.int64(1)
        for a in range(n):
            first = np.int64(cells[p, a])
            last = first
            for e in range(begin[p], begin[p + 1]):
                first = min(first, np.int64(entered[e, a]))
                last = max(last, np.int64(entered[e, a]))
            low[p, a] = first
            widest = max(widest, last - first + 1)
        variant = _variant(windows, widest)
        covered &= windows[variant] >= widest
        kind[p] = variant
    return covered


@njit(cache=True, nogil=True)
def _to_addresses(tables, level, kind, rows):
    """Turn the index at which each point's box begins into its place in the tables' addresses."""
    n = rows.shape[1]
    variants, length, low = tables.windows.shape[1], tables.length, tables.low
    for p in range(rows.shape[0]):
        table = level * variants + kind[p]
        for a in range(n):
            rows[p, a] += (n * table + a) * length - low[a]


@njit(cache=True, nogil=True)
def _slot(scan, lattice, rotations, tables, arcs, level, q, tilt):
    """Return the slot of a cell of rotations, filled; -1 where the crossings of one of level 0 have no room."""
    tag = _tag(level, q, tilt)
    slot = _slot_number(level, q, tilt, arcs.tag.shape[0])
    if arcs.tag[slot] != tag:
        arcs.tag[slot] = -1
        if level > 0:
            arcs.covered[slot] = _box_arcs(
                scan, lattice, rotations, tables.windows[level], level, q, tilt, arcs.rows[slot], arcs.kind
            )
        else:
            exact = _exact_slot(scan, lattice, rotations, arcs, q, tilt)
            if exact < 0:
                return -1
            arcs.covered[slot] = _exact_boxes(
                tables.windows[0], arcs.exact[exact], arcs.begin[exact], arcs.entered[exact], arcs.rows[slot], arcs.kind
            )
        _to_addresses(tables, level, arcs.kind, arcs.rows[slot])
        arcs.tag[slot] = tag
    return slot


@njit(cache=True, nogil=True)
def _forbidden(lattice, region, level, shift):
    """Tell whether no shift of a block of 2^level may be taken: none is marked, or all lie beside the region's box."""
    n = shift.shape[0]
    # First what the map says of its blocks: one look-up; then the region's box, corner by corner.
    if region.allowed.shape[0] > 0:
        at = np.int64(0)
        for a in range(n):
            k = (shift[a] - region.allowed_low[a]) >> level
            if k < 0 or k >= region.allowed_shape[level, a]:
                return True
            at = at * region.allowed_shape[level, a] + k
        if region.allowed[region.allowed_start[level] + at] == 0:
            return True
    size = (np.int64(1) << level) - 1
    for b in range(n):
        least = 0.0
        most = 0.0
        for a in range(n):
            v = lattice.basis[b, a]
            near = v * shift[a]
            far = v * (shift[a] + size)
            least += min(near, far)
            most += max(near, far)
        if most < region.box[0, b] or least > region.box[1, b]:
            return True
    return False


@njit(cache=True, nogil=True)
def _turn_between(region, rotations, tilt, yaw):
    """Return the angle between the rotation that is left out and Rz(yaw) times a tilt."""
    T = rotations.tilts[tilt]
    n = T.shape[0]
    c, s = np.cos(yaw), np.sin(yaw)
    trace = 0.0
    for k in range(n):
        trace += region.turned[0, k] * (c * T[0, k] - s * T[1, k])
        trace += region.turned[1, k] * (s * T[0, k] + c * T[1, k])
        if n == 3:
            trace += region.turned[2, k] * T[2, k]
    cosine = 0.5 * trace if n == 2 else 0.5 * (trace - 1.0)
    return np.arccos(min(1.0, max(-1.0, cosine)))


@njit(cache=True, nogil=True)
def _left_out(lattice, rotations, region, level, q, tilt, shift):
    """Tell whether every pose of a node is left out; at level 0 the middle of the interval decides."""
    if region.apart[0] < 0.0:
        return False
    n = shift.shape[0]
    size = (np.int64(1) << level) - 1
    # The farthest corner of the block decides.
    for corner in range(1 << n):
        length = 0.0
        for b in range(n):
            x = -region.away[b]
            for a in range(n):
                x += lattice.basis[b, a] * (shift[a] + (size if (corner >> a) & 1 else 0))
            length += x * x
        if length > region.apart[0] * region.apart[0]:
            return False
    low_yaw, high_yaw = _yaw_range(rotations, level, q)
    turn = _turn_between(region, rotations, tilt, 0.5 * (low_yaw + high_yaw))
    margin = 0.0 if level == 0 else 0.5 * (high_yaw - low_yaw) + rotations.radius[tilt]
    return turn + margin <= region.apart[1]


@njit(cache=True, nogil=True)
def allowed_blocks(lattice, region, level, low, blocks, out):
    """Tell of each of ``blocks`` (n,) blocks of 2^level from ``low`` on, row-major, whether it holds a shift that may
    be taken.
    """
    n = low.shape[0]
    shift = np.empty(n, np.int64)
    for block in range(out.shape[0]):
        rest = block
        for a in range(n - 1, -1, -1):
            shift[a] = low[a] + ((rest % blocks[a]) << level)
            rest //= blocks[a]
        out[block] = not _forbidden(lattice, region, level, shift)


@njit(cache=True, nogil=True)
def _evaluate(scan, lattice, rotations, tables, arcs, q, tilt, shift, state, current, interval, best_node, best_yaw):
    """Sweep one cell of rotations at one shift and keep what is better than the best so far; False: no room."""
    slot = _exact_slot(scan, lattice, rotations, arcs, q, tilt)
    if slot < 0:
        return False
    first, last = _yaw_range(rotations, 0, q)
    interval[0] = 0.0
    interval[1] = -1.0
    score, closed = _sweep(
        scan, tables, arcs.exact[slot], arcs.begin[slot], arcs.entered[slot], arcs.angle[slot], arcs.owner[slot],
        arcs.order[slot], first, last, shift, current, interval,
    )  # fmt: skip
    state[LEAVES] += 1
    state[CLOSED] = max(state[CLOSED], closed)
    if score > state[BEST]:
        state[BEST] = score
        best_node[0] = tilt
        for a in range(shift.shape[0]):
            best_node[1 + a] = shift[a]
        best_yaw[0] = interval[0]
        best_yaw[1] = interval[1]
    return True


@njit(cache=True, nogil=True)
def _push(stack, base, used, level, yaw, tilt, shift, bound):
    """Put a node among those from ``base`` on, ascending by bound, equal ones as they came."""
    n = shift.shape[0]
    k = used
    while k > base and stack.bound[k - 1] > bound:
        for a in range(n):
            stack.shift[k, a] = stack.shift[k - 1, a]
        stack.level[k] = stack.level[k - 1]
        stack.yaw[k] = stack.yaw[k - 1]
        stack.tilt[k] = stack.tilt[k - 1]
        stack.bound[k] = stack.bound[k - 1]
        k -= 1
    for a in range(n):
        stack.shift[k, a] = shift[a]
    stack.level[k] = level
    stack.yaw[k] = yaw
    stack.tilt[k] = tilt
    stack.bound[k] = bound


@njit(cache=True, nogil=True)
def _expand(scan, lattice, rotations, tables, arcs, region, stack, base, level, q, tilt, shift, parent, state, bounds):
    """Push the children of a node that may pass the best score from ``base`` on; return the stack's height, -1: no
    room.

    Its children are the groups of yaw and patches of tilt one level down, each with the 2^n halves of the block.
    """
    n = shift.shape[0]
    below = level - 1
    half = np.int64(1) << below
    # Groups are powers of two units, so that a group's children begin where it does.
    first_yaw = q * rotations.group[level] // rotations.group[below]
    last_yaw = -(-min((q + 1) * rotations.group[level], rotations.count) // rotations.group[below])
    child = np.empty(n, np.int64)
    packed, address, unit = tables.packed, tables.address, tables.unit
    weights, rest, stops = scan.weights, scan.rest, scan.stops
    tag, covered, rows = arcs.tag, arcs.covered, arcs.rows
    used = base
    for k in range(rotations.child_start[tilt], rotations.child_start[tilt + 1]):
        tilt_below = rotations.children[k]
        for yaw_below in range(first_yaw, last_yaw):
            slot = _slot_number(below, yaw_below, tilt_below, tag.shape[0])
            if tag[slot] != _tag(below, yaw_below, tilt_below):
                slot = _slot(scan, lattice, rotations, tables, arcs, below, yaw_below, tilt_below)
                if slot < 0:
                    return -1
            state[NODES] += 1 << n
            if covered[slot]:
                best = state[BEST]
                if _bounds(packed, address, unit, weights, rest, stops, rows[slot], shift, best, bounds) <= best:
                    continue
            else:
                bounds[:] = parent
            for c in range(1 << n):
                bound = min(bounds[c], parent)
                if bound <= state[BEST]:
                    continue
                for a in range(n):
                    child[a] = shift[a] + (half if (c >> a) & 1 else 0)
                if _forbidden(lattice, region, below, child):
                    continue
                _push(stack, base, used, below, yaw_below, tilt_below, child, bound)
                used += 1
    return used


@njit(cache=True, nogil=True)
def probe(
    scan,
    lattice,
    rotations,
    tables,
    arcs,
    region,
    top,
    root_bound,
    root_node,
    stack,
    widths,
    state,
    best_node,
    best_yaw,
):
    """Find a good pose quickly: keep the ``widths[k]`` best nodes of each level k only; return DONE or FULL.

    Nothing is proved by it. But a search that begins with a score near the best drops most nodes at the first look.
    Roots are of level ``top``; ``stack`` is room for the children of all nodes kept on a level.
    """
    n = region.low.shape[0]
    current = np.empty(scan.points.shape[0], np.int64)
    interval = np.empty(2)
    bounds = np.empty(1 << n, np.int64)
    shift = np.empty(n, np.int64)
    # Level by level only the best are carried on; their children compete with each other.
    kept = min(widths[top], root_bound.shape[0])
    yaw = root_node[:kept, 0].copy()
    tilt = root_node[:kept, 1].copy()
    shifts = root_node[:kept, 2:].copy()
    bound = root_bound[:kept].copy()
    for level in range(top, 0, -1):
        used = 0
        for k in range(kept):
            if bound[k] <= state[BEST] or _left_out(lattice, rotations, region, level, yaw[k], tilt[k], shifts[k]):
                continue
            more = _expand(
                scan, lattice, rotations, tables, arcs, region, stack, used, level, yaw[k], tilt[k], shifts[k],
                bound[k], state, bounds,
            )  # fmt: skip
            if more < 0:
                return FULL
            used = more
        order = np.argsort(-stack.bound[:used], kind="mergesort")
        kept = min(widths[level - 1], used)
        order = order[:kept]
        yaw = stack.yaw[order]
        tilt = stack.tilt[order]
        shifts = stack.shift[order]
        bound = stack.bound[order]
    for k in range(kept):
        for a in range(n):
            shift[a] = shifts[k, a]
        if bound[k] <= state[BEST] or _left_out(lattice, rotations, region, 0, yaw[k], tilt[k], shift):
            continue
        if not _evaluate(
            scan, lattice, rotations, tables, arcs, yaw[k], tilt[k], shift, state, current, interval, best_node,
            best_yaw,
        ):  # fmt: skip
            return FULL
    return DONE


@njit(cache=True, nogil=True)
def search(
    scan,
    lattice,
    rotations,
    tables,
    arcs,
    region,
    root_level,
    root_bound,
    root_node,
    stack,
    state,
    best_node,
    best_yaw,
    most_nodes,
):
    """Carry a search on for ``most_nodes`` nodes; return DONE, PAUSED or FULL.

    Roots are of any level and sorted by falling bound.

    Nodes whose bound does not pass the best score so far are dropped; of the others the best child is looked at first,
    equal ones in a fixed order, so that the same input takes the same way on every run.
    """
    n = region.low.shape[0]
    current = np.empty(scan.points.shape[0], np.int64)
    interval = np.empty(2)
    bounds = np.empty(1 << n, np.int64)
    shift = np.empty(n, np.int64)
    end = state[NODES] + most_nodes
    while True:
        if state[USED] == 0:
            # The next root, unless no root that is left can win.
            r = state[ROOT]
            if r >= root_bound.shape[0] or root_bound[r] <= state[BEST]:
                return DONE
            _push(stack, 0, 0, root_level[r], root_node[r, 0], root_node[r, 1], root_node[r, 2:], root_bound[r])
            state[ROOT] += 1
            state[USED] = 1
        if state[NODES] >= end:
            return PAUSED
        at = state[USED] - 1
        level, q, tilt, bound = stack.level[at], stack.yaw[at], stack.tilt[at], stack.bound[at]
        for a in range(n):
            shift[a] = stack.shift[at, a]
        if bound <= state[BEST] or _left_out(lattice, rotations, region, level, q, tilt, shift):
            state[USED] = at
        elif level == 0:
            if not _evaluate(
                scan, lattice, rotations, tables, arcs, q, tilt, shift, state, current, interval, best_node, best_yaw
            ):
                return FULL
            state[USED] = at
        else:
            used = _expand(
                scan, lattice, rotations, tables, arcs, region, stack, at, level, q, tilt, shift, bound, state, bounds
            )
            if used < 0:
                # As it was before this node, so that the search can go on with more room.
                _push(stack, at, at, level, q, tilt, shift, bound)
                return FULL
            state[USED] = used
