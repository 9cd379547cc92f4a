"""From a log to a map: predict each scan's pose, match it, fuse it.

The main loop reads as the job is done. Order in the log is the order of events; time stamps are
carried along and never divided by, because in real logs they repeat and step back.
"""

from __future__ import annotations

import math
import platform
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np

from hexmap.errors import ArgumentError, BoundsError, HexmapError, LogError, TooLargeError, TrajectoryError
from hexmap.lattice import Lattice
from hexmap.logs import Log, LogSettings
from hexmap.maps import Map, MapBuilder, StateRule
from hexmap.pose import Pose
from hexmap.scan import Event, Odometry, Scan
from hexmap.trajectory import Trajectory
from localisation.matcher import CounterOccupancy, Match, ScanMatcher, SearchWindow

__all__ = ["MappingResult", "MappingSettings", "ScanMapper", "build_map", "fuse_log", "readings_at_poses"]

Progress = Callable[[int], None]
OnPose = Callable[[float, Pose, bool], None]


@dataclass(frozen=True)
class MappingSettings:
    """All settings of a map, as plain numbers and texts: what is stored in the map file.

    Attributes:
        lattice: name of the lattice, or its basis (columns are generators, metres) as nested lists.
        resolution: side, metres, of the square of the same area as a cell (ignored with a basis).
        levels: levels of the map, each at twice the resolution of the one before.
        min_range: points nearer than this, metres, are left out.
        max_range: points farther than this, metres, are left out; None for no limit.
        clear_no_return: metres that a beam without return clears.
        mount: x, y (m) and heading (rad) of the laser on the robot; None: as the log says, else 0.
        search_metres: radius of the search around the prediction.
        search_radians: angle of the search to both sides of the prediction.
        search_level: the level to search on. Level 1 (0.1 m by default) is about as wide as the
            gap between neighbouring beams across a room, so that a wall seen once has no holes.
        use_odometry: whether odometry predicts the motion; if not, the last motion does.
        rule: what an occupied cell is.
        log: how the log is read.
    """

    lattice: str | list[list[float]] = "A2"
    resolution: float = 0.05
    levels: int = 3
    min_range: float = 0.0
    max_range: float | None = None
    clear_no_return: float = 0.0
    mount: tuple[float, float, float] | None = None
    search_metres: float = 0.5
    search_radians: float = math.radians(20.0)
    search_level: int = 1
    use_odometry: bool = True
    rule: StateRule = field(default_factory=StateRule)
    log: LogSettings = field(default_factory=LogSettings)

    def __post_init__(self) -> None:
        """Check what the parts do not check themselves."""
        if not 0 <= self.search_level < self.levels:
            raise ArgumentError(f"the search level must be 0 to {self.levels - 1}, not {self.search_level}")
        SearchWindow(self.search_metres, self.search_radians)
        if self.mount is not None:
            object.__setattr__(self, "mount", tuple(float(v) for v in self.mount))
            if len(self.mount) != 3 or not all(math.isfinite(v) for v in self.mount):
                raise ArgumentError(f"the mount of the laser takes x, y and a heading, not {self.mount}")
        if self.make_lattice().dim != 2:
            raise ArgumentError(
                f"a planar log cannot be mapped on {self.make_lattice().name}, a lattice of space; take Z2 or A2"
            )

    def make_lattice(self) -> Lattice:
        """Return the lattice of the finest level."""
        if isinstance(self.lattice, str):
            return Lattice.named(self.lattice, self.resolution)
        return Lattice(np.array(self.lattice))

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as plain JSON values."""
        return asdict(self)

    @classmethod
    def from_dict(cls, value: Mapping[str, Any]) -> MappingSettings:
        """Make settings of what :meth:`to_dict` returned; settings that are left out keep their defaults.

        Raises:
            ArgumentError: a setting is not known or has a wrong value.
        """
        known = {f.name for f in fields(cls)}
        unknown = sorted(set(value) - known)
        if unknown:
            raise ArgumentError(f"no setting is called {unknown[0]!r}; known are {', '.join(sorted(known))}")
        values = dict(value)
        for name, kinds in _KINDS.items():
            if name in values and (
                not isinstance(values[name], kinds) or isinstance(values[name], bool) != (kinds is bool)
            ):
                raise ArgumentError(f"the setting {name} has a wrong value: {values[name]!r}")
        for part in ("rule", "log"):
            if part in values and not isinstance(values[part], Mapping):
                raise ArgumentError(f"the setting {part} has a wrong value: {values[part]!r}")
        try:
            if "rule" in values:
                values["rule"] = StateRule(**values["rule"])
            if "log" in values:
                values["log"] = LogSettings(**values["log"])
            return cls(**values)
        except HexmapError:
            raise
        except (TypeError, ValueError) as error:
            raise ArgumentError(f"not a configuration of a map: {error}") from error


_KINDS: dict[str, Any] = {
    "lattice": (str, list),
    "resolution": (int, float),
    "levels": int,
    "min_range": (int, float),
    "max_range": (int, float, type(None)),
    "clear_no_return": (int, float),
    "mount": (list, tuple, type(None)),
    "search_metres": (int, float),
    "search_radians": (int, float),
    "search_level": int,
    "use_odometry": bool,
}


@dataclass(frozen=True, eq=False)
class MappingResult:
    """A finished map and what was counted on the way.

    Attributes:
        map: the map.
        scans: laser readings fused.
        odometry: odometry readings seen.
        matched: scans that were matched (the first has nothing to be matched against).
        unmatched: scans that coincided with nothing and kept their prediction.
        skipped: scans without a pose, where poses were given.
        mean_part: mean part of a scan's cells that coincided with the map when it was matched.
        metres: length of the way.
        warnings: what was wrong with the log, one line each.
    """

    map: Map
    scans: int
    odometry: int
    matched: int
    unmatched: int
    skipped: int
    mean_part: float
    metres: float
    warnings: list[str]


class ScanMapper:
    """Simultaneous localisation and mapping by scan matching alone: no loop closure, no back end.

    Feed it events in the log's order; it yields the poses that became final.
    """

    def __init__(self, settings: MappingSettings, mount: Pose | None = None) -> None:
        """Make a mapper; ``mount`` is T_robot_laser where the settings do not say."""
        self.settings = settings
        self.builder = make_builder(settings)
        self.mount = make_mount(settings, mount)
        self._matcher = ScanMatcher(SearchWindow(settings.search_metres, settings.search_radians))
        self._coarse = CounterOccupancy(self.builder.counter(settings.search_level), settings.rule)
        self._fine = CounterOccupancy(self.builder.counter(0), settings.rule)
        self._T_map_robot = Pose.identity(2)
        self._last_motion = Pose.identity(2)
        self._T_odom_robot: Pose | None = None
        self._waiting: list[tuple[float, Pose | None]] = []
        self.jumps = 0
        self.last_match: Match | None = None
        self.matched = 0
        self.unmatched = 0
        self.part_sum = 0.0

    def add(self, event: Event) -> Iterator[tuple[float, Pose, bool]]:
        """Take the next event; yield stamp, T_map_robot and "is a scan" of all readings whose pose is now final.

        Poses of odometry readings between two scans are final only after the second: they get
        their share of its correction.
        """
        if isinstance(event, Odometry):
            predicted = self._predict(event.pose) if self.settings.use_odometry else None
            self._waiting.append((event.stamp, predicted))
            if self._T_odom_robot is None and self.settings.use_odometry:
                self._T_odom_robot = event.pose
            if len(self._waiting) >= 10_000:  # a log that drives on without a laser must not fill the memory
                yield from self.finish()
            return
        odometry = event.odometry if self.settings.use_odometry else None
        if odometry is not None:
            if self._T_odom_robot is None:
                self._T_odom_robot = odometry
            by_wheels = self._predict(odometry)
        else:
            by_wheels = self._waiting[-1][1] if self._waiting else None
        predicted = by_wheels if by_wheels is not None else self._T_map_robot @ self._last_motion
        T_map_robot = self._match(event, predicted)
        correction = predicted.inverse() @ T_map_robot
        motion = self._T_map_robot.inverse() @ T_map_robot
        for k, (stamp, pose) in enumerate(self._waiting):
            part = (k + 1) / (len(self._waiting) + 1)
            if pose is None:  # nothing is known but the scans before and after
                yield stamp, self._T_map_robot @ _part_of(motion, part), False
            else:
                yield stamp, pose @ _part_of(correction, part), False
        self._waiting.clear()
        yield event.stamp, T_map_robot, True
        self._last_motion = self._T_map_robot.inverse() @ T_map_robot
        self._T_map_robot = T_map_robot
        if odometry is not None:
            self._T_odom_robot = odometry

    def finish(self) -> Iterator[tuple[float, Pose, bool]]:
        """Yield the readings after the last scan, at their predicted poses."""
        for stamp, pose in self._waiting:
            yield stamp, pose if pose is not None else self._T_map_robot, False
        self._waiting.clear()

    def _predict(self, odometry: Pose) -> Pose | None:
        """Return T_map_robot of an odometry reading, carried on from the last scan; None where it cannot be true."""
        if self._T_odom_robot is None:
            return self._T_map_robot
        motion = self._T_odom_robot.inverse() @ odometry
        if math.hypot(motion.x, motion.y) > FARTHEST_JUMP:
            self.jumps += 1
            return None
        return self._T_map_robot @ motion

    def _match(self, scan: Scan, predicted: Pose) -> Pose:
        """Match a scan around ``predicted`` (T_map_robot), fuse it at the pose found and return that."""
        settings = self.settings
        ranges = np.sqrt((scan.points**2).sum(axis=1))
        usable = scan.points[(ranges >= settings.min_range) & (ranges <= _limit(settings.max_range))]
        T_map_robot = predicted
        if self.builder.scans > 0 and len(usable):
            found = self._search(self.mount.apply(usable), predicted)
            self.last_match = found
            if found is None:
                self.unmatched += 1
            else:
                self.matched += 1
                self.part_sum += found.part
                T_map_robot = found.pose
        self.builder.fuse(scan, T_map_robot @ self.mount)
        return T_map_robot

    def _search(self, points: np.ndarray, predicted: Pose) -> Match | None:
        """Match in the window; where most of the scan then disagrees with the map, look farther.

        Wheels that slip or a laser that skips a turn put the true pose outside any window that is
        fast for every scan. A scan that enters a new room disagrees as well, and there a wide
        window finds chance agreements: a wider search must beat the narrower one clearly.
        """
        best: Match | None = None
        for factor in WIDENING:
            window = SearchWindow(
                self.settings.search_metres * factor, min(self.settings.search_radians * factor, math.pi)
            )
            found = self._matcher.match(points, predicted, self._coarse, fine=self._fine, window=window)
            if found is not None and (best is None or found.score > CLEARLY * best.score):
                best = found
            if best is not None and best.part >= ENOUGH:
                break
        return best


# Metres that no robot drives between a scan and the next reading: a damaged number or a reset of the odometry.
FARTHEST_JUMP = 100.0
# A scan agrees with the map when at least half of its cells do; if not, the window is doubled twice.
WIDENING = (1.0, 2.0, 4.0)
ENOUGH = 0.5
# The number of coincident cells of a scan that half agrees scatters by about a tenth (the square
# root of some hundred cells): two and a half times that is no chance.
CLEARLY = 1.25


def _limit(max_range: float | None) -> float:
    return math.inf if max_range is None else max_range


def make_builder(settings: MappingSettings) -> MapBuilder:
    """Return the empty builder that the settings describe."""
    return MapBuilder(
        settings.make_lattice(),
        settings.levels,
        min_range=settings.min_range,
        max_range=_limit(settings.max_range),
        clear_no_return=settings.clear_no_return,
    )


def make_mount(settings: MappingSettings, from_log: Pose | None) -> Pose:
    """Return T_robot_laser: as set, else as the log has it, else the identity."""
    if settings.mount is not None:
        return Pose.planar(*settings.mount)
    return from_log if from_log is not None else Pose.identity(2)


def _part_of(motion: Pose, part: float) -> Pose:
    """Return a part (0 to 1) of a small motion of the plane."""
    return Pose.planar(motion.x * part, motion.y * part, motion.theta * part)


def _source(log: Log, settings: MappingSettings, result: str) -> dict[str, Any]:
    """Return what the map file says of where the map came from."""
    import numba

    import hexmap

    return {
        "log": log.path.name,
        "format": log.format,
        "poses": result,
        "settings": settings.to_dict(),
        "versions": {
            "hexmap": hexmap.__version__,
            "numpy": np.__version__,
            "numba": numba.__version__,
            "python": platform.python_version(),
        },
    }


def build_map(
    log: Log,
    settings: MappingSettings | None = None,
    *,
    on_pose: OnPose | None = None,
    progress: Progress | None = None,
) -> MappingResult:
    """Map a log by scan matching.

    Args:
        log: an open log (``hexmap.logs.open_log``).
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
    way = _Way(on_pose)
    unusable = _Unusable(log)
    for event in log:
        if mapper is None:
            mapper = ScanMapper(settings, log.mount)
        try:
            readings = list(mapper.add(event))
        except (BoundsError, TooLargeError) as error:
            unusable.add(event, error)
            continue
        for reading in readings:
            way.add(*reading)
        if progress is not None and isinstance(event, Scan):
            progress(mapper.builder.scans)
    if mapper is None:
        raise LogError(f"{log.path}: there is no laser reading in it")
    unusable.check(mapper.builder.scans)
    for reading in mapper.finish():
        way.add(*reading)
    return MappingResult(
        map=mapper.builder.build(source=_source(log, settings, "scan matching")),
        scans=mapper.builder.scans,
        odometry=log.odometry,
        matched=mapper.matched,
        unmatched=mapper.unmatched,
        skipped=0,
        mean_part=mapper.part_sum / mapper.matched if mapper.matched else 0.0,
        metres=way.metres,
        warnings=[*log.warnings, *unusable.warnings, *_jumps(log, mapper.jumps)],
    )


def _jumps(log: Log, count: int) -> list[str]:
    if not count:
        return []
    return [
        f"{log.path}: odometry jumps by more than {FARTHEST_JUMP:g} m {count} times; the last motion was used there"
    ]


class _Unusable:
    """Counts the scans that cannot go into the map and remembers the first, for one clear line."""

    def __init__(self, log: Log) -> None:
        self._log = log
        self._count = 0
        self._first = ""

    def add(self, event: Event, error: Exception) -> None:
        if self._count == 0:
            self._first = f"line {event.line}: {error}" if event.line is not None else str(error)
        self._count += 1

    def check(self, used: int) -> None:
        """Raise where not one scan could be used."""
        if self._count and not used:
            raise LogError(f"{self._log.path}: no scan can be used, {self._first}")

    @property
    def warnings(self) -> list[str]:
        if not self._count:
            return []
        return [f"{self._log.path}: {self._count} scans cannot be used and are left out, the first at {self._first}"]


class _Way:
    """Passes poses on and measures the way."""

    def __init__(self, on_pose: OnPose | None) -> None:
        self._on_pose = on_pose
        self._last: Pose | None = None
        self.metres = 0.0

    def add(self, stamp: float, pose: Pose, is_scan: bool) -> None:
        if self._last is not None:
            self.metres += math.dist(self._last.translation, pose.translation)
        self._last = pose
        if self._on_pose is not None:
            self._on_pose(stamp, pose, is_scan)


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


def fuse_log(
    log: Log,
    poses: Trajectory,
    settings: MappingSettings | None = None,
    *,
    associate: str | None = None,
    tolerance: float = 0.1,
    on_pose: OnPose | None = None,
    progress: Progress | None = None,
) -> MappingResult:
    """Map a log whose poses (T_map_robot) are known.

    How poses go with scans is said at :func:`readings_at_poses`; scans without a pose are left out
    and counted.

    Raises:
        LogError: the log cannot be read or has no laser reading.
        TrajectoryError: the poses go with no scan, or not by the order asked for.
    """
    settings = settings or MappingSettings()
    builder = make_builder(settings)
    mount: Pose | None = None
    skipped = seen = 0
    way = _Way(on_pose)
    unusable = _Unusable(log)
    for event, pose in readings_at_poses(log, poses, associate=associate, tolerance=tolerance):
        if isinstance(event, Odometry):
            if pose is not None:
                way.add(event.stamp, pose, False)
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
                way.add(event.stamp, pose, True)
        seen += 1
        if progress is not None:
            progress(seen)
    unusable.check(builder.scans)
    if builder.scans == 0:
        raise TrajectoryError(
            f"none of the {len(poses)} poses is within {tolerance:g} s of one of the {seen} scans of {log.path}"
        )
    return MappingResult(
        map=builder.build(source=_source(log, settings, "given")),
        scans=builder.scans,
        odometry=log.odometry,
        matched=0,
        unmatched=0,
        skipped=skipped,
        mean_part=0.0,
        metres=way.metres,
        warnings=[*log.warnings, *unusable.warnings],
    )
