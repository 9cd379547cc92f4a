"""Scores: one non-negative whole number a cell, what a point that falls into it counts.

A matcher adds them up and asks for nothing else, so that every score has the same search, bounds and certificate. One
of your own is a :class:`~hexmap.maps.VoxelList` whose counts are the numbers; cells that are not in it count nothing.
"""

from __future__ import annotations

import math

import numpy as np

from hexmap.base.errors import ArgumentError
from hexmap.maps.voxel_list import VoxelList
from localisation.matching.search_region import shifts_in_ball

__all__ = ["coincidence", "hits", "likelihood"]


def coincidence(cells: VoxelList) -> VoxelList:
    """Return one for each cell: the score is the number of points that meet an occupied cell."""
    return VoxelList(cells.lattice, cells.keys, np.ones_like(cells.counts))


def hits(cells: VoxelList, most: int = 255) -> VoxelList:
    """Return how often each cell was hit, at most ``most``: walls that were seen often count more.

    Raises:
        ArgumentError: ``most`` is not 1 to 65,535.
    """
    if not 1 <= most <= 65535:
        raise ArgumentError(f"a weight is 1 to 65,535, not {most}")
    return VoxelList(cells.lattice, cells.keys, np.minimum(cells.counts, most))


def likelihood(cells: VoxelList, sigma: float, most: int = 16) -> VoxelList:
    """Return a likelihood field in whole numbers: ``most`` at the cells, falling with a Gaussian of the distance.

    Each cell counts ``most`` exp(-d^2 / (2 sigma^2)), rounded, d the distance of its centre from that of the nearest
    occupied cell (Thrun, Burgard and Fox, "Probabilistic Robotics", 6.4).

    Args:
        cells: the occupied cells.
        sigma: metres.
        most: the weight of an occupied cell, 1 to 65,535.

    Raises:
        ArgumentError: a number is out of its range.
    """
    if not (0.0 < sigma < math.inf and 1 <= most <= 65535):
        raise ArgumentError(f"a likelihood field takes a positive sigma and a weight of 1 to 65,535: {sigma}, {most}")
    lattice = cells.lattice
    reach = sigma * math.sqrt(2.0 * math.log(2.0 * most))
    offsets = shifts_in_ball(lattice, reach)
    squared = (lattice.centres(offsets) ** 2).sum(axis=1)
    weights = np.rint(most * np.exp(-0.5 * squared / sigma**2)).astype(np.int64)
    # The nearest cells first, so that each cell keeps the largest weight: the first that claims it.
    claimed = VoxelList.empty(lattice)
    for k in np.argsort(squared, kind="stable"):
        if weights[k] > 0:
            moved = cells.shift(offsets[k])
            fresh = moved.select(~claimed.contains(moved.index))
            claimed = claimed.merge(VoxelList(lattice, fresh.keys, np.full(len(fresh), weights[k])))
    return claimed
