"""A search on a fixed set of angles, as Cartographer's scan matchers make it.

The score, the map and the search over shifts are those of :class:`~localisation.matching.GlobalMatcher`, so that only
one thing is compared: all real angles against those of a set.
"""

from __future__ import annotations

import math

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.lattice.lattice import Lattice

__all__ = ["angular_step"]

# Of Cartographer's SearchParameters: the step is a little smaller than the largest that is safe, and a scan that sees
# less far than three cells is treated as if it saw that far.
_SAFETY = 1.0 - 1e-3
_NEAREST_CELLS = 3.0


def angular_step(points: FloatArray, lattice: Lattice) -> float:
    """Return the step, radians, that moves the farthest of ``points`` (P, 2) by no more than a resolution.

    Hess et al., "Real-time loop closure in 2D LIDAR SLAM" (2016), Eq. 7: arccos(1 - r^2 / (2 d^2)).
    """
    r = lattice.resolution
    farthest = float(np.sqrt((points**2).sum(axis=1)).max()) if len(points) else 0.0
    d = max(_NEAREST_CELLS * r, farthest)
    return _SAFETY * math.acos(1.0 - 0.5 * (r / d) ** 2)
