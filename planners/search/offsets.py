"""Vectors of lattice indices, as tuples where they are looked up, and what flat offsets stand for."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from hexmap.base.arrays import IntArray

__all__ = ["Vector", "offset_vectors", "plus"]

Vector: TypeAlias = tuple[int, ...]


def plus(a: Vector, b: Vector) -> Vector:
    """Return the sum of two index vectors."""
    return tuple(x + y for x, y in zip(a, b, strict=True))


def offset_vectors(flat: IntArray, pad: IntArray, shape: IntArray, strides: IntArray) -> IntArray:
    """Return the index vectors (S, n) of flat offsets (S,), none of which leads beyond the padding ``pad`` (n,)."""
    # Counted from a cell on the padding's inner edge each ends inside the window, which makes it unique.
    at = np.unravel_index(flat + pad @ strides, tuple(int(s) for s in shape))
    return np.stack(at, axis=1) - pad
