"""The paper's metrics of a voxel list and of its variability under rotation (section V)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hexmap.base.errors import ArgumentError
from hexmap.lattice.convert import LatticeLike, as_lattice
from hexmap.maps.voxel_list import VoxelList

__all__ = ["coefficient_of_variation", "distortion", "interquartile_variability", "voxel_count"]


def voxel_count(points: ArrayLike, lattice: LatticeLike, resolution: float | None = None) -> int:
    """Return how many cells it takes to hold ``points`` (N, n), metres."""
    return len(VoxelList.from_points(points, lattice, resolution))


def distortion(points: ArrayLike, lattice: LatticeLike, resolution: float | None = None) -> float:
    """Return the mean distance, metres, from ``points`` (N, n) to the centres of their cells.

    Raises:
        ArgumentError: there is no point.
    """
    p = np.asarray(points, dtype=np.float64)
    if len(p) == 0:
        raise ArgumentError("the distortion of no points is not defined")
    on = as_lattice(lattice, resolution)
    error = p - on.centres(on.quantise(p))
    return float(np.sqrt((error**2).sum(axis=1)).mean())


def _sample(values: ArrayLike) -> np.ndarray:
    v = np.asarray(values, dtype=np.float64)
    if v.ndim != 1 or len(v) == 0 or not np.isfinite(v).all() or v.mean() == 0.0:
        raise ArgumentError("a variability needs a list of finite values with a mean other than zero")
    return v


def coefficient_of_variation(values: ArrayLike) -> float:
    """Return sigma / mu of ``values`` (K,), with the population's sigma (divided by K, as in the paper)."""
    v = _sample(values)
    return float(v.std() / abs(v.mean()))


def interquartile_variability(values: ArrayLike) -> float:
    """Return (Q3 - Q1) / (Q3 + Q1) of ``values`` (K,): the inter-quartile variability factor."""
    q1, q3 = np.percentile(_sample(values), [25.0, 75.0])
    return float((q3 - q1) / (q3 + q1))
