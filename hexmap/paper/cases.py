"""The cases of the experiments on point clouds: small functions that workers can call.

They stand alone because a finished case is kept only as long as this file does not change.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.lattice.lattice import Lattice
from hexmap.maps.metrics import distortion
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose


def random_rotation(rng: np.random.Generator, dim: int) -> Pose:
    """Return a rotation drawn uniformly: an angle in the plane, Haar's measure in space (Shoemake 1992)."""
    if dim == 2:
        return Pose.planar(0.0, 0.0, rng.uniform(0.0, 2.0 * np.pi))
    return Pose.from_quaternion([0.0, 0.0, 0.0], rng.normal(size=4))


def about_axis(axis: str, degrees: float, dim: int) -> Pose:
    """Return the rotation about x, y or z through the origin; in the plane about z.

    Args:
        axis: "x", "y" or "z".
        degrees: counter-clockwise.
        dim: 2 or 3.
    """
    angle = np.radians(degrees)
    if dim == 2:
        return Pose.planar(0.0, 0.0, float(angle))
    quaternion = np.zeros(4)
    quaternion["xyz".index(axis)] = np.sin(angle / 2)
    quaternion[3] = np.cos(angle / 2)
    return Pose.from_quaternion([0.0, 0.0, 0.0], quaternion)


def rotation_case(case: dict[str, Any], rng: np.random.Generator, shared: dict[str, Any]) -> dict[str, Any]:
    """Move the points and count cells and distortion on every lattice, under one and the same transform."""
    points = np.array(shared["points"])
    lattices = [Lattice(np.array(basis)) for basis in shared["bases"]]
    dim = points.shape[1]
    if case["kind"] == "axis":
        pose = about_axis(case["axis"], case["degrees"], dim)
    else:
        # Shifts of several cells in every direction: as good as uniform over the cell of any lattice.
        width = 8.0 * max(lattice.resolution for lattice in lattices)
        rotation = random_rotation(rng, dim).rotation
        pose = Pose(rotation, rng.uniform(-width, width, dim))
    moved = pose.apply(points)
    return {
        "count": [len(VoxelList.from_points(moved, lattice)) for lattice in lattices],
        "distortion": [distortion(moved, lattice) for lattice in lattices],
    }


def score_case(case: dict[str, Any], rng: np.random.Generator, shared: dict[str, Any]) -> dict[str, Any]:
    """Match one half of a scan against the map of its other half, at one random pose, on every lattice.

    ``at_pose`` is the fraction of the scan's cells that coincide where the pose is exactly right,
    ``beside`` where it is half a resolution off in a random direction.
    """
    points = np.array(shared["points"])
    dim = points.shape[1]
    lattices = [Lattice(np.array(basis)) for basis in shared["bases"]]
    half = rng.permutation(len(points))
    first, second = points[half[: len(half) // 2]], points[half[len(half) // 2 :]]
    rotation = random_rotation(rng, dim).rotation
    unit = rng.uniform(-0.5, 0.5, dim)
    normal = np.asarray(rng.normal(size=dim))
    direction = normal / np.sqrt((normal * normal).sum())
    exact: list[float] = []
    beside: list[float] = []
    for lattice in lattices:
        pose = Pose(rotation, lattice.basis @ unit)
        occupied = VoxelList.from_points(pose.apply(first), lattice)
        seen = pose.apply(second)
        for shift, scores in ((0.0, exact), (0.5 * lattice.resolution, beside)):
            scan = VoxelList.from_points(seen + shift * direction, lattice)
            scores.append(scan.count_coincident(occupied) / len(scan))
    return {"at_pose": exact, "beside": beside}


def as_columns(results: list[dict[str, Any]], key: str) -> NDArray[np.float64]:
    """Return one row a lattice: the values of ``key`` over all cases."""
    return np.array([result[key] for result in results], dtype=np.float64).T
