"""How sure a match is: the covariance that the surface of scores around it tells.

Poses near the best one are weighted with exp((score - best) / T), and the second moments of these weights are the
covariance (Olson, "Real-time correlative scan matching", 2009, Eq. 8). Neighbouring beams are not independent, so T is not
one point but a share of the scan's points; and however steep the surface, the finest step that it was looked at with is a
cell, so that a share of the cell's second moment is added as the floor: all of it where the pose is a cell's centre, the
little that refining leaves where it is refined.
"""

from __future__ import annotations

import math

import numpy as np

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import exponential
from localisation.matching.pyramid import OccupancyPyramid
from localisation.matching.search_region import shifts_in_ball

__all__ = ["TEMPERATURE", "score_covariance"]

# T as a share of the largest score. Fitted, with the floor below, on 1,600 simulated scans of ten buildings on A2 and Z2 at
# 0.05 m (``python -m tests.benchmarks.localisation calibration`` measures it on ten others): the error of a refined pose,
# squared and normalised, was 2.9 on average over 3 degrees of freedom, and ellipses of 50, 90 and 95 % held 63, 91 and 95 %.
# With T = 0.03 it was 1.3, with 0.015 it was 8 on Z2, because second modes along corridors were missed.
TEMPERATURE = 0.02
# The share of a cell's second moment that refining leaves: its error is a quarter of what quantising alone leaves, 4 mm
# an axis at 0.05 m (with the whole moment, ellipses of 50 % held 98 % of the refined poses). A pose that was not refined
# has all of it.
_REFINED = 0.075
# Steps along an axis to either side in the plane; in space every pose more is dear.
_STEPS = {2: 6, 3: 2}
# What the outermost ring of poses may weigh before the surface is looked at over twice the distance.
_RIM = 0.02
_DOUBLINGS = 4


def score_covariance(
    pyramid: OccupancyPyramid,
    points: FloatArray,
    weights: IntArray,
    pose: Pose,
    *,
    refined: bool = True,
    temperature: float = TEMPERATURE,
) -> FloatArray:
    """Return the covariance, (3, 3) in the plane or (6, 6) in space, of the error of a pose by the scores around it.

    Args:
        pyramid: the weights of the map's cells.
        points: (P, n) the scan in the sensor's frame, metres.
        weights: (P,) how often each point counts.
        pose: T_map_scan at a maximum of the score, as it was searched.
        refined: whether the pose that is reported was refined from it below a cell; its error is smaller.
        temperature: T as a share of the largest score the scan could have.

    Returns:
        In metres and radians: translation in the map's frame, then the rotation vector in the map's frame about the
        sensor.
    """
    from localisation.matching import _pose_kernels as kernels

    lattice = pyramid.lattice
    n = lattice.dim
    ranges = np.sqrt((points**2).sum(axis=1))
    lever = max(float(np.sqrt(np.average(ranges**2, weights=weights))), lattice.resolution)
    T = max(1e-9, temperature * float(weights.sum()) * pyramid.most)
    turns = 1 if n == 2 else 3
    metres, radians = _STEPS[n] * lattice.resolution, _STEPS[n] * lattice.resolution / lever
    for _ in range(_DOUBLINGS):
        # Poses on a grid that always has about as many steps: coarser where it reaches farther.
        spacing = max(1, round(metres / (_STEPS[n] * lattice.resolution)))
        shifts = shifts_in_ball(lattice.scaled(float(spacing)), metres) * spacing
        steps = np.linspace(-radians, radians, 2 * _STEPS[n] + 1)
        vectors = np.stack(np.meshgrid(*[steps] * turns, indexing="ij"), axis=-1).reshape(-1, turns)
        index = np.empty((len(vectors), len(points), n), np.int64)
        for k, vector in enumerate(vectors):
            R = Pose.planar(0.0, 0.0, float(vector[0])).rotation if n == 2 else exponential(vector)
            index[k] = lattice.quantise(Pose(R @ pose.rotation, pose.translation).apply(points))
        scores = np.empty((len(vectors), len(shifts)), np.int64)
        kernels.surface(pyramid.tables(0), index, np.ascontiguousarray(weights), np.ascontiguousarray(shifts, np.int64), scores)
        heat = np.exp((scores - scores.max()) / T)
        heat /= heat.sum()
        offsets = lattice.centres(shifts)
        far = np.linalg.norm(offsets, axis=1) > metres - spacing * lattice.resolution
        wide = np.abs(vectors).max(axis=1) > radians * (1.0 - 0.5 / _STEPS[n])
        in_rim = float(heat[:, far].sum()) > _RIM
        turned_rim = float(heat[wide].sum()) > _RIM
        if not in_rim and not turned_rim:
            break
        metres *= 2.0 if in_rim else 1.0
        radians = min(radians * (2.0 if turned_rim else 1.0), math.pi)
    size = n + turns
    mean = np.concatenate([heat.sum(axis=0) @ offsets, heat.sum(axis=1) @ vectors])
    covariance = np.zeros((size, size))
    by_shift, by_turn = heat.sum(axis=0), heat.sum(axis=1)
    d, v = offsets - mean[:n], vectors - mean[n:]
    covariance[:n, :n] = np.einsum("k,ka,kb->ab", by_shift, d, d)
    covariance[n:, n:] = np.einsum("r,ra,rb->ab", by_turn, v, v)
    covariance[:n, n:] = np.einsum("rk,ka,rb->ab", heat, d, v)
    covariance[n:, :n] = covariance[:n, n:].T
    covariance = 0.5 * (covariance + covariance.T)  # sums in another order differ in the last bits
    # The floor: a point uniform in its cell, or what refining leaves of that, and the turn that moves the points by as much.
    cell = lattice.cell.second_moment * lattice.resolution**2
    floor = cell * (_REFINED if refined else 1.0)
    covariance[range(n), range(n)] += floor
    covariance[range(n, size), range(n, size)] += floor / lever**2
    return covariance
