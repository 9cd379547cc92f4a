"""Numba kernels of the occupancy pyramid: writing weights into its tables.

Entries lie tile by tile in one flat array, and the address of an entry is a *sum of one number an axis*. Whatever lies
outside the map has an address in a tile that stays zero, so that no kernel that reads needs to check a bound.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def raise_cells(index, weights, low, address, values):
    """Raise the cells ``index`` (M, n) of the finest table to their ``weights`` (M,) at least."""
    for m in range(index.shape[0]):
        at = np.int64(0)
        for a in range(index.shape[1]):
            at += address[a, index[m, a] - low[a]]
        if values[at] < weights[m]:
            values[at] = weights[m]


@njit(cache=True, nogil=True)
def _raise_lane(values, at, shift, weight):
    """Raise one byte of a packed entry."""
    word = np.uint64(values[at])
    if (word >> shift) & np.uint64(255) < weight:
        values[at] = (word & ~(np.uint64(255) << shift)) | (weight << shift)


@njit(cache=True, nogil=True)
def raise_entries(index, weights, low, apart, step, window, first, address, values):
    """Raise all packed entries of one table whose boxes hold the cells ``index`` (M, n) to ``weights`` (M,) at least.

    An entry stands for the places from ``e * step`` on, ``step`` of them; byte c of it is the largest weight in the
    boxes of ``window`` indices that begin there, moved by ``apart`` along each axis whose bit is set in c.
    """
    n = index.shape[1]
    reach = window + step - 2
    first_entry = np.empty(n, np.int64)
    last_entry = np.empty(n, np.int64)
    for m in range(index.shape[0]):
        w = np.uint64(weights[m])
        for c in range(1 << n):
            for a in range(n):
                # The box of entry e holds this cell when it begins at most ``reach`` before it.
                b = index[m, a] - low[a] - (apart if (c >> a) & 1 else 0)
                first_entry[a] = -((reach - b) // step) - first[a]
                last_entry[a] = b // step - first[a]
            shift = np.uint64(8 * c)
            for i in range(first_entry[0], last_entry[0] + 1):
                for j in range(first_entry[1], last_entry[1] + 1):
                    row = address[0, i] + address[1, j]
                    if n == 2:
                        _raise_lane(values, row, shift, w)
                    else:
                        for k in range(first_entry[2], last_entry[2] + 1):
                            _raise_lane(values, row + address[2, k], shift, w)


@njit(cache=True, nogil=True)
def mark_blocks(index, low, level, shape, marked):
    """Mark the blocks of 2^level indices along each axis that hold one of the cells ``index`` (M, n)."""
    n = index.shape[1]
    for m in range(index.shape[0]):
        at = np.int64(0)
        for a in range(n):
            at = at * shape[a] + ((index[m, a] - low[a]) >> level)
        marked[at] = 1
