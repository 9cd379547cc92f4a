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
