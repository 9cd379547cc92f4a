"""Numba kernels of the surfaces that points lie on: sums of the points of each cell, and drawing a scan onto them.

The hash is the counter's, the quantiser the lattice's. Numba does not notice when those are edited: delete the caches
then (``make clean``).
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from hexmap.lattice._kernels import quantise_3d
from hexmap.maps._counter_kernels import EMPTY, cell_key, slot

SUMS = 10


class SurfaceArrays(NamedTuple):
    """The cells that hold points, and the plane through each.

    Attributes:
        table: (K,) int64 keys of cells, ``EMPTY`` where there is none; K is a power of two.
        rows: (K,) int64 which row has that key.
        sums: (M, 10) how many points, their sum, and the sums xx, xy, xz, yy, yz, zz, from the cell's centre, metres.
        means: (M, 3) a point on the plane, metres.
        normals: (M, 3) unit normals.
        variances: (M,) mean squared distance of the points from the plane; -1 where the points lie on no plane.
    """

    table: np.ndarray
    rows: np.ndarray
    sums: np.ndarray
    means: np.ndarray
    normals: np.ndarray
    variances: np.ndarray


@njit(cache=True, nogil=True)
def add(arrays, index, points, basis, sign, begin, used, changed):
    """Add points to the sums of their cells, or take them away (``sign`` -1); stops where there is no room.

    Returns:
        The first point that was not taken, and how many rows there are.
    """
    room = min(arrays.sums.shape[0], arrays.table.shape[0] // 2)
    for k in range(begin, points.shape[0]):
        a, b, c = np.int64(index[k, 0]), np.int64(index[k, 1]), np.int64(index[k, 2])
        at = slot(arrays.table, cell_key(a, b, c, 3))
        if arrays.table[at] == EMPTY:
            if sign < 0.0:
                continue
            if used >= room:
                return k, used
            arrays.table[at] = cell_key(a, b, c, 3)
            arrays.rows[at] = used
            used += 1
        row = arrays.rows[at]
        x = points[k, 0] - (basis[0, 0] * a + basis[0, 1] * b + basis[0, 2] * c)
        y = points[k, 1] - (basis[1, 0] * a + basis[1, 1] * b + basis[1, 2] * c)
        z = points[k, 2] - (basis[2, 0] * a + basis[2, 1] * b + basis[2, 2] * c)
        s = arrays.sums[row]
        s[0] += sign
        s[1] += sign * x
        s[2] += sign * y
        s[3] += sign * z
        s[4] += sign * x * x
        s[5] += sign * x * y
        s[6] += sign * x * z
        s[7] += sign * y * y
        s[8] += sign * y * z
        s[9] += sign * z * z
        changed[row] = True
    return points.shape[0], used


@njit(cache=True, nogil=True)
def first_of_each(index, mask, chosen):
    """Mark the first point of each cell; ``mask`` is a table of twice as many slots as points, at least."""
    table = mask
    table[:] = EMPTY
    for k in range(index.shape[0]):
        key = cell_key(np.int64(index[k, 0]), np.int64(index[k, 1]), np.int64(index[k, 2]), 3)
        at = slot(table, key)
        if table[at] == EMPTY:
            table[at] = key
            chosen[k] = True


@njit(cache=True, nogil=True)
def find_planes(arrays, tables, placed, index, planes):
    """Quantise points (P, 3) and find the row of the plane in each one's cell; -1 where there is none.

    Returns:
        How many lie in cells that hold points, on a plane or not.
    """
    met = 0
    quantise_3d(placed, tables.inverse, tables.gram2, tables.constants, tables.extra, tables.extra_constants,
                tables.to_public, tables.limit, index)  # fmt: skip
    for k in range(placed.shape[0]):
        at = slot(arrays.table, cell_key(np.int64(index[k, 0]), np.int64(index[k, 1]), np.int64(index[k, 2]), 3))
        planes[k] = -1
        if arrays.table[at] != EMPTY:
            met += 1
            if arrays.variances[arrays.rows[at]] >= 0.0:
                planes[k] = arrays.rows[at]
    return met


@njit(cache=True, nogil=True)
def normal_equations(arrays, placed, planes, origin, width, H, g):
    """Sum up the normal equations of the distances of points to their planes, weighted by how well each fits.

    The motion is a translation and a rotation vector about ``origin``. A point ``width`` metres off its plane counts a
    quarter (Geman and McClure).

    Returns:
        The sum of weights, the weighted sum of squared distances, and how many points have a plane.
    """
    H[:] = 0.0
    g[:] = 0.0
    J = np.empty(6)
    total = 0.0
    squares = 0.0
    count = 0
    for k in range(placed.shape[0]):
        row = planes[k]
        if row < 0:
            continue
        count += 1
        n0, n1, n2 = arrays.normals[row, 0], arrays.normals[row, 1], arrays.normals[row, 2]
        x, y, z = placed[k, 0], placed[k, 1], placed[k, 2]
        r = n0 * (x - arrays.means[row, 0]) + n1 * (y - arrays.means[row, 1]) + n2 * (z - arrays.means[row, 2])
        w = 1.0 + r * r / (width * width)
        w = 1.0 / (w * w)
        x -= origin[0]
        y -= origin[1]
        z -= origin[2]
        J[0], J[1], J[2] = n0, n1, n2
        J[3] = y * n2 - z * n1
        J[4] = z * n0 - x * n2
        J[5] = x * n1 - y * n0
        total += w
        squares += w * r * r
        for i in range(6):
            g[i] += w * J[i] * r
            for j in range(i, 6):
                H[i, j] += w * J[i] * J[j]
    for i in range(6):
        for j in range(i):
            H[i, j] = H[j, i]
    return total, squares, count
