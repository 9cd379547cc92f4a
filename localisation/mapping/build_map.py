"""From a log to a map by scan matching alone: predict each scan's pose, match it, fuse it.

The main loop reads as the job is done. Order in the log is the order of events; time stamps are
carried along and never divided by, because in real logs they repeat and step back.
"""

from __future__ import annotations

from hexmap.base.errors import BoundsError, LogError, TooLargeError
from hexmap.io.logs.log import Log
from hexmap.io.map_store import MapStore
from hexmap.poses.scan import Odometry
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
from localisation.odometry.scan_odometry import ScanOdometry
from localisation.settings import MappingSettings, make_builder

__all__ = ["build_map"]


def build_map(
    log: Log,
    settings: MappingSettings | None = None,
    *,
    on_pose: OnPose | None = None,
    progress: Progress | None = None,
    store: MapStore | None = None,
) -> MappingResult:
    """Map a log by scan matching.

    Args:
        log: an open log (``hexmap.io.logs.open_log``).
        settings: all settings; the defaults serve every log we know.
        on_pose: called with stamp, T_map_robot and whether it is a scan's, for every laser and
            odometry reading in the log's order.
        progress: called after each scan with the number of scans so far.
        store: where the map is written at the end, level by level; None: it is made in memory. Until then it is whole,
            because scans are matched against it.

    Returns:
        The map, in the frame of the first pose, and what was counted.

    Raises:
        LogError: the log cannot be read or has no laser reading.
    """
    settings = settings or MappingSettings()
    builder = make_builder(settings)
    odometry: ScanOdometry | None = None
    recorder = PoseRecorder(on_pose)
    unusable = UnusableScans(log)
    matched = unmatched = 0
    fractions = 0.0
    for event in log:
        # Only once the log has been begun does it say how the laser is mounted.
        odometry = odometry or ScanOdometry(settings, builder, log.mount)
        if isinstance(event, Odometry):
            recorder.add_readings(odometry.observe(event))
            continue
        try:
            registered = odometry.register(event)
            builder.fuse(event, registered.T_map_scan)
        except (BoundsError, TooLargeError) as error:
            unusable.add(event, error)
            continue
        recorder.add_readings(registered.readings)
        recorder.add(event.stamp, registered.T_map_robot, True)
        if registered.match is not None:
            matched += 1
            fractions += registered.match.fraction
        elif registered.matched:
            unmatched += 1
        if progress is not None:
            progress(builder.scans)
    if odometry is None:
        raise LogError(f"{log.path}: there is no laser reading in it")
    unusable.check(builder.scans)
    recorder.add_readings(odometry.finish())
    scans, jumps = builder.scans, odometry.jumps
    del odometry, registered
    return MappingResult(
        made=finished(builder, provenance(log, settings, "scan matching"), store),
        scans=scans,
        odometry=log.odometry,
        matched=matched,
        unmatched=unmatched,
        skipped=0,
        mean_part=fractions / matched if matched else 0.0,
        metres=recorder.metres,
        warnings=[*log.warnings, *unusable.warnings, *jump_warnings(log, jumps)],
    )
