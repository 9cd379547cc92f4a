"""The points of a sweep, each measured from where the sensor was at its own time, brought to one time."""

from __future__ import annotations

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import logarithms
from hexmap.poses.scan import Scan

__all__ = ["Velocity", "deskewed"]

# Between scans that lie farther apart in time nothing is known of the motion within a sweep.
_LONGEST = 2.0


class Velocity:
    """A constant motion: metres and a rotation vector in radians a second, in the sensor's own frame.

    Attributes:
        linear: (3,) metres a second.
        angular: (3,) radians a second.
    """

    def __init__(self, linear: FloatArray, angular: FloatArray) -> None:
        """Take both."""
        self.linear, self.angular = linear, angular

    @classmethod
    def between(cls, motion: Pose, seconds: float) -> Velocity | None:
        """Return the velocity of a motion T_before_after in some seconds; None where stamps do not tell."""
        if not 0.0 < seconds < _LONGEST:
            return None
        return cls(motion.translation / seconds, logarithms(motion.rotation) / seconds)


def deskewed(scan: Scan, velocity: Velocity | None) -> FloatArray:
    """Return the points (N, 3) of a scan as the sensor would have seen them at its stamp, metres.

    Args:
        scan: with a time a point; without, the points are returned as they are.
        velocity: of the sensor; None: as if it stood.
    """
    if scan.times is None or velocity is None:
        return scan.points
    tau = scan.times[:, None]
    # Rodrigues for each point; the way is straight, which over a tenth of a second it is to a millimetre.
    w = velocity.angular
    rate = float(np.linalg.norm(w))
    p = np.asarray(scan.points)
    if rate * float(np.abs(scan.times).max(initial=0.0)) > 1e-9:
        axis = w / rate
        s, c = np.sin(rate * tau), np.cos(rate * tau)
        along = (p @ axis)[:, None] * axis
        p = p * c + np.cross(axis, p) * s + along * (1.0 - c)
    return np.ascontiguousarray(p + tau * velocity.linear)
