"""Poses of scans by matching each against the map of those before."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hexmap.poses.pose import Pose
from hexmap.poses.scan import Event, Odometry, Scan
from localisation.matching.local_matcher import LocalMatcher
from localisation.matching.match import Match
from localisation.matching.occupancy import Occupancy
from localisation.matching.search_region import SearchWindow
from localisation.settings import MappingSettings, limit_of, make_builder, make_mount


class ScanMapper:
    """Simultaneous localisation and mapping by scan matching alone: no loop closure, no back end.

    Feed it events in the log's order; it yields the poses that became final.
    """

    def __init__(self, settings: MappingSettings, mount: Pose | None = None) -> None:
        """Make a mapper; ``mount`` is T_robot_laser where the settings do not say."""
        self.settings = settings
        self.builder = make_builder(settings)
        self.mount = make_mount(settings, mount)
        self._matcher = LocalMatcher(SearchWindow(settings.search_metres, settings.search_radians))
        self._coarse = Occupancy.of_counter(self.builder.counter(settings.search_level), settings.rule)
        self._fine = Occupancy.of_counter(self.builder.counter(0), settings.rule)
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
        usable = scan.points[(ranges >= settings.min_range) & (ranges <= limit_of(settings.max_range))]
        T_map_robot = predicted
        if self.builder.scans > 0 and len(usable):
            found = self._search(self.mount.apply(usable), predicted)
            self.last_match = found
            if found is None:
                self.unmatched += 1
            else:
                self.matched += 1
                self.part_sum += found.fraction
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
            if best is not None and best.fraction >= ENOUGH:
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


def _part_of(motion: Pose, part: float) -> Pose:
    """Return a part (0 to 1) of a small motion of the plane."""
    return Pose.planar(motion.x * part, motion.y * part, motion.theta * part)
