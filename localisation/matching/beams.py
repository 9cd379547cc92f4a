"""Beams that contradict a map: those that end beyond a wall.

Where a scan is in the wrong place by chance its points may still fall onto walls, but its beams then go through others.
A beam that enters a wall and ends inside it is not beyond it: walls of maps are as thick as their maker drew them.
"""

from __future__ import annotations

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.lattice.rays import traverse
from hexmap.poses.pose import Pose
from localisation.matching.pyramid import OccupancyPyramid

__all__ = ["contradicted_share"]

# How far before its end a beam must meet a wall to contradict it: in resolutions, and metres at the least. A beam
# along a wall meets the wall's own cells before it ends on it.
_BEFORE = 4.0
_LEAST = 0.3
# Cells of walls it must meet: one alone may be a stray hit.
_CELLS = 2


def contradicted_share(pyramid: OccupancyPyramid, points: FloatArray, pose: Pose) -> float:
    """Return the share (0 to 1) of the beams that go through two or more occupied cells and out again before they end.

    Args:
        pyramid: the map's occupied cells.
        points: (P, n) the ends of the beams in the sensor's frame, metres.
        pose: T_map_scan.
    """
    lattice = pyramid.lattice
    ranges = np.sqrt((points**2).sum(axis=1))
    shorter = ranges - max(_LEAST, _BEFORE * lattice.resolution)
    long = shorter > lattice.resolution
    if not long.any():
        return 0.0
    ends = pose.apply(points[long] * (shorter[long] / ranges[long])[:, None])
    cells = traverse(lattice, np.broadcast_to(pose.translation, ends.shape), ends)
    met = pyramid.weights(cells.index) > 0
    starts = cells.offsets[:-1]
    # What counts is before the last cell that is not of a wall: beyond it the beam has not come out again.
    last = np.maximum.reduceat(np.where(met, -1, np.arange(len(met))), starts)
    before = np.concatenate([[0], np.cumsum(met)])
    walls = before[np.maximum(last, starts)] - before[starts]
    return float((walls >= _CELLS).sum() / len(points))
