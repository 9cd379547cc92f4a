"""Poses of the plane as rows x, y, heading: many at once, for corrections and for what is kept of a log."""

from __future__ import annotations

from typing import Any

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.poses.pose import Pose, wrap_angle

__all__ = ["PLANE", "adjoint", "between", "blend", "compose", "invert", "of_pose", "to_pose"]


def of_pose(pose: Pose) -> FloatArray:
    """Return a pose of the plane as a row (3,)."""
    return np.array([pose.x, pose.y, pose.theta])


def to_pose(row: FloatArray) -> Pose:
    """Return the pose of a row (3,)."""
    return Pose.planar(float(row[0]), float(row[1]), float(row[2]))


def compose(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return ``a @ b`` for rows (..., 3)."""
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x = a[..., 0] + c * b[..., 0] - s * b[..., 1]
    y = a[..., 1] + s * b[..., 0] + c * b[..., 1]
    return np.stack([x, y, wrap_angle(a[..., 2] + b[..., 2])], axis=-1)


def invert(a: FloatArray) -> FloatArray:
    """Return the inverses of rows (..., 3)."""
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack([-c * a[..., 0] - s * a[..., 1], s * a[..., 0] - c * a[..., 1], -a[..., 2]], axis=-1)


def between(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return ``a^-1 @ b`` for rows (..., 3)."""
    return compose(invert(a), b)


def blend(a: FloatArray, b: FloatArray, share: FloatArray) -> FloatArray:
    """Return the poses ``share`` (...,) of the way from rows ``a`` to rows ``b`` (..., 3), which lie close together."""
    return compose(a, between(a, b) * share[..., None])


def adjoint(a: FloatArray) -> FloatArray:
    """Return the adjoints (..., 3, 3) of rows (..., 3): how a small motion in the inner frame looks in the outer."""
    out = np.zeros((*a.shape[:-1], 3, 3))
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    out[..., 0, 0], out[..., 0, 1], out[..., 1, 0], out[..., 1, 1] = c, -s, s, c
    out[..., 0, 2], out[..., 1, 2], out[..., 2, 2] = a[..., 1], -a[..., 0], 1.0
    return out


class PlaneGeometry:
    """What a graph of poses must know of the plane."""

    row = 3
    dof = 3
    compose = staticmethod(compose)
    invert = staticmethod(invert)
    between = staticmethod(between)
    adjoint = staticmethod(adjoint)

    @staticmethod
    def small(a: FloatArray) -> FloatArray:
        """Return rows (..., 3) near the identity as small motions (..., 3)."""
        return a

    def pose(self, gtsam: Any, row: FloatArray) -> Any:
        """Return a row as gtsam's pose."""
        return gtsam.Pose2(*row)

    def row_of(self, values: Any, key: int) -> FloatArray:
        """Return one of gtsam's values as a row."""
        pose = values.atPose2(key)
        return np.array([pose.x(), pose.y(), pose.theta()])

    def between_factor(self, gtsam: Any, i: int, j: int, row: FloatArray, covariance: FloatArray) -> Any:
        """Return an edge as gtsam's factor."""
        noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
        return gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(*row), noise)

    def prior_factor(self, gtsam: Any, key: int, row: FloatArray, noise: Any) -> Any:
        """Return the place of a node as gtsam's factor."""
        return gtsam.PriorFactorPose2(key, gtsam.Pose2(*row), noise)

    def g2o_vertex(self, key: int, row: FloatArray) -> str:
        """Return the line of a node in a g2o file."""
        x, y, theta = row.tolist()
        return f"VERTEX_SE2 {key} {x:.9f} {y:.9f} {theta:.12f}"

    def g2o_edge(self, i: int, j: int, row: FloatArray, information: FloatArray) -> str:
        """Return the line of an edge; ``information`` is (3, 3)."""
        upper = information[np.triu_indices(3)]
        return f"EDGE_SE2 {i} {j} " + " ".join(f"{v:.12g}" for v in [*row.tolist(), *upper.tolist()])


PLANE = PlaneGeometry()
"""The geometry of the plane."""
