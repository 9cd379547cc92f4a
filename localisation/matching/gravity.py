"""Which way is up, by the floors and ceilings that a LiDAR sees."""

from __future__ import annotations

import math

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.lattice.lattice import Lattice
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import exponential
from localisation.matching.surfaces import SurfaceMap

__all__ = ["levelling", "levelling_of", "up_direction"]

# Floors and ceilings are planes whose normals lean no farther than this from the z axis, radians, and
_FARTHEST_LEAN = math.radians(45.0)
# agree with one another to this.
_SAME_LEAN = math.radians(3.0)
# Planes that make a floor.
_FLOOR_PLANES = 20
# Normals that are compared, each with each.
_COMPARED = 2000


def up_direction(surfaces: SurfaceMap) -> FloatArray | None:
    """Return the unit normal (3,) that most floors and ceilings share, or None where there are hardly any."""
    _, normals, _ = surfaces.planes()
    normals = normals * np.where(normals[:, 2:] < 0.0, -1.0, 1.0)
    normals = normals[normals[:, 2] > math.cos(_FARTHEST_LEAN)]
    if len(normals) < _FLOOR_PLANES:
        return None
    some = normals[np.linspace(0, len(normals) - 1, min(_COMPARED, len(normals))).astype(np.int64)]
    agree = (some @ some.T > math.cos(_SAME_LEAN)).sum(axis=1)
    up = some[int(np.argmax(agree))]
    for _ in range(5):
        near = normals[normals @ up > math.cos(_SAME_LEAN)]
        if len(near) < _FLOOR_PLANES:
            return None
        up = near.mean(axis=0)
        up /= np.linalg.norm(up)
    return np.asarray(up)


def levelling(surfaces: SurfaceMap) -> Pose | None:
    """Return the smallest turn that makes floors level; None where there is hardly any floor."""
    up = up_direction(surfaces)
    if up is None:
        return None
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return Pose.identity(3)
    return Pose(exponential(axis / sine * math.atan2(sine, float(up[2]))), np.zeros(3))


def levelling_of(points: FloatArray, lattice: Lattice) -> Pose:
    """Return the smallest turn that makes the floors of a scan level, the identity where it sees hardly any.

    Args:
        points: (N, 3) of the scan, metres.
        lattice: in whose cells its planes are looked for.
    """
    surfaces = SurfaceMap(lattice)
    surfaces.add(points)
    return levelling(surfaces) or Pose.identity(3)
