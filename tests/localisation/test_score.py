"""The scores: what each cell counts, against a slow reference, on every lattice."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError
from hexmap.lattice.lattice import Lattice
from hexmap.maps.voxel_list import VoxelList
from localisation.matching.score import coincidence, hits, likelihood
from tests.lattices import CASES, SHEARED, Case

EVERY = [*CASES, *SHEARED]


def strewn(lattice: Lattice, seed: int, count: int, reach: int = 4) -> VoxelList:
    """A few cells with counts from 1 to 1,000, some of them neighbours."""
    rng = np.random.default_rng([seed, lattice.dim])
    index = np.unique(rng.integers(-reach, reach + 1, (count, lattice.dim)), axis=0)
    return VoxelList.from_cells(index, lattice, rng.integers(1, 1001, len(index)))


def as_dict(cells: VoxelList) -> dict[tuple[int, ...], int]:
    return {tuple(c): int(w) for c, w in zip(cells.index.tolist(), cells.counts.tolist(), strict=True)}


@pytest.mark.parametrize("case", EVERY, ids=str)
def test_coincidence_counts_each_cell_once(case: Case) -> None:
    cells = strewn(case.lattice, 0, 30)
    assert as_dict(coincidence(cells)) == dict.fromkeys(as_dict(cells), 1)


@pytest.mark.parametrize("case", EVERY, ids=str)
@pytest.mark.parametrize("most", [1, 255, 65535])
def test_hits_count_as_often_as_the_cell_was_hit_up_to_the_most(case: Case, most: int) -> None:
    cells = strewn(case.lattice, 1, 30)
    assert as_dict(hits(cells, most)) == {c: min(w, most) for c, w in as_dict(cells).items()}


@pytest.mark.parametrize("case", EVERY, ids=str)
@pytest.mark.parametrize(("sigmas", "most"), [(0.3, 16), (0.9, 16), (0.7, 300)])
def test_a_likelihood_field_falls_with_the_distance_of_the_nearest_cell(case: Case, sigmas: float, most: int) -> None:
    lattice = case.lattice
    sigma = sigmas * lattice.resolution
    cells = strewn(lattice, 2, 8 if case.dim == 2 else 5)
    # Every cell that could count anything: a box of indices around each occupied one, wider than the Gaussian reaches.
    farthest = 1.2 * sigma * math.sqrt(2.0 * math.log(2.0 * most))
    reach = np.ceil(farthest * np.linalg.norm(np.linalg.inv(lattice.basis), axis=1)).astype(int) + 1
    box = np.array(list(itertools.product(*[range(-r, r + 1) for r in reach])))
    near = np.unique((cells.index[:, None, :] + box).reshape(-1, case.dim), axis=0)
    apart = lattice.centres(near)[:, None, :] - lattice.centres(cells.index)[None, :, :]
    nearest = (apart**2).sum(axis=2).min(axis=1)
    weights = np.rint(most * np.exp(-0.5 * nearest / sigma**2)).astype(int)
    expected = {tuple(c): w for c, w in zip(near.tolist(), weights.tolist(), strict=True) if w > 0}
    assert as_dict(likelihood(cells, sigma, most)) == expected


def test_the_score_of_no_cells_is_no_cells() -> None:
    empty = VoxelList.empty(Lattice.named("A2", 0.1))
    assert len(coincidence(empty)) == len(hits(empty)) == len(likelihood(empty, 0.1)) == 0


@pytest.mark.parametrize("most", [0, -1, 65536])
def test_a_weight_out_of_range_is_named(most: int) -> None:
    cells = strewn(Lattice.named("A2", 0.1), 3, 5)
    with pytest.raises(ArgumentError, match=str(most)):
        hits(cells, most)
    with pytest.raises(ArgumentError, match=str(most)):
        likelihood(cells, 0.1, most)


@pytest.mark.parametrize("sigma", [0.0, -0.1, math.inf, math.nan])
def test_a_width_that_is_none_is_named(sigma: float) -> None:
    with pytest.raises(ArgumentError, match=str(sigma)):
        likelihood(strewn(Lattice.named("A2", 0.1), 3, 5), sigma)
