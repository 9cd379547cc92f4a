"""Dense boxes of lattice indices: strides and flat offsets, in one place."""

from __future__ import annotations

import numpy as np

from hexmap.base.arrays import IntArray


def strides(shape: IntArray) -> IntArray:
    """Return the strides, in cells, of a row-major window."""
    strides = np.ones(len(shape), np.int64)
    for k in range(len(shape) - 2, -1, -1):
        strides[k] = strides[k + 1] * shape[k + 1]
    return strides
