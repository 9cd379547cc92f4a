"""Scans of a LiDAR, one after the other: ROS 1 and ROS 2 bags and MCAP with PointCloud2, and folders of point files.

Examples:
    >>> from hexmap.io.lidar import open_lidar
    >>> for scan in open_lidar("run/"):  # doctest: +SKIP
    ...     print(scan.stamp, scan.points.shape)
"""

from __future__ import annotations

from hexmap.io.lidar.lidar_log import LidarLog, LidarLogSettings
from hexmap.io.lidar.open_lidar import is_lidar_log, open_lidar

__all__ = ["LidarLog", "LidarLogSettings", "is_lidar_log", "open_lidar"]
