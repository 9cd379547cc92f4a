"""The global matcher: equal to trying everything, over stated angles and over all real ones, on every lattice."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError, BoundsError
from hexmap.lattice.lattice import Lattice
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import exponential
from localisation.matching.global_matcher import GlobalMatcher, match_anywhere, thin
from localisation.matching.pyramid import OccupancyPyramid, level_windows
from localisation.matching.score import coincidence, hits, likelihood
from localisation.matching.search_region import SearchRegion
from tests.lattices import CASES, JIT, PART, PLANAR, SHEARED, SPATIAL, Case

EVERY = [*CASES, *SHEARED]


def scaled(case: Case, resolution: float) -> Lattice:
    return case.lattice.scaled(resolution / case.lattice.resolution)


def random_map(lattice: Lattice, rng: np.random.Generator, most: int, count: int = 60, size: float = 6.0) -> VoxelList:
    """Cells strewn about, so that many poses score alike and no structure helps the search."""
    index = np.unique(lattice.quantise(rng.uniform(-size, size, (count, lattice.dim))), axis=0)
    return VoxelList.from_cells(index, lattice, rng.integers(1, most + 1, len(index)))


class EveryPose:
    """All shifts whose centres lie in a box, scored by looking each cell up."""

    def __init__(self, weights: VoxelList, low: NDArray, high: NDArray) -> None:
        self.lattice = lattice = weights.lattice
        n = lattice.dim
        self.weights = {tuple(c): int(w) for c, w in zip(weights.index.tolist(), weights.counts.tolist(), strict=True)}
        corners = np.array(list(itertools.product(*np.stack([low, high]).T))) @ np.linalg.inv(lattice.basis).T
        ranges = [range(math.floor(a) - 1, math.ceil(b) + 2) for a, b in zip(corners.min(0), corners.max(0), strict=True)]
        shifts = np.array(list(itertools.product(*ranges)))
        centres = lattice.centres(shifts)
        self.shifts = shifts[((centres >= low) & (centres <= high)).all(axis=1)]
        index = weights.index.astype(np.int64)
        reach = 40
        self.low = index.min(axis=0) - reach
        self.dense = np.zeros(index.max(axis=0) + reach + 1 - self.low, np.int64)
        self.dense[tuple((index - self.low).T)] = weights.counts
        self.n = n

    def best(self, points: NDArray, point_weights: NDArray, rotation: NDArray) -> int:
        """The best score of one rotation over all shifts."""
        index = self.lattice.quantise(points @ rotation.T).astype(np.int64)
        at = index[None, :, :] + self.shifts[:, None, :] - self.low
        inside = ((at >= 0) & (at < np.array(self.dense.shape))).all(axis=2)
        at = np.where(inside[..., None], at, 0)
        values = np.where(inside, self.dense[tuple(np.moveaxis(at, -1, 0))], 0)
        return int((values * point_weights).sum(axis=1).max())


def turned(n: int, yaw: float, tilt: NDArray | None = None) -> NDArray:
    R = np.eye(n)
    R[:2, :2] = Pose.planar(0.0, 0.0, yaw).rotation
    return R if tilt is None else R @ tilt


def breakpoints(lattice: Lattice, points: NDArray, tilt: NDArray | None = None) -> NDArray:
    """All yaws at which a point lies on a face of a cell, from the closed form, with many that belong to none."""
    found = [0.0, 2.0 * math.pi]
    faces = np.asarray(lattice.cell.faces)
    for p in points if tilt is None else points @ tilt.T:
        radius, phase = math.hypot(p[0], p[1]), math.atan2(p[1], p[0])
        for f in faces:
            v = lattice.basis @ f
            flat = math.hypot(v[0], v[1]) * radius
            height = v[2] * p[2] if lattice.dim == 3 else 0.0
            # The planes across v: v . x = (whole number of Gram steps) + |v|^2 / 2.
            gram = np.abs(v @ lattice.basis)
            reach = np.linalg.norm(v) * np.linalg.norm(p) + float(v @ v)
            size = math.ceil(reach / max(1e-9, float(gram[gram > 1e-9].min()))) + 1
            near = np.array(list(itertools.product(range(-size, size + 1), repeat=lattice.dim))) if size < 12 else None
            if near is None:
                near = np.unique(lattice.quantise(np.random.default_rng(0).uniform(-1, 1, (20000, lattice.dim)) * np.linalg.norm(p) * 1.5), axis=0)
            levels = np.unique(np.round((lattice.centres(near) @ v) + 0.5 * float(v @ v), 12))
            for c in levels - height:
                if flat > abs(c):
                    a = math.acos(c / flat)
                    base = math.atan2(v[1], v[0]) - phase
                    found += [(base + a) % (2 * math.pi), (base - a) % (2 * math.pi)]
    return np.unique(np.array(found))


@pytest.mark.parametrize("case", EVERY, ids=str)
@pytest.mark.parametrize("seed", range(6))
def test_over_stated_angles_it_is_equal_to_trying_all(case: Case, seed: int) -> None:
    rng = np.random.default_rng([seed, case.dim])
    n = case.dim
    lattice = scaled(case, 0.7 if n == 2 else 1.3)
    weights = random_map(lattice, rng, most=[1, 7, 300][seed % 3], size=5.0 if n == 2 else 3.0)
    points = rng.uniform(-3.0, 3.0, (int(rng.integers(3, 20)), n))
    low, high = np.full(n, -5.0 if n == 2 else -2.0), np.full(n, 4.0 if n == 2 else 1.5)
    step = 2 * math.pi / 40
    match = GlobalMatcher(OccupancyPyramid(weights)).match(
        points, SearchRegion(low, high), angles=step, refine=False, runner_up=None
    )
    kept, point_weights = thin(points, lattice)
    every = EveryPose(weights, low, high)
    # The matcher looks in the box around the weights; poses farther out cannot be better in it.
    best = max(every.best(kept, point_weights, turned(n, k * step)) for k in range(40))
    within = match.score if match else 0
    assert within <= best
    inside = GlobalMatcher(OccupancyPyramid(weights), VoxelList.from_cells(every.shifts, lattice))
    match = inside.match(points, SearchRegion(low, high), angles=step, refine=False, runner_up=None)
    assert (match.score if match else 0) == best
    if match:
        assert match.gap == 0 and match.certified


@pytest.mark.parametrize("case", EVERY, ids=str)
@pytest.mark.parametrize("seed", range(3))
def test_over_all_real_angles_it_is_equal_to_an_exact_sweep(case: Case, seed: int) -> None:
    rng = np.random.default_rng([seed, case.dim, 1])
    n = case.dim
    lattice = scaled(case, 0.8 if n == 2 else 1.3)
    weights = random_map(lattice, rng, most=[1, 5, 300][seed % 3], size=4.0 if n == 2 else 2.5, count=40)
    points = rng.uniform(-2.0, 2.0, (max(3, int(6 * PART)), n))
    low, high = np.full(n, -2.0 if n == 2 else -1.5), np.full(n, 2.0 if n == 2 else 1.5)
    every = EveryPose(weights, low, high)
    kept, point_weights = thin(points, lattice)
    edges = breakpoints(lattice, kept)
    middles = 0.5 * (edges[1:] + edges[:-1])[np.diff(edges) > 1e-9]
    best = max(every.best(kept, point_weights, turned(n, yaw)) for yaw in middles)
    matcher = GlobalMatcher(OccupancyPyramid(weights), VoxelList.from_cells(every.shifts, lattice))
    match = matcher.match(points, SearchRegion(low, high), refine=False, runner_up=None)
    assert (match.score if match else 0) == best
    if match:
        assert match.gap == 0 and match.certified
