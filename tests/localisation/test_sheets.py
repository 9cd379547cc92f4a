"""Sheets: the bounds of all blocks of a level at once, against looking at every cell of every box."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hexmap.lattice.lattice import Lattice
from localisation.matching import _sheet_kernels as kernels
from localisation.matching.global_matcher import spread_points, thin
from localisation.matching.pyramid import level_windows
from localisation.matching.sheets import Sheet, make_sheet
from tests.lattices import CASES, EXAMPLES, Case


def sheet_of(cells: np.ndarray, steps: np.ndarray, level: int, beyond: int, windows: tuple[int, ...]) -> Sheet:
    n = cells.shape[1]
    return make_sheet(cells.astype(np.int64), steps.astype(np.uint8), windows, level, np.full(n, beyond))


def largest(cells: np.ndarray, steps: np.ndarray, first: np.ndarray, side: int) -> int:
    """The largest weight in a box, by looking at every cell."""
    inside = ((cells >= first) & (cells < first + side)).all(axis=1)
    return int(steps[inside].max(initial=0))


@given(
    n=st.sampled_from([2, 3]), level=st.integers(1, 3), seed=st.integers(0, 10_000), flat=st.booleans(),
    most=st.sampled_from([1, 3, 255]),
)  # fmt: skip
@settings(max_examples=EXAMPLES, deadline=None)
def test_the_bounds_of_all_blocks_are_the_sums_of_the_largest_weights(
    n: int, level: int, seed: int, flat: bool, most: int
) -> None:
    rng = np.random.default_rng(seed)
    span = 9 if n == 3 else 30
    cells = np.unique(rng.integers(-span, span, (rng.integers(1, 25), n)), axis=0)
    steps = rng.integers(1, most + 1, len(cells))
    windows = tuple((1 << level) + k for k in (1, 3, 6))
    blocks = rng.integers(1, 4, n)
    sheet = sheet_of(cells, steps, level, int(blocks.max()) << level, windows)
    points = int(rng.integers(1, 12))
    first = rng.integers(-3 * span, 3 * span, (2, points, n)).astype(np.int32)
    kind = rng.integers(0, len(windows), (2, points)).astype(np.int32)
    weights = rng.integers(1, 4, points)
    low = rng.integers(-4, 4, n)
    rows = [np.arange(b) * s for b, s in zip(blocks, sheet.strides, strict=True)]
    whole = int(sum(r[-1] for r in rows)) + 1
    starts = np.array([sum(place) for place in itertools.product(*rows[:-1])])
    runs = np.array([[0, whole]]) if flat else np.column_stack([starts, np.full(len(starts), blocks[-1])])
    out = np.empty((2, int(blocks.prod())), np.int32)
    stops = np.array([k for k in (3, 7) if k < points] + [points])
    covered = np.array([True, bool(seed % 2)])
    sums = np.empty(int(runs.sum(axis=1).max()), np.uint16)
    kernels.add_up(sheet, first, kind, covered, weights.astype(np.uint16), stops, 999, low, blocks, runs, sums, out)
    for b in range(2):
        for at, block in enumerate(itertools.product(*[range(k) for k in blocks])):
            if not covered[b]:
                assert out[b, at] == 999
                continue
            bound = exact = 0
            for p in range(points):
                place = first[b, p] + low + np.array(block) * (1 << level)
                window = windows[kind[b, p]]
                # An entry serves the places of one step: its box begins at the first of them.
                begin = sheet.low + (place - sheet.low) // sheet.step * sheet.step
                bound += int(weights[p]) * largest(cells, steps, begin, window + sheet.step - 1)
                exact += int(weights[p]) * largest(cells, steps, place, window)
            assert out[b, at] == bound >= exact


@pytest.mark.parametrize("level", [4, 5, 6])
def test_high_levels_round_places_down_and_stay_upper_bounds(level: int) -> None:
    rng = np.random.default_rng(level)
    cells = np.unique(rng.integers(0, 300, (40, 2)), axis=0)
    steps = np.ones(len(cells), np.int64)
    windows = level_windows(Lattice.named("A2", 0.1), level)
    sheet = sheet_of(cells, steps, level, 600, windows)
    for place in rng.integers(-100, 300, (200, 2)):
        first = place.astype(np.int32)[None, None]
        for kind, window in enumerate(windows):
            out = np.empty((1, 1), np.int32)
            kernels.add_up(
                sheet, first, np.full((1, 1), kind, np.int32), np.array([True]), np.ones(1, np.uint16), np.array([1]),
                0, np.zeros(2, np.int64), np.ones(2, np.int64), np.array([[0, 1]]), np.empty(1, np.uint16), out,
            )  # fmt: skip
            assert largest(cells, steps, place, window) <= out[0, 0]
            assert out[0, 0] <= largest(cells, steps, place - sheet.step, window + 2 * sheet.step)


def test_bounds_are_no_more_than_those_of_the_block_around_and_nothing_where_no_shift_may_be() -> None:
    rng = np.random.default_rng(0)
    blocks = np.array([4, 6])
    out = rng.integers(0, 100, (3, 24)).astype(np.int32)
    parents = rng.integers(0, 100, (2, 6)).astype(np.int32)
    parent = np.array([0, 1, 1])
    allowed = rng.random(24) < 0.7
    before = out.copy()
    kernels.keep_within(out, parents, parent, blocks, allowed)
    for b in range(3):
        for at, (i, j) in enumerate(itertools.product(range(4), range(6))):
            above = parents[parent[b], (i // 2) * 3 + j // 2]
            assert out[b, at] == (min(before[b, at], above) if allowed[at] else 0)
    row, block, bound = kernels.passing(out, 40)
    np.testing.assert_array_equal(np.stack([row, block]), np.nonzero(out > 40))
    np.testing.assert_array_equal(bound, out[out > 40])
    counts = np.zeros(101, np.int64)
    kernels.count_bounds(out, counts)
    np.testing.assert_array_equal(counts, np.bincount(out.ravel(), minlength=101))


@pytest.mark.parametrize("case", CASES, ids=str)
def test_spread_points_are_points_of_the_scan_few_and_far_apart(case: Case) -> None:
    rng = np.random.default_rng(1)
    n = case.dim
    lattice = case.lattice
    wall = rng.uniform(-20, 20, (4000, n)) * lattice.resolution
    wall[:, -1] = 3.0 * lattice.resolution
    kept, _ = thin(wall, lattice)
    some = spread_points(wall, lattice, 50)
    assert 1 <= len(some) <= 50
    assert {tuple(p) for p in some} <= {tuple(p) for p in kept}
    np.testing.assert_array_equal(some, spread_points(wall, lattice, 50))
    assert len(spread_points(wall, lattice, 10**6)) == len(kept)
    assert len(spread_points(wall, lattice, 1)) == 1
