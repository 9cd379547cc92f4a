"""Occupied voxel lists: counting, the algebra of merging, look-up, shifting."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hexmap.base.errors import ArgumentError, BoundsError, LatticeError
from hexmap.lattice.keys import key_delta, pack, unpack
from hexmap.lattice.lattice import Lattice
from hexmap.maps.voxel_list import VoxelList
from tests import reference
from tests.lattices import ALL, BULK, CASES, EXAMPLES, Case

each = pytest.mark.parametrize("case", CASES, ids=str)
A2, D3 = CASES[1].lattice, CASES[3].lattice


def cloud(case: Case, seed: int, n: int = 0, reach: float = 4.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform(-reach, reach, (n or max(200, BULK // 100), case.dim)) * case.lattice.resolution


def as_dict(voxels: VoxelList) -> dict[tuple[int, ...], int]:
    return dict(zip(reference.as_tuples(voxels.index), voxels.counts.tolist(), strict=True))


# Small lists in a small box, so that they share points.
cells = st.dictionaries(st.tuples(*[st.integers(-3, 3)] * 3), st.integers(1, 5), max_size=12)


def from_dict(a: dict[tuple[int, ...], int], lattice: Lattice) -> VoxelList:
    return VoxelList.from_cells(
        np.array(list(a), dtype=np.int64).reshape(-1, 3)[:, : lattice.dim],
        lattice,
        np.array(list(a.values()), np.int64),
    )


@pytest.mark.parametrize("case", ALL, ids=str)
def test_a_list_counts_points_by_nearest_lattice_point(case: Case) -> None:
    exact = case.integer_gram is not None
    points = cloud(case, 1, n=0 if exact else 200)
    voxels = VoxelList.from_points(points, case.lattice)
    expected = reference.voxels(case, points)
    assert voxels.rows().tolist() == reference.rows(expected)
    assert voxels.total == len(points) and len(voxels) == len(expected)
    assert voxels.counts.dtype == np.int64 and voxels.index.dtype == np.int32
    assert (np.diff(voxels.keys) > 0).all(), "sorted, each once"
    np.testing.assert_array_equal(voxels.centres(), case.lattice.centres(voxels.index))
    np.testing.assert_array_equal(case.lattice.quantise(voxels.centres()), voxels.index)
    assert VoxelList.from_points(points[::-1], case.lattice) == voxels, "the order of the points does not count"
    assert VoxelList.from_points(points.astype(np.float32).astype(float), case.lattice) == VoxelList.from_points(
        np.asfortranarray(points.astype(np.float32)), case.lattice
    )


@each
def test_many_points_and_wide_boxes(case: Case) -> None:
    """Enough points for every pass of the sort, and boxes from one cell to the whole range of indices."""
    lattice = case.lattice
    for reach in (1e-3, 1.0, 30.0, 3e4, 0.3 * lattice.limit):
        points = cloud(case, 2, n=BULK // 10, reach=reach)
        index, counts = np.unique(lattice.quantise(points), axis=0, return_counts=True)
        voxels = VoxelList.from_points(points, lattice)
        np.testing.assert_array_equal(voxels.index, index)
        np.testing.assert_array_equal(voxels.counts, counts)


@each
def test_the_corners_of_the_range_of_indices(case: Case) -> None:
    top = case.lattice.limit - 1
    index = np.array(
        [[top] * case.dim, [-top] * case.dim, [0] * case.dim, [top] * case.dim, [-top] + [top] * (case.dim - 1)]
    )
    voxels = VoxelList.from_cells(index, case.lattice)
    assert voxels.rows().tolist() == sorted([*index[1], 1] if k == 1 else r for k, r in enumerate(
        [[*index[0], 2], [*index[1], 1], [*index[2], 1], [*index[4], 1]]))  # fmt: skip
    np.testing.assert_array_equal(unpack(pack(voxels.index), case.dim), voxels.index)


@given(st.lists(st.tuples(*[st.integers(-(2**20) + 1, 2**20 - 1)] * 3), min_size=1), st.sampled_from([2, 3]))
def test_packed_keys_sort_as_indices_do(rows: list[tuple[int, int, int]], dim: int) -> None:
    index = np.array(rows, dtype=np.int32)[:, :dim]
    keys = pack(index)
    np.testing.assert_array_equal(unpack(keys, dim), index)
    np.testing.assert_array_equal(np.sort(keys), pack(np.array(sorted(index.tolist()), dtype=np.int32)))
    v = index[0].astype(np.int64)
    moved = index - v
    inside = (np.abs(moved) < 2**20).all(axis=1)
    np.testing.assert_array_equal(keys[inside] + key_delta(-v), pack(moved[inside].astype(np.int32)))


@settings(max_examples=EXAMPLES, deadline=None)
@given(cells, cells, cells, st.sampled_from([A2, D3]))
def test_merging_is_a_commutative_monoid(a: dict, b: dict, c: dict, lattice: Lattice) -> None:
    x, y, z = (from_dict(d, lattice) for d in (a, b, c))
    assert as_dict(x.merge(y)) == reference.merge(as_dict(x), as_dict(y))
    assert x.merge(y) == y.merge(x)
    assert x.merge(y).merge(z) == x.merge(y.merge(z))
    assert x.merge(VoxelList.empty(lattice)) == x == VoxelList.empty(lattice).merge(x)
    assert x.merge(y).total == x.total + y.total
    assert x.count_coincident(y) == y.count_coincident(x) == reference.count_coincident(as_dict(x), as_dict(y))
    assert x.count_coincident(x) == len(x)


@settings(max_examples=EXAMPLES, deadline=None)
@given(cells, st.integers(-1, 7), st.lists(st.tuples(*[st.integers(-4, 4)] * 3), max_size=6), st.sampled_from([A2, D3]))
def test_looking_up(a: dict, occupancy: int, asked: list, lattice: Lattice) -> None:
    x = from_dict(a, lattice)
    d = as_dict(x)
    index = np.array(asked, dtype=np.int64).reshape(-1, 3)[:, : lattice.dim]
    assert x.find(index).tolist() == [d.get(i, 0) for i in reference.as_tuples(index)]
    assert x.contains(index).tolist() == [i in d for i in reference.as_tuples(index)]
    assert as_dict(x.at_least(occupancy)) == {k: v for k, v in d.items() if v >= occupancy}
    assert x.contains(x.index).all() and x.find(x.index).tolist() == x.counts.tolist()


@settings(max_examples=EXAMPLES, deadline=None)
@given(cells, st.tuples(*[st.integers(-50, 50)] * 3), st.sampled_from([A2, D3]))
def test_shifting_by_a_lattice_vector(a: dict, vector: tuple, lattice: Lattice) -> None:
    x = from_dict(a, lattice)
    v = np.array(vector[: lattice.dim])
    moved = x.shift(v)
    assert as_dict(moved) == {tuple(np.add(k, v).tolist()): n for k, n in as_dict(x).items()}
    assert moved.shift(-v) == x
    points = np.vstack([x.centres(), np.zeros((1, lattice.dim))])
    shifted_points = VoxelList.from_points(points + lattice.centres(v[None]), lattice)
    assert shifted_points == VoxelList.from_points(points, lattice).shift(v)


@each
def test_nothing_leaves_the_range_of_indices_unseen(case: Case) -> None:
    lattice = case.lattice
    top = lattice.limit - 1
    for axis in range(case.dim):
        unit = np.eye(case.dim, dtype=np.int64)[axis]
        edge = VoxelList.from_cells([unit * top], lattice)
        assert edge.shift(-unit * 2 * top).index.tolist() == (-unit * top)[None].tolist()
        for v in (unit, unit * 2**31, -unit * (2 * top + 1)):
            with pytest.raises(BoundsError, match="range"):
                edge.shift(v)
        with pytest.raises(BoundsError, match="index 1 "):
            VoxelList.from_cells([unit, unit * (top + 1)], lattice)
        far = [unit * (top + 1), -unit * (top + 1), unit * 2**40, unit * (2**63 - 1), -unit * 2**62]
        assert not edge.contains(far).any()


@pytest.mark.parametrize("lattice", [A2, D3], ids=["A2", "D3"])
def test_the_largest_integers_do_not_wrap_around(lattice: Lattice) -> None:
    """The absolute value of the least 64-bit integer is negative."""
    origin = VoxelList.from_cells([[0] * lattice.dim, [1] * lattice.dim], lattice)
    least = [-(2**63)] + [0] * (lattice.dim - 1)
    assert origin.find([least]).tolist() == [0]
    with pytest.raises(BoundsError):
        VoxelList.from_cells([least], lattice)
    with pytest.raises(BoundsError):
        VoxelList.from_cells(np.array([[2**63] + [0] * (lattice.dim - 1)], dtype=np.uint64), lattice)
    for v in (2**63 - 1, -(2**63)):
        with pytest.raises(BoundsError):
            origin.shift([v] + [0] * (lattice.dim - 1))


def test_indices_that_are_not_indices_are_not_rounded() -> None:
    origin = VoxelList.from_cells([[0, 0, 0]], D3)
    for index in ([[0.5, 0.0, 0.0]], np.zeros((3, 2), np.int64), np.zeros((1, 6), np.int64)):
        with pytest.raises(ArgumentError):
            origin.find(index)


@each
def test_empty_lists_work_everywhere(case: Case) -> None:
    lattice = case.lattice
    nothing = VoxelList.empty(lattice)
    for other in (
        VoxelList.from_points([], lattice),
        VoxelList.from_points(np.empty((0, case.dim), np.float32), lattice),
        VoxelList.from_cells([], lattice),
        VoxelList.from_cells(np.empty((0, case.dim), np.int32), lattice, []),
        nothing.merge(nothing),
        nothing.at_least(1),
        nothing.shift([1] * case.dim),
        VoxelList.from_points(np.zeros((1, case.dim)), lattice).at_least(2),
        nothing.select(np.zeros(0, bool)),
    ):
        assert other == nothing and len(other) == other.total == 0
        assert other.index.shape == (0, case.dim) and other.rows().shape == (0, case.dim + 1)
        assert other.centres().shape == (0, case.dim)
        assert other.count_coincident(nothing) == 0 and other.contains([[0] * case.dim]).tolist() == [False]
        assert other.find(np.empty((0, case.dim), int)).shape == (0,)
        assert other.keys.dtype == other.counts.dtype == np.int64
        assert "0 points" in repr(other)


def test_counts_never_saturate() -> None:
    half = VoxelList.from_cells([[0, 0]], A2, [2**40])
    total = half
    for _ in range(20):
        total = total.merge(total)
    assert total.counts.tolist() == [2**60]
    assert VoxelList.from_cells([[0, 0]] * 3, A2, [2**40] * 3).total == 3 * 2**40
    many = VoxelList.from_points(np.zeros((70_000, 2)), A2)
    assert many.counts.tolist() == [70_000], "more than 16 bits"


def test_cells_may_repeat_and_come_in_any_order() -> None:
    x = VoxelList.from_cells([[2, 0], [-1, 5], [2, 0]], A2, [1, 2, 3])
    assert x.rows().tolist() == [[-1, 5, 2], [2, 0, 4]]
    assert VoxelList.from_cells([[2, 0], [-1, 5], [2, 0]], A2).rows().tolist() == [[-1, 5, 1], [2, 0, 2]]
    assert VoxelList.from_cells(x.index, A2, x.counts) == x
    assert VoxelList.from_cells(np.array([[2, 0]], np.uint8), A2, np.array([3], np.int8)).rows().tolist() == [[2, 0, 3]]


@pytest.mark.parametrize(
    ("index", "counts"),
    [
        ([[0.5, 1.0]], None),
        ([[1, 2, 3]], None),
        ([1, 2], None),
        ([[1, 2]], [0]),
        ([[1, 2]], [-1]),
        ([[1, 2]], [1.5]),
        ([[1, 2]], [1, 2]),
        ([[1, 2]], [[1]]),
    ],
)
def test_cells_and_counts_are_checked(index: object, counts: object) -> None:
    with pytest.raises(ArgumentError):
        VoxelList.from_cells(index, A2, counts)


def test_lists_on_different_lattices_do_not_mix() -> None:
    a = VoxelList.from_points([[0.0, 0.0]], A2)
    b = VoxelList.from_points([[0.0, 0.0]], A2.scaled(2.0))
    assert a != b and a != "a list"
    with pytest.raises(LatticeError):
        a.merge(b)
    with pytest.raises(LatticeError):
        a.count_coincident(b)
    with pytest.raises(ArgumentError):
        a.shift([1, 2, 3])
    with pytest.raises(ArgumentError):
        a.shift([0.5, 1.0])


def test_lists_are_immutable() -> None:
    x = VoxelList.from_points([[0.0, 0.0], [1.0, 1.0]], A2)
    for column in (x.keys, x.counts, x.index):
        with pytest.raises(ValueError, match="read-only"):
            column[0] = 0
    with pytest.raises(TypeError):
        hash(x)


def test_bad_points_are_named() -> None:
    with pytest.raises(BoundsError, match="point 1 is not finite"), np.errstate(all="ignore"):
        VoxelList.from_points([[0.0, 0.0], [np.nan, 0.0]], A2)
    with pytest.raises(ArgumentError):
        VoxelList.from_points([[0.0, 0.0, 0.0]], A2)
