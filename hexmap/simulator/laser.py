"""The laser: where its beams end, in closed form, and what the instrument makes of that."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError
from hexmap.poses.pose import Pose

__all__ = ["NO_RETURN", "Laser", "cast", "cast_unchecked"]

NO_RETURN = 81.83
"""Range in metres that a SICK LMS, and so a CARMEN log, writes for a beam that returned nothing."""

# An end point this close to the line of a ray counts as on it: well above the rounding of coordinates of a
# building (1e-14 m), well below anything a laser resolves.
_ON_RAY = 1e-12
# An origin this close to a wall stands on it.
_ON_WALL = 1e-9


@dataclass(frozen=True)
class Laser:
    """Settings of a planar laser; the defaults are those of a SICK LMS.

    Attributes:
        beams: number of beams of one scan.
        first: angle of the first beam in the laser's frame, radians; the others follow counter-clockwise.
        step: angle between two beams, radians. None spreads them over 180 degrees as CARMEN logs do: an odd
            number includes both ends (181: 1 degree, 361: 0.5 degrees), an even number leaves out the last one.
        rate: scans a second.
        noise: standard deviation of a range, metres.
        resolution: ranges are rounded to multiples of this, metres; 0 leaves them as they are.
        missing: probability that a beam returns nothing although there is a wall.
        max_range: walls beyond this return nothing, metres.
        mount: T_robot_laser, where the laser sits on the robot.
    """

    beams: int = 181
    first: float = -math.pi / 2
    step: float | None = None
    rate: float = 5.0
    noise: float = 0.01
    resolution: float = 0.01
    missing: float = 0.005
    max_range: float = 30.0
    mount: Pose = field(default_factory=Pose.identity)

    def __post_init__(self) -> None:
        """Refuse settings that make no laser.

        Raises:
            ArgumentError: a setting that is out of its range.
        """
        if self.beams < 1:
            raise ArgumentError(f"a laser needs at least one beam, not {self.beams}")
        if not (math.isfinite(self.rate) and self.rate > 0.0):
            raise ArgumentError(f"the rate of a laser must be positive, not {self.rate}")
        for name in ("noise", "resolution"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ArgumentError(f"the {name} of a laser must be zero or more metres, not {value}")
        if not 0.0 <= self.missing <= 1.0:
            raise ArgumentError(f"the probability of a missing return must be within 0 and 1, not {self.missing}")
        if not 0.0 < self.max_range < NO_RETURN:
            raise ArgumentError(
                f"the maximum range must be between 0 and {NO_RETURN} m, which means no return; not {self.max_range}"
            )
        if not math.isfinite(self.first) or not (self.step is None or math.isfinite(self.step)):
            raise ArgumentError(f"the angles of a laser must be finite, not {self.first} and {self.step}")
        if self.mount.dim != 2:
            raise ArgumentError(f"the mount of a planar laser must be a pose of the plane, not {self.mount}")

    @property
    def angles(self) -> NDArray[np.float64]:
        """Angles of the beams in the laser's frame, (beams,) radians, counter-clockwise."""
        step = self.step
        if step is None:
            step = math.pi / (max(self.beams - 1, 1) if self.beams % 2 else self.beams)
        return self.first + step * np.arange(self.beams, dtype=np.float64)

    def measure(self, ranges: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
        """Return what the instrument reports for true ``ranges`` (B,), metres; inf where it reports nothing.

        The generator advances by the same amount whatever the ranges are.
        """
        noise = rng.standard_normal(len(ranges))
        lost = rng.random(len(ranges)) < self.missing
        seen = np.maximum(ranges + self.noise * noise, 0.0)
        if self.resolution > 0.0:
            seen = np.round(seen / self.resolution) * self.resolution
        # Judged after the noise, so that a reader with the same limit drops none of the returns.
        return np.where(lost | ~(seen <= self.max_range), np.inf, seen)


def cast(walls: ArrayLike, origin: ArrayLike, angles: ArrayLike) -> NDArray[np.float64]:
    """Return the distance from ``origin`` to the nearest wall along each of the rays.

    A ray through an end point hits the wall, so nothing leaks between two walls that share a corner. A ray along a
    wall ends where the wall begins. From an origin on a wall every range is 0.

    Args:
        walls: (S, 2, 2) end points of wall segments, metres.
        origin: (2,) where the rays start, metres, in the frame of the walls.
        angles: (B,) directions of the rays in the frame of the walls, radians.

    Returns:
        (B,) float64 ranges in metres; inf where a ray hits nothing.

    Raises:
        ArgumentError: arrays of other shapes, or values that are not finite.

    Examples:
        >>> import math
        >>> from hexmap.simulator import cast
        >>> cast([[[2.0, -1.0], [2.0, 1.0]]], [0.0, 0.0], [0.0, math.pi]).tolist()
        [2.0, inf]
    """
    w = np.asarray(walls, dtype=np.float64)
    o = np.asarray(origin, dtype=np.float64)
    theta = np.asarray(angles, dtype=np.float64)
    if w.ndim != 3 or w.shape[1:] != (2, 2) or o.shape != (2,) or theta.ndim != 1:
        raise ArgumentError(
            f"rays take walls (S, 2, 2), an origin (2,) and angles (B,), not {w.shape}, {o.shape} and {theta.shape}"
        )
    if not (np.isfinite(w).all() and np.isfinite(o).all() and np.isfinite(theta).all()):
        raise ArgumentError("walls, origins and angles of rays must be finite")
    return cast_unchecked(w, o, theta)


def cast_unchecked(
    walls: NDArray[np.float64], origin: NDArray[np.float64], angles: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return what :func:`cast` does, of float64 arrays that are known to be right."""
    beams = len(angles)
    ranges = np.full(beams, np.inf)
    if len(walls) == 0 or beams == 0:
        return ranges
    rel = walls - origin
    ax, ay, bx, by = rel[:, 0, 0], rel[:, 0, 1], rel[:, 1, 0], rel[:, 1, 1]
    ex, ey = bx - ax, by - ay
    square = ex * ex + ey * ey
    along = np.clip(-(ax * ex + ay * ey) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    if np.hypot(ax + along * ex, ay + along * ey).min() <= _ON_WALL:
        return np.zeros(beams)

    wall, ray = _candidates(np.arctan2(ay, ax), np.arctan2(by, bx), angles)
    dx, dy = np.cos(angles)[ray], np.sin(angles)[ray]
    ax, ay, bx, by = ax[wall], ay[wall], bx[wall], by[wall]
    # Signed distances of both end points from the line of the ray. A shared corner gives the same number for both of
    # its walls, so a ray between two walls that touch always crosses at least one of them.
    a = ax * dy - ay * dx
    b = bx * dy - by * dx
    a[np.abs(a) <= _ON_RAY] = 0.0
    b[np.abs(b) <= _ON_RAY] = 0.0
    t_a = ax * dx + ay * dy
    t_b = bx * dx + by * dy
    # The crossing is interpolated between the end points rather than divided by the sine of the angle of incidence,
    # so that it stays on the wall however flat the ray comes in.
    apart = a - b
    flat = (a == 0.0) & (b == 0.0)
    share = a / np.where(apart == 0.0, 1.0, apart)
    t = t_a + share * (t_b - t_a)
    if flat.any():
        # Seen end on; the origin is not on the wall, so both ends lie on the same side of it.
        t[flat] = np.minimum(t_a[flat], t_b[flat])
    hit = (np.minimum(a, b) <= 0.0) & (np.maximum(a, b) >= 0.0) & (t > 0.0)
    np.minimum.at(ranges, ray[hit], t[hit])
    return ranges


def _candidates(
    from_a: NDArray[np.float64], from_b: NDArray[np.float64], angles: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the pairs (wall, ray) that can meet: the rays within the angle that a wall fills as seen from the origin.

    ``from_a`` and ``from_b`` (S,) are the bearings of the end points. A wall fills less than half a turn, since the
    origin is not on it.
    """
    turn = 2.0 * math.pi
    wrapped = angles % turn
    order = np.argsort(wrapped, kind="stable")
    # Twice around, so that no wall is cut by the seam at 0.
    twice = np.concatenate([wrapped[order], wrapped[order] + turn])
    span = (from_b - from_a + math.pi) % turn - math.pi
    # Wide enough for an end point to count as on a ray from as near as an origin may come to a wall.
    margin = 2.0 * _ON_RAY / _ON_WALL
    low = (np.minimum(from_a, from_a + span) - margin) % turn
    first = np.searchsorted(twice, low, side="left")
    count = np.searchsorted(twice, low + np.abs(span) + 2.0 * margin, side="right") - first
    wall = np.repeat(np.arange(len(from_a)), count)
    offset = np.arange(len(wall)) - np.repeat(np.cumsum(count) - count, count)
    return wall, order[(np.repeat(first, count) + offset) % len(angles)]
