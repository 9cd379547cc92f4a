"""The points of a log: its scans, each carried into the map by its pose."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan

__all__ = ["scans_to_points"]


def scans_to_points(pairs: Iterable[tuple[Scan, Pose]]) -> NDArray[np.float64]:
    """Return the points of all scans in the map's frame, in the order of the scans.

    The caller, who knows the log and its poses, says which pose goes with which scan.

    Args:
        pairs: scans with their ``T_map_sensor``; all of one dimension.

    Returns:
        (N, n) float64, metres; (0, 2) where there are no scans.

    Raises:
        ArgumentError: a pose of another dimension than its scan, or scans of different dimensions.

    Examples:
        >>> import numpy as np
        >>> from hexmap import Pose, Scan
        >>> from hexmap.io.clouds import scans_to_points
        >>> scan = Scan(0.0, np.array([[1.0, 0.0]]))
        >>> scans_to_points([(scan, Pose.planar(2.0, 0.0, 0.0)), (scan, Pose.planar(0.0, 3.0, 0.0))]).tolist()
        [[3.0, 0.0], [1.0, 3.0]]
    """
    parts: list[NDArray[np.float64]] = []
    for scan, T_map_sensor in pairs:
        points = T_map_sensor.apply(scan.points)
        if parts and points.shape[1] != parts[0].shape[1]:
            raise ArgumentError(f"scan {len(parts)} has dimension {points.shape[1]}, those before {parts[0].shape[1]}")
        parts.append(points)
    return np.concatenate(parts) if parts else np.empty((0, 2))
