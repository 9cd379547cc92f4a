"""Packed cell keys: one signed 64-bit number a lattice point, in the order of the index.

In space three fields of 21 bits (|index| < 2^20), in the plane two of 32 (|index| < 2^31 - 1).
Each field is offset so that it is never negative: the order of the keys is the lexicographic
order of the indices, and adding a constant to all keys shifts them all by a lattice vector.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["key_delta", "layout", "pack", "unpack"]

KeyArray: TypeAlias = NDArray[np.int64]


def layout(dim: int) -> tuple[int, NDArray[np.int64]]:
    """Return the bits of a field and what is added to each index, so that fields are not negative."""
    if dim == 2:
        # The first field is the high half of a signed number and may be negative.
        return 32, np.array([0, 2**31], dtype=np.int64)
    return 21, np.full(3, 2**20, dtype=np.int64)


def pack(index: NDArray[np.int32]) -> KeyArray:
    """Return the keys (N,) of indices (N, n) that are known to be in range."""
    bits, offset = layout(index.shape[1])
    keys = np.zeros(len(index), np.int64)
    for column, added in zip(index.T, offset, strict=True):
        keys <<= bits
        keys += column
        keys += added
    return keys


def unpack(keys: KeyArray, dim: int) -> NDArray[np.int32]:
    """Return the indices (N, dim) int32 of keys (N,)."""
    bits, offset = layout(dim)
    mask = (1 << bits) - 1
    out = np.empty((len(keys), dim), dtype=np.int32)
    for k in range(dim):
        field = keys >> bits * (dim - 1 - k)
        out[:, k] = (field if k == 0 else field & mask) - offset[k]
    return out


def key_delta(vector: NDArray[np.int64]) -> int:
    """Return what a shift by the lattice vector (n,) adds to every key, where no field overflows."""
    bits, _ = layout(len(vector))
    total = 0
    for v in vector:
        total = (total << bits) + int(v)
    return (total + 2**63) % 2**64 - 2**63  # keys wrap around to the right place
