"""What mapping a log returns, and what it counts on the way."""

from __future__ import annotations

import hashlib
import math
import platform
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hexmap.base.errors import LogError
from hexmap.base.values import one_line
from hexmap.io.fingerprint import fingerprint
from hexmap.io.lidar.lidar_log import LidarLog
from hexmap.io.logs.log import Log
from hexmap.io.map_store import MapStore, StoredMap
from hexmap.maps.builder import MapBuilder
from hexmap.maps.map import Map
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Event
from hexmap.poses.trajectory import Trajectory
from localisation.lidar_settings import LidarSettings
from localisation.odometry.motion import FARTHEST_JUMP
from localisation.settings import MappingSettings
from localisation.slam.slam import SlamResult


@dataclass(frozen=True, eq=False)
class MappingResult:
    """A finished map and what was counted on the way.

    Attributes:
        made: the map, or where it was written.
        scans: laser readings fused.
        odometry: odometry readings seen.
        matched: scans that were matched (the first has nothing to be matched against).
        unmatched: scans that coincided with nothing and kept their prediction.
        skipped: scans without a pose, where poses were given.
        mean_part: mean part of a scan's cells that coincided with the map when it was matched.
        metres: length of the path.
        warnings: what was wrong with the log, one line each.
        slam: the graph, the loops and how sure each pose is, where loops were closed.
    """

    made: Map | StoredMap
    scans: int
    odometry: int
    matched: int
    unmatched: int
    skipped: int
    mean_part: float
    metres: float
    warnings: list[str]
    slam: SlamResult | None = None

    __repr__ = one_line

    @cached_property
    def map(self) -> Map:
        """The map; one that was written is read again."""
        return whole(self.made)


def whole(made: Map | StoredMap) -> Map:
    """Return a map, read again where it was written."""
    return made.load() if isinstance(made, StoredMap) else made


def finished(builder: MapBuilder, source: Mapping[str, Any], store: MapStore | None) -> Map | StoredMap:
    """Return the map of a builder, which is empty then: in memory, or where ``store`` has written it."""
    return builder.build(source=source, finish=True) if store is None else store.finish(builder, source)


class UnusableScans:
    """Counts the scans that cannot go into the map and remembers the first, for one clear line."""

    def __init__(self, log: Log | LidarLog) -> None:
        self.log = log
        self._count = 0
        self._first = ""

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the log, which is opened again."""
        return {**self.__dict__, "log": None}

    def add(self, event: Event, error: Exception) -> None:
        """Count a scan that ``error`` keeps out of the map."""
        if self._count == 0:
            self._first = f"line {event.line}: {error}" if event.line is not None else str(error)
        self._count += 1

    def check(self, used: int) -> None:
        """Raise where not one scan could be used."""
        if self._count and not used:
            raise LogError(f"{self.log.path}: no scan can be used, {self._first}")

    @property
    def warnings(self) -> list[str]:
        """What to say of them: one line, or none."""
        if not self._count:
            return []
        return [f"{self.log.path}: {self._count} scans cannot be used and are left out, the first at {self._first}"]


class PoseRecorder:
    """Passes poses on and measures the path."""

    def __init__(self, on_pose: OnPose | None) -> None:
        self._on_pose = on_pose
        self._last: Pose | None = None
        self.metres = 0.0

    def add_readings(self, readings: Iterable[tuple[float, Pose]]) -> None:
        """Take stamps and poses of odometry readings, T_map_robot."""
        for stamp, pose in readings:
            self.add(stamp, pose, False)

    def add(self, stamp: float, pose: Pose, is_scan: bool) -> None:
        """Take the pose of the next reading, T_map_robot."""
        if self._last is not None:
            self.metres += math.dist(self._last.translation, pose.translation)
        self._last = pose
        if self._on_pose is not None:
            self._on_pose(stamp, pose, is_scan)


def jump_warnings(log: Log, count: int) -> list[str]:
    """Return what to say of odometry readings that could not be true: one line, or none."""
    if not count:
        return []
    return [
        f"{log.path}: odometry jumps by more than {FARTHEST_JUMP:g} m {count} times; the last motion was used there"
    ]


def provenance(
    log: Log | LidarLog, settings: MappingSettings | LidarSettings, result: str, poses: Trajectory | None = None
) -> dict[str, Any]:
    """Return what the map file says of where the map came from (see :mod:`hexmap.maps.origin`).

    Args:
        log: that was mapped.
        settings: with which.
        result: how its poses were found.
        poses: those that were given: logs that are mapped at the same poses are in the same frame.
    """
    import numba

    from hexmap.base.version import __version__

    return {
        **_identity(log, settings, result, poses),
        "log": log.path.name,
        "format": log.format,
        "poses": result,
        "settings": settings.to_dict(),
        "versions": {
            "hexmap": __version__,
            "numpy": np.__version__,
            "numba": numba.__version__,
            "python": platform.python_version(),
        },
    }


def _identity(
    log: Log | LidarLog, settings: MappingSettings | LidarSettings, result: str, poses: Trajectory | None
) -> dict[str, str]:
    """Return the identities of the log and of the frame of its map, as far as they are known."""
    checksum = fingerprint(log.path)
    found: dict[str, str] = {}
    if checksum is not None:
        # The scans of two lasers of one log are two logs, in one frame.
        chosen = settings.to_dict()["log"]
        names = "laser", "scan_topic", "topic", "frame"
        which = [str(chosen[name]) for name in names if chosen.get(name) not in (None, "front")]
        found["log_id"] = ":".join([checksum, *which])
        found["frame"] = f"{checksum}:{result}"
    if poses is not None:
        arrays = poses.stamps, poses.positions, poses.quaternions
        found["frame"] = hashlib.sha256(b"".join(a.tobytes() for a in arrays)).hexdigest()[:32]
    return found


Progress = Callable[[int], None]


OnPose = Callable[[float, Pose, bool], None]
