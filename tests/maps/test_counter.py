"""The growing grid of counts against a dictionary."""

from __future__ import annotations

import pickle
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hexmap.base.errors import BoundsError, TooLargeError
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.rays import traverse
from hexmap.maps.counter import HITS, PASSES, CellCounter
from hexmap.maps.map import Level
from hexmap.maps.voxel_list import VoxelList
from tests.lattices import CASES, EXAMPLES, JIT, Case

# The hash of a tile wraps around on purpose; numpy warns of it where the JIT is off.
pytestmark = pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")
each = pytest.mark.parametrize("case", CASES, ids=str)


def check_list(counter: CellCounter, counts: Counter, channel: int) -> None:
    rows = [[*cell, n] for cell, n in sorted(counts.items())]
    assert counter.to_list(channel).rows().tolist() == rows


@each
def test_counts_and_lists_equal_a_dictionary(case: Case) -> None:
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
        asked = rng.integers(-45, 45, (500, case.dim)).astype(np.int32)
        assert counter.find(asked, channel).tolist() == [expected[channel][tuple(c)] for c in asked.tolist()]


@each
@pytest.mark.parametrize("layer", [1, 1 << 18], ids=["layer by layer", "tile by tile"])
def test_rows_are_the_cells_of_both_lists_in_one_order(
    case: Case, layer: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hexmap.maps.counter._LAYER", layer)
    rng = np.random.default_rng(3)
    counter = CellCounter(case.lattice)
    assert list(counter.rows()) == [] and counter.nbytes == 0
    for channel in (HITS, PASSES):
        counter.add(rng.integers(-20, 20, (400, case.dim)).astype(np.int32) * (1 + channel), channel)
    found = list(counter.rows())
    keys, hits, passes = (np.concatenate(columns) for columns in zip(*found, strict=True))
    expected = Level(counter.to_list(HITS), counter.to_list(PASSES)).columns()
    for column, wanted in zip((keys, hits, passes), expected, strict=True):
        assert column.dtype == np.int64 and column.tolist() == wanted.tolist()
    assert len(found) > 1 and counter.nbytes > 0


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
    assert counter.find(index, PASSES).tolist() == [counts[tuple(c)] for c in index.tolist()]


@each
def test_the_corners_of_the_range(case: Case) -> None:
    top = case.lattice.limit - 1
    index = np.array([[top] * case.dim, [-top] * case.dim, [-top] + [top] * (case.dim - 1), [0] * case.dim], np.int32)
    counter = CellCounter(case.lattice)
    for _ in range(3):
        counter.add(index)
    assert counter.to_list() == VoxelList.from_cells(np.repeat(index, 3, axis=0), case.lattice)
    assert counter.find(index).tolist() == [3, 3, 3, 3]


@settings(max_examples=EXAMPLES, deadline=None)
@given(st.lists(st.lists(st.tuples(st.integers(-70, 70), st.integers(-70, 70)), max_size=20), max_size=5))
def test_any_additions(batches: list) -> None:
    counter = CellCounter(Lattice.named("A2", 0.1))
    counts: Counter = Counter()
    for batch in batches:
        counter.add(np.array(batch, np.int32).reshape(-1, 2))
        counts.update(batch)
    check_list(counter, counts, HITS)
    assert len(counter.to_list(PASSES)) == 0


@each
def test_a_scan_is_hits_at_the_ends_of_rays_and_passes_before_them(case: Case) -> None:
    """Against the traversal and a dictionary; rays so long that they need many new tiles on their way."""
    rng = np.random.default_rng(4)
    counter = CellCounter(case.lattice)
    hits: Counter = Counter()
    passes: Counter = Counter()
    reach = 400 * case.lattice.resolution if JIT else 20 * case.lattice.resolution
    for _ in range(4):
        origin = rng.uniform(-reach, reach, case.dim)
        ends = rng.uniform(-reach, reach, (70, case.dim))
        count = int(rng.integers(0, len(ends) + 1))
        ends[0] = origin  # a ray within a cell
        counter.fuse(origin, ends, count)
        through = traverse(case.lattice, np.broadcast_to(origin, ends.shape), ends)
        for r in range(len(ends)):
            cells = list(map(tuple, through.ray(r).tolist()))
            passes.update(cells[:-1] if r < count else cells)
            hits.update(cells[-1:] if r < count else [])
    check_list(counter, hits, HITS)
    check_list(counter, passes, PASSES)


@each
def test_rays_along_faces_and_through_corners_count_the_cells_of_the_exact_walk(case: Case) -> None:
    """Many rays at once take quotients that are rounded once more; ties are settled as for one ray alone."""
    rng = np.random.default_rng(6)
    corners = np.vstack([case.lattice.cell.vertices, 0.5 * case.lattice.cell.normals, np.zeros((1, case.dim))])
    # From a centre, the middle of a face or a corner to others of these, and a few anywhere between.
    for begin in corners[:: max(1, len(corners) // 5)]:
        at = case.lattice.centres(rng.integers(-6, 7, (50, case.dim)))
        ends = at + corners[rng.integers(0, len(corners), 50)]
        ends[::7] += rng.uniform(-0.5, 0.5, (8, case.dim)) * case.lattice.resolution
        counter = CellCounter(case.lattice)
        counter.fuse(begin, ends, 30)
        through = traverse(case.lattice, np.broadcast_to(begin, ends.shape), ends)
        rays = [list(map(tuple, through.ray(r).tolist())) for r in range(len(ends))]
        check_list(counter, Counter(ray[-1] for ray in rays[:30]), HITS)
        passes: Counter = Counter()
        for r, ray in enumerate(rays):
            passes.update(ray[:-1] if r < 30 else ray)
        check_list(counter, passes, PASSES)


@each
def test_a_scan_that_is_out_of_range_or_too_large_adds_nothing(case: Case) -> None:
    counter = CellCounter(case.lattice)
    ends = np.ones((3, case.dim))
    ends[1] = 1e13
    for origin, some, hits in ((np.zeros(case.dim), ends, 3), (np.full(case.dim, -1e13), ends[:1], 0)):
        with pytest.raises(BoundsError, match="out of range"):
            counter.fuse(origin, some, hits)
    far = np.full((200, case.dim), 0.4 * case.lattice.limit * case.lattice.inradius / 2)
    if case.dim == 2:  # in space the range of indices ends before a scan is too large
        with pytest.raises(TooLargeError, match="rays of up to"):
            counter.fuse(np.zeros(2), far, 200)
    assert len(counter.to_list(HITS)) == len(counter.to_list(PASSES)) == 0


@each
def test_a_count_that_is_full_grows(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    """Four bytes a count, then eight: with a limit of 5 instead of two thousand million."""
    monkeypatch.setattr(CellCounter, "_most", property(lambda c: 5 if c.bytes_a_count == 4 else 2**63 - 1))
    counter = CellCounter(case.lattice)
    cell = np.full((12, case.dim), -3, np.int32)
    counter.add(cell[:5], PASSES)
    assert counter.bytes_a_count == 4
    counter.add(cell, PASSES)
    counter.fuse(case.lattice.centres(cell[:1])[0], case.lattice.centres(cell[:7]), 7)
    assert counter.bytes_a_count == 8
    assert counter.find(cell[:1], PASSES).tolist() == [17] and counter.find(cell[:1], HITS).tolist() == [7]


@each
def test_a_follower_knows_every_cell_that_was_hit(case: Case) -> None:
    """What it was told last is what the counter holds, whether it came early or late; even where thousands change."""
    rng = np.random.default_rng(6)
    counter = CellCounter(case.lattice)
    told: list[dict] = [{}, {}]

    def follower(which: int):
        def hear(index: np.ndarray, counts: np.ndarray) -> None:
            assert len(np.unique(index, axis=0)) == len(index)
            told[which].update(zip(map(tuple, index.tolist()), map(tuple, counts.tolist()), strict=True))

        return hear

    counter.follow(follower(0))
    for turn in range(6):
        if turn == 3:
            counter.follow(follower(1))
        index = rng.integers(-40, 40, (9000 if JIT else 90, case.dim)).astype(np.int32)
        counter.add(index, turn % 2)
        origin = rng.uniform(-1, 1, case.dim)
        counter.fuse(origin, origin + rng.uniform(-2, 2, (40, case.dim)), 30)
    hits = counter.to_list(HITS)
    passes = counter.find(hits.index, PASSES)
    counts = zip(hits.counts.tolist(), passes.tolist(), strict=True)
    expected = dict(zip(map(tuple, hits.index.tolist()), counts, strict=True))
    assert told[0] == told[1] == expected


@each
def test_an_empty_counter(case: Case) -> None:
    counter = CellCounter(case.lattice)
    counter.add(np.empty((0, case.dim), np.int32))
    assert counter.to_list() == VoxelList.empty(case.lattice)
    assert counter.find(np.zeros((1, case.dim), np.int32)).tolist() == [0]
    counter.fuse(np.zeros(case.dim), np.empty((0, case.dim)), 0)
    assert counter.to_list(PASSES) == VoxelList.empty(case.lattice)


@each
def test_a_counter_that_was_sent_elsewhere_goes_on_as_before(case: Case) -> None:
    """Spare tiles stay behind, also where there is none but those."""
    rng = np.random.default_rng(8)
    here, there = CellCounter(case.lattice), pickle.loads(pickle.dumps(CellCounter(case.lattice)))
    for _ in range(3):
        ends = rng.uniform(-30, 30, (40, case.dim)) * case.lattice.resolution
        for counter in (here, there):
            counter.fuse(np.zeros(case.dim), ends, 20)
        there = pickle.loads(pickle.dumps(there))
        for channel in (HITS, PASSES):
            assert here.to_list(channel) == there.to_list(channel)
