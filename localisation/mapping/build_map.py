"""From a log to a map: predict each scan's pose, match it, fuse it.

The main loop reads as the job is done. Order in the log is the order of events; time stamps are
carried along and never divided by, because in real logs they repeat and step back.
"""

from __future__ import annotations

from hexmap.base.errors import BoundsError, LogError, TooLargeError
from hexmap.io.logs.log import Log
from hexmap.poses.scan import Scan
from localisation.mapping.result import MappingResult, OnPose, PoseRecorder, Progress, UnusableScans, provenance
from localisation.odometry.scan_odometry import FARTHEST_JUMP, ScanMapper
from localisation.settings import MappingSettings

__all__ = ["build_map"]


def build_map(
    log: Log,
    settings: MappingSettings | None = None,
    *,
    on_pose: OnPose | None = None,
    progress: Progress | None = None,
) -> MappingResult:
    """Map a log by scan matching.

    Args:
        log: an open log (``hexmap.io.logs.open_log``).
        settings: all settings; the defaults serve every log we know.
        on_pose: called with stamp, T_map_robot and whether it is a scan's, for every laser and
            odometry reading in the log's order.
        progress: called after each scan with the number of scans so far.

    Returns:
        The map, in the frame of the first pose, and what was counted.

    Raises:
        LogError: the log cannot be read or has no laser reading.
    """
    settings = settings or MappingSettings()
    mapper: ScanMapper | None = None
    recorder = PoseRecorder(on_pose)
    unusable = UnusableScans(log)
    for event in log:
        if mapper is None:
            mapper = ScanMapper(settings, log.mount)
        try:
            readings = list(mapper.add(event))
        except (BoundsError, TooLargeError) as error:
            unusable.add(event, error)
            continue
        for reading in readings:
            recorder.add(*reading)
        if progress is not None and isinstance(event, Scan):
            progress(mapper.builder.scans)
    if mapper is None:
        raise LogError(f"{log.path}: there is no laser reading in it")
    unusable.check(mapper.builder.scans)
    for reading in mapper.finish():
        recorder.add(*reading)
    return MappingResult(
        map=mapper.builder.build(source=provenance(log, settings, "scan matching")),
        scans=mapper.builder.scans,
        odometry=log.odometry,
        matched=mapper.matched,
        unmatched=mapper.unmatched,
        skipped=0,
        mean_part=mapper.part_sum / mapper.matched if mapper.matched else 0.0,
        metres=recorder.metres,
        warnings=[*log.warnings, *unusable.warnings, *_jumps(log, mapper.jumps)],
    )


def _jumps(log: Log, count: int) -> list[str]:
    if not count:
        return []
    return [
        f"{log.path}: odometry jumps by more than {FARTHEST_JUMP:g} m {count} times; the last motion was used there"
    ]


