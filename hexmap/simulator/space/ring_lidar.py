"""The ring LiDAR: which ray is fired when, and what the instrument makes of how far it goes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError
from hexmap.poses.pose import Pose

__all__ = ["RingLidar"]


@dataclass(frozen=True)
class RingLidar:
    """Settings of a LiDAR whose head turns about its z axis; the defaults are those of a common one of 32 rings.

    One sweep is a full turn, clockwise as seen from above, from straight behind through the left side to the front and
    on. All rings fire at once, a column of rays for every azimuth.

    Attributes:
        rings: number of rings, the lowest first.
        lowest: elevation of the lowest ring, radians.
        highest: elevation of the highest ring, radians; the others are spread evenly between them.
        azimuths: columns of a sweep.
        rate: sweeps a second that are kept.
        sweep: seconds that a turn takes, at most ``1 / rate``; 0 for all columns at one instant.
        noise: standard deviation of a range, metres.
        resolution: ranges are rounded to multiples of this, metres; 0 leaves them as they are.
        missing: probability that a ray returns nothing although it meets something.
        min_range: nearer returns are not reported, metres.
        max_range: nor are those that are farther than this, metres.
        mount: T_robot_lidar, where the LiDAR sits; the robot's frame is on the ground below its middle.
        own_body: whether the rays meet two posts of the robot itself, behind the LiDAR.
    """

    rings: int = 32
    lowest: float = math.radians(-25.0)
    highest: float = math.radians(15.0)
    azimuths: int = 1024
    rate: float = 5.0
    sweep: float = 0.1
    noise: float = 0.02
    resolution: float = 0.002
    missing: float = 0.01
    min_range: float = 0.3
    max_range: float = 60.0
    mount: Pose = field(default_factory=lambda: Pose(np.eye(3), [0.0, 0.0, 1.0]))
    own_body: bool = False

    def __post_init__(self) -> None:
        """Refuse settings that make no LiDAR.

        Raises:
            ArgumentError: a setting that is out of its range.
        """
        if not 1 <= self.rings <= 65535:
            raise ArgumentError(f"a ring LiDAR must have 1 to 65535 rings, not {self.rings}")
        if self.azimuths < 1:
            raise ArgumentError(f"a sweep must have at least one azimuth, not {self.azimuths}")
        if not -math.pi / 2 <= self.lowest <= self.highest <= math.pi / 2:
            raise ArgumentError(
                f"the elevations of the rings must rise within -pi/2 and pi/2, not from {self.lowest} to {self.highest}"
            )
        if not (math.isfinite(self.rate) and self.rate > 0.0):
            raise ArgumentError(f"the rate of a LiDAR must be positive, not {self.rate}")
        if not 0.0 <= self.sweep <= (1.0 + 1e-9) / self.rate:
            raise ArgumentError(f"a sweep must take between 0 and {1.0 / self.rate:g} s at this rate, not {self.sweep}")
        for name in ("noise", "resolution"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ArgumentError(f"the {name} of a LiDAR must be zero or more metres, not {value}")
        if not 0.0 <= self.missing <= 1.0:
            raise ArgumentError(f"the probability of a missing return must be within 0 and 1, not {self.missing}")
        if not 0.0 <= self.min_range < self.max_range < math.inf:
            raise ArgumentError(
                f"the ranges of a LiDAR must be zero or more and rise, not from {self.min_range} to {self.max_range}"
            )
        if self.mount.dim != 3:
            raise ArgumentError(f"the mount of a ring LiDAR must be a pose of space, not {self.mount}")

    @property
    def directions(self) -> FloatArray:
        """Unit vectors (azimuths, rings, 3) of the rays in the LiDAR's frame, in the order in which they are fired."""
        azimuth = math.pi - 2.0 * math.pi * np.arange(self.azimuths) / self.azimuths
        elevation = np.linspace(self.lowest, self.highest, self.rings)
        out = np.empty((self.azimuths, self.rings, 3))
        out[..., 0] = np.cos(azimuth)[:, None] * np.cos(elevation)
        out[..., 1] = np.sin(azimuth)[:, None] * np.cos(elevation)
        out[..., 2] = np.sin(elevation)
        return out

    @property
    def column_times(self) -> FloatArray:
        """Seconds (azimuths,) after the stamp at which the columns are fired: none is positive, the last is 0."""
        step = self.sweep / self.azimuths
        return np.arange(1.0 - self.azimuths, 1.0, dtype=np.float64) * step

    def measure(self, ranges: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return what the instrument reports for true ``ranges`` (any shape), metres; inf where it reports nothing."""
        noise = rng.standard_normal(ranges.shape)
        lost = rng.random(ranges.shape) < self.missing
        seen = np.maximum(ranges + self.noise * noise, 0.0)
        if self.resolution > 0.0:
            seen = np.round(seen / self.resolution) * self.resolution
        # Judged after the noise, so that a reader with the same limits drops none of the returns.
        return np.where(lost | ~((seen >= self.min_range) & (seen <= self.max_range)), np.inf, seen)
