"""What a search is given: a box of cells or the list of them, memory of its own or shared, sheets or none."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from hexmap.poses.pose import Pose
from localisation.matching import pyramid as pyramids
from localisation.matching.global_matcher import GlobalMatcher
from localisation.matching.pyramid import OccupancyPyramid
from localisation.matching.score import coincidence
from localisation.matching.search_region import SearchRegion, box_of_cells, cells_of_box
from localisation.matching.search_space import Scratch, SearchSpace
from tests.lattices import CASES, JIT, Case
from tests.localisation.test_global_matcher import random_map, scaled


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_box_allows_the_same_as_the_list_of_its_cells(case: Case) -> None:
    lattice = scaled(case, 0.7)
    pyramid = OccupancyPyramid(coincidence(random_map(lattice, np.random.default_rng(1), 3)))
    low, high = np.full(case.dim, -2.3), np.full(case.dim, 1.9) + np.arange(case.dim)
    boxed = SearchSpace(pyramid, box_of_cells(lattice, low, high))
    listed = SearchSpace(pyramid, cells_of_box(lattice, low, high))
    assert (boxed.low == listed.low).all() and (boxed.high == listed.high).all()
    for one, other in zip(boxed.allowed, listed.allowed, strict=True):
        assert one.dtype == other.dtype and one.tolist() == other.tolist()


@pytest.mark.skipif(not JIT, reason="searches of whole scans take minutes without the compiler")
@pytest.mark.parametrize("case", [c for c in CASES if c.dim == 2 or c.label == "D3"], ids=str)
def test_memory_changes_no_match(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    lattice = scaled(case, 0.5)
    n = case.dim
    rng = np.random.default_rng(2)
    shared = Scratch(sparse=True)
    for count in (30, 12, 45):  # so that the memory is taken for arrays of other shapes, and grows
        cells = coincidence(random_map(lattice, rng, 1, count, 4.0))
        points = Pose(np.eye(n), np.full(n, 0.4)).apply(lattice.centres(cells.index)[: count // 2])
        region = SearchRegion(np.full(n, -1.5), np.full(n, 1.5), 0.1, 0.4)
        found = []
        for few in (0, 1 << 40):  # tables in small pages and in large ones
            monkeypatch.setattr(pyramids, "_FEW", few)
            pyramid = OccupancyPyramid(cells)
            found.append(GlobalMatcher(pyramid, None).match(points, region, information=False))
            pyramid.forget_sheets()
            found.append(GlobalMatcher(pyramid, None, shared).match(points, region, information=False))
        first = found[0]
        assert first is not None and first.certified and first.score > 0
        assert all((m.pose, m.score, m.bound, m.nodes) == (first.pose, first.score, first.bound, first.nodes)
                   for m in found)  # fmt: skip


def test_memory_is_not_pickled_and_can_be_given_back() -> None:
    scratch = Scratch(sparse=True)
    a, b = scratch.arrays(((3, 5), np.int32), ((7,), np.float64))
    assert (a.shape, a.dtype, b.shape, b.dtype) == ((3, 5), np.int32, (7,), np.float64)
    a[...], b[...] = 1, 2.0
    assert (a == 1).all() and a.flags.c_contiguous and b.flags.aligned and not np.shares_memory(a, b)
    assert len(pickle.dumps(scratch)) < 200
    pickle.loads(pickle.dumps(scratch)).arrays(((2,), np.int64))
    scratch.key = (1,)
    scratch.give_back()
    assert scratch.key is None and scratch.arcs is None
