"""LiDAR logs read as a world of space: every scan at the pose that the map maker gives it, or that was given."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import LogError
from hexmap.io.lidar.lidar_log import LidarLog
from hexmap.poses.pose import Pose
from hexmap.poses.trajectory import Trajectory
from localisation.experiments.geometry import geometry_of
from localisation.experiments.settings import LEAST_SCANS, ExperimentSettings
from localisation.experiments.world import World
from localisation.lidar_settings import LidarSettings
from localisation.mapping.align import align_maps
from localisation.mapping.lidar_map import LidarMappingResult, build_lidar_map, fuse_lidar_log
from localisation.odometry.sweep import Velocity, deskewed

__all__ = ["placed_scans", "read_lidar_runs"]

_SPACE = geometry_of(3)
# Where only the poses of a map are wanted: cells of a metre cost next to nothing.
_POSES_ONLY = 1.0


@dataclass(frozen=True)
class _Run:
    """A log, the poses that were given for it, and the random draws of its points."""

    log: LidarLog
    poses: Trajectory | None
    number: int


def read_lidar_runs(
    log: LidarLog,
    poses: Trajectory | None,
    test: LidarLog | None,
    test_poses: Trajectory | None,
    associate: str | None,
    settings: ExperimentSettings,
) -> list[World]:
    """Return the scans of a log and of another run of the place, all at poses in the first one's frame.

    Raises:
        LogError: a log cannot be read, or has too few scans.
        TrajectoryError: poses do not go with the scans.
        AlignmentError: the other run's map is not found in the log's.
        MissingDependencyError: poses are to be found, and kiss-icp or gtsam cannot be loaded.
    """
    aligned = test is not None and test_poses is None
    first = _mapped(log, poses, associate, settings, whole=aligned)
    worlds = [_world(_Run(log, poses, 0), first.poses, Pose.identity(3), settings)]
    if test is not None:
        other = _mapped(test, test_poses, associate, settings, whole=aligned)
        T = align_maps(first.map, other.map).pose if aligned else Pose.identity(3)
        worlds.append(_world(_Run(test, test_poses, 1), other.poses, T, settings))
    return worlds


def _mapped(
    log: LidarLog, poses: Trajectory | None, associate: str | None, settings: ExperimentSettings, *, whole: bool
) -> LidarMappingResult:
    """Map a log by the defaults, the whole of it or as cheaply as its poses can be had."""
    ranges = _ranges(settings)
    if poses is None:
        return build_lidar_map(log, ranges if whole else LidarSettings(
            levels=1, free_space=False, max_range=ranges.max_range
        ))  # fmt: skip
    if not whole:
        ranges = LidarSettings(resolution=_POSES_ONLY, levels=1, free_space=False, max_range=ranges.max_range)
    return fuse_lidar_log(log, poses, ranges, associate=associate)


def _ranges(settings: ExperimentSettings) -> LidarSettings:
    return LidarSettings() if settings.max_range is None else LidarSettings(max_range=settings.max_range)


def _world(run: _Run, placed: Trajectory, T: Pose, settings: ExperimentSettings) -> World:
    """Return the scans of a log at the poses that some of them have, moved by ``T``."""
    scans: list[FloatArray] = []
    rows: list[FloatArray] = []
    for number, (points, pose) in enumerate(_in_order(run.log, placed, _ranges(settings))):
        if settings.points is not None and len(points) > settings.points:
            # At random: of a scan in the order of its rings every so-many-th point may be of one ring.
            draws = np.random.default_rng([settings.seed, run.number, number, 3])
            points = points[np.sort(draws.choice(len(points), settings.points, replace=False))]
        scans.append(points)
        rows.append(np.full(_SPACE.row, math.nan) if pose is None else _SPACE.to_row(T @ pose))
    if len(scans) < 2 * LEAST_SCANS:
        raise LogError(
            f"{run.log.path}: {len(scans)} scans are too few; the experiment needs {2 * LEAST_SCANS} or more"
        )
    return World(
        points=np.concatenate(scans),
        offsets=np.cumsum([0, *(len(s) for s in scans)]),
        poses=np.array(rows),
        odometry=np.full((len(scans), _SPACE.row), math.nan),
        run=np.full(len(scans), run.number),
        held_out=np.zeros(len(scans), np.bool_),
        # The poses are the sensor's.
        mounts=_SPACE.to_row(Pose.identity(3))[None],
        source=run.log.path.name,
        reference="",
        given=run.poses is not None,
    )


def _in_order(log: LidarLog, placed: Trajectory, ranges: LidarSettings) -> Iterator[tuple[FloatArray, Pose | None]]:
    """Yield the points of each scan in range, moved to where the sensor was at its stamp, and its pose, if it has one.

    Scans that the map maker left out have none; the others follow in the order of the log.
    """
    at = [placed[k] for k in range(len(placed))]
    k = 0
    for scan in log:
        known = k < len(at) and scan.stamp == placed.stamps[k]
        velocity = _velocity(at, placed.stamps, k) if known else None
        yield ranges.in_range(deskewed(scan, velocity)), at[k] if known else None
        k += known


def placed_scans(
    log: LidarLog, poses: Trajectory | None, associate: str | None = None
) -> Iterator[tuple[FloatArray, Pose]]:
    """Yield the points (P, 3) of each scan of a LiDAR's log in its own frame, and its pose T_map_sensor.

    Args:
        log: an open log.
        poses: T_map_sensor, given; None: those that the map maker finds.
        associate: how poses go with scans: "order", "time", or as fits.

    Raises:
        LogError: the log cannot be read or has no scan.
        TrajectoryError: the poses go with no scan, or not by the order asked for.
        MissingDependencyError: poses are to be found, and kiss-icp or gtsam cannot be loaded.
    """
    settings = ExperimentSettings()
    found = _mapped(log, poses, associate, settings, whole=False)
    for points, pose in _in_order(log, found.poses, _ranges(settings)):
        if pose is not None:
            yield points, pose


def _velocity(poses: list[Pose], stamps: FloatArray, k: int) -> Velocity | None:
    """Return the sensor's velocity at scan ``k``: from the scan before, at the first one to the scan after."""
    if len(poses) < 2:
        return None
    a, b = (k - 1, k) if k else (0, 1)
    return Velocity.between(poses[a].inverse() @ poses[b], float(stamps[b] - stamps[a]))
