"""Numba kernel of the particle filter: what a scan says of each particle.

The quantiser is the lattice's. Numba does not notice when that is edited: delete the caches then.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from hexmap.lattice._kernels import quantise_2d


class Field(NamedTuple):
    """What a beam that ends in a cell adds to a particle's log-likelihood.

    Attributes:
        values: flat, row by row of the box of cells.
        low: (2,) index of its first cell.
        shape: (2,) cells along each index.
        beyond: of a cell outside the box.
    """

    values: np.ndarray
    low: np.ndarray
    shape: np.ndarray
    beyond: float


@njit(cache=True, nogil=True)
def weigh(particles, beams, field, quantiser, out):
    """Write the sum over ``beams`` (B, 2) at each of the ``particles`` (P, 3: x, y, theta) into ``out`` (P,).

    Returns the number of beams that end outside the range of indices; they add what lies outside the box.
    """
    q = quantiser
    count = beams.shape[0]
    placed = np.empty((count, 2))
    index = np.empty((count, 2), np.int32)
    low0, low1 = field.low[0], field.low[1]
    size0, size1 = field.shape[0], field.shape[1]
    bad = 0
    for k in range(particles.shape[0]):
        x, y = particles[k, 0], particles[k, 1]
        c, s = np.cos(particles[k, 2]), np.sin(particles[k, 2])
        # All beams of a particle first: the quantiser takes blocks of points.
        for b in range(count):
            placed[b, 0] = c * beams[b, 0] - s * beams[b, 1] + x
            placed[b, 1] = s * beams[b, 0] + c * beams[b, 1] + y
        wrong = quantise_2d(
            placed, q.inverse, q.gram2, q.constants, q.extra, q.extra_constants, q.to_public, q.limit, index
        )
        bad += wrong
        total = 0.0
        for b in range(count):
            i0, i1 = np.int64(index[b, 0]) - low0, np.int64(index[b, 1]) - low1
            if wrong == 0 and 0 <= i0 < size0 and 0 <= i1 < size1:
                total += field.values[i0 * size1 + i1]
            else:
                total += field.beyond
        out[k] = total
    return bad
