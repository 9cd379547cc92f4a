"""Fuse a log whose poses are known."""

from __future__ import annotations

from collections.abc import Iterator

from hexmap.base.errors import ArgumentError, BoundsError, TooLargeError, TrajectoryError
from hexmap.io.logs.log import Log
from hexmap.io.map_store import MapStore
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Event, Odometry, Scan
from hexmap.poses.trajectory import Trajectory
from localisation.mapping.result import (
    MappingResult,
    OnPose,
    PoseRecorder,
    Progress,
    UnusableScans,
    finished,
    provenance,
)
from localisation.settings import MappingSettings, make_builder, make_mount


def fuse_log(
    log: Log,
    poses: Trajectory,
    settings: MappingSettings | None = None,
    *,
    associate: str | None = None,
    tolerance: float = 0.1,
    on_pose: OnPose | None = None,
    progress: Progress | None = None,
    store: MapStore | None = None,
) -> MappingResult:
    """Map a log whose poses (T_map_robot) are known.

    How poses go with scans is said at :func:`readings_at_poses`; scans without a pose are left out
    and counted. A ``store`` says where the map is written as its rows come; without one it is made in memory.

    Raises:
        LogError: the log cannot be read or has no laser reading.
        TrajectoryError: the poses go with no scan, or not by the order asked for.
    """
    settings = settings or MappingSettings()
    builder = make_builder(settings)
    if store is not None:
        store.begin(builder)
    mount: Pose | None = None
    skipped = seen = 0
    recorder = PoseRecorder(on_pose)
    unusable = UnusableScans(log)
    for event, pose in readings_at_poses(log, poses, associate=associate, tolerance=tolerance):
        if isinstance(event, Odometry):
            if pose is not None:
                recorder.add(event.stamp, pose, False)
            continue
        mount = mount or make_mount(settings, log.mount)
        if pose is None:
            skipped += 1
        else:
            try:
                builder.fuse(event, pose @ mount)
            except (BoundsError, TooLargeError) as error:
                unusable.add(event, error)
            else:
                recorder.add(event.stamp, pose, True)
        seen += 1
        if progress is not None:
            progress(seen)
    unusable.check(builder.scans)
    if builder.scans == 0:
        raise TrajectoryError(
            f"none of the {len(poses)} poses is within {tolerance:g} s of one of the {seen} scans of {log.path}"
        )
    scans = builder.scans
    return MappingResult(
        made=finished(builder, provenance(log, settings, "given", poses), store),
        scans=scans,
        odometry=log.odometry,
        matched=0,
        unmatched=0,
        skipped=skipped,
        mean_part=0.0,
        metres=recorder.metres,
        warnings=[*log.warnings, *unusable.warnings],
    )


def readings_at_poses(
    log: Log, poses: Trajectory, *, associate: str | None = None, tolerance: float = 0.1
) -> Iterator[tuple[Event, Pose | None]]:
    """Yield each reading of a log with its given pose (T_map_robot), None where it has none.

    Poses go with scans by order where there are as many as scans, or as many as laser and
    odometry readings together (what :func:`build_map` writes); else by time, each scan with the
    pose nearest to its stamp, at most ``tolerance`` seconds off. ``associate`` ("order" or
    "time") insists on one of them. The log is read twice: once to count.

    Raises:
        LogError: the log cannot be read or has no laser reading.
        TrajectoryError: the poses do not go by the order asked for, or are not planar.
        ArgumentError: ``associate`` is neither.
    """
    if not poses.planar:
        raise TrajectoryError("poses in space cannot place a planar log: z, roll and pitch must be 0")
    if associate not in (None, "order", "time"):
        raise ArgumentError(f"poses associate by 'order' or 'time', not {associate!r}")
    scans = odometry = 0
    for event in log:
        scans += isinstance(event, Scan)
        odometry += isinstance(event, Odometry)
    each_scan, each_event = len(poses) == scans, len(poses) == scans + odometry
    if associate == "order" and not (each_scan or each_event):
        raise TrajectoryError(
            f"{len(poses)} poses do not go by order with the {scans} scans of {log.path}, "
            f"nor with its {scans + odometry} readings"
        )
    by_order = associate != "time" and (each_scan or each_event)
    seen = 0
    for at, event in enumerate(log):
        is_scan = isinstance(event, Scan)
        if not by_order:
            k, off = poses.nearest([event.stamp])
            yield event, poses[int(k[0])] if off[0] <= tolerance else None
        elif each_event:
            yield event, poses[at]
        else:
            yield event, poses[seen] if is_scan else None
        seen += is_scan
