"""Predict the motion between scans: by the wheels, or by the last motion where they say nothing."""

from __future__ import annotations

import math

from hexmap.poses.pose import Pose
from hexmap.poses.scan import Odometry, Scan
from localisation.odometry.odometry import Reading, RegisteredScan

__all__ = ["FARTHEST_JUMP", "MotionPredictor"]

# Metres that no robot drives between a scan and the next reading: a damaged number or a reset of the odometry.
FARTHEST_JUMP = 100.0
# A log that drives on without a laser must not fill the memory: so many readings wait for a scan at most.
_MOST_WAITING = 10_000


class MotionPredictor:
    """Carries the last pose on by the odometry's increments; by itself an odometry of the wheels alone.

    Poses of readings between two scans are final only after the second: they get their share of its correction.

    Attributes:
        jumps: readings that could not be true; the last motion was used there.
    """

    def __init__(self, *, use_odometry: bool = True, mount: Pose | None = None) -> None:
        """Begin at the origin of the map; ``mount`` is T_robot_laser."""
        self._use_odometry = use_odometry
        self._mount = mount if mount is not None else Pose.identity(2)
        self._T_map_robot = Pose.identity(2)
        self._last_motion = Pose.identity(2)
        self._T_odom_robot: Pose | None = None
        self._T_robot_odom: Pose | None = None
        self._waiting: list[tuple[float, Pose | None]] = []
        self.jumps = 0

    def observe(self, reading: Odometry) -> tuple[Reading, ...]:
        """Take an odometry reading; return those that need not wait for a scan any longer: as a rule none."""
        predicted = self._carried_on(reading.pose) if self._use_odometry else None
        self._waiting.append((reading.stamp, predicted))
        if self._T_odom_robot is None and self._use_odometry:
            self._set_odometry(reading.pose)
        return self.finish() if len(self._waiting) >= _MOST_WAITING else ()

    def predict(self, scan: Scan) -> Pose:
        """Return T_map_robot at a scan as far as the odometry or the last motion tells."""
        odometry = scan.odometry if self._use_odometry else None
        if odometry is not None:
            if self._T_odom_robot is None:
                self._set_odometry(odometry)
            by_wheels = self._carried_on(odometry)
        else:
            by_wheels = self._waiting[-1][1] if self._waiting else None
        return by_wheels if by_wheels is not None else self._T_map_robot @ self._last_motion

    def arrive(self, scan: Scan, predicted: Pose, T_map_robot: Pose) -> tuple[Reading, ...]:
        """Go on from where the robot was at a scan; return the readings before it, which share the correction."""
        correction = predicted.inverse() @ T_map_robot
        motion = self._T_map_robot.inverse() @ T_map_robot
        readings = []
        for k, (stamp, pose) in enumerate(self._waiting):
            fraction = (k + 1) / (len(self._waiting) + 1)
            # Where there is no prediction nothing is known but the scans before and after.
            from_here, step = (self._T_map_robot, motion) if pose is None else (pose, correction)
            readings.append((stamp, from_here @ _fraction_of(step, fraction)))
        self._waiting.clear()
        self._last_motion = motion
        self._T_map_robot = T_map_robot
        if self._use_odometry and scan.odometry is not None:
            self._set_odometry(scan.odometry)
        return tuple(readings)

    def move_to(self, T_map_robot: Pose) -> None:
        """Go on from another pose of the robot at the last scan: the map's frame has moved under it."""
        self._T_map_robot = T_map_robot

    def register(self, scan: Scan) -> RegisteredScan:
        """Return the scan at the pose that is predicted."""
        predicted = self.predict(scan)
        return RegisteredScan(scan, predicted, predicted @ self._mount, self.arrive(scan, predicted, predicted))

    def finish(self) -> tuple[Reading, ...]:
        """Return the readings after the last scan, at their predicted poses."""
        readings = tuple((stamp, pose if pose is not None else self._T_map_robot) for stamp, pose in self._waiting)
        self._waiting.clear()
        return readings

    def _set_odometry(self, odometry: Pose) -> None:
        self._T_odom_robot, self._T_robot_odom = odometry, odometry.inverse()

    def _carried_on(self, odometry: Pose) -> Pose | None:
        """Return T_map_robot of an odometry reading, carried on from the last scan; None where it cannot be true."""
        if self._T_robot_odom is None:
            return self._T_map_robot
        motion = self._T_robot_odom @ odometry
        if math.hypot(motion.x, motion.y) > FARTHEST_JUMP:
            self.jumps += 1
            return None
        return self._T_map_robot @ motion


def _fraction_of(motion: Pose, fraction: float) -> Pose:
    """Return a fraction (0 to 1) of a small motion of the plane."""
    return Pose.planar(motion.x * fraction, motion.y * fraction, motion.theta * fraction)
