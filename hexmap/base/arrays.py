"""Small array helpers that every layer may use."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["FloatArray", "IntArray", "frozen", "multiply"]

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]


def multiply(points: FloatArray, matrix: FloatArray) -> FloatArray:
    """Return ``points`` (N, n), each multiplied by ``matrix`` (n, n).

    Written out by columns: a matrix product of a linear algebra library may round a row
    differently when the number of rows changes, and results must not depend on how work is cut.
    """
    out = np.empty((len(points), len(matrix)), dtype=np.float64)
    for i, row in enumerate(matrix):
        out[:, i] = points[:, 0] * row[0]
        for k in range(1, len(row)):
            out[:, i] += points[:, k] * row[k]
    return out


def frozen(values: ArrayLike) -> FloatArray:
    """Return ``values`` as a contiguous, read-only float64 copy."""
    a = np.array(values, dtype=np.float64, order="C")
    a.setflags(write=False)
    return a
