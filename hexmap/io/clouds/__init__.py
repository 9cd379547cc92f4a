"""Point files: PCD, PLY, text (XYZ, CSV), KITTI scans and NPY; and which of their points to use.

Examples:
    >>> from hexmap.io.clouds import PointFilter, read_points
    >>> cloud = read_points("hall.pcd")  # doctest: +SKIP
    >>> points = PointFilter(min_range=0.5, unique=True).apply(cloud.points)  # doctest: +SKIP
"""

from __future__ import annotations

from hexmap.io.clouds.filters import FilterReport, PointFilter, random_sample, unique_points, within_box, within_range
from hexmap.io.clouds.read_points import FORMATS, PointFile, read_points
from hexmap.io.clouds.scans import scans_to_points

__all__ = [
    "FORMATS",
    "FilterReport",
    "PointFile",
    "PointFilter",
    "random_sample",
    "read_points",
    "scans_to_points",
    "unique_points",
    "within_box",
    "within_range",
]
