"""Refine a pose below a cell."""

from __future__ import annotations

import math

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.window import strides
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import exponential, product
from localisation.matching.occupancy import Occupancy
from localisation.matching.search_region import shifts_in_ball

__all__ = ["REFINE_STEPS", "refine"]

REFINE_STEPS = 12


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
