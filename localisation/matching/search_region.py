"""Where a matcher looks: a window around a prediction, or a region of a map."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from hexmap.base.arrays import FloatArray, IntArray, frozen
from hexmap.base.errors import ArgumentError
from hexmap.base.values import one_line
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.window import IndexBox, box_coordinates
from hexmap.maps.voxel_list import VoxelList

__all__ = ["SearchRegion", "SearchWindow", "box_of_cells", "cells_of_box", "shifts_in_ball"]


@dataclass(frozen=True)
class SearchWindow:
    """Where to look: all poses within ``metres`` and ``radians`` of the prediction."""

    metres: float = 0.5
    radians: float = math.radians(20.0)

    def __post_init__(self) -> None:
        """Check the limits."""
        if not (0.0 <= self.metres < math.inf and 0.0 <= self.radians <= math.pi):
            raise ArgumentError(f"not a search window: {self.metres} m, {self.radians} rad")


@dataclass(frozen=True, eq=False)
class SearchRegion:
    """A region of poses T_map_scan for :class:`~localisation.matching.GlobalMatcher`.

    Attributes:
        low: (n,) lowest translation in metres; None: the whole map.
        high: (n,) highest translation in metres; None: the whole map.
        yaw: middle of the angles about z, radians.
        yaw_range: how far the yaw may be from it to either side, radians; pi for all of them.
        tilt: in space, how far the sensor's z axis may lean away from the map's, radians (about any horizontal axis).

    Raises:
        ArgumentError: one corner without the other, corners that do not make a box, or an angle out of its range.
    """

    low: ArrayLike | None = None
    high: ArrayLike | None = None
    yaw: float = 0.0
    yaw_range: float = math.pi
    tilt: float = 0.0

    __repr__ = one_line

    def __post_init__(self) -> None:
        """Check the limits."""
        if (self.low is None) != (self.high is None):
            raise ArgumentError("a region takes both corners or none")
        if self.low is not None and self.high is not None:
            low, high = frozen(self.low), frozen(self.high)
            fits = low.shape == high.shape and low.ndim == 1
            if not (fits and (low <= high).all() and np.isfinite([low, high]).all()):
                raise ArgumentError(f"the corners of a region must be finite, the low one first, not {low} and {high}")
            object.__setattr__(self, "low", low)
            object.__setattr__(self, "high", high)
        if not (math.isfinite(self.yaw) and 0.0 <= self.yaw_range <= math.pi and 0.0 <= self.tilt <= math.pi / 2):
            raise ArgumentError(f"not a range of angles: {self.yaw} +- {self.yaw_range} rad, tilt {self.tilt} rad")

    def box(self, lattice: Lattice) -> tuple[FloatArray, FloatArray] | None:
        """Return the corners, or None for the whole map.

        Raises:
            ArgumentError: the corners are not of the lattice's dimension.
        """
        if self.low is None or self.high is None:
            return None
        low, high = np.asarray(self.low), np.asarray(self.high)
        if len(low) != lattice.dim:
            raise ArgumentError(
                f"the corners of a region have {len(low)} numbers, the map is of dimension {lattice.dim}"
            )
        return low, high


@lru_cache(maxsize=64)
def shifts_in_ball(lattice: Lattice, metres: float) -> IntArray:
    """Return the lattice vectors (K, n) no longer than ``metres``, lexicographically: the shifts of a window."""
    reach = np.ceil(metres * np.linalg.norm(np.linalg.inv(lattice.basis), axis=1)).astype(np.int64)
    grids = np.meshgrid(*[np.arange(-r, r + 1) for r in reach], indexing="ij")
    offsets = np.stack([g.ravel() for g in grids], axis=1)
    offsets = offsets[(lattice.centres(offsets) ** 2).sum(axis=1) <= (metres * (1.0 + 1e-12)) ** 2]
    offsets.setflags(write=False)
    return offsets


def cells_of_box(lattice: Lattice, low: FloatArray, high: FloatArray) -> VoxelList:
    """Return all cells of a box, whose corners (n,) are in metres, and those around it."""
    return VoxelList.from_cells(box_of_cells(lattice, low, high).cells(), lattice)


def box_of_cells(lattice: Lattice, low: FloatArray, high: FloatArray) -> IndexBox:
    """Return the box of indices of these cells: a large one need not be written down cell by cell."""
    u = box_coordinates(lattice.basis, low, high)
    first, last = np.floor(u.min(axis=0)).astype(np.int64) - 1, np.ceil(u.max(axis=0)).astype(np.int64) + 1
    return IndexBox.of_corners(first, last)
