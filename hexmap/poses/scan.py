"""What a log is made of: laser scans and odometry readings.

A :class:`Scan` holds what one sweep of a range sensor saw, in the sensor's own frame; an
:class:`Odometry` holds where the wheels believe the robot to be. Both say where in the log they
stand, because the order in the file, not the time stamp, is the order of events.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError
from hexmap.base.text import quoted
from hexmap.base.values import kept, lossless, one_line, remade
from hexmap.poses.pose import Pose

__all__ = ["Event", "Odometry", "Scan"]


def _rows(values: object, what: str) -> NDArray[np.float64]:
    a = lossless(values)
    if a is None:
        raise ArgumentError(f"the {what} of a scan must be real numbers without a mask, not {quoted(values)}")
    if a.ndim != 2 or a.shape[1] not in (2, 3):
        raise ArgumentError(f"the {what} of a scan must be (N, 2) or (N, 3), not {a.shape}")
    return kept(a, np.float64)


def _one_each(values: object, what: str, n: int) -> NDArray[np.float64]:
    a = lossless(values)
    if a is None:
        raise ArgumentError(f"the {what} of a scan must be real numbers without a mask, not {quoted(values)}")
    if a.shape != (n,):
        raise ArgumentError(f"the {what} of a scan of {n} points must be ({n},), not {a.shape}")
    return kept(a, np.float64)


@dataclass(frozen=True, eq=False)
class Scan:
    """One sweep of a range sensor, in the sensor's frame.

    Attributes:
        stamp: seconds; may repeat and step back.
        points: (N, n) float64 end points of the beams that returned, metres.
        no_return: (M, n) unit directions of the beams that returned nothing.
        odometry: the pose of the robot in the odometry's frame that came with the scan, if any.
        line: line of the log (or the message's number) that the scan was read from, if any.
        times: (N,) float64 seconds after ``stamp`` at which each point was measured (may be negative), if known.
        intensity: (N,) float64 strength of each return in the sensor's own unit, if known.
    """

    stamp: float
    points: NDArray[np.float64]
    no_return: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
    odometry: Pose | None = None
    line: int | None = None
    times: NDArray[np.float64] | None = None
    intensity: NDArray[np.float64] | None = None

    __repr__ = one_line

    def __post_init__(self) -> None:
        """Make the arrays contiguous float64 and read-only, and check that their shapes fit."""
        points = _rows(self.points, "points")
        no_return = self.no_return
        if len(no_return) == 0:
            no_return = np.empty((0, points.shape[1]))
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "no_return", _rows(no_return, "rays without return"))
        if self.no_return.shape[1] != points.shape[1]:
            raise ArgumentError("points and rays without return must have the same dimension")
        for name in ("times", "intensity"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _one_each(getattr(self, name), name, len(points)))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy through the constructor: arrays that are unpickled can be written to."""
        return remade(self)

    @property
    def dim(self) -> int:
        """2 for a planar laser, 3 for a LiDAR."""
        return int(self.points.shape[1])


@dataclass(frozen=True)
class Odometry:
    """One reading of the odometry: ``pose`` is T_odom_robot at ``stamp`` seconds."""

    stamp: float
    pose: Pose
    line: int | None = None


Event: TypeAlias = Scan | Odometry
