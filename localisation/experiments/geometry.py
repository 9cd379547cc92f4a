"""What differs between the plane and space in the experiment: rows of numbers for poses, errors, perturbed starts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import gammainc, gammaincinv

from hexmap.base.arrays import FloatArray
from hexmap.poses.pose import Pose, wrap_angle
from hexmap.poses.rotations import exponential, logarithms
from localisation.slam import planar, spatial

__all__ = ["Geometry", "geometry_of"]


@dataclass(frozen=True)
class Geometry:
    """The plane or space.

    Attributes:
        dim: 2 or 3.
        row: numbers that a pose is kept as: x, y, heading; or a rotation matrix and a translation.
        freedom: numbers that the error of a pose has.
        cell: what cells of one size have the same of.
    """

    dim: int
    row: int
    freedom: int
    cell: str

    def to_row(self, pose: Pose) -> FloatArray:
        """Return a pose as a row."""
        return planar.of_pose(pose) if self.dim == 2 else spatial.of_pose(pose)

    def to_pose(self, row: FloatArray) -> Pose:
        """Return the pose of a row."""
        return planar.to_pose(row) if self.dim == 2 else spatial.to_pose(row)

    def positions(self, rows: FloatArray) -> FloatArray:
        """Return where the poses of rows (K, row) are: (K, dim), metres."""
        return rows[:, :2] if self.dim == 2 else rows[:, 9:]

    def error(self, found: Pose, true: Pose) -> tuple[FloatArray, float, float]:
        """Return the error (freedom,) in the map's frame (metres, radians), and its size in metres and degrees.

        In space the rotation is a rotation vector in the map's axes about the sensor.
        """
        if self.dim == 2:
            turn = float(wrap_angle(found.theta - true.theta))
            off = np.array([found.x - true.x, found.y - true.y, turn])
            return off, math.hypot(float(off[0]), float(off[1])), math.degrees(abs(turn))
        vector = logarithms(found.rotation @ true.rotation.T)
        off = np.concatenate([found.translation - true.translation, vector])
        return off, math.dist(found.translation, true.translation), math.degrees(float(np.linalg.norm(vector)))

    def perturbed(self, true: Pose, metres: float, radians: float, rng: np.random.Generator) -> Pose:
        """Return a pose so far from the true one in a random direction, turned by so much.

        In the plane to either side, in space about a random axis.
        """
        if self.dim == 2:
            angle, side = rng.uniform(0.0, 2.0 * math.pi), 1.0 if rng.random() < 0.5 else -1.0
            return Pose.planar(
                true.x + metres * math.cos(angle), true.y + metres * math.sin(angle), true.theta + side * radians
            )
        direction, axis = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
        return Pose(exponential(axis * radians) @ true.rotation, true.translation + metres * direction)

    def about_z(self, radians: float, shift: FloatArray | None = None) -> Pose:
        """Return the turn by an angle about z, and the shift (dim,) after it."""
        turn = Pose.planar(0.0, 0.0, radians)
        R = np.eye(self.dim)
        R[:2, :2] = turn.rotation
        return Pose(R, np.zeros(self.dim) if shift is None else shift)

    def inside(self, squared: float) -> float:
        """Return of how much of a normal error an ellipsoid of so large a normalised squared radius is, 0 to 1."""
        return float(gammainc(0.5 * self.freedom, 0.5 * squared))

    @property
    def median_squared(self) -> float:
        """The median of normal errors, squared and normalised."""
        return float(2.0 * gammaincinv(0.5 * self.freedom, 0.5))


_PLANE, _SPACE = Geometry(2, 3, 3, "area"), Geometry(3, 12, 6, "volume")


def geometry_of(dim: int) -> Geometry:
    """Return the plane for 2 and space for 3."""
    return _PLANE if dim == 2 else _SPACE
