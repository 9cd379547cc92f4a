"""The growing grid of counts against a dictionary."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hexmap.lattice.lattice import Lattice
from hexmap.maps.counter import HITS, PASSES, CellCounter
from hexmap.maps.voxel_list import VoxelList
from tests.lattices import CASES, EXAMPLES, JIT, Case

# The hash of a tile wraps around on purpose; numpy warns of it where the JIT is off.
pytestmark = pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")
each = pytest.mark.parametrize("case", CASES, ids=str)


def expected_window(counts: Counter, low: np.ndarray, shape: np.ndarray) -> np.ndarray:
    out = np.zeros(tuple(shape), np.int64)
    for cell, n in counts.items():
        at = tuple(np.subtract(cell, low))
        if all(0 <= a < s for a, s in zip(at, shape, strict=True)):
            out[at] = n
    return out


def check_list(counter: CellCounter, counts: Counter, channel: int) -> None:
    rows = [[*cell, n] for cell, n in sorted(counts.items())]
    assert counter.to_list(channel).rows().tolist() == rows


@each
def test_counts_lists_and_windows_equal_a_dictionary(case: Case) -> None:
    rng = np.random.default_rng(1)
    counter = CellCounter(case.lattice)
    expected: list[Counter] = [Counter(), Counter()]
    for turn in range(6):
        index = rng.integers(-40, 40, (60, case.dim)).astype(np.int32) // (1 + turn)
        channel = turn % 2
        counter.add(index, channel)
        expected[channel].update(map(tuple, index.tolist()))
    for channel in (HITS, PASSES):
        check_list(counter, expected[channel], channel)
        for low, shape in (
            ([-45] * case.dim, [90] * case.dim if JIT else [50] * case.dim),
            ([-1] * case.dim, [3] * case.dim),
            ([-17, 5, -8][: case.dim], [33, 1, 20][: case.dim]),
            ([1000] * case.dim, [4] * case.dim),
        ):
            low, shape = np.array(low), np.array(shape)
            np.testing.assert_array_equal(
                counter.window(low, shape, channel), expected_window(expected[channel], low, shape)
            )


@each
def test_growing_over_thousands_of_tiles(case: Case) -> None:
    """Far apart, so that each cell makes a tile, and both the table and the tiles grow many times."""
    rng = np.random.default_rng(2)
    n = 3000 if JIT else 150
    index = rng.integers(-50_000, 50_000, (n, case.dim)).astype(np.int32)
    counter = CellCounter(case.lattice)
    counter.add(index, PASSES)
    counter.add(index[: n // 2], PASSES)
    counter.add(index[n // 2 :], HITS)
    counts = Counter(map(tuple, np.vstack([index, index[: n // 2]]).tolist()))
    check_list(counter, counts, PASSES)
    check_list(counter, Counter(map(tuple, index[n // 2 :].tolist())), HITS)
    for cell in index[:20]:
        window = counter.window(cell.astype(np.int64) - 1, np.full(case.dim, 3), PASSES)
        assert window[(1,) * case.dim] == counts[tuple(cell.tolist())]


@each
def test_the_corners_of_the_range(case: Case) -> None:
    top = case.lattice.limit - 1
    index = np.array([[top] * case.dim, [-top] * case.dim, [-top] + [top] * (case.dim - 1), [0] * case.dim], np.int32)
    counter = CellCounter(case.lattice)
    for _ in range(3):
        counter.add(index)
    assert counter.to_list() == VoxelList.from_cells(np.repeat(index, 3, axis=0), case.lattice)
    for cell in index:
        assert counter.window(cell.astype(np.int64), np.ones(case.dim, np.int64)).ravel().tolist() == [3]
    # A window may reach beyond the range; there is nothing there.
    over = counter.window(index[0].astype(np.int64) - 1, np.full(case.dim, 4))
    assert over.sum() == 3


@settings(max_examples=EXAMPLES, deadline=None)
@given(
    st.lists(st.lists(st.tuples(st.integers(-70, 70), st.integers(-70, 70)), max_size=20), max_size=5),
    st.tuples(st.integers(-80, 80), st.integers(-80, 80)),
    st.tuples(st.integers(0, 40), st.integers(0, 40)),
)
def test_any_additions_and_any_window(batches: list, low: tuple[int, int], shape: tuple[int, int]) -> None:
    counter = CellCounter(Lattice.named("A2", 0.1))
    counts: Counter = Counter()
    for batch in batches:
        counter.add(np.array(batch, np.int32).reshape(-1, 2))
        counts.update(batch)
    check_list(counter, counts, HITS)
    assert len(counter.to_list(PASSES)) == 0
    found = counter.window(np.array(low), np.array(shape))
    np.testing.assert_array_equal(found, expected_window(counts, np.array(low), np.array(shape)))


@each
def test_an_empty_counter(case: Case) -> None:
    counter = CellCounter(case.lattice)
    counter.add(np.empty((0, case.dim), np.int32))
    assert counter.to_list() == VoxelList.empty(case.lattice)
    assert counter.window(np.zeros(case.dim, np.int64), np.full(case.dim, 2)).sum() == 0
