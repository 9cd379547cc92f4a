"""What a cell is, from its hits and passes: one rule that pictures, exports, planners and matchers share."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral, Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError
from hexmap.maps.cell_state import CellState
from hexmap.maps.voxel_list import VoxelList


@dataclass(frozen=True)
class StateRule:
    """What a cell is, from its hits and passes.

    Occupied: at least ``min_hits`` hits, and hits make up at least ``min_ratio`` of hits and
    passes. Free: not occupied, and at least ``min_passes`` beams went through. Else unknown. A
    wall seen at a grazing angle is passed by many beams that end in the next cell of the same
    wall, so the ratio that still means a wall is well below a half (Karto's default is a tenth, too).

    Attributes:
        min_hits: hits it takes, at least 1.
        min_ratio: hits / (hits + passes) it takes, 0 to 1.
        min_passes: beams it takes for free, at least 1.
    """

    min_hits: int = 1
    min_ratio: float = 0.1
    min_passes: int = 1

    def __post_init__(self) -> None:
        """Check the limits."""
        for name in ("min_hits", "min_passes"):
            value = getattr(self, name)
            if not isinstance(value, Integral) or isinstance(value, bool) or value < 1:
                raise ArgumentError(f"{name} must be a whole number of at least 1, not {value!r}")
        ratio = self.min_ratio
        if not isinstance(ratio, Real) or isinstance(ratio, bool) or not 0.0 <= ratio <= 1.0:
            raise ArgumentError(f"min_ratio must be a number from 0 to 1, not {ratio!r}")

    def occupied(self, hits: NDArray[np.int64], passes: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Tell where cells with these counts are occupied."""
        # The quotient, correctly rounded, meets a ratio written as a decimal; the product misses 7 of 25 at 0.28.
        # Both counts are below 2^63, so that their sum may need the 64th bit but no more.
        of = np.asarray(hits).astype(np.uint64) + np.asarray(passes).astype(np.uint64)
        return np.asarray((hits >= self.min_hits) & (hits / np.maximum(of, 1) >= self.min_ratio))


@dataclass(frozen=True, eq=False)
class States:
    """Which cells are occupied and which are free; all others are unknown.

    Attributes:
        occupied: the occupied cells, with their hits as counts.
        free: the free cells, with their passes as counts.
    """

    occupied: VoxelList
    free: VoxelList

    def of(self, index: ArrayLike) -> NDArray[np.uint8]:
        """Return the :class:`CellState` (K,) of each of the indices (K, n)."""
        occupied = self.occupied.contains(index)
        free = self.free.contains(index)
        known = np.where(free, CellState.FREE, CellState.UNKNOWN)
        return np.where(occupied, CellState.OCCUPIED, known).astype(np.uint8)
