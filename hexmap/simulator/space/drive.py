"""The drive in space: a planar drive carried onto floors and ramps, as a pose for every time."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError
from hexmap.poses.rotations import euler_to_quaternions, quaternions_to_rotations
from hexmap.simulator.drive import Drive

__all__ = ["Drive3D"]

# Metres between the axles: where the ground bends, the robot pitches over this length and not all at once.
_WHEELBASE = 0.8
# The frame of a robot that drives is never quite still: roll and pitch sway at these rates, in Hz.
_SWAY_RATES = (0.7, 1.1)
# Into how many parts the time over which a drive is eased is cut; more would change a pose by less than a millimetre.
_PARTS = 16


class Drive3D:
    """A drive over floors and ramps: smooth in x, y, z, yaw, pitch and roll.

    The plan is that of :class:`hexmap.simulator.drive.Drive`; corners are on the flat and legs that rise are straight.
    The robot does not start, stop or begin a turn at once: place and heading are averaged over a short time. The height
    is that of the ground, averaged over the distance between the axles, and the pitch follows from it. Roll and pitch
    sway a little.

    Attributes:
        duration: seconds from standing at the first way point to standing at the last.
        length: metres driven, in the plan.
    """

    duration: float
    length: float

    def __init__(
        self,
        waypoints: ArrayLike,
        *,
        speed: float = 1.2,
        turn_rate: float = 0.8,
        corner_radius: float = 0.8,
        easing: float = 0.8,
        sway: float = math.radians(0.3),
        seed: int = 0,
    ) -> None:
        """Plan the drive.

        Args:
            waypoints: (W, 3) corners of the path on the ground, metres.
            speed: metres a second in the plan, on the straight and on ramps.
            turn_rate: the fastest turn, radians a second.
            corner_radius: radius of the arc at a corner in metres; smaller where the legs are short.
            easing: seconds that a change of speed or of the turn rate takes.
            sway: amplitude of the swaying of roll and pitch, radians; 0 for none.
            seed: of the phases of the swaying, zero or more.

        Raises:
            ArgumentError: way points of another shape, not finite or repeated in the plan, a corner beside a leg that
                rises, or a setting out of its range.
        """
        points = np.asarray(waypoints, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise ArgumentError(f"a drive in space takes finite way points (W, 3), not an array {points.shape}")
        if not (math.isfinite(easing) and easing >= 0.0):
            raise ArgumentError(f"the easing of a drive must be zero or more seconds, not {easing}")
        if not (math.isfinite(sway) and 0.0 <= sway < 0.2):
            raise ArgumentError(f"the sway of a drive must be between 0 and 0.2 radians, not {sway}")
        if seed < 0:
            raise ArgumentError(f"a seed must be zero or more, not {seed}")
        self._plan = Drive(points[:, :2], speed=speed, turn_rate=turn_rate, corner_radius=corner_radius)
        legs = np.diff(points, axis=0)
        cross = legs[:-1, 0] * legs[1:, 1] - legs[:-1, 1] * legs[1:, 0]
        onward = (legs[:-1, :2] * legs[1:, :2]).sum(axis=1) > 0.0
        turned = (np.abs(cross) > 1e-9) | ~onward
        rises = legs[:, 2] != 0.0
        if (turned & (rises[:-1] | rises[1:])).any():
            corner = 1 + int(np.argmax(turned & (rises[:-1] | rises[1:])))
            raise ArgumentError(f"way point {corner} of the drive is a corner beside a leg that rises")
        self.duration, self.length = self._plan.duration + easing, self._plan.length
        # The plan at these times before a moment makes the pose at that moment.
        self._delays = easing * (np.arange(_PARTS) + 0.5) / _PARTS if easing > 0.0 else np.zeros(1)
        # The height of the ground over time is linear between these, and so its integral is quadratic.
        times = self._plan.leg_times.ravel()
        heights = np.column_stack([points[:-1, 2], points[1:, 2]]).ravel()
        keep = np.concatenate([[True], np.diff(times) > 0.0])
        self._times, self._heights = times[keep], heights[keep]
        steps = np.diff(self._times) * 0.5 * (self._heights[1:] + self._heights[:-1])
        self._integral = np.concatenate([[0.0], np.cumsum(steps)])
        self._speed, self._sway = speed, sway
        self._phases = np.random.Generator(np.random.PCG64(seed)).uniform(0.0, 2.0 * math.pi, 2)

    def length_until(self, time: float) -> float:
        """Return the metres driven in the plan after ``time`` seconds."""
        return sum(self._plan.length_until(time - delay) for delay in self._delays.tolist()) / len(self._delays)

    def poses(self, times: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return where the robot is at ``times`` (N,) seconds: positions (N, 3) in metres and rotations (N, 3, 3).

        The position is that of the ground below the middle of the robot, the rotation T_map_robot's.
        """
        t = np.atleast_1d(np.asarray(times, dtype=np.float64))
        plan = np.zeros((len(t), 3))
        for delay in self._delays.tolist():
            plan += self._plan.poses(t - delay)
        x, y, yaw = plan.T / len(self._delays)
        # Speed is constant wherever the ground rises, so there the average of the places is the place at the mean time.
        window = _WHEELBASE / self._speed
        middle = t - float(self._delays.mean())
        before, after = middle - 0.5 * window, middle + 0.5 * window
        z = (self._area(after) - self._area(before)) / window
        climb = self._ground(after) - self._ground(before)
        roll, pitch = (
            self._sway * np.sin(2.0 * math.pi * rate * t + phase)
            for rate, phase in zip(_SWAY_RATES, self._phases, strict=True)
        )
        # Pitch turns about y, to the left: up is negative.
        pitch = pitch - np.arctan2(climb, _WHEELBASE)
        quaternions = euler_to_quaternions(np.column_stack([roll, pitch, yaw]))
        return np.column_stack([x, y, z]), quaternions_to_rotations(quaternions)

    def _ground(self, t: FloatArray) -> FloatArray:
        """Return the height of the ground under the path at times (N,)."""
        return np.interp(t, self._times, self._heights)

    def _area(self, t: FloatArray) -> FloatArray:
        """Return the integral of the height of the ground over time, up to times (N,)."""
        i = np.clip(np.searchsorted(self._times, t, side="right") - 1, 0, len(self._times) - 1)
        inside = np.clip(t, self._times[0], self._times[-1])
        area = self._integral[i] + (inside - self._times[i]) * 0.5 * (self._heights[i] + self._ground(inside))
        # Before the beginning and after the end the robot stands.
        return np.asarray(area + (t - inside) * self._ground(t))
