"""A log split into scans of the map and scans that are looked for, with their poses, as plain arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.base.errors import ArgumentError, LogError, TrajectoryError
from hexmap.base.values import one_line
from hexmap.io.logs.log import Log, LogSettings
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Event, Odometry, Scan
from hexmap.poses.trajectory import Trajectory
from localisation.experiments.settings import LEAST_SCANS, ExperimentSettings
from localisation.mapping.build_map import build_map
from localisation.mapping.fuse_log import readings_at_poses
from localisation.mapping.result import MappingResult
from localisation.settings import MappingSettings

__all__ = ["NEAR", "ScansLog", "World", "aligned_case", "read_world", "reference_case"]

# Points that a scan must have to be looked for: fewer fit anywhere.
_LEAST_POINTS = 20
NEAR = 3.0
"""Metres: a scan is looked for where a scan of the map was taken no farther away, about a room's width."""

Runner: TypeAlias = Callable[[Any, list[dict[str, Any]], Mapping[str, Any]], list[dict[str, Any]]]


@dataclass(frozen=True, eq=False)
class World:
    """The scans of one place, in the order of the log, those of another run after them.

    Attributes:
        points: (N, 2) of all scans one after the other, in the laser's frame, metres.
        offsets: (K + 1,) where each scan's points begin.
        poses: (K, 3) T_map_laser: x, y, theta; NaN where it is not known.
        odometry: (K, 3) T_odom_robot, NaN where there is none.
        run: (K,) number of the log of each scan.
        held_out: (K,) whether a scan is looked for; then it is in no map.
        mounts: (R, 3) T_robot_laser of each log.
        source: what the logs are.
        reference: where the poses are from, a sentence.
        given: whether they were given, rather than built.
    """

    points: FloatArray
    offsets: IntArray
    poses: FloatArray
    odometry: FloatArray
    run: IntArray
    held_out: NDArray[np.bool_]
    mounts: FloatArray
    source: str
    reference: str
    given: bool

    __repr__ = one_line

    def __len__(self) -> int:
        """Return the number of scans."""
        return len(self.poses)

    def shared(self) -> dict[str, Any]:
        """Return the arrays for the cases."""
        names = ("points", "offsets", "poses", "odometry", "run", "held_out", "mounts")
        return {**{name: getattr(self, name) for name in names}, "given": self.given}

    @classmethod
    def of_shared(cls, shared: Mapping[str, Any]) -> World:
        """Return the world that a case was given."""
        names = ("points", "offsets", "poses", "odometry", "run", "held_out", "mounts")
        return cls(**{name: shared[name] for name in names}, source="", reference="", given=bool(shared["given"]))

    def scan(self, k: int) -> FloatArray:
        """Return the points (P, 2) of scan ``k``."""
        return self.points[self.offsets[k] : self.offsets[k + 1]]

    def pose(self, k: int) -> Pose:
        """Return T_map_laser of scan ``k``, which is known."""
        return Pose.planar(*(float(v) for v in self.poses[k]))

    def odometry_pose(self, k: int) -> Pose | None:
        """Return T_odom_robot of scan ``k``, None where there is none."""
        row = self.odometry[k]
        return None if np.isnan(row).any() else Pose.planar(*(float(v) for v in row))

    def mount(self, k: int) -> Pose:
        """Return T_robot_laser of scan ``k``."""
        return Pose.planar(*(float(v) for v in self.mounts[self.run[k]]))

    @property
    def known(self) -> NDArray[np.bool_]:
        """(K,) whether the pose of each scan is known."""
        return np.asarray(~np.isnan(self.poses).any(axis=1))

    def map_scans(self) -> IntArray:
        """Return the numbers of the scans that go into maps."""
        return np.flatnonzero(self.known & ~self.held_out)

    def test_scans(self) -> IntArray:
        """Return the numbers of the scans that are looked for: held out, with a pose and enough points, in the map."""
        numbers = np.flatnonzero(self.known & self.held_out & (np.diff(self.offsets) >= _LEAST_POINTS))
        mapped = self.poses[self.map_scans(), :2]
        if len(mapped) == 0 or len(numbers) == 0:
            return numbers[:0]
        distance = cKDTree(mapped).query(self.poses[numbers, :2])[0]
        return np.asarray(numbers[distance <= NEAR])


class ScansLog(Log):
    """Some scans of a world as a log; the stamp of each is its number, so that its pose can be told."""

    format = "scans"

    def __init__(self, world: World, numbers: IntArray) -> None:
        super().__init__(Path("scans"), LogSettings(), len(numbers))
        self._world, self._numbers = world, numbers
        self.mount = world.mount(int(numbers[0])) if len(numbers) else None

    def _events(self) -> Iterator[Event]:
        for k in self._numbers.tolist():
            self.scans += 1
            yield Scan(float(k), self._world.scan(k), odometry=self._world.odometry_pose(k))

    def _no_laser(self) -> str:
        return "there is no scan"


def built_poses(
    world: World, numbers: IntArray, settings: MappingSettings | None = None
) -> tuple[MappingResult, FloatArray]:
    """Map some scans; return the result and T_map_laser (K, 3) of each scan of the world, NaN of the others."""
    poses = np.full((len(world), 3), math.nan)

    def on_pose(stamp: float, pose: Pose, is_scan: bool) -> None:
        if is_scan:
            at = pose @ world.mount(int(stamp))
            poses[int(stamp)] = at.x, at.y, at.theta

    return build_map(ScansLog(world, numbers), settings, on_pose=on_pose), poses


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
        at = T @ Pose.planar(*(float(v) for v in poses[k]))
        poses[k] = at.x, at.y, at.theta
    return {"poses": _nullable(poses)}


def _nullable(rows: FloatArray) -> list[list[float] | None]:
    return [None if math.isnan(row[0]) else row.tolist() for row in rows]


def _rows(values: list[list[float] | None]) -> FloatArray:
    return np.array([[math.nan] * 3 if row is None else row for row in values], dtype=np.float64).reshape(-1, 3)


# ---------------------------------------------------------------------- reading


def read_world(
    log: Log,
    settings: ExperimentSettings,
    run: Runner,
    *,
    poses: Trajectory | None = None,
    test: Log | None = None,
    test_poses: Trajectory | None = None,
    associate: str | None = None,
) -> World:
    """Read a log and split it, or take another run of the same place for the scans that are looked for.

    Args:
        log: of the map.
        settings: how to split.
        run: computes cases: the poses are built where none are given.
        poses: T_map_robot of the log, the reference; None: those that the map maker finds.
        test: another run; None: the log itself is split by time.
        test_poses: T_map_robot of it, in the same frame; None: its own map is found in the log's.
        associate: how poses go with scans: "order", "time", or as fits.

    Raises:
        LogError: a log cannot be read, or has too few scans.
        TrajectoryError: poses do not go with the scans.
        ArgumentError: poses of a test run without poses of the log, or without a test run.
        AlignmentError: the other run's map is not found in the log's.
    """
    if test_poses is not None and (test is None or poses is None):
        raise ArgumentError("--test-poses needs --test and --poses: all poses must be in one frame")
    parts = [_read(log, poses, 0, associate, settings)]
    if test is not None:
        parts.append(_read(test, test_poses, 1, associate, settings))
    world = _joined(parts)
    built = run(reference_case, [{"run": 0}], world.shared()) if poses is None else []
    words = (
        f"Errors are measured against the poses given for {log.path.name}."
        if poses is not None
        else f"No poses were given for {log.path.name}: errors are measured against those that the map maker itself "
        "finds with all of its scans and its defaults, so they say how well scans are found in the maps of this "
        "project, and not how true those are; it builds them on its default lattice, which may favour that one below "
        "some centimetres."
    )
    for found in built:
        world = replace(world, poses=np.where(np.isnan(world.poses), _rows(found["poses"]), world.poses))
    if test is not None and test_poses is None:
        (found,) = run(aligned_case, [{"run": 1}], world.shared())
        world = replace(world, poses=np.where(np.isnan(world.poses), _rows(found["poses"]), world.poses))
        words += (
            f" The poses of {test.path.name} come from its own map, found as a whole in the first one: where two maps "
            "bend differently that is an error of the reference."
        )
    world = replace(world, held_out=_held_out(world, settings), reference=words, given=poses is not None)
    for numbers, what in ((world.map_scans(), "for the map"), (world.test_scans(), "to look for")):
        if len(numbers) < LEAST_SCANS:
            raise LogError(f"{log.path}: {len(numbers)} scans with a pose are left {what}; the least is {LEAST_SCANS}")
    return world


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
