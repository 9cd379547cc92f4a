"""Rigid transforms in the plane and in space.

Metres and radians, right-handed, x forward, y left, z up; angles counter-clockwise; quaternions
in the order x y z w. A pose called ``T_map_scan`` maps coordinates of the scan into the map, so
``T_map_robot @ T_robot_scan`` reads as it is computed: the inner names cancel.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hexmap.base.arrays import FloatArray, multiply
from hexmap.base.errors import ArgumentError
from hexmap.poses.rotations import rotation_entries

__all__ = ["Pose", "wrap_angle"]


def wrap_angle(angle: Any) -> Any:
    """Return ``angle`` (radians, scalar or array) wrapped into [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


class Pose:
    """A rigid transform of the plane (dimension 2) or of space (dimension 3); immutable.

    Attributes:
        rotation: (n, n) float64 rotation matrix, read-only.
        translation: (n,) float64 in metres, read-only.

    Examples:
        >>> import math
        >>> from hexmap import Pose
        >>> T_map_robot = Pose.planar(1.0, 2.0, math.pi / 2)
        >>> T_map_robot.apply([[1.0, 0.0]]).round(6).tolist()
        [[1.0, 3.0]]
        >>> (T_map_robot @ T_map_robot.inverse()).is_close(Pose.identity(2))
        True
    """

    __slots__ = ("rotation", "translation")

    rotation: FloatArray
    translation: FloatArray

    def __init__(self, rotation: ArrayLike, translation: ArrayLike) -> None:
        """Make a pose of a rotation matrix and a translation in metres.

        Raises:
            ArgumentError: shapes that do not fit, values that are not finite, or a matrix that
                is not a rotation (to 1e-6).
        """
        R = np.array(rotation, dtype=np.float64)
        t = np.array(translation, dtype=np.float64)
        n = t.shape[0] if t.ndim == 1 else 0
        if n not in (2, 3) or R.shape != (n, n):
            raise ArgumentError(f"a pose takes (2, 2) and (2,) or (3, 3) and (3,) arrays, not {R.shape} and {t.shape}")
        if not (np.isfinite(R).all() and np.isfinite(t).all()):
            raise ArgumentError("a pose must be finite")
        if np.abs(R @ R.T - np.eye(n)).max() > 1e-6 or np.linalg.det(R) < 0.0:
            raise ArgumentError("the matrix of a pose must be a rotation")
        self._set(R, t)

    def _set(self, R: FloatArray, t: FloatArray) -> None:
        R.setflags(write=False)
        t.setflags(write=False)
        object.__setattr__(self, "rotation", R)
        object.__setattr__(self, "translation", t)

    @classmethod
    def _trusted(cls, R: FloatArray, t: FloatArray) -> Pose:
        """Make a pose without checks, for results that are rotations by construction."""
        pose = cls.__new__(cls)
        pose._set(R, t)
        return pose

    def __setattr__(self, name: str, value: object) -> None:
        """Refuse: a pose is a value."""
        raise AttributeError("a Pose is immutable")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle through the constructor (workers get poses)."""
        return (Pose, (np.array(self.rotation), np.array(self.translation)))

    @classmethod
    def identity(cls, dim: int = 2) -> Pose:
        """Return the pose that moves nothing."""
        return cls._trusted(np.eye(dim), np.zeros(dim))

    @classmethod
    def planar(cls, x: float, y: float, theta: float) -> Pose:
        """Return the pose of the plane at (x, y) metres, turned by ``theta`` radians."""
        if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(theta)):
            raise ArgumentError(f"a pose must be finite, not ({x}, {y}, {theta})")
        c, s = math.cos(theta), math.sin(theta)
        return cls._trusted(np.array([[c, -s], [s, c]]), np.array([x, y], dtype=np.float64))

    @classmethod
    def from_quaternion(cls, translation: ArrayLike, quaternion: ArrayLike) -> Pose:
        """Return the pose of space with ``translation`` (3,) and ``quaternion`` x y z w (normalised here)."""
        t = np.array(translation, dtype=np.float64)
        q = np.array(quaternion, dtype=np.float64)
        norm = float(np.linalg.norm(q)) if q.shape == (4,) else 0.0
        if t.shape != (3,) or not math.isfinite(norm) or norm < 1e-9:
            raise ArgumentError("a pose takes a translation of 3 and a non-zero quaternion x y z w of 4 numbers")
        x, y, z, w = q / norm
        return cls(rotation_entries(x, y, z, w), t)

    @classmethod
    def from_matrix(cls, matrix: ArrayLike) -> Pose:
        """Return the pose of a homogeneous (3, 3) or (4, 4) matrix."""
        m = np.array(matrix, dtype=np.float64)
        if m.shape not in ((3, 3), (4, 4)):
            raise ArgumentError(f"a homogeneous matrix is (3, 3) or (4, 4), not {m.shape}")
        return cls(m[:-1, :-1], m[:-1, -1])

    @property
    def dim(self) -> int:
        """2 in the plane, 3 in space."""
        return int(self.translation.shape[0])

    @property
    def x(self) -> float:
        """First coordinate of the translation, metres."""
        return float(self.translation[0])

    @property
    def y(self) -> float:
        """Second coordinate of the translation, metres."""
        return float(self.translation[1])

    @property
    def theta(self) -> float:
        """Heading about z in radians, in (-pi, pi]; in space the yaw of Rz Ry Rx."""
        return math.atan2(float(self.rotation[1, 0]), float(self.rotation[0, 0]))

    @property
    def angle(self) -> float:
        """Angle of the whole rotation in radians, 0 to pi."""
        if self.dim == 2:
            return abs(self.theta)
        R = self.rotation
        axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
        return math.atan2(float(np.linalg.norm(axis)), float(np.trace(R)) - 1.0)

    def quaternion(self) -> FloatArray:
        """Return the rotation as a unit quaternion x y z w with w >= 0; in the plane about z."""
        if self.dim == 2:
            half = 0.5 * self.theta
            return np.array([0.0, 0.0, math.sin(half), math.cos(half)])
        from scipy.spatial.transform import Rotation

        return np.asarray(Rotation.from_matrix(self.rotation).as_quat(canonical=True), dtype=np.float64)

    def matrix(self) -> FloatArray:
        """Return the homogeneous matrix, (3, 3) or (4, 4)."""
        m = np.eye(self.dim + 1)
        m[:-1, :-1] = self.rotation
        m[:-1, -1] = self.translation
        return m

    def inverse(self) -> Pose:
        """Return the inverse: ``T_map_scan.inverse()`` is ``T_scan_map``."""
        R = self.rotation.T.copy()
        return Pose._trusted(R, -(R @ self.translation))

    def __matmul__(self, other: Pose) -> Pose:
        """Compose: ``T_a_b @ T_b_c`` is ``T_a_c``."""
        if not isinstance(other, Pose):
            return NotImplemented
        if other.dim != self.dim:
            raise ArgumentError(f"a pose of dimension {self.dim} cannot be composed with one of {other.dim}")
        R = self.rotation @ other.rotation
        # One Newton step towards the nearest rotation: the inverse is taken to be the transpose, and
        # without this the rounding of long chains of poses would grow without bound.
        R = 1.5 * R - 0.5 * (R @ (R.T @ R))
        return Pose._trusted(R, self.rotation @ other.translation + self.translation)

    def apply(self, points: ArrayLike) -> FloatArray:
        """Return ``points`` (N, n), in metres, carried into the outer frame."""
        p = np.asarray(points, dtype=np.float64)
        if p.ndim != 2 or p.shape[1] != self.dim:
            raise ArgumentError(f"points for this pose must be (N, {self.dim}), not {p.shape}")
        return multiply(p, self.rotation) + self.translation

    def is_close(self, other: Pose, metres: float = 1e-9, radians: float = 1e-9) -> bool:
        """Tell whether two poses agree within a distance and an angle."""
        delta = self.inverse() @ other
        return bool(np.linalg.norm(delta.translation) <= metres and delta.angle <= radians)

    def __eq__(self, other: object) -> bool:
        """Tell whether two poses are the same numbers."""
        if not isinstance(other, Pose):
            return NotImplemented
        return np.array_equal(self.rotation, other.rotation) and np.array_equal(self.translation, other.translation)

    def __hash__(self) -> int:
        """Hash the numbers."""
        # A zero may have a sign, which equality does not see.
        return hash(((self.rotation + 0.0).tobytes(), (self.translation + 0.0).tobytes()))

    def __repr__(self) -> str:
        """Show the numbers that make the pose."""
        if self.dim == 2:
            return f"Pose.planar({self.x:.6g}, {self.y:.6g}, {self.theta:.6g})"
        t = ", ".join(f"{v:.6g}" for v in self.translation)
        q = ", ".join(f"{v:.6g}" for v in self.quaternion())
        return f"Pose.from_quaternion(({t}), ({q}))"
