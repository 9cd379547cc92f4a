"""Logs read as a world: which scans make the maps and which are looked for, and where the reference is from."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError, LogError, TrajectoryError
from hexmap.io.lidar.lidar_log import LidarLog
from hexmap.io.logs.log import Log
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Event, Odometry, Scan
from hexmap.poses.trajectory import Trajectory
from localisation.experiments.lidar_reading import read_lidar_runs
from localisation.experiments.settings import LEAST_SCANS, ExperimentSettings
from localisation.experiments.world import World, built_poses
from localisation.mapping.fuse_log import readings_at_poses
from localisation.settings import MappingSettings

__all__ = ["aligned_case", "read_world", "reference_case"]

Runner: TypeAlias = Callable[[Any, list[dict[str, Any]], Mapping[str, Any]], list[dict[str, Any]]]

# ---------------------------------------------------------------------- reference poses


def reference_case(case: dict[str, Any], rng: np.random.Generator, shared: Mapping[str, Any]) -> dict[str, Any]:
    """Map all scans of a log by the map maker's defaults and return their poses; a case, so that it is kept."""
    world = World.of_shared(shared)
    _, poses = built_poses(world, np.flatnonzero(world.run == case["run"]))
    return {"poses": _nullable(poses)}


def aligned_case(case: dict[str, Any], rng: np.random.Generator, shared: Mapping[str, Any]) -> dict[str, Any]:
    """Map another run by itself, find that map in the first one's, and return the run's poses there.

    Raises:
        AlignmentError: the runs are not of one place beyond doubt.
    """
    from localisation.mapping.align import align_maps
    from localisation.settings import make_builder

    world = World.of_shared(shared)
    first = make_builder(MappingSettings())
    for k in np.flatnonzero((world.run == 0) & world.known).tolist():
        first.fuse(Scan(0.0, world.scan(k)), world.pose(k))
    result, poses = built_poses(world, np.flatnonzero(world.run == case["run"]))
    T = align_maps(first.build(), result.map).pose
    for k in np.flatnonzero(~np.isnan(poses).any(axis=1)).tolist():
        poses[k] = world.geometry.to_row(T @ world.geometry.to_pose(poses[k]))
    return {"poses": _nullable(poses)}


def _nullable(rows: FloatArray) -> list[list[float] | None]:
    return [None if math.isnan(row[0]) else row.tolist() for row in rows]


def _rows(values: list[list[float] | None]) -> FloatArray:
    return np.array([[math.nan] * 3 if row is None else row for row in values], dtype=np.float64).reshape(-1, 3)


# ---------------------------------------------------------------------- reading


def read_world(
    log: Log | LidarLog,
    settings: ExperimentSettings,
    run: Runner,
    *,
    poses: Trajectory | None = None,
    test: Log | LidarLog | None = None,
    test_poses: Trajectory | None = None,
    associate: str | None = None,
) -> World:
    """Read a log and split it, or take another run of the same place for the scans that are looked for.

    Args:
        log: of the map; of a planar laser or of a LiDAR.
        settings: how to split.
        run: computes cases: the poses are built where none are given.
        poses: T_map_robot of the log, the reference; None: those that the map maker finds.
        test: another run; None: the log itself is split by time.
        test_poses: T_map_robot of it, in the same frame; None: its own map is found in the log's.
        associate: how poses go with scans: "order", "time", or as fits.

    Raises:
        LogError: a log cannot be read, or has too few scans.
        TrajectoryError: poses do not go with the scans.
        ArgumentError: poses of a test run without poses of the log, or without a test run; lattices of the plane for a
            LiDAR's log, or the reverse; a planar log and a LiDAR's.
        AlignmentError: the other run's map is not found in the log's.
    """
    if test_poses is not None and (test is None or poses is None):
        raise ArgumentError("--test-poses needs --test and --poses: all poses must be in one frame")
    settings.check_dim(3 if isinstance(log, LidarLog) else 2)
    if isinstance(log, LidarLog):
        if isinstance(test, Log):
            raise ArgumentError(f"{log.path.name} is a LiDAR's log and {test.path.name} is a planar one")
        world = _joined(read_lidar_runs(log, poses, test, test_poses, associate, settings))
    else:
        if isinstance(test, LidarLog):
            raise ArgumentError(f"{log.path.name} is a planar log and {test.path.name} is a LiDAR's")
        world = _planar_world(log, settings, run, poses, test, test_poses, associate)
    words = _where_from(log, poses, test if test_poses is None else None)
    world = replace(world, held_out=_held_out(world, settings), reference=words, given=poses is not None)
    for numbers, what in ((world.map_scans(), "for the map"), (world.test_scans(), "to look for")):
        if len(numbers) < LEAST_SCANS:
            raise LogError(f"{log.path}: {len(numbers)} scans with a pose are left {what}; the least is {LEAST_SCANS}")
    return world


def _planar_world(
    log: Log,
    settings: ExperimentSettings,
    run: Runner,
    poses: Trajectory | None,
    test: Log | None,
    test_poses: Trajectory | None,
    associate: str | None,
) -> World:
    """Return the scans of planar logs with their poses, given or found."""
    parts = [_read(log, poses, 0, associate, settings)]
    if test is not None:
        parts.append(_read(test, test_poses, 1, associate, settings))
    world = _joined(parts)
    if poses is None:
        (found,) = run(reference_case, [{"run": 0}], world.shared())
        world = replace(world, poses=np.where(np.isnan(world.poses), _rows(found["poses"]), world.poses))
    if test is not None and test_poses is None:
        (found,) = run(aligned_case, [{"run": 1}], world.shared())
        world = replace(world, poses=np.where(np.isnan(world.poses), _rows(found["poses"]), world.poses))
    return world


def _where_from(log: Log | LidarLog, poses: Trajectory | None, aligned: Log | LidarLog | None) -> str:
    """Say where the reference poses are from; ``aligned`` is the other run where its poses are found by its map."""
    words = (
        f"Errors are measured against the poses given for {log.path.name}."
        if poses is not None
        else f"No poses were given for {log.path.name}: errors are measured against those that the map maker itself "
        "finds with all of its scans and its defaults, so they say how well scans are found in the maps of this "
        "project, and not how true those are; it builds them on its default lattice, which may favour that one below "
        "some centimetres."
    )
    if isinstance(log, LidarLog):
        words += (
            " Where points have times they were moved to where the sensor was at the stamp of their scan by the motion "
            "of these poses; up is the z axis of their frame."
        )
    if aligned is not None:
        words += (
            f" The poses of {aligned.path.name} come from its own map, found as a whole in the first one: where two "
            "maps bend differently that is an error of the reference."
        )
    return words


def _held_out(world: World, settings: ExperimentSettings) -> NDArray[np.bool_]:
    """Tell which scans are looked for."""
    if world.run.any():
        return np.asarray(world.run > 0)
    number = np.arange(len(world))
    if settings.split == "half":
        return np.asarray(number >= len(world) // 2)
    return np.asarray(number % settings.hold_out == settings.hold_out // 2)


def _read(log: Log, poses: Trajectory | None, run: int, associate: str | None, settings: ExperimentSettings) -> World:
    """Return the scans of one log."""
    events: Iterator[tuple[Event, Pose | None]] = ((event, None) for event in log)
    if poses is not None:
        events = readings_at_poses(log, poses, associate=associate)
    reading: Pose | None = None
    scans: list[FloatArray] = []
    placed: list[Pose | None] = []
    odometry: list[tuple[float, float, float]] = []
    farthest = math.inf if settings.max_range is None else settings.max_range
    for event, pose in events:
        if isinstance(event, Odometry):
            reading = event.pose
            continue
        if event.dim != 2:
            raise LogError(f"{log.path}: the experiment takes planar scans, not scans of dimension {event.dim}")
        there = event.odometry if event.odometry is not None else reading
        points = event.points[np.isfinite(event.points).all(axis=1)]
        scans.append(points[np.sqrt((points**2).sum(axis=1)) <= farthest])
        placed.append(pose)
        odometry.append((math.nan,) * 3 if there is None else (there.x, there.y, there.theta))
    if len(scans) < 2 * LEAST_SCANS:
        raise LogError(f"{log.path}: {len(scans)} scans are too few; the experiment needs {2 * LEAST_SCANS} or more")
    if poses is not None and all(pose is None for pose in placed):
        raise TrajectoryError(f"none of the {len(poses)} poses goes with one of the {len(scans)} scans of {log.path}")
    mount = log.mount or Pose.identity(2)
    at = [None if pose is None else pose @ mount for pose in placed]
    return World(
        points=np.concatenate(scans),
        offsets=np.cumsum([0, *(len(s) for s in scans)]),
        poses=_rows([None if p is None else [p.x, p.y, p.theta] for p in at]),
        odometry=np.array(odometry, dtype=np.float64),
        run=np.full(len(scans), run),
        held_out=np.zeros(len(scans), np.bool_),
        mounts=np.array([[mount.x, mount.y, mount.theta]]),
        source=log.path.name,
        reference="",
        given=poses is not None,
    )


def _joined(parts: list[World]) -> World:
    """Put the scans of several logs one after the other."""
    starts = np.cumsum([0, *(len(p.points) for p in parts[:-1])])
    return replace(
        parts[0],
        points=np.concatenate([p.points for p in parts]),
        offsets=np.concatenate([[0], *(p.offsets[1:] + s for p, s in zip(parts, starts, strict=True))]),
        poses=np.concatenate([p.poses for p in parts]),
        odometry=np.concatenate([p.odometry for p in parts]),
        run=np.concatenate([p.run for p in parts]),
        held_out=np.concatenate([p.held_out for p in parts]),
        mounts=np.concatenate([p.mounts for p in parts]),
        source=" and ".join(p.source for p in parts),
    )
