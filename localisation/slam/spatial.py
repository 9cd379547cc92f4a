"""Poses of space as rows of twelve numbers, the rotation row by row and then the translation: many at once.

A small motion is six numbers, translation (metres) and rotation vector (radians), in the frame of the pose it moves.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import logarithms

__all__ = ["SPACE", "adjoint", "between", "compose", "invert", "motion", "of_pose", "small", "to_pose"]


def of_pose(pose: Pose) -> FloatArray:
    """Return a pose of space as a row (12,)."""
    return np.concatenate([pose.rotation.ravel(), pose.translation])


def to_pose(row: FloatArray) -> Pose:
    """Return the pose of a row (12,)."""
    # Products of many rotations drift off by rounding: the nearest rotation.
    u, _, v = np.linalg.svd(np.asarray(row[:9]).reshape(3, 3))
    return Pose(u @ v, row[9:])


def _parts(a: FloatArray) -> tuple[FloatArray, FloatArray]:
    return a[..., :9].reshape(*a.shape[:-1], 3, 3), a[..., 9:]


def _row(R: FloatArray, t: FloatArray) -> FloatArray:
    return np.concatenate([R.reshape(*R.shape[:-2], 9), t], axis=-1)


def compose(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return ``a @ b`` for rows (..., 12)."""
    (Ra, ta), (Rb, tb) = _parts(a), _parts(b)
    return _row(Ra @ Rb, (Ra @ tb[..., None])[..., 0] + ta)


def invert(a: FloatArray) -> FloatArray:
    """Return the inverses of rows (..., 12)."""
    R, t = _parts(a)
    back = np.swapaxes(R, -1, -2)
    return _row(back, -(back @ t[..., None])[..., 0])


def between(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return ``a^-1 @ b`` for rows (..., 12)."""
    return compose(invert(a), b)


def small(a: FloatArray) -> FloatArray:
    """Return rows (..., 12) near the identity as small motions (..., 6): translation, then rotation vector."""
    R, t = _parts(a)
    return np.concatenate([t, logarithms(R)], axis=-1)


def motion(v: FloatArray) -> FloatArray:
    """Return the rows (..., 12) of small motions (..., 6): the inverse of :func:`small`."""
    w = v[..., 3:]
    angle = np.linalg.norm(w, axis=-1)[..., None, None]
    K = _cross(w)
    safe = np.maximum(angle, 1e-12)
    R = np.eye(3) + np.where(angle > 1e-12, np.sin(safe) / safe, 1.0) * K
    R = R + np.where(angle > 1e-12, (1.0 - np.cos(safe)) / safe**2, 0.5) * (K @ K)
    return _row(R, v[..., :3])


def _cross(w: FloatArray) -> FloatArray:
    K = np.zeros((*w.shape[:-1], 3, 3))
    K[..., 0, 1], K[..., 0, 2], K[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    K[..., 1, 0], K[..., 2, 0], K[..., 2, 1] = w[..., 2], -w[..., 1], w[..., 0]
    return K


def adjoint(a: FloatArray) -> FloatArray:
    """Return the adjoints (..., 6, 6) of rows (..., 12): how a small motion in the inner frame looks in the outer."""
    R, t = _parts(a)
    out = np.zeros((*a.shape[:-1], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = R
    out[..., :3, 3:] = _cross(t) @ R
    return out


class SpaceGeometry:
    """What a graph of poses must know of space."""

    row = 12
    dof = 6
    compose = staticmethod(compose)
    invert = staticmethod(invert)
    between = staticmethod(between)
    adjoint = staticmethod(adjoint)
    small = staticmethod(small)
    # gtsam has the rotation first.
    _order = np.array([3, 4, 5, 0, 1, 2])

    def pose(self, gtsam: Any, row: FloatArray) -> Any:
        """Return a row as gtsam's pose."""
        return gtsam.Pose3(gtsam.Rot3(row[:9].reshape(3, 3)), row[9:])

    def row_of(self, values: Any, key: int) -> FloatArray:
        """Return one of gtsam's values as a row."""
        pose = values.atPose3(key)
        return np.concatenate([np.asarray(pose.rotation().matrix()).ravel(), np.asarray(pose.translation()).ravel()])

    def between_factor(self, gtsam: Any, i: int, j: int, row: FloatArray, covariance: FloatArray) -> Any:
        """Return an edge as gtsam's factor."""
        noise = gtsam.noiseModel.Gaussian.Covariance(covariance[np.ix_(self._order, self._order)])
        return gtsam.BetweenFactorPose3(i, j, self.pose(gtsam, row), noise)

    def prior_factor(self, gtsam: Any, key: int, row: FloatArray, noise: Any) -> Any:
        """Return the place of a node as gtsam's factor."""
        return gtsam.PriorFactorPose3(key, self.pose(gtsam, row), noise)

    def g2o_vertex(self, key: int, row: FloatArray) -> str:
        """Return the line of a node in a g2o file."""
        return f"VERTEX_SE3:QUAT {key} {self._g2o_pose(row)}"

    def g2o_edge(self, i: int, j: int, row: FloatArray, information: FloatArray) -> str:
        """Return the line of an edge; ``information`` is (6, 6)."""
        # A small rotation is half of its vector in g2o's quaternion.
        scale = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
        upper = (information * np.outer(scale, scale))[np.triu_indices(6)]
        return f"EDGE_SE3:QUAT {i} {j} {self._g2o_pose(row)} " + " ".join(f"{v:.12g}" for v in upper.tolist())

    @staticmethod
    def _g2o_pose(row: FloatArray) -> str:
        pose = to_pose(row)
        place = " ".join(f"{v:.9f}" for v in pose.translation.tolist())
        return f"{place} " + " ".join(f"{v:.12f}" for v in pose.quaternion().tolist())


SPACE = SpaceGeometry()
"""The geometry of space."""
