"""Numba kernels around one pose: its score, and the surface of scores around it.

All of them read the finest table of an occupancy pyramid, so that their cost does not depend on how far a scan sees.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def _weight(tables, cell):
    """Return the weight of a cell (n,); cells beyond the addresses have none."""
    at = np.int64(0)
    for a in range(cell.shape[0]):
        k = cell[a] - tables.low[a]
        if k < 0 or k >= tables.length:
            return np.int64(0)
        at += tables.cell_address[a * tables.length + k]
    return np.int64(tables.cells[at])


@njit(cache=True, nogil=True)
def weights_of(tables, index, out):
    """Write the weight of each of the cells ``index`` (M, n)."""
    cell = np.empty(index.shape[1], np.int64)
    for m in range(index.shape[0]):
        for a in range(index.shape[1]):
            cell[a] = index[m, a]
        out[m] = _weight(tables, cell)


@njit(cache=True, nogil=True)
def surface(tables, index, weights, shifts, out):
    """Write the score of each rotation's cells ``index`` (R, P, n) under each of the ``shifts`` (K, n) into (R, K)."""
    n = shifts.shape[1]
    cell = np.empty(n, np.int64)
    for r in range(index.shape[0]):
        for k in range(shifts.shape[0]):
            total = np.int64(0)
            for p in range(index.shape[1]):
                for a in range(n):
                    cell[a] = index[r, p, a] + shifts[k, a]
                total += np.int64(weights[p]) * _weight(tables, cell)
            out[r, k] = total


@njit(cache=True, nogil=True)
def widened_surface(tables, table, back, index, weights, shifts, out):
    """Write what :func:`surface` does with every cell's weight the largest of the box around it, in whole units.

    The boxes are those of ``table``, and begin ``back`` indices before the cell along each axis: an upper bound of the
    scores of all poses that move no point out of its box.
    """
    n = shifts.shape[1]
    first = table * n * tables.length
    for r in range(index.shape[0]):
        for k in range(shifts.shape[0]):
            total = np.int64(0)
            for p in range(index.shape[1]):
                at = np.int64(0)
                inside = True
                for a in range(n):
                    # Addresses end where nothing is: cells beyond them have no box with a weight in it.
                    c = index[r, p, a] + shifts[k, a] - back - tables.low[a]
                    if c < 0 or c >= tables.length:
                        inside = False
                        break
                    at += tables.address[first + a * tables.length + c]
                if inside:
                    total += np.int64(weights[p]) * np.int64(np.uint64(tables.packed[at]) & np.uint64(255))
            out[r, k] = total * tables.unit
