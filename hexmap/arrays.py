"""Small array helpers that every layer may use."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["multiply"]


def multiply(points: NDArray[np.float64], matrix: NDArray[np.float64]) -> NDArray[np.float64]:
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
