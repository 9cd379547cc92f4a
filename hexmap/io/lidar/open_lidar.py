"""Open the log of a LiDAR: a bag with clouds, or a folder of point files."""

from __future__ import annotations

import os
from pathlib import Path

from hexmap.base.errors import FileAccessError, HexmapError, LogError
from hexmap.io.lidar.bag import CLOUD, LidarBag
from hexmap.io.lidar.folder import LidarFolder, scan_files
from hexmap.io.lidar.lidar_log import LidarLog, LidarLogSettings
from hexmap.io.logs.open_bag import open_sound_bag
from hexmap.io.logs.open_log import bag_kind

__all__ = ["is_lidar_log", "open_lidar"]


def open_lidar(path: str | os.PathLike[str], settings: LidarLogSettings | None = None) -> LidarLog:
    """Open the log of a LiDAR.

    Args:
        path: a ROS 1 bag, a ROS 2 bag (folder or its single file) or an MCAP file with sensor_msgs/PointCloud2, or a
            folder of PCD, PLY, KITTI .bin, NPY or text files, one a scan.
        settings: how to read it.

    Returns:
        The log, to be iterated over: :class:`~hexmap.poses.Scan` of points (N, 3) in the sensor's frame, metres.

    Raises:
        FileAccessError: there is no such file, or it cannot be read.
        LogError: it is something else, is empty, or has no cloud in it.
    """
    settings = settings or LidarLogSettings()
    path = Path(path)
    if not path.exists():
        raise FileAccessError(f"{path}: no such file or folder")
    found = bag_kind(path)
    if found is not None:
        return LidarBag(path, settings, *found)
    if path.is_dir():
        return LidarFolder(path, settings)
    raise LogError(f"{path}: neither a bag with clouds nor a folder of point files")


def is_lidar_log(path: Path) -> bool:
    """Tell whether a path is a bag with clouds and no planar laser, or a folder of point files."""
    try:
        found = bag_kind(path)
        if found is None:
            return path.is_dir() and bool(scan_files(path))
        source = open_sound_bag(path, *found)
    except (HexmapError, OSError):
        return False
    try:
        kinds = set(source.topics.values())
    finally:
        source.close()
    return CLOUD in kinds and "sensor_msgs/msg/LaserScan" not in kinds

