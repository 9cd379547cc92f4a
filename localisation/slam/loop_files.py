"""Tables of what closing loops found: every loop that was tried, and how sure each pose is."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Iterable

import numpy as np

from hexmap.base.atomic_files import atomic_write
from localisation.slam import spatial
from localisation.slam.lidar_slam import LidarSlamResult
from localisation.slam.slam import SlamResult

__all__ = ["write_covariances", "write_loops"]

_LOOPS = (
    "old_node", "new_node", "old_scan", "new_scan", "old_stamp", "new_stamp", "accepted", "reason", "sigma_m",
    "sigma_deg", "score", "total", "gap", "margin", "overlap", "contradicted", "reverse_m", "reverse_deg", "chi2",
)  # fmt: skip
_PLANE = ("x", "y", "heading_deg")
_SPACE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_COVARIANCES = ("stamp", "scan", "x", "y", "heading", "xx", "xy", "xt", "yy", "yt", "tt")
_AXES = ("x", "y", "z", "rx", "ry", "rz")


def write_loops(path: str | os.PathLike[str], result: SlamResult | LidarSlamResult) -> None:
    """Write every loop that was tried as a line of a CSV file.

    Nodes and scans count from 0; the last columns are the pose of the new node as seen from the old one: ``x``, ``y``
    and ``heading_deg`` in the plane, place and quaternion in space. Numbers that a loop did not get to are empty. See
    :class:`~localisation.slam.loop_search.LoopRecord`.

    Raises:
        FileAccessError: the folder is missing or not writable.
    """
    space = isinstance(result, LidarSlamResult)
    rows = []
    for record in result.records:
        scans = [result.node_scans[record.i], result.node_scans[record.j]]
        stamps = [result.stamps[s] if isinstance(result, LidarSlamResult) else result.scans[s].stamp for s in scans]
        pose: Iterable[float | None] = (None,) * len(_SPACE if space else _PLANE)
        if record.pose is not None and space:
            T = spatial.to_pose(np.array(record.pose))
            pose = [*T.translation.tolist(), *T.quaternion().tolist()]
        elif record.pose is not None:
            pose = (record.pose[0], record.pose[1], math.degrees(record.pose[2]))
        reverse = None if record.reverse_radians is None else math.degrees(record.reverse_radians)
        rows.append([
            record.i, record.j, *scans, *[f"{stamp:.6f}" for stamp in stamps], int(record.accepted),
            record.reason, *map(_short, (record.sigma_metres, math.degrees(record.sigma_radians), record.score,
            record.total, record.gap, record.margin, record.overlap, record.contradicted, record.reverse_metres,
            reverse, record.chi2, *pose)),
        ])  # fmt: skip
    _write(path, (*_LOOPS, *(_SPACE if space else _PLANE)), rows)


def write_covariances(path: str | os.PathLike[str], result: SlamResult | LidarSlamResult) -> None:
    """Write how sure each pose is, a line for each laser and odometry reading, in the log's order.

    Columns: stamp in seconds, whether it is a scan, the pose T_map_robot in metres and radians, and the upper triangle
    of the covariance of x, y and heading in the map's frame, relative to the first pose. In space a line for each scan:
    stamp, place and quaternion of T_map_robot, and the upper triangle of the covariance of a translation and a
    rotation vector in the map's axes, about the robot; the robot is the sensor where its mount is not known.

    Raises:
        FileAccessError: the folder is missing or not writable.
    """
    if isinstance(result, LidarSlamResult):
        _write_in_space(path, result)
        return
    turn = np.zeros((len(result.poses), 3, 3))
    c, s = np.cos(result.poses[:, 2]), np.sin(result.poses[:, 2])
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = c, -s, s, c, 1.0
    covariances = turn @ result.covariances @ np.swapaxes(turn, 1, 2)
    upper = covariances[:, *np.triu_indices(3)]
    rows = [
        [f"{stamp:.6f}", int(scan), *[f"{v:.9f}" for v in pose], *[f"{v:.6g}" for v in row]]
        for stamp, scan, pose, row in zip(
            result.stamps.tolist(), result.is_scan.tolist(), result.poses.tolist(), upper.tolist(), strict=True
        )
    ]
    _write(path, _COVARIANCES, rows)


def _write_in_space(path: str | os.PathLike[str], result: LidarSlamResult) -> None:
    names = [f"{a}_{b}" for k, a in enumerate(_AXES) for b in _AXES[k:]]
    turn = np.zeros((len(result.poses), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = result.poses[:, :9].reshape(-1, 3, 3)
    covariances = turn @ result.covariances @ np.swapaxes(turn, 1, 2)
    upper = covariances[:, *np.triu_indices(6)]
    rows: list[list[object]] = []
    for k, (stamp, row) in enumerate(zip(result.stamps.tolist(), upper.tolist(), strict=True)):
        T = result.pose(k)
        pose = [*T.translation.tolist(), *T.quaternion().tolist()]
        rows.append([f"{stamp:.6f}", *[f"{v:.9f}" for v in pose], *[f"{v:.6g}" for v in row]])
    _write(path, ("stamp", *_SPACE, *names), rows)


def _short(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"


def _write(path: str | os.PathLike[str], names: tuple[str, ...], rows: list[list[object]]) -> None:
    with atomic_write(path, "w") as handle:
        writer = csv.writer(handle, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(rows)
