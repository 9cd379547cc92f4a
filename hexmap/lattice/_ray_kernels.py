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
def count_bound(start, end, planes, half):
    """Return for each ray an upper bound of the number of its cells: walls it can cross, plus two."""
    n = start.shape[1]
    out = np.empty(start.shape[0], dtype=np.int64)
    for r in range(start.shape[0]):
        total = 2
        for k in range(planes.shape[0]):
            rate = 0.0
            for i in range(n):
                rate += (end[r, i] - start[r, i]) * planes[k, i]
            if rate > 0.0:
                total += np.int64(rate / (2.0 * half[k])) + 2
        out[r] = total
    return out


@njit(cache=True, nogil=True)
def traverse(start, end, start_offset, first, last, planes, half, products, vectors, room, out, ends):
    """Write the cells of each ray into ``out`` and where each ray's cells end into ``ends``.

    ``start``, ``end`` (R, n) are reduced coordinates; ``start_offset`` (R, n) those of the start
    minus its cell; ``first``, ``last`` (R, n) the end cells in the public basis; ``vectors`` the
    faces in the public basis, ``planes`` G v in the reduced one, ``products`` v G w.
    """
    n = start.shape[1]
    faces = planes.shape[0]
    times = np.empty(faces)
    gaps = np.empty(faces)
    rates = np.empty(faces)
    ahead = np.empty(faces, dtype=np.int64)
    cell = np.empty(n, dtype=np.int64)
    w = 0
    for r in range(start.shape[0]):
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
        missing = 0
        for i in range(n):
            cell[i] = first[r, i]
            if cell[i] != last[r, i]:
                missing += 1
        entered = -1.0
        steps = 0
        while missing > 0 and steps < room[r]:
            steps += 1
            best = 0
            for j in range(1, m):
                if times[j] < times[best]:
                    best = j
                elif times[j] == times[best]:
                    a = ahead[j]
                    b = ahead[best]
                    for i in range(n):
                        va = vectors[a, i] / rates[j]
                        vb = vectors[b, i] / rates[best]
                        if va < vb:
                            best = j
                            break
                        if va > vb:
                            break
            t = times[best]
            # Rounding may put a corner at the end of the ray on the other side: never go past the end.
            if min(t, 1.0) > entered:
                for i in range(n):
                    out[w, i] = cell[i]
                w += 1
                entered = max(t, 0.0)
            if t > 1.0:
                break
            k = ahead[best]
            missing = 0
            for i in range(n):
                cell[i] += vectors[k, i]
                if cell[i] != last[r, i]:
                    missing += 1
            for j in range(m):
                gaps[j] += products[k, ahead[j]]
                times[j] = gaps[j] / rates[j]
        for i in range(n):
            out[w, i] = last[r, i]
        w += 1
        ends[r] = w
    return w
