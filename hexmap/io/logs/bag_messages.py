"""What the messages of a bag say: ranges, angles that contradict each other, readings of the odometry, stamps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Odometry

__all__ = ["contradiction", "message_stamp", "odometry_reading", "scan_ranges"]


def scan_ranges(message: Any) -> FloatArray:
    """Return the ranges of a scan; of several echoes of a beam the first, NaN where there is none."""
    ranges = message.ranges
    if len(ranges) and hasattr(ranges[0], "echoes"):
        return np.array([beam.echoes[0] if len(beam.echoes) else math.nan for beam in ranges], dtype=np.float64)
    return np.asarray(ranges, dtype=np.float64)


def contradiction(first: float, last: float, step: float, beams: int) -> str:
    """Return how the angles of a scan contradict each other, or nothing.

    Drivers differ by a beam in what the last angle is: that of the last beam, or of one more or less.
    """
    if beams < 2:
        return ""
    span = step * (beams - 1)
    if not abs((last - first) - span) <= 1.5 * abs(step) + 1e-4 * abs(span):
        return (
            f"{beams} beams by angle_increment {step:.6g} span {span:.6g} rad, "
            f"from angle_min {first:.6g} to angle_max {last:.6g} are {last - first:.6g}"
        )
    if abs(span) > 2.0 * math.pi + 1.5 * abs(step) + 1e-3:
        return f"{beams} beams by angle_increment {step:.6g} span {span:.6g} rad, more than a turn; degrees, perhaps"
    return ""


def odometry_reading(message: Any, nanoseconds: int, number: int) -> Odometry:
    """Return the reading of an odometry message."""
    position, q = message.pose.pose.position, message.pose.pose.orientation
    pose = Pose.from_quaternion((position.x, position.y, position.z), (q.x, q.y, q.z, q.w))
    return Odometry(message_stamp(message.header, nanoseconds), Pose.planar(pose.x, pose.y, pose.theta), number)


def message_stamp(header: Any, nanoseconds: int) -> float:
    """Return the stamp in seconds: the header's, or the time of recording where that was never filled in."""
    seconds = header.stamp.sec + header.stamp.nanosec * 1e-9
    return float(seconds if seconds != 0 else nanoseconds * 1e-9)
