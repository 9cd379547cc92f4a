"""From a log to a map that closes its loops: poses by :class:`~localisation.slam.slam.Slam`, then all scans fused."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import TypeAlias

from hexmap.base.errors import BoundsError, LogError, TooLargeError
from hexmap.base.values import one_line
from hexmap.io.logs.log import Log
from hexmap.io.map_store import MapStore
from hexmap.poses.scan import Odometry
from localisation.mapping.checkpoint import Checkpoints
from localisation.mapping.result import (
    MappingResult,
    OnPose,
    PoseRecorder,
    Progress,
    UnusableScans,
    finished,
    jump_warnings,
    provenance,
)
from localisation.settings import MappingSettings, make_builder
from localisation.slam import planar
from localisation.slam.rematch import rematch
from localisation.slam.settings import LoopSettings
from localisation.slam.slam import Slam, SlamResult

__all__ = ["MappedRun", "Phase", "build_loop_closed_map", "fuse_run", "map_run", "silent"]

Phase: TypeAlias = Callable[[str, Callable[[], float]], AbstractContextManager[Progress]]
"""Begins a phase of the work: its name, and what tells which part of it is done."""


def build_loop_closed_map(
    log: Log,
    settings: MappingSettings | None = None,
    loops: LoopSettings | None = None,
    *,
    on_pose: OnPose | None = None,
    phase: Phase | None = None,
    checkpoints: Checkpoints | None = None,
    store: MapStore | None = None,
) -> MappingResult:
    """Map a log by scan matching, with its loops closed.

    Args:
        log: an open log (``hexmap.io.logs.open_log``).
        settings: all settings of the map.
        loops: how loops are looked for, and what is believed.
        on_pose: called at the end with stamp, T_map_robot and whether it is a scan's, for every laser and odometry
            reading in the log's order.
        phase: shows what is being done; it is entered for each phase, and what it yields is called with the number of
            scans that are done.
        checkpoints: where the run keeps what it knows, and finds what one that was killed has left.
        store: where the map is written as its rows come; None: it is made in memory.

    Returns:
        The map, in the frame of the first pose, with what was found of loops in ``slam``.

    Raises:
        LogError: the log cannot be read or has no laser reading.
        MissingDependencyError: gtsam cannot be loaded.
        FormatError: the checkpoint is of another run, or damaged.
    """
    settings = settings or MappingSettings()
    run = map_run(log, settings, loops, phase=phase, checkpoints=checkpoints)
    return fuse_run(run, settings, on_pose=on_pose, phase=phase, store=store)


@dataclass(frozen=True, eq=False)
class MappedRun:
    """The poses of a log, before its scans are fused.

    Attributes:
        log: which was read.
        slam: what mapped it.
        result: its poses, with loops closed and every scan drawn to the others.
        unusable: the scans that were left out.
    """

    log: Log
    slam: Slam
    result: SlamResult
    unusable: UnusableScans

    __repr__ = one_line


def map_run(
    log: Log,
    settings: MappingSettings,
    loops: LoopSettings | None = None,
    *,
    phase: Phase | None = None,
    checkpoints: Checkpoints | None = None,
) -> MappedRun:
    """Find the poses of a log: arguments and errors as of :func:`build_loop_closed_map`."""
    loops, phase = loops or LoopSettings(), phase or silent
    slam: Slam | None = None
    unusable = UnusableScans(log)
    begun = None if checkpoints is None else checkpoints.find(log, settings, loops)
    if begun is not None:
        slam, unusable = begun.state
        unusable.log = log
    with phase("mapping", log.fraction) as progress:
        for number, event in enumerate(log):
            if begun is not None and number < begun.readings:
                continue
            if checkpoints is not None and slam is not None:
                checkpoints.keep(log, settings, loops, number, (slam, unusable))
            # Only once the log has been begun does it say how the laser is mounted.
            slam = slam or Slam(settings, loops, log.mount)
            if isinstance(event, Odometry):
                slam.observe(event)
                continue
            try:
                slam.register(event)
            except (BoundsError, TooLargeError) as error:
                unusable.add(event, error)
                continue
            progress(len(slam.scans))
    if slam is None:
        raise LogError(f"{log.path}: there is no laser reading in it")
    unusable.check(len(slam.scans))
    with phase("closing loops", lambda: 0.0):
        result = slam.finish()
    done = 0

    def count(scans: int) -> None:
        nonlocal done
        done = scans
        progress(scans)

    with phase("matching again", lambda: done / (2 * len(result.scans))) as progress:
        result = rematch(result, settings, slam.mount, count)
    return MappedRun(log, slam, result, unusable)


def fuse_run(
    run: MappedRun,
    settings: MappingSettings,
    *,
    on_pose: OnPose | None = None,
    phase: Phase | None = None,
    store: MapStore | None = None,
) -> MappingResult:
    """Fuse the scans of a run at its poses: arguments as of :func:`build_loop_closed_map`."""
    log, slam, result = run.log, run.slam, run.result
    phase = phase or silent
    builder = make_builder(settings)
    if store is not None:
        store.begin(builder)
    recorder = PoseRecorder(on_pose)
    scans = iter(result.scans)
    with phase("fusing", lambda: builder.scans / len(result.scans)) as progress:
        for stamp, row, is_scan in zip(result.stamps.tolist(), result.poses, result.is_scan.tolist(), strict=True):
            pose = planar.to_pose(row)
            recorder.add(stamp, pose, is_scan)
            if is_scan:
                builder.fuse(next(scans).scan(), pose @ slam.mount)
                progress(builder.scans)
    return MappingResult(
        made=finished(builder, provenance(log, settings, "scan matching with loop closure"), store),
        scans=len(result.scans),
        odometry=log.odometry,
        matched=slam.matched,
        unmatched=slam.unmatched,
        skipped=0,
        mean_part=slam.fractions / slam.matched if slam.matched else 0.0,
        metres=recorder.metres,
        warnings=[*log.warnings, *run.unusable.warnings, *jump_warnings(log, slam.jumps)],
        slam=result,
    )


@contextmanager
def silent(name: str, fraction: Callable[[], float]) -> Iterator[Progress]:
    """A phase that shows nothing."""
    yield lambda scans: None
