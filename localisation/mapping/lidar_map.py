"""From a LiDAR's log to a map in space: poses by surfaces and closed loops, or given ones; then all scans fused.

The log is read twice: once for the poses, once for the map. Only one scan of it is in memory at a time; what is kept of
the others are the submaps' thinned points.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError, BoundsError, TooLargeError, TrajectoryError
from hexmap.base.values import one_line
from hexmap.io.lidar.lidar_log import LidarLog
from hexmap.io.map_store import MapStore, StoredMap
from hexmap.maps.map import Map
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import angles
from hexmap.poses.scan import Scan
from hexmap.poses.trajectory import Trajectory
from localisation.lidar_settings import LidarSettings
from localisation.mapping.checkpoint import Checkpoints
from localisation.mapping.loop_closed_map import Phase, silent
from localisation.mapping.result import OnPose, PoseRecorder, UnusableScans, finished, provenance, whole
from localisation.matching.gravity import levelling
from localisation.matching.surfaces import SurfaceMap, first_of_each_cell
from localisation.odometry.lidar_odometry import LidarOdometry
from localisation.odometry.sweep import Velocity, deskewed
from localisation.slam import spatial
from localisation.slam.lidar_slam import LidarSlam, LidarSlamResult
from localisation.slam.settings import LoopSettings

__all__ = [
    "LidarMappingResult", "LidarRun", "build_lidar_map", "fuse_lidar_log", "fuse_lidar_run", "map_lidar_run",
]  # fmt: skip

# In cells of the surfaces: the last drawing is a touch, not a search.
_TOUCH = 0.3


@dataclass(frozen=True, eq=False)
class LidarMappingResult:
    """A finished map in space and what was counted on the way.

    Attributes:
        made: the map, or where it was written.
        scans: scans fused.
        matched: scans that surfaces held (the first has nothing to be matched against).
        unmatched: scans that kept the motion predicted for them.
        missed: scans that lay nowhere near the ones before and were left out.
        skipped: scans without a pose, where poses were given.
        mean_share: mean share of a matched scan's points that lay on surfaces; NaN where none was matched.
        metres: length of the path.
        warnings: what was wrong with the log, one line each.
        levelled: by how much the map was turned to make floors level, radians; None where that was not asked for, or
            no floor was found.
        poses: T_map_robot of all scans; of the sensor where the log does not say how it is mounted.
        slam: the graph, the loops and how sure each pose is; None where poses were given.
    """

    made: Map | StoredMap
    scans: int
    matched: int
    unmatched: int
    missed: int
    skipped: int
    mean_share: float
    metres: float
    warnings: list[str]
    levelled: float | None
    poses: Trajectory
    slam: LidarSlamResult | None

    __repr__ = one_line

    @cached_property
    def map(self) -> Map:
        """The map; one that was written is read again."""
        return whole(self.made)


def build_lidar_map(
    log: LidarLog,
    settings: LidarSettings | None = None,
    loops: LoopSettings | None = None,
    *,
    close: bool = True,
    on_pose: OnPose | None = None,
    phase: Phase | None = None,
    checkpoints: Checkpoints | None = None,
    store: MapStore | None = None,
) -> LidarMappingResult:
    """Map a LiDAR's log.

    Args:
        log: an open log (``hexmap.io.lidar.open_lidar``).
        settings: all settings of the map.
        loops: how loops are looked for, and what is believed.
        close: whether loops are closed.
        on_pose: called at the end with stamp, T_map_robot and True for every scan in the log's order.
        phase: shows what is being done, as for :func:`~localisation.mapping.loop_closed_map.build_loop_closed_map`.
        checkpoints: where the run keeps what it knows, and finds what one that was killed has left.
        store: where the map is written as its rows come; None: it is made in memory.

    Returns:
        The map. Its origin is where the robot was at the first scan; its axes are the robot's then, turned so that
        floors are level where ``settings.level_floor`` says so. The robot is the sensor where the log does not say how
        it is mounted.

    Raises:
        LogError: the log cannot be read or has no scan.
        MissingDependencyError: kiss-icp or gtsam cannot be loaded.
        FormatError: the checkpoint is of another run, or damaged.
    """
    run = map_lidar_run(
        log, settings or LidarSettings(), loops, close=close, phase=phase, checkpoints=checkpoints
    )
    return fuse_lidar_run(run, run.levelling(), on_pose=on_pose, phase=phase, store=store)


@dataclass(frozen=True, eq=False)
class LidarRun:
    """The poses of a log, before its scans are fused.

    Attributes:
        log: which was read.
        settings: of the map.
        slam: what mapped it.
        result: the poses T_map_sensor, with loops closed, and the graph.
        used: which scans of the log have a pose, counted from 0.
        warnings: what was wrong with the log.
        how: how the poses were found, for the map's file.
    """

    log: LidarLog
    settings: LidarSettings
    slam: LidarSlam
    result: LidarSlamResult
    used: list[int]
    warnings: list[str]
    how: str

    def surfaces(self) -> SurfaceMap:
        """Return the surfaces of all submaps where the graph has them."""
        return self.slam.surfaces(self.result.graph.poses)

    def levelling(self) -> Pose | None:
        """Return the turn that makes floors level; None where that is not asked for, or there is hardly any floor."""
        return levelling(self.surfaces()) if self.settings.level_floor else None


def map_lidar_run(
    log: LidarLog,
    settings: LidarSettings,
    loops: LoopSettings | None = None,
    *,
    close: bool = True,
    phase: Phase | None = None,
    checkpoints: Checkpoints | None = None,
) -> LidarRun:
    """Find the poses of a log: arguments and errors as of :func:`build_lidar_map`."""
    phase, loops = phase or silent, loops or LoopSettings()
    begun = None if checkpoints is None else checkpoints.find(log, settings, loops)
    slam: LidarSlam
    used: list[int]
    if begun is not None:
        slam, unusable, used = begun.state
        unusable.log = log
    else:
        velocity = LidarOdometry.first_velocity(settings, list(itertools.islice(log, 2)))
        slam = LidarSlam(settings, loops, close=close, velocity=velocity, begin=log.mount)
        unusable, used = UnusableScans(log), []
    with phase("mapping", log.fraction) as progress:
        for number, scan in enumerate(log):
            if begun is not None and number < begun.readings:
                continue
            if checkpoints is not None:
                checkpoints.keep(log, settings, loops, number, (slam, unusable, used))
            try:
                missed = slam.register(scan).missed
            except (BoundsError, TooLargeError) as error:
                unusable.add(scan, error)
                continue
            if not missed:
                used.append(number)
            progress(slam.scans)
    unusable.check(slam.scans)
    warnings = [*log.warnings, *unusable.warnings]
    with phase("closing loops", lambda: 0.0):
        result = slam.finish()
    how = "kiss-icp, surfaces" + (" and loop closure" if close else "")
    return LidarRun(log, settings, slam, result, used, warnings, how)


def fuse_lidar_run(
    run: LidarRun,
    turn: Pose | None,
    *,
    on_pose: OnPose | None = None,
    phase: Phase | None = None,
    store: MapStore | None = None,
) -> LidarMappingResult:
    """Fuse the scans of a run at its poses, which are turned by ``turn`` (T_map_run) first; None: as they are."""
    log, settings, slam, result = run.log, run.settings, run.slam, run.result
    phase = phase or silent
    fuser = _Fuser(log, settings, on_pose, store)
    chosen = set(run.used)
    poses = [result.pose(k) for k in range(len(run.used))]
    levelled = None if turn is None else float(angles(turn.rotation[None])[0])
    turn = turn or Pose.identity(3)
    drawn = _Drawing(run.surfaces(), settings)
    with phase("fusing", log.fraction) as progress:
        k = 0
        for number, scan in enumerate(log):
            if number not in chosen:
                continue
            # The poses before are the last ones already, so that the motion between them is what it was.
            poses[k] = drawn.touch(scan, poses, result.stamps, k)
            points = deskewed(scan, _velocity(poses, result.stamps, k))
            fuser.fuse(replace(scan, points=points, times=None), turn @ poses[k])
            k += 1
            progress(k)
    final = [turn @ pose for pose in poses]
    moved = replace(
        result, poses=np.array([spatial.of_pose(p) for p in final]), graph=result.graph.moved(
            spatial.compose(spatial.of_pose(turn), result.graph.poses))
    )  # fmt: skip
    return LidarMappingResult(
        made=fuser.finish(run.how),
        scans=len(run.used),
        matched=slam.matched,
        unmatched=slam.unmatched,
        missed=slam.missed,
        skipped=0,
        mean_share=slam.mean_share,
        metres=fuser.recorder.metres,
        warnings=run.warnings,
        levelled=levelled,
        poses=Trajectory.from_poses(result.stamps.tolist(), [fuser.of_robot(pose) for pose in final]),
        slam=moved if log.mount is None else moved.of_robot(log.mount),
    )


def fuse_lidar_log(
    log: LidarLog,
    poses: Trajectory,
    settings: LidarSettings | None = None,
    *,
    associate: str | None = None,
    tolerance: float = 0.1,
    on_pose: OnPose | None = None,
    phase: Phase | None = None,
    store: MapStore | None = None,
) -> LidarMappingResult:
    """Map a LiDAR's log whose poses (T_map_robot, of the sensor where its mount is not known) are known.

    Poses go with scans by order where there are as many, else by time: each scan is put between the poses before and
    after its stamp, of which the nearer one must be no more than ``tolerance`` seconds off.

    Args:
        log: an open log.
        poses: T_map_robot; T_map_sensor where the log does not say how the sensor is mounted.
        settings: all settings of the map.
        associate: "order" or "time" insists on one of them.
        tolerance: seconds.
        on_pose: called with stamp, pose and True for every scan that has one.
        phase: shows what is being done.
        store: where the map is written as its rows come; None: it is made in memory.

    Raises:
        LogError: the log cannot be read or has no scan.
        TrajectoryError: the poses go with no scan, or not by the order asked for.
        ArgumentError: ``associate`` is neither.
    """
    settings, phase = settings or LidarSettings(), phase or silent
    if associate not in (None, "order", "time"):
        raise ArgumentError(f"poses associate by 'order' or 'time', not {associate!r}")
    count = 0
    for _ in log:
        count += 1
    if associate == "order" and len(poses) != count:
        raise TrajectoryError(f"{len(poses)} poses do not go by order with the {count} scans of {log.path}")
    by_order = associate != "time" and len(poses) == count
    mount = log.mount or Pose.identity(3)
    fuser, unusable = _Fuser(log, settings, on_pose, store), UnusableScans(log)
    placed: list[Pose] = []
    stamps: list[float] = []
    skipped = 0
    with phase("fusing", log.fraction) as progress:
        for k, scan in enumerate(log):
            pose = _in_space(poses[k]) if by_order else _at(poses, scan.stamp, tolerance)
            if pose is None:
                skipped += 1
                continue
            pose = pose @ mount
            velocity = None
            if stamps:
                velocity = Velocity.between(placed[-1].inverse() @ pose, scan.stamp - stamps[-1])
            try:
                fuser.fuse(replace(scan, points=deskewed(scan, velocity), times=None), pose)
            except (BoundsError, TooLargeError) as error:
                unusable.add(scan, error)
                continue
            placed.append(pose)
            stamps.append(scan.stamp)
            progress(k + 1)
    unusable.check(len(placed))
    if not placed:
        raise TrajectoryError(
            f"none of the {len(poses)} poses is within {tolerance:g} s of one of the {count} scans of {log.path}"
        )
    return LidarMappingResult(
        made=fuser.finish("given"), scans=len(placed), matched=0, unmatched=0, missed=0, skipped=skipped,
        mean_share=math.nan, metres=fuser.recorder.metres, warnings=[*log.warnings, *unusable.warnings], levelled=None,
        poses=Trajectory.from_poses(stamps, [fuser.of_robot(pose) for pose in placed]), slam=None,
    )  # fmt: skip


class _Fuser:
    """Fuses scans and passes their poses on."""

    def __init__(
        self, log: LidarLog, settings: LidarSettings, on_pose: OnPose | None, store: MapStore | None
    ) -> None:
        self._log, self._settings, self._store = log, settings, store
        self._builder = settings.make_builder()
        if store is not None:
            store.begin(self._builder)
        self._back = None if log.mount is None else log.mount.inverse()
        self.recorder = PoseRecorder(on_pose)

    def fuse(self, scan: Scan, pose: Pose) -> None:
        if self._settings.free_space:
            self._builder.fuse(scan, pose)
        else:
            self._builder.add_hits(scan, pose)
        self.recorder.add(scan.stamp, self.of_robot(pose), True)

    def of_robot(self, pose: Pose) -> Pose:
        """Return T_map_robot of a pose T_map_sensor."""
        return pose if self._back is None else pose @ self._back

    def finish(self, how: str) -> Map | StoredMap:
        return finished(self._builder, provenance(self._log, self._settings, how), self._store)


class _Drawing:
    """Draws each scan once more, onto the surfaces of all."""

    def __init__(self, surfaces: SurfaceMap, settings: LidarSettings) -> None:
        self._surfaces, self._settings = surfaces, settings
        self._thin = surfaces.lattice.scaled(1.0 / 3.0)

    def touch(self, scan: Scan, poses: list[Pose], stamps: FloatArray, k: int) -> Pose:
        """Return the pose of scan ``k`` on the surfaces, or what it is where they do not hold it."""
        points = self._settings.in_range(deskewed(scan, _velocity(poses, stamps, k)))
        drawn = self._surfaces.draw(first_of_each_cell(points, self._thin), poses[k], farthest=_TOUCH)
        return drawn.pose if drawn.converged else poses[k]


def _velocity(poses: list[Pose], stamps: FloatArray, k: int) -> Velocity | None:
    """Return the sensor's velocity at scan ``k``: from the scan before, at the first one to the scan after."""
    if len(poses) < 2:
        return None
    a, b = (k - 1, k) if k else (0, 1)
    return Velocity.between(poses[a].inverse() @ poses[b], float(stamps[b] - stamps[a]))


def _in_space(pose: Pose) -> Pose:
    """Return a pose of the plane as one of space."""
    if pose.dim == 3:
        return pose
    R = np.eye(3)
    R[:2, :2] = pose.rotation
    return Pose(R, [*pose.translation, 0.0])


def _at(poses: Trajectory, stamp: float, tolerance: float) -> Pose | None:
    """Return the pose at a stamp, between the readings around it; None where the nearest is too far off."""
    nearest, off = poses.nearest([stamp])
    k = int(nearest[0])
    if off[0] > tolerance:
        return None
    step = 1 if poses.stamps[k] < stamp else -1
    other = k + step
    here = _in_space(poses[k])
    if not 0 <= other < len(poses) or off[0] == 0.0:
        return here
    span = float(poses.stamps[other] - poses.stamps[k])
    share = (stamp - float(poses.stamps[k])) / span if span else 0.0
    if not 0.0 < share < 1.0:
        return here
    motion = spatial.small(spatial.of_pose(here.inverse() @ _in_space(poses[other])))
    return here @ spatial.to_pose(spatial.motion(motion * share))

