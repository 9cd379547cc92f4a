"""Tables of what closing loops found: every loop that was tried, and how sure each pose is."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Iterable

import numpy as np

from hexmap.base.atomic_files import atomic_write
from localisation.slam.slam import SlamResult

__all__ = ["write_covariances", "write_loops"]

_LOOPS = (
    "old_node", "new_node", "old_scan", "new_scan", "old_stamp", "new_stamp", "accepted", "reason", "sigma_m",
    "sigma_deg", "score", "total", "gap", "margin", "overlap", "contradicted", "reverse_m", "reverse_deg", "chi2",
    "x", "y", "heading_deg",
)  # fmt: skip
_COVARIANCES = ("stamp", "scan", "x", "y", "heading", "xx", "xy", "xt", "yy", "yt", "tt")


def write_loops(path: str | os.PathLike[str], result: SlamResult) -> None:
    """Write every loop that was tried as a line of a CSV file.

    Nodes and scans count from 0; ``x``, ``y`` and ``heading_deg`` are the pose of the new node as seen from the old
    one; numbers that a loop did not get to are empty. See :class:`~localisation.slam.loop_closer.LoopRecord`.

    Raises:
        FileAccessError: the folder is missing or not writable.
    """
    rows = []
    for record in result.records:
        scans = [result.node_scans[record.i], result.node_scans[record.j]]
        pose: Iterable[float | None] = (None, None, None)
        if record.pose is not None:
            pose = (record.pose[0], record.pose[1], math.degrees(record.pose[2]))
        reverse = None if record.reverse_radians is None else math.degrees(record.reverse_radians)
        rows.append([
            record.i, record.j, *scans, *[f"{result.scans[s].stamp:.6f}" for s in scans], int(record.accepted),
            record.reason, *map(_short, (record.sigma_metres, math.degrees(record.sigma_radians), record.score,
            record.total, record.gap, record.margin, record.overlap, record.contradicted, record.reverse_metres,
            reverse, record.chi2, *pose)),
        ])  # fmt: skip
    _write(path, _LOOPS, rows)


def write_covariances(path: str | os.PathLike[str], result: SlamResult) -> None:
    """Write how sure each pose is, a line for each laser and odometry reading, in the log's order.

    Columns: stamp in seconds, whether it is a scan, the pose T_map_robot in metres and radians, and the upper triangle
    of the covariance of x, y and heading in the map's frame, relative to the first pose.

    Raises:
        FileAccessError: the folder is missing or not writable.
    """
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


def _short(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"


def _write(path: str | os.PathLike[str], names: tuple[str, ...], rows: list[list[object]]) -> None:
    with atomic_write(path, "w") as handle:
        writer = csv.writer(handle, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(rows)
