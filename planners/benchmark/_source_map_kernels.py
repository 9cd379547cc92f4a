"""Numba kernel of the source map: which points are too near to a pinch."""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def near_pinch(points, origin, cosine, sine, cell, radius_squared, across, shapes, starts, pinched, out):
    """Mark in ``out`` (N,) those of ``points`` (N, n), metres, that are too near to a pinch of any kind.

    A kind is a set of axes, ``across`` (M, n), in which pinches are points; along the others they reach through a
    whole cell. Its vertices and layers are the array of ``shapes`` (M, n) from ``starts`` (M,) on in ``pinched``.
    """
    n = points.shape[1]
    vertex = np.empty(n)
    layer = np.empty(n)
    gap_squared = np.empty(n)
    for i in range(points.shape[0]):
        # Coordinates in cells, with the operations of ``grid_coordinates`` and so its bits.
        x = points[i, 0] - origin[0]
        y = points[i, 1] - origin[1]
        for k in range(n):
            if k == 0:
                u = (cosine * x + sine * y) / cell
            elif k == 1:
                u = (-sine * x + cosine * y) / cell
            else:
                u = (points[i, k] - origin[k]) / cell
            vertex[k] = np.rint(u)
            layer[k] = np.floor(u) + 1.0
            gap = (u - vertex[k]) * cell
            gap_squared[k] = gap * gap
        out[i] = False
        for m in range(across.shape[0]):
            distance_squared = 0.0
            for k in range(n):
                if across[m, k]:
                    distance_squared += gap_squared[k]
            if distance_squared >= radius_squared:
                continue
            at = 0
            for k in range(n):
                place = np.int64(vertex[k] if across[m, k] else layer[k])
                at = at * shapes[m, k] + min(max(place, 0), shapes[m, k] - 1)
            if pinched[starts[m] + at]:
                out[i] = True
                break
