"""How sure a match is: the covariance that the surface of scores around it tells.

Poses near the best one are weighted with exp((score - best) / T), and the second moments of these weights are the
covariance (Olson, "Real-time correlative scan matching", 2009, Eq. 8). Neighbouring beams are not independent, so T is
not one point but a share of the scan's points. Three parts add up:

- the surface of scores cell by cell, close to the pose;
- a surface of upper bounds, as far as it is flat: what a corridor leaves open, whichever way it runs;
- a floor, because cell by cell is as fine as the surface is: all of a cell's second moment where the pose is a cell's
  centre, the little that refining leaves where it is refined.
"""

from __future__ import annotations

import math

import numpy as np

from hexmap.base.arrays import FloatArray, IntArray, multiply
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import exponential
from localisation.matching.pyramid import OccupancyPyramid, cell_reach
from localisation.matching.search_region import shifts_in_ball

__all__ = ["TEMPERATURE", "score_covariance"]

# T as a share of the largest score. Fitted, with the floor below, on simulated scans of ten buildings on A2 and Z2 at
# 0.05 m (``python -m tests.benchmarks.localisation calibration`` measures it on ten others): errors of refined poses,
# squared and normalised, were 2.9 and 2.6 on average over 3 degrees of freedom, and ellipses of 50, 90 and 95 % held
# 62, 91 and 95 % of them. With T = 0.03 it was about 1.2, with 0.015 4.7 and 3.5.
TEMPERATURE = 0.02
# The share of a cell's second moment that refining leaves: an error of 3.5 mm an axis at 0.05 m, a quarter of what
# quantising alone leaves (with the whole moment, ellipses of 50 % held 98 % of the refined poses). A pose that was not
# refined has all of it: then 2.1 over 3 degrees of freedom. So has one in space, where nothing was fitted.
_REFINED = 0.06
# Steps along an axis to either side in the plane; in space every pose more is dear.
_STEPS = {2: 6, 3: 2}
# What the outermost ring of poses may weigh before the surface is looked at over twice the distance.
_RIM = 0.02
_DOUBLINGS = 4
# What boxes of one index blur: the second moment of a segment of that length.
_BLUR = 1.0 / 12.0


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
    lattice = pyramid.lattice
    n = lattice.dim
    ranges = np.sqrt((points**2).sum(axis=1))
    lever = max(float(np.sqrt(np.average(ranges**2, weights=weights))), lattice.resolution)
    T = max(1e-9, temperature * float(weights.sum()) * pyramid.most)
    placed = _Placed(pyramid, points, np.ascontiguousarray(weights), pose, lever)
    # The floor: a point uniform in its cell, or what refining leaves of that, and the turn that moves points as far.
    floor = lattice.cell.second_moment * lattice.resolution**2 * (_REFINED if refined and n == 2 else 1.0)
    unit = np.ones(n + placed.turns)
    unit[n:] = lever
    # In space boxes blur too much: a hall's walls, floor and furniture, widened by a cell or two, bound nothing. There
    # the scores themselves are looked at farther away, which finds a tunnel only where it runs along the lattice.
    surface = placed.narrow(T) + placed.wide(T, unit) if n == 2 else placed.wide(T, unit)
    covariance = surface + floor * np.diag(1.0 / unit**2)
    return 0.5 * (covariance + covariance.T)  # sums in another order differ in the last bits


class _Placed:
    """A scan at a pose, and the scores of the poses around it."""

    def __init__(
        self, pyramid: OccupancyPyramid, points: FloatArray, weights: IntArray, pose: Pose, lever: float
    ) -> None:
        self.pyramid, self.points, self.weights, self.pose, self.lever = pyramid, points, weights, pose, lever
        self.lattice = pyramid.lattice
        self.dim = pyramid.lattice.dim
        self.turns = 1 if self.dim == 2 else 3

    def poses(self, apart: int, wide: float = 1.0) -> tuple[IntArray, FloatArray, IntArray]:
        """Return shifts ``apart`` indices from one another, turns (rotation vectors), and the turned points' cells.

        ``wide`` is how many times as far as a cell a turn to the next moves the points.
        """
        n, steps = self.dim, _STEPS[self.dim]
        radius = steps * self.lattice.resolution
        shifts = np.ascontiguousarray(shifts_in_ball(self.lattice, radius) * apart, np.int64)
        radians = min(steps * wide * self.lattice.resolution / self.lever, math.pi)
        along = np.linspace(-radians, radians, 2 * steps + 1)
        vectors = np.stack(np.meshgrid(*[along] * self.turns, indexing="ij"), axis=-1).reshape(-1, self.turns)
        moved = np.empty((len(vectors), len(self.points), n))
        for k, vector in enumerate(vectors):
            R = Pose.planar(0.0, 0.0, float(vector[0])).rotation if n == 2 else exponential(vector)
            moved[k] = multiply(self.points, R @ self.pose.rotation) + self.pose.translation
        index = self.lattice.quantise(moved.reshape(-1, n)).astype(np.int64)
        return shifts, vectors, index.reshape(moved.shape)

    def narrow(self, T: float) -> FloatArray:
        """Return the second moments of the surface of scores, cell by cell."""
        from localisation.matching import _pose_kernels as kernels

        shifts, vectors, index = self.poses(1)
        scores = np.empty((len(vectors), len(shifts)), np.int64)
        kernels.surface(self.pyramid.tables(0), index, self.weights, shifts, scores)
        return _moments(_heat(scores, T), self.lattice.centres(shifts), vectors)

    def wide(self, T: float, unit: FloatArray) -> FloatArray:
        """Return what the surface of upper bounds adds: how far the pose may slide with no loss of score.

        A wall is a cell thick, and shifts along it that are lattice vectors leave it and meet it again, unless it runs
        along the lattice: cell by cell, the ridge of a corridor is a row of peaks. With the largest weight in a box
        around each cell it is a ridge, whichever way it runs; what the boxes themselves blur is taken off again. In
        space it is the surface of the scores themselves.
        """
        from localisation.matching import _pose_kernels as kernels

        tables = self.pyramid.tables(0)
        windows = tables.windows.ravel()
        covariance = np.zeros((len(unit), len(unit)))
        apart, wide = 1, 1.0
        for _ in range(_DOUBLINGS + 1):
            # A pose halfway between two shifts moves a point by half of their distance, and both cells are rounded.
            reach = math.floor(0.5 * apart + 2.0 * float(cell_reach(self.lattice).max()))
            fits = np.flatnonzero(windows >= 2 * reach + 1)
            if not len(fits):
                break
            table = int(fits[0])
            window = int(windows[table])
            shifts, vectors, index = self.poses(apart, wide)
            scores = np.empty((len(vectors), len(shifts)), np.int64)
            if self.dim == 2:
                kernels.widened_surface(tables, table, (window - 1) // 2, index, self.weights, shifts, scores)
            else:
                kernels.surface(tables, index, self.weights, shifts, scores)
            heat = _heat(scores, T)
            offsets = self.lattice.centres(shifts)
            moments = _moments(heat, offsets, vectors) * np.outer(unit, unit)
            size, axes = np.linalg.eigh(moments)
            n = self.dim
            width = np.abs(self.lattice.basis.T @ axes[:n]).sum(axis=0)
            width += self.lattice.resolution * np.linalg.norm(axes[n:], axis=0)
            blur = _BLUR * (window * width) ** 2 if self.dim == 2 else 0.0
            covariance = (axes * np.maximum(size - blur, 0.0)) @ axes.T / np.outer(unit, unit)
            # Where poses at the rim still weigh something the surface is looked at over twice the distance.
            length = np.linalg.norm(offsets, axis=1)
            far = length > length.max() - apart * self.lattice.resolution
            turned = np.abs(vectors).max(axis=1) > np.abs(vectors).max() * (1.0 - 0.5 / _STEPS[self.dim])
            in_rim, in_turned = float(heat[:, far].sum()) > _RIM, float(heat[turned].sum()) > _RIM
            if not in_rim and not in_turned:
                break
            apart *= 2 if in_rim else 1
            wide *= 2.0 if in_turned else 1.0
        return covariance


def _heat(scores: IntArray, T: float) -> FloatArray:
    """Return the weights of poses by their scores, adding up to one."""
    heat = np.exp((scores - scores.max()) / T)
    return np.asarray(heat / heat.sum())


def _moments(heat: FloatArray, offsets: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return the second moments of ``offsets`` (K, n) and ``vectors`` (R, t) under weights (R, K), about their mean."""
    n = offsets.shape[1]
    by_shift, by_turn = heat.sum(axis=0), heat.sum(axis=1)
    d, v = offsets - by_shift @ offsets, vectors - by_turn @ vectors
    out = np.zeros((n + vectors.shape[1],) * 2)
    out[:n, :n] = np.einsum("k,ka,kb->ab", by_shift, d, d)
    out[n:, n:] = np.einsum("r,ra,rb->ab", by_turn, v, v)
    out[:n, n:] = np.einsum("rk,ka,rb->ab", heat, d, v)
    out[n:, :n] = out[:n, n:].T
    return out
