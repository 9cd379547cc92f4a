"""Poses with covariances: carried on by a motion, fused with a match, moved to another point of the robot.

A covariance is that of the translation in the map's frame, then of the rotation vector in the map's frame about the
point whose pose it is: a true pose is (exp(w) R, t + v) with (v, w) of that covariance.
"""

from __future__ import annotations

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.poses.pose import Pose, wrap_angle
from hexmap.poses.rotations import exponential

__all__ = ["carry_on", "difference", "fuse", "move_point"]


def _lever(offset: FloatArray) -> FloatArray:
    """Return what turns a rotation vector into the motion of a point at ``offset`` (n,): w x offset."""
    if len(offset) == 2:
        return np.array([[-offset[1]], [offset[0]]])
    x, y, z = offset
    return np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])


def move_point(covariance: FloatArray, pose: Pose, further: Pose) -> FloatArray:
    """Return the covariance of ``pose @ further`` where only that of ``pose`` is in doubt."""
    n = pose.dim
    F = np.eye(len(covariance))
    F[:n, n:] = _lever(pose.rotation @ further.translation)
    return np.asarray(F @ covariance @ F.T)


def carry_on(
    pose: Pose, covariance: FloatArray, motion: Pose, metres: float, radians: float
) -> tuple[Pose, FloatArray]:
    """Return pose and covariance after a motion that errs by so many metres and radians (one sigma each axis)."""
    n = pose.dim
    after = move_point(covariance, pose, motion)
    after[range(n), range(n)] += metres * metres
    after[range(n, len(after)), range(n, len(after))] += radians * radians
    return pose @ motion, after


def fuse(predicted: Pose, P: FloatArray, measured: Pose, M: FloatArray) -> tuple[Pose, FloatArray]:
    """Return pose and covariance that a prediction (P) and a measurement (M) make together, by their information."""
    n = predicted.dim
    between = difference(predicted, measured)
    information = np.linalg.inv(P) + np.linalg.inv(M)
    covariance = np.linalg.inv(information)
    covariance = 0.5 * (covariance + covariance.T)
    step = covariance @ np.linalg.solve(M, between)
    R = exponential(step[n:]) if n == 3 else Pose.planar(0.0, 0.0, float(step[2])).rotation
    return Pose.identity(n) @ Pose(R @ predicted.rotation, predicted.translation + step[:n]), covariance


def difference(a: Pose, b: Pose) -> FloatArray:
    """Return what a covariance of ``a`` speaks of: the translation, then the rotation vector, from ``a`` to ``b``."""
    return np.concatenate([b.translation - a.translation, _rotation_vector(b.rotation @ a.rotation.T)])


def _rotation_vector(R: FloatArray) -> FloatArray:
    """Return the rotation vector of a rotation matrix: one number in the plane."""
    if len(R) == 2:
        return np.array([wrap_angle(np.arctan2(R[1, 0], R[0, 0]))])
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(R).as_rotvec())
