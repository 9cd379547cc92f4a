"""Scans without odometry of their own wait for that around them, and for the joints of a mount that moves."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace

from hexmap.io.logs.bag_frames import Joints
from hexmap.poses.pose import Pose, wrap_angle
from hexmap.poses.scan import Event, Odometry, Scan

__all__ = ["Waiting"]

# How many events a scan waits for what comes after it, and how long in seconds.
_EVENTS = 200
_SECONDS = 2.0
# How many readings are kept: those of two seconds and more at a thousand hertz.
_READINGS = 2048


class Waiting:
    """Gives each scan the odometry at its stamp, in the order of the log."""

    def __init__(self, has_odometry: bool, joints: Joints | None) -> None:
        """Take what scans wait for.

        Args:
            has_odometry: readings of the odometry are to come.
            joints: the joints that move between robot and laser, if any do.
        """
        self._has_odometry = has_odometry
        self._joints = joints
        self._readings: deque[Odometry] = deque(maxlen=_READINGS)

    def events(self, events: Iterable[Event]) -> Iterator[Event]:
        """Yield the events, each scan once what it waits for is known, or will not come soon."""
        if not self._has_odometry and self._joints is None:
            yield from events
            return
        held: deque[Event] = deque()
        for event in events:
            if isinstance(event, Odometry):
                self._readings.append(event)
            held.append(event)
            while held:
                front = held[0]
                if isinstance(front, Scan):
                    soon = len(held) < _EVENTS and abs(event.stamp - front.stamp) < _SECONDS
                    if soon and not self._known(front.stamp):
                        break
                    front = self._with_odometry(front)
                held.popleft()
                yield front
        for event in held:
            yield self._with_odometry(event) if isinstance(event, Scan) else event

    def _known(self, stamp: float) -> bool:
        if self._has_odometry and not (self._readings and self._readings[-1].stamp >= stamp):
            return False
        return self._joints is None or self._joints.known(stamp)

    def _with_odometry(self, scan: Scan) -> Scan:
        pose = self._at(scan.stamp)
        return scan if pose is None else replace(scan, odometry=pose)

    def _at(self, stamp: float) -> Pose | None:
        """Return the odometry at a time: between two readings, the last one after all, none before all."""
        if not self._readings:
            return None
        after = self._readings[-1]
        if stamp >= after.stamp:
            return after.pose
        for before in reversed(self._readings):
            if before.stamp <= stamp:
                return _between(stamp, before, after)
            after = before
        return None


def _between(stamp: float, before: Odometry, after: Odometry) -> Pose:
    """Return the odometry at a time between two readings."""
    if not before.stamp < after.stamp:
        return before.pose
    part = (stamp - before.stamp) / (after.stamp - before.stamp)
    a, b = before.pose, after.pose
    turn = float(wrap_angle(b.theta - a.theta))
    return Pose.planar(a.x + part * (b.x - a.x), a.y + part * (b.y - a.y), a.theta + part * turn)
