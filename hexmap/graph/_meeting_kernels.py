"""The Numba kernel of :mod:`hexmap.graph.meeting`."""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def block_met(bodies, inverse, basis, span, normals, limits, layout, free):
    """Set to 0 in ``free`` all cells whose centre is, from one of ``bodies`` (M, n), inside the given half-spaces.

    ``span`` (n,) is how far, in coordinates of the basis, that shape reaches along each index.
    """
    n = bodies.shape[1]
    low, high, at = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    offset = np.empty(n, np.float64)
    for row in range(bodies.shape[0]):
        # The box of indices around the body, cut to the window.
        some = True
        for k in range(n):
            u = 0.0
            for j in range(n):
                u += inverse[k, j] * bodies[row, j]
            low[k] = max(layout.first[k], np.int64(np.ceil(u - span[k])))
            high[k] = min(layout.first[k] + layout.inner[k] - 1, np.int64(np.floor(u + span[k])))
            at[k] = low[k]
            some &= low[k] <= high[k]
        while some:
            for j in range(n):
                offset[j] = -bodies[row, j]
                for k in range(n):
                    offset[j] += basis[j, k] * at[k]
            inside = True
            for plane in range(normals.shape[0]):
                reach = 0.0
                for j in range(n):
                    reach += normals[plane, j] * offset[j]
                if reach >= limits[plane]:
                    inside = False
                    break
            if inside:
                flat = 0
                for k in range(n):
                    flat += (at[k] - layout.first[k] + layout.pad[k]) * layout.strides[k]
                free[flat] = 0
            # The next index of the box, the last one fastest.
            k = n - 1
            while k >= 0 and at[k] == high[k]:
                at[k] = low[k]
                k -= 1
            if k < 0:
                some = False
            else:
                at[k] += 1
