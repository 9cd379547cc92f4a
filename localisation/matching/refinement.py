"""Refine a pose below a cell.

Each point is drawn to the mean of the occupied cells near it, weighted by a Gaussian of their distance: expectation
maximisation on a sum of Gaussians. The Gaussian is half a resolution wide, what quantising leaves unknown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.window import strides
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import exponential, product
from localisation.matching.occupancy import Occupancy
from localisation.matching.pyramid import OccupancyPyramid
from localisation.matching.search_region import shifts_in_ball

__all__ = ["REFINE_STEPS", "Refinement", "refine_on"]

REFINE_STEPS = 12
# Cells farther than this many sigmas pull with less than a twentieth.
_REACH = 2.5
# In resolutions of the search: farther away there is a better candidate, and the search would have found it.
_FARTHEST = 2.0


@dataclass(frozen=True, eq=False)
class Refinement:
    """A refined pose.

    Attributes:
        pose: T_map_scan; where ``converged`` is False, the pose that was to be refined.
        information: (3, 3) or (6, 6) normal matrix of the last step over sigma^2: translation, then rotation vector.
        converged: whether the pose stayed in the neighbourhood that was searched.
    """

    pose: Pose
    information: FloatArray
    converged: bool


def refine_on(
    pyramid: OccupancyPyramid, points: FloatArray, start: Pose, *, searched: Lattice | None = None
) -> Refinement:
    """Pull a scan onto the occupied cells around it.

    Args:
        pyramid: the map.
        points: (P, n) the scan, in its own frame, metres.
        start: T_map_scan, the pose found.
        searched: the lattice on which it was found, where that was a coarser one: the Gaussian is that wide first.
    """
    from localisation.matching import _global_kernels, _pose_kernels

    lattice = pyramid.lattice
    n = lattice.dim
    coarse = searched or lattice
    last = 0.5 * lattice.resolution
    widths = np.array([last] if coarse == lattice else [0.5 * coarse.resolution, last])
    # A point may lie anywhere in its cell, and the cell looked up may be a neighbour of it.
    slack = 2.0 * lattice.covering_radius + float(np.linalg.norm(lattice.basis, axis=0).max())
    balls = [shifts_in_ball(lattice, _REACH * w + slack) for w in widths]
    ends = np.array([len(ball) for ball in balls])
    offsets = max(balls, key=len)
    offsets = np.ascontiguousarray(offsets[np.argsort((lattice.centres(offsets) ** 2).sum(axis=1), kind="stable")])
    R, t = np.array(start.rotation), np.array(start.translation)
    size = 3 if n == 2 else 6
    hessian = np.zeros((size, size))
    inverse = np.ascontiguousarray(np.linalg.inv(lattice.basis))
    tables = pyramid.tables(0)
    arrays = _global_kernels.LatticeArrays(
        np.ascontiguousarray(lattice.basis), inverse, np.zeros(n), np.zeros((1, n), np.int64), np.zeros((1, n))
    )
    taken = _pose_kernels.refine(
        tables, arrays, np.ascontiguousarray(points), np.ones(len(points)), R, t, widths, offsets, ends, REFINE_STEPS,
        0.002 * lattice.resolution, hessian,
    )  # fmt: skip
    moved = math.sqrt(float(((t - start.translation) ** 2).sum()))
    if taken < 0 or moved > _FARTHEST * coarse.resolution:
        return Refinement(start, hessian, False)
    return Refinement(Pose._trusted(R, t), hessian, True)


def refine(p: FloatArray, start: Pose, lattice: Lattice, world: Occupancy) -> Pose:
    """Pull the scan onto the occupied cells around it: expectation maximisation on a sum of Gaussians.

    Each point is drawn to the mean of the occupied cells near it, weighted by a Gaussian of
    their distance. Its width is half a resolution, what quantising leaves unknown: first that
    of the lattice searched on, then that of the finer one.
    """
    from localisation.matching import _kernels as kernels

    fine = world.lattice
    n = fine.dim
    size = 3 if n == 2 else 6
    last = 0.5 * fine.resolution
    widths = [last] if lattice == fine else [0.5 * lattice.resolution, last]
    margin = math.ceil((2.5 * widths[0] + 2.0 * lattice.resolution) / fine.inradius / 2.0) + 1
    index = fine.quantise(start.apply(p)).astype(np.int64)
    low = index.min(axis=0) - margin
    shape = index.max(axis=0) + margin + 1 - low
    cells = world.occupied(low, shape).ravel()
    steps = strides(shape)
    hessian, gradient = np.empty((size, size)), np.empty(size)
    pose = start
    for sigma in widths:
        offsets = shifts_in_ball(fine, 2.5 * sigma)
        centres = fine.centres(offsets)
        for _ in range(REFINE_STEPS):
            at = pose.apply(p)
            kernels.refine_terms(
                at, pose.translation, fine.quantise(at), cells, low, steps, shape, offsets, centres,
                fine.basis, sigma * sigma, hessian, gradient,
            )  # fmt: skip
            trace = float(np.trace(hessian))
            if trace <= 0.0:
                return start
            # A little damping keeps directions that the scan says nothing about where they are.
            step = np.linalg.solve(hessian + np.eye(size) * (1e-6 * trace), gradient)
            R = exponential(np.array(step[n:])) if n == 3 else Pose.planar(0.0, 0.0, float(step[2])).rotation
            pose = Pose._trusted(product(R, pose.rotation), pose.translation + step[:n])
            if np.abs(step).max() < 0.002 * fine.resolution:
                break
    # Farther than the search's own resolution there is a better candidate, and the search would have found it.
    moved = float(np.sqrt(((pose.translation - start.translation) ** 2).sum()))
    return pose if moved <= 2.0 * lattice.resolution else start
