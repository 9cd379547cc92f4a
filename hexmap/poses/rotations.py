"""Rotations as arrays, for many at a time; a single one is a Pose."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from hexmap.base.arrays import FloatArray


def product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the products (..., n, n) of rotations ``a`` (..., n, n) with ``b`` (n, n), entry by entry.

    Written out for the same reason as in :func:`hexmap.base.arrays.multiply`.
    """
    out = np.zeros(a.shape)
    for i, j, k in itertools.product(range(len(b)), repeat=3):
        out[..., i, j] += a[..., i, k] * b[k, j]
    return out


def exponential(v: FloatArray) -> FloatArray:
    """Return the rotation matrix of the rotation vector ``v`` (3,) (Rodrigues)."""
    angle = float(np.sqrt((v**2).sum()))
    K = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    if angle < 1e-12:
        return np.asarray(np.eye(3) + K)
    return np.asarray(np.eye(3) + math.sin(angle) / angle * K + (1.0 - math.cos(angle)) / angle**2 * (K @ K))


def logarithms(rotations: FloatArray) -> FloatArray:
    """Return the rotation vectors (..., 3), radians, of ``rotations`` (..., 3, 3) by less than half a turn."""
    R = rotations
    skew = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    sine = 0.5 * np.linalg.norm(skew, axis=-1)
    angle = np.arctan2(sine, 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0))
    factor = np.where(sine > 1e-9, angle / np.maximum(2.0 * sine, 1e-300), 0.5)
    return np.asarray(factor[..., None] * skew)


def angles(rotations: FloatArray) -> FloatArray:
    """Return the angle (R,), radians, of each of ``rotations`` (R, n, n)."""
    trace = np.trace(rotations, axis1=1, axis2=2)
    cosine = trace / 2.0 if rotations.shape[1] == 2 else (trace - 1.0) / 2.0
    return np.arccos(np.clip(cosine, -1.0, 1.0))


def rotation_entries(x: Any, y: Any, z: Any, w: Any) -> list[list[Any]]:
    """Return the rows of the rotation matrix of a unit quaternion, whose components are numbers or arrays.

    Written out, because scipy's Rotation rounds the last bit of most entries differently, and poses that
    are read from a bag must not depend on that; it also takes 0.4 s to import.
    """
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]


def quaternions_to_rotations(q: FloatArray) -> FloatArray:
    """Return the (N, 3, 3) rotations of unit quaternions (N, 4) x y z w."""
    R = np.empty((len(q), 3, 3))
    for i, row in enumerate(rotation_entries(*q.T)):
        for k, entry in enumerate(row):
            R[:, i, k] = entry
    return R


def euler_to_quaternions(euler: FloatArray) -> FloatArray:
    """Return the unit quaternions (N, 4) x y z w of roll, pitch and yaw (N, 3), radians: Rz(yaw) Ry(pitch) Rx(roll)."""
    half = 0.5 * euler
    (cr, cp, cy), (sr, sp, sy) = np.cos(half).T, np.sin(half).T
    return np.stack(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ],
        axis=1,
    )
