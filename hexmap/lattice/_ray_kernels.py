"""Numba kernel of the ray traversal through the Voronoi cells of any lattice.

A generalisation of Amanatides and Woo (1987): in cell c the ray u(t) = u0 + t d leaves through the
first face v that it reaches, where (u(t) - c) G v = v G v / 2. Coordinates are multiples of 2^-32
and G is integer on every named lattice, so numerators and denominators are exact, and two faces
that are reached at the same time are seen to be.

Ties follow the quantiser's rule (the lexicographically lower index wins), which is the same as
moving the whole ray by an infinitesimal towards lower indices: of faces reached together the ray
first crosses the one whose v / (d G v) is lexicographically least. Cells that the true ray meets
in a single point are left out.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def count_bound(start, end, tables):
    """Return for each ray an upper bound of the number of its cells: walls it can cross, plus two."""
    planes, half = tables.planes, tables.half
    n = start.shape[1]
    out = np.empty(start.shape[0], dtype=np.int64)
    for r in range(start.shape[0]):
        total = 2
        for k in range(planes.shape[0]):
            rate = 0.0
            for i in range(n):
                rate += (end[r, i] - start[r, i]) * planes[k, i]
            # The walls of one face stand v G v = 2 half apart; only those ahead are crossed, one more by rounding.
            if rate > 0.0:
                total += np.int64(rate / (2.0 * half[k])) + 2
        out[r] = total
    return out


@njit(cache=True, nogil=True)
def _first_reached(times, rates, ahead, vectors, m):
    """Return which of the ``m`` faces ahead the ray reaches first, by the tie rule where it reaches several."""
    best = 0
    for j in range(1, m):
        if times[j] < times[best]:
            best = j
        elif times[j] == times[best]:
            # Both at once: the face whose v / (d G v) is lexicographically less would be first for a ray moved
            # a little towards lower indices.
            a = ahead[j]
            b = ahead[best]
            for i in range(vectors.shape[1]):
                va = vectors[a, i] / rates[j]
                vb = vectors[b, i] / rates[best]
                if va < vb:
                    best = j
                    break
                if va > vb:
                    break
    return best


@njit(cache=True, nogil=True)
def traverse(start, end, start_offset, first, last, tables, room, out, ends):
    """Write the cells of each ray into ``out`` and where each ray's cells end into ``ends``.

    ``start``, ``end`` (R, n) are reduced coordinates; ``start_offset`` (R, n) those of the start
    minus its cell; ``first``, ``last`` (R, n) the end cells in the public basis; ``tables`` the
    faces (:class:`hexmap.lattice.lattice.RayTables`); ``room`` (R,) the bounds of :func:`count_bound`.
    """
    vectors, planes, half, products = tables.vectors, tables.planes, tables.half, tables.products
    n = start.shape[1]
    faces = planes.shape[0]
    # Of the m faces that the ray can leave through: which, how fast it nears them, how far off they are, and when.
    ahead = np.empty(faces, dtype=np.int64)
    rates = np.empty(faces)
    gaps = np.empty(faces)
    times = np.empty(faces)
    cell = np.empty(n, dtype=np.int64)
    w = 0
    for r in range(start.shape[0]):
        # The faces ahead: d G v > 0. A ray never leaves through the others, in whichever cell it is.
        m = 0
        for k in range(faces):
            rate = 0.0
            gap = half[k]
            for i in range(n):
                rate += (end[r, i] - start[r, i]) * planes[k, i]
                gap -= start_offset[r, i] * planes[k, i]
            if rate > 0.0:
                ahead[m] = k
                rates[m] = rate
                gaps[m] = gap
                times[m] = gap / rate
                m += 1
        # The walk ends where all indices are those of the last cell, which ``missing`` counts as it goes.
        missing = 0
        for i in range(n):
            cell[i] = first[r, i]
            if cell[i] != last[r, i]:
                missing += 1
        entered = -1.0
        steps = 0
        while missing > 0 and steps < room[r]:
            steps += 1
            best = _first_reached(times, rates, ahead, vectors, m)
            t = times[best]
            # A cell that is left when it is entered is met in a point and left out. Rounding may put a corner at
            # the end of the ray on the other side: never go past the end.
            if min(t, 1.0) > entered:
                for i in range(n):
                    out[w, i] = cell[i]
                w += 1
                entered = max(t, 0.0)
            if t > 1.0:
                break
            # Step across the face. Seen from the next cell every face w has moved away by v G w, which is exact
            # where G is integer: gaps do not drift, however long the ray.
            k = ahead[best]
            missing = 0
            for i in range(n):
                cell[i] += vectors[k, i]
                if cell[i] != last[r, i]:
                    missing += 1
            for j in range(m):
                gaps[j] += products[k, ahead[j]]
                times[j] = gaps[j] / rates[j]
        # The quantiser says which cell the end is in, also on a wall.
        for i in range(n):
            out[w, i] = last[r, i]
        w += 1
        ends[r] = w
    return w


# ---------------------------------------------------------------------- many rays at once, in space

LANES = 16
ONE = np.uint64(1)
_FACES = 8  # that a ray may cross, filled up: no cell in space has more than 14
# Times of crossings, 0 to 1 along a ray, that differ by less are left to the exact walk.
_CLOSE = 1e-12
_NEVER = 1e300


class SignTables(NamedTuple):
    """What a step across a face adds, by the signs of a ray: bit j is set where it nears the face ``pairs[j, 1]``.

    Attributes:
        filled: (2^P,) uint8, whether a pattern was met.
        deltas: (2^P, 8) int64, to packed keys.
        products: (2^P, 8, 8) float64, to the gaps of all faces.
    """

    filled: np.ndarray
    deltas: np.ndarray
    products: np.ndarray


@njit(cache=True, nogil=True)
def empty_signs(pairs):
    """Return tables of signs with no pattern filled."""
    patterns = 1 << pairs
    return SignTables(
        np.zeros(patterns, np.uint8), np.empty((patterns, _FACES), np.int64), np.empty((patterns, _FACES, _FACES))
    )


@njit(cache=True, nogil=True)
def face_pairs(tables):
    """Return the faces of a cell in space as pairs (P, 2): each with the one opposite."""
    vectors = tables.vectors
    faces = vectors.shape[0]
    pairs = np.empty((faces // 2, 2), np.int64)
    found = 0
    for f in range(faces):
        for g in range(f + 1, faces):
            opposite = True
            for i in range(vectors.shape[1]):
                opposite = opposite and vectors[f, i] == -vectors[g, i]
            if opposite:
                pairs[found, 0], pairs[found, 1] = f, g
                found += 1
    return pairs


@njit(cache=True, nogil=True, inline="always")
def _least_two(a0, b0, a1, b1):
    """Return the least and the second least of two such pairs of numbers."""
    low = a0 if a0 < a1 else a1
    high = a1 if a0 < a1 else a0
    next_ = b0 if b0 < b1 else b1
    return low, high if high < next_ else next_


class Lanes(NamedTuple):
    """Where up to ``LANES`` rays are on their way; indices are unsigned, as signed ones may count from the end.

    Attributes:
        gaps: (L, 8) float64 how far off the faces ahead are.
        inverse: (L, 8) float64 one over how fast the ray nears them.
        pattern: (L,) uint64 the signs of the ray.
        key: (L,) int64 of the cell it is in.
        at: (L,) uint64 where the next key is written.
        limit: (L,) uint64 where the last one may be.
        entered: (L,) float64 when it entered the cell.
        active: (L,) uint64 the rays that go on, in the first entries.
    """

    gaps: np.ndarray
    inverse: np.ndarray
    pattern: np.ndarray
    key: np.ndarray
    at: np.ndarray
    limit: np.ndarray
    entered: np.ndarray
    active: np.ndarray


@njit(cache=True, nogil=True)
def _set_out(start, end, offset, first, tables, pairs, signs, room, begins):
    """Return the :class:`Lanes` of rays at their starts; the arguments are those of :func:`walk_keys`."""
    planes, half = tables.planes, tables.half
    lanes = Lanes(
        np.full((LANES, _FACES), _NEVER), np.ones((LANES, _FACES)), np.empty(LANES, np.uint64),
        np.empty(LANES, np.int64), np.empty(LANES, np.uint64), np.empty(LANES, np.uint64), np.full(LANES, -1.0),
        np.empty(LANES, np.uint64),
    )  # fmt: skip
    for r in range(start.shape[0]):
        mask = np.int64(0)
        # Of each two opposite faces the ray nears one; which ones these are is the pattern of its signs.
        for j in range(pairs.shape[0]):
            f = pairs[j, 0]
            rate = 0.0
            for i in range(3):
                rate += (end[r, i] - start[r, i]) * planes[f, i]
            if rate < 0.0:
                mask |= np.int64(1) << j
                f = pairs[j, 1]
                rate = 0.0
                for i in range(3):
                    rate += (end[r, i] - start[r, i]) * planes[f, i]
            if rate > 0.0:
                gap = half[f]
                for i in range(3):
                    gap -= offset[r, i] * planes[f, i]
                lanes.gaps[r, j] = gap
                lanes.inverse[r, j] = 1.0 / rate
        lanes.pattern[r] = mask
        if signs.filled[mask] == 0:
            _fill_signs(signs, mask, pairs, tables)
        lanes.key[r] = first[r]
        lanes.at[r] = begins[r]
        lanes.limit[r] = begins[r] + room[r] - 1
    return lanes


@njit(cache=True, nogil=True)
def walk_keys(start, end, offset, first, last, tables, pairs, signs, room, out, begins, stops):
    """Write the packed keys of the cells of up to ``LANES`` rays in space, all at once.

    A step along one ray waits for the step before; steps along several rays do not wait for each other. So each ray
    takes a step in turn. Times of crossings are compared as quotients rounded once more than :func:`traverse` rounds
    them, with the number of the face in their last bits: wherever that could decide otherwise, the ray is left to
    :func:`traverse`.

    Args:
        start: (L, 3) reduced coordinates.
        end: (L, 3) the same.
        offset: (L, 3) of the start from its cell.
        first: (L,) packed keys of the cells of the starts.
        last: (L,) those of the ends.
        tables: :class:`hexmap.lattice.lattice.RayTables`.
        pairs: of :func:`face_pairs`.
        signs: a :class:`SignTables`, filled as signs of rays are met.
        room: (L,) the bounds of :func:`count_bound`.
        out: the keys of ray r are written from ``begins[r]`` on.
        begins: (L,) where the keys of each ray begin.
        stops: (L,) where they end, or -1 where the ray is left to :func:`traverse`.
    """
    deltas, products, known = signs.deltas, signs.products, pairs.shape[0]
    lanes = _set_out(start, end, offset, first, tables, pairs, signs, room, begins)
    gaps, inverse, pattern, key = lanes.gaps, lanes.inverse, lanes.pattern, lanes.key
    at, limit, entered, active = lanes.at, lanes.limit, lanes.entered, lanes.active
    times = np.empty((LANES, _FACES))
    # The bits of positive numbers are ordered as the numbers are.
    bits = times.view(np.int64)
    count = 0
    for r in range(start.shape[0]):
        if first[r] == last[r]:
            out[begins[r]] = last[r]
            stops[r] = begins[r] + 1
        else:
            active[count] = r
            count += 1
    few, many = known <= 4, known > 6
    while count > 0:
        i = 0
        while i < count:
            r = active[i]
            times[r, 0] = gaps[r, 0] * inverse[r, 0]
            times[r, 1] = gaps[r, 1] * inverse[r, 1]
            times[r, 2] = gaps[r, 2] * inverse[r, 2]
            times[r, 3] = gaps[r, 3] * inverse[r, 3]
            t0 = bits[r, 0] & -8
            t1 = (bits[r, 1] & -8) | 1
            t2 = (bits[r, 2] & -8) | 2
            t3 = (bits[r, 3] & -8) | 3
            a0 = t0 if t0 < t1 else t1
            b0 = t1 if t0 < t1 else t0
            a1 = t2 if t2 < t3 else t3
            b1 = t3 if t2 < t3 else t2
            best, second = _least_two(a0, b0, a1, b1)
            if not few:
                times[r, 4] = gaps[r, 4] * inverse[r, 4]
                times[r, 5] = gaps[r, 5] * inverse[r, 5]
                t0 = (bits[r, 4] & -8) | 4
                t1 = (bits[r, 5] & -8) | 5
                a0 = t0 if t0 < t1 else t1
                b0 = t1 if t0 < t1 else t0
                best, second = _least_two(best, second, a0, b0)
                if many:
                    times[r, 6] = gaps[r, 6] * inverse[r, 6]
                    t2 = (bits[r, 6] & -8) | 6
                    high = t2 if best < t2 else best
                    best = best if best < t2 else t2
                    second = second if second < high else high
            face = np.uint64(best & 7)
            bits[r, 7] = second
            t = times[r, face]
            # Less than zero, later than the end, together with another face or no later than the cell was entered.
            clear = (best >= 0) & (t < 1.0 - _CLOSE) & (t > entered[r] + _CLOSE) & (times[r, 7] - t > _CLOSE)
            w = at[r]
            if not clear or w >= limit[r]:
                stops[r] = -1
                count -= 1
                active[i] = active[count]
                continue
            entered[r] = t
            mask = pattern[r]
            there = key[r]
            out[w] = there
            w += ONE
            at[r] = w
            there += deltas[mask, face]
            key[r] = there
            if there == last[r]:
                out[w] = there
                stops[r] = w + ONE
                count -= 1
                active[i] = active[count]
                continue
            # Step across the face, as in :func:`traverse`.
            g0 = gaps[r, 0] + products[mask, face, 0]
            g1 = gaps[r, 1] + products[mask, face, 1]
            g2 = gaps[r, 2] + products[mask, face, 2]
            g3 = gaps[r, 3] + products[mask, face, 3]
            gaps[r, 0] = g0
            gaps[r, 1] = g1
            gaps[r, 2] = g2
            gaps[r, 3] = g3
            if not few:
                g0 = gaps[r, 4] + products[mask, face, 4]
                g1 = gaps[r, 5] + products[mask, face, 5]
                gaps[r, 4] = g0
                gaps[r, 5] = g1
                if many:
                    gaps[r, 6] = gaps[r, 6] + products[mask, face, 6]
            i += 1


@njit(cache=True, nogil=True)
def _fill_signs(signs, mask, pairs, tables):
    """Fill the entries of a pattern of signs: what a step across each face ahead adds to keys and gaps."""
    signs.filled[mask] = 1
    for j in range(_FACES):
        signs.deltas[mask, j] = 0
        for k in range(_FACES):
            signs.products[mask, j, k] = 0.0
    for j in range(pairs.shape[0]):
        f = pairs[j, (mask >> j) & 1]
        v = tables.vectors[f]
        signs.deltas[mask, j] = v[0] * (np.int64(1) << 42) + v[1] * (np.int64(1) << 21) + v[2]
        for k in range(pairs.shape[0]):
            signs.products[mask, j, k] = tables.products[f, pairs[k, (mask >> k) & 1]]
