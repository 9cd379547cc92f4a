"""Packed cell keys: one signed 64-bit number a lattice point, in the order of the index.

In space three fields of 21 bits (|index| < 2^20), in the plane two of 32 (|index| < 2^31 - 1).
Each field is offset so that it is never negative: the order of the keys is the lexicographic
order of the indices, and adding a constant to all keys shifts them all by a lattice vector.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["key_delta", "pack", "unpack"]

KeyArray: TypeAlias = NDArray[np.int64]


def _layout(dim: int) -> tuple[int, int]:
    """Return the bits of a field and the offset that makes it non-negative."""
    return (32, 2**31) if dim == 2 else (21, 2**20)


def pack(index: NDArray[np.int32]) -> KeyArray:
    """Return the keys (N,) of indices (N, n) that are known to be in range."""
    bits, offset = _layout(index.shape[1])
    i = index.astype(np.int64)
    if index.shape[1] == 2:
        return np.asarray((i[:, 0] << bits) + (i[:, 1] + offset))
    return np.asarray(((i[:, 0] + offset) << 2 * bits) | ((i[:, 1] + offset) << bits) | (i[:, 2] + offset))


def unpack(keys: KeyArray, dim: int) -> NDArray[np.int32]:
    """Return the indices (N, dim) int32 of keys (N,)."""
    bits, offset = _layout(dim)
    mask = (1 << bits) - 1
    out = np.empty((len(keys), dim), dtype=np.int32)
    if dim == 2:
        out[:, 0] = keys >> bits
        out[:, 1] = (keys & mask) - offset
    else:
        out[:, 0] = (keys >> 2 * bits) - offset
        out[:, 1] = ((keys >> bits) & mask) - offset
        out[:, 2] = (keys & mask) - offset
    return out


def key_delta(vector: NDArray[np.int64]) -> int:
    """Return what a shift by the lattice vector (n,) adds to every key, where no field overflows."""
    bits, _ = _layout(len(vector))
    total = 0
    for v in vector:
        total = (total << bits) + int(v)
    return (total + 2**63) % 2**64 - 2**63  # keys wrap around to the right place
