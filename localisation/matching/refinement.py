"""Refine a pose below a cell.

Each point is drawn to the mean of the occupied cells near it, weighted by a Gaussian of their distance: expectation
maximisation on a sum of Gaussians. The Gaussian is half a resolution wide, what quantising leaves unknown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.values import one_line
from hexmap.lattice.lattice import Lattice
from hexmap.poses.pose import Pose
from localisation.matching.occupancy import Occupancy, box_offsets

__all__ = ["REFINE_STEPS", "Refinement", "refine_on"]

REFINE_STEPS = 12
# Cells farther than this many sigmas pull with less than a twentieth.
_REACH = 2.5
# In resolutions of the search: farther away there is a better candidate, and the search would have found it.
_FARTHEST = 2.0
# In resolutions: a step shorter than this is the last.
_TOLERANCE = 0.002


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

    __repr__ = one_line


def refine_on(
    occupancy: Occupancy, points: FloatArray, start: Pose, *, searched: Lattice | None = None
) -> Refinement:
    """Pull a scan onto the occupied cells around it.

    Args:
        occupancy: the occupied cells.
        points: (P, n) the scan, in its own frame, metres.
        start: T_map_scan, the pose found.
        searched: the lattice on which it was found, where that was a coarser one: the Gaussian is that wide first.
    """
    from localisation.matching import _kernels as kernels

    lattice = occupancy.lattice
    n = lattice.dim
    coarse = searched or lattice
    R, t = np.array(start.rotation), np.array(start.translation)
    hessian = np.zeros((3, 3) if n == 2 else (6, 6))
    taken = kernels.refine(
        occupancy.tiles, _gaussians(lattice, coarse), np.ascontiguousarray(points), R, t, REFINE_STEPS,
        _TOLERANCE * lattice.resolution, hessian,
    )  # fmt: skip
    moved = math.dist(t, start.translation)
    if taken < 0 or moved > _FARTHEST * coarse.resolution:
        return Refinement(start, hessian, False)
    return Refinement(Pose._trusted(R, t), hessian, True)


@lru_cache(maxsize=64)
def _gaussians(lattice: Lattice, searched: Lattice) -> Any:
    """Return the Gaussians for a lattice: first those of the one searched on, then its own."""
    from localisation.matching import _kernels as kernels

    inverse = np.ascontiguousarray(np.linalg.inv(lattice.basis))
    last = 0.5 * lattice.resolution
    sigmas = np.array([last] if searched == lattice else [0.5 * searched.resolution, last])
    # A ball reaches along an index as far as its radius times the length of that row of the inverse basis.
    reach = _REACH * sigmas[:, None] * np.linalg.norm(inverse, axis=1)
    lanes = np.ascontiguousarray(lattice.centres(box_offsets(lattice.dim)))
    return kernels.Gaussians(np.array(lattice.basis), inverse, lanes, sigmas, reach, _REACH)
