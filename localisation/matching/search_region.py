"""Where a matcher looks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hexmap.base.arrays import IntArray
from hexmap.base.errors import ArgumentError
from hexmap.lattice.lattice import Lattice


@dataclass(frozen=True)
class SearchWindow:
    """Where to look: all poses within ``metres`` and ``radians`` of the prediction."""

    metres: float = 0.5
    radians: float = math.radians(20.0)

    def __post_init__(self) -> None:
        """Check the limits."""
        if not (0.0 <= self.metres < math.inf and 0.0 <= self.radians <= math.pi):
            raise ArgumentError(f"not a search window: {self.metres} m, {self.radians} rad")


@lru_cache(maxsize=64)
def shifts_in_ball(lattice: Lattice, metres: float) -> IntArray:
    """Return the lattice vectors (K, n) no longer than ``metres``, lexicographically: the shifts of a window."""
    reach = np.ceil(metres * np.linalg.norm(np.linalg.inv(lattice.basis), axis=1)).astype(np.int64)
    grids = np.meshgrid(*[np.arange(-r, r + 1) for r in reach], indexing="ij")
    offsets = np.stack([g.ravel() for g in grids], axis=1)
    offsets = offsets[(lattice.centres(offsets) ** 2).sum(axis=1) <= (metres * (1.0 + 1e-12)) ** 2]
    offsets.setflags(write=False)
    return offsets
