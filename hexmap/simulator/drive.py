"""The drive: a path of way points with rounded corners, as a pose for every time."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError

__all__ = ["Drive", "clearance"]

# Turns sharper than this are made on the spot, as are those that leave no room for a radius worth the name.
_SHARPEST_ARC = math.radians(150.0)
_SMALLEST_RADIUS = 0.1


class Drive:
    """A drive along way points: straight legs, arcs at the corners, turns on the spot where the path goes back.

    Every piece has a constant speed and a constant turn rate, so the pose at any time has a closed form and nothing
    depends on a step of integration. Arcs are driven more slowly where the turn rate asks for it.

    Attributes:
        duration: seconds from the first way point to the last.
        length: metres driven.
        leg_times: (W - 1, 2) seconds at which the straight part of each leg begins and ends.
    """

    duration: float
    length: float
    leg_times: NDArray[np.float64]

    def __init__(
        self, waypoints: ArrayLike, *, speed: float = 0.5, turn_rate: float = 0.8, corner_radius: float = 0.6
    ) -> None:
        """Plan the drive.

        Args:
            waypoints: (W, 2) corners of the path, metres, at least two, no two neighbours the same.
            speed: metres a second on the straight.
            turn_rate: the fastest turn, radians a second.
            corner_radius: radius of the arc at a corner in metres; smaller where the legs are short.

        Raises:
            ArgumentError: way points of another shape, not finite or repeated, or a setting that is not positive.
        """
        points = np.asarray(waypoints, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2 or not np.isfinite(points).all():
            raise ArgumentError(f"a drive takes at least two finite way points (W, 2), not an array {points.shape}")
        for name, value in (("speed", speed), ("turn rate", turn_rate), ("corner radius", corner_radius)):
            if not (math.isfinite(value) and value > 0.0):
                raise ArgumentError(f"the {name} of a drive must be positive, not {value}")
        legs = np.diff(points, axis=0)
        lengths = np.hypot(legs[:, 0], legs[:, 1])
        if not (lengths > 0.0).all():
            raise ArgumentError(f"way point {int(np.argmin(lengths)) + 1} of the drive repeats the one before it")
        # Unwrapped, so that the heading has no jump that the wheels would take for a turn.
        headings = np.unwrap(np.arctan2(legs[:, 1], legs[:, 0]))

        pieces: list[tuple[float, ...]] = []  # x, y, theta at its start, speed, turn rate, seconds
        straight: list[int] = []  # which piece is the straight part of each leg
        start = 0.0  # how much of the current leg the corner before it has used
        for i, (point, leg, heading) in enumerate(zip(points, lengths, headings, strict=False)):
            u = np.array([math.cos(heading), math.sin(heading)])
            turn, radius, tangent = 0.0, 0.0, 0.0
            if i + 1 < len(lengths):
                turn = float(headings[i + 1] - heading)
                if 1e-12 < abs(turn) <= _SHARPEST_ARC:
                    # Each corner gets less than half of a leg, so two corners never meet.
                    half = math.tan(0.5 * abs(turn))
                    radius = min(corner_radius, 0.45 * min(leg, lengths[i + 1]) / half)
                    radius = radius if radius >= _SMALLEST_RADIUS else 0.0
                    tangent = radius * half
            begin, end = point + start * u, point + (leg - tangent) * u
            straight.append(len(pieces))
            pieces.append((begin[0], begin[1], heading, speed, 0.0, (leg - tangent - start) / speed))
            if abs(turn) > 1e-12:
                pace = min(speed, turn_rate * radius)
                rate = math.copysign(pace / radius if radius > 0.0 else turn_rate, turn)
                pieces.append((end[0], end[1], heading, pace, rate, turn / rate))
            start = tangent
        self._pieces = np.array(pieces, dtype=np.float64)
        ends = np.cumsum(self._pieces[:, 5])
        self._starts = np.concatenate([[0.0], ends[:-1]])
        self.leg_times = np.column_stack([self._starts, ends])[straight]
        self.duration = float(ends[-1])
        self.length = self.length_until(self.duration)

    def length_until(self, time: float) -> float:
        """Return the metres driven after ``time`` seconds."""
        return float((np.clip(time - self._starts, 0.0, self._pieces[:, 5]) * self._pieces[:, 3]).sum())

    def poses(self, times: ArrayLike) -> NDArray[np.float64]:
        """Return x, y (metres) and heading (radians, not wrapped) at ``times`` (N,) seconds, as (N, 3).

        Before the beginning the robot stands at the first way point, after the end at the last.
        """
        t = np.asarray(times, dtype=np.float64)
        which = np.clip(np.searchsorted(self._starts, t, side="right") - 1, 0, len(self._starts) - 1)
        x, y, theta, speed, rate, seconds = self._pieces[which].T
        tau = np.clip(t - self._starts[which], 0.0, seconds)
        turned = theta + rate * tau
        bent = rate != 0.0
        # Equations of a unicycle at constant speed and turn rate.
        radius = speed / np.where(bent, rate, 1.0)
        dx = np.where(bent, radius * (np.sin(turned) - np.sin(theta)), speed * tau * np.cos(theta))
        dy = np.where(bent, radius * (np.cos(theta) - np.cos(turned)), speed * tau * np.sin(theta))
        return np.column_stack([x + dx, y + dy, turned])


def clearance(drive: Drive, walls: ArrayLike, every: float = 0.05) -> float:
    """Return how near the drive comes to a wall, in metres, looked at ``every`` so many seconds.

    Args:
        drive: the drive, in the frame of the walls.
        walls: (S, 2, 2) end points of wall segments, metres.
        every: seconds between two looks.
    """
    w = np.asarray(walls, dtype=np.float64)
    a, e = w[:, 0], w[:, 1] - w[:, 0]
    square = np.maximum((e * e).sum(axis=1), np.finfo(np.float64).tiny)
    times = np.append(np.arange(0.0, drive.duration, every), drive.duration)
    nearest = math.inf
    for part in np.array_split(drive.poses(times)[:, :2], 1 + len(times) // 1000):
        rel = part[:, None, :] - a
        share = np.clip((rel * e).sum(axis=2) / square, 0.0, 1.0)
        gap = rel - share[:, :, None] * e
        nearest = min(nearest, float(np.hypot(gap[:, :, 0], gap[:, :, 1]).min(initial=math.inf)))
    return nearest
