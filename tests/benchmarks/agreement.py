"""How well overlapping passes of a log agree: the mean distance of one pass's points to the map of the others.

A pass is what was seen along a stretch of way. Its others are all scans that were taken more than so many metres of way
before or after it: what the same visit saw says nothing of whether two visits agree. Both are thinned to one point a
cell: the mean of what fell into it. Points with none of the others' within the overlap's distance were seen once only.
Time plays no part: some logs have no useful stamps.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from hexmap.base.arrays import FloatArray
from hexmap.lattice.lattice import Lattice
from hexmap.poses.pose import Pose

__all__ = ["agreement"]

_PASS_METRES = 10.0
_APART_METRES = 20.0
_OVERLAP_METRES = 0.5


def agreement(scans: Sequence[FloatArray], poses: Sequence[Pose], resolution: float = 0.1) -> tuple[float, float]:
    """Return the mean distance of passes' points to the map of the others, metres, and the share that overlap.

    Args:
        scans: points (P, 2) of each scan in its sensor's frame, metres.
        poses: T_map_sensor of each.
        resolution: of the map, metres.
    """
    lattice = Lattice.named("Z2", resolution)
    at = np.array([pose.translation for pose in poses])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(at, axis=0).T))])
    number = np.floor(way / _PASS_METRES).astype(np.int64)
    passes: list[FloatArray] = []
    for k in range(int(number[-1]) + 1):
        chosen = np.flatnonzero(number == k)
        seen = [poses[s].apply(scans[s]) for s in chosen.tolist()]
        points = np.concatenate(seen) if seen else np.zeros((0, 2))
        passes.append(_thinned(points, lattice))
    total, overlapping, count = 0.0, 0, 0
    apart = int(_APART_METRES / _PASS_METRES) + 1
    for k, points in enumerate(passes):
        others = [p for j, p in enumerate(passes) if abs(j - k) >= apart and len(p)]
        if not others or not len(points):
            count += len(points)
            continue
        # Of passes that disagree the mean counts, not the one that happens to lie nearest.
        others_map = _thinned(np.concatenate(others), lattice)
        distance, _ = cKDTree(others_map).query(points, distance_upper_bound=_OVERLAP_METRES)
        near = np.isfinite(distance)
        total += float(distance[near].sum())
        overlapping += int(near.sum())
        count += len(points)
    return total / max(1, overlapping), overlapping / max(1, count)


def _thinned(points: FloatArray, lattice: Lattice) -> FloatArray:
    """Return the mean of the points in each cell."""
    if not len(points):
        return points
    _, cell = np.unique(lattice.quantise(points), axis=0, return_inverse=True)
    cell = cell.ravel()
    return np.stack([np.bincount(cell, axis) for axis in points.T], axis=1) / np.bincount(cell)[:, None]
