"""The occupancy pyramid: its tables are upper bounds, as tight as they claim, on every lattice."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError, TooLargeError
from hexmap.lattice.lattice import Lattice
from hexmap.maps.voxel_list import VoxelList
from localisation.matching.pyramid import MOST_WEIGHT, OccupancyPyramid, level_windows, most_spread
from tests.lattices import CASES, JIT, SHEARED, Case

EVERY = [*CASES, *SHEARED]
# Levels whose entries stand at every place, and one or two whose entries stand at every second or fourth.
LEVELS = {2: 5 if JIT else 4, 3: 4 if JIT else 3}


def strewn(lattice: Lattice, seed: int, most: int) -> VoxelList:
    rng = np.random.default_rng([seed, lattice.dim])
    size = [23, 14] if lattice.dim == 2 else [9, 6, 8]
    low = rng.integers(-40, 40, lattice.dim)
    index = np.unique(low + rng.integers(0, size, (25 if JIT else 8, lattice.dim)), axis=0)
    weights = rng.integers(1, most + 1, len(index))
    weights[0] = most
    return VoxelList.from_cells(index, lattice, weights)


def places(pyramid: OccupancyPyramid, margin: int, count: int, seed: int) -> NDArray[np.int64]:
    """Indices in and around the box of the cells, the corners of that neighbourhood among them."""
    rng = np.random.default_rng(seed)
    low, high = pyramid.low - margin, pyramid.high + margin
    corners = np.array(list(itertools.product(*np.stack([low, high]).T)))
    return np.concatenate([corners, rng.integers(low, high + 1, (count, len(low)))])


def largest_in_box(cells: VoxelList, first: NDArray[np.int64], side: int) -> NDArray[np.int64]:
    """The largest weight with index from ``first`` (M, n) on, ``side`` along each axis, by looking at every cell."""
    off = cells.index[None].astype(np.int64) - first[:, None]
    inside = ((off >= 0) & (off < side)).all(axis=2)
    return np.where(inside, cells.counts[None], 0).max(axis=1)


@pytest.mark.parametrize("case", EVERY, ids=str)
@pytest.mark.parametrize("most", [1, 200, 300, 65535])
def test_no_entry_is_less_than_the_largest_weight_of_its_box(case: Case, most: int) -> None:
    n = case.dim
    cells = strewn(case.lattice, most, most)
    levels = LEVELS[n]
    pyramid = OccupancyPyramid(cells, levels)
    tables = pyramid.tables(60)
    at = places(pyramid, 60, 300, most)
    table = 0
    for level in range(levels):
        apart = 1 << level
        step = max(1, apart // 4)
        for window in level_windows(case.lattice, level):
            address = np.zeros(len(at), np.int64)
            for a in range(n):
                row = (table * n + a) * tables.length
                address += tables.address[row + at[:, a] - tables.low[a]]
            packed = tables.packed[address].astype(np.uint64)
            for c in range(1 << n):
                moved = apart * np.array([(c >> a) & 1 for a in range(n)])
                found = ((packed >> np.uint64(8 * c)) & np.uint64(255)).astype(np.int64)
                steps = -(-largest_in_box(cells, at + moved, window) // tables.unit)
                assert (found >= steps).all()
                # An entry serves ``step`` places: exactly the largest of all their boxes, no more.
                first = pyramid.low + (at - pyramid.low) // step * step
                widest = -(-largest_in_box(cells, first + moved, window + step - 1) // tables.unit)
                np.testing.assert_array_equal(found, widest)
                if step == 1:
                    np.testing.assert_array_equal(found, steps)
            table += 1


@pytest.mark.parametrize("case", EVERY, ids=str)
@pytest.mark.parametrize("most", [1, 255, 256, 65535])
def test_the_weight_of_a_cell_is_what_it_was_given_and_0_elsewhere(case: Case, most: int) -> None:
    cells = strewn(case.lattice, most, most)
    pyramid = OccupancyPyramid(cells, 2)
    known = {tuple(c): int(w) for c, w in zip(cells.index.tolist(), cells.counts.tolist(), strict=True)}
    at = np.concatenate([cells.index, places(pyramid, 200, 200, 0), places(pyramid, 3, 200, 1)])
    assert pyramid.weights(at).tolist() == [known.get(tuple(c), 0) for c in at.tolist()]
    assert pyramid.most == most


@pytest.mark.parametrize("case", EVERY, ids=str)
def test_a_wider_reach_changes_no_weight(case: Case) -> None:
    cells = strewn(case.lattice, 5, 100)
    pyramid = OccupancyPyramid(cells, 2)
    at = places(pyramid, 10, 200, 2)
    before = pyramid.weights(at)
    assert pyramid.tables(500).length > pyramid.tables(0).length or pyramid.tables(0) is pyramid.tables(500)
    np.testing.assert_array_equal(pyramid.weights(at), before)


@pytest.mark.parametrize("case", EVERY, ids=str)
def test_the_boxes_of_a_level_grow_up_to_the_farthest_spread(case: Case) -> None:
    for level in range(6):
        windows = level_windows(case.lattice, level)
        assert list(windows) == sorted(windows)
        assert windows[-1] == (1 << level) - 1 + most_spread(case.lattice, level)


def test_a_map_without_cells_weighs_nothing() -> None:
    pyramid = OccupancyPyramid(VoxelList.empty(Lattice.named("A2", 0.1)))
    assert pyramid.most == 0
    assert pyramid.weights(np.array([[0, 0], [5, -7]])).tolist() == [0, 0]
    assert pyramid.nbytes > 0


def test_a_weight_that_is_too_large_is_named() -> None:
    cells = VoxelList.from_cells([[0, 0]], Lattice.named("A2", 0.1), [MOST_WEIGHT + 1])
    with pytest.raises(ArgumentError, match="65,536"):
        OccupancyPyramid(cells)


def test_a_map_that_is_too_large_is_named_with_its_size() -> None:
    cells = VoxelList.from_cells([[0, 0], [200_000, 100_000]], Lattice.named("A2", 0.1), [1, 1])
    with pytest.raises(TooLargeError, match="200001 x 100001"):
        OccupancyPyramid(cells)
