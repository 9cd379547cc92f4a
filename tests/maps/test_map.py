"""Maps: fusing scans in any order, merging parts, asking for states, cutting, moving, comparing."""

from __future__ import annotations

import itertools
import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hexmap.base.errors import ArgumentError, BoundsError, LatticeError
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.rays import traverse
from hexmap.maps.builder import MapBuilder
from hexmap.maps.cell_state import CellState
from hexmap.maps.map import Level, Map
from hexmap.maps.state_rule import StateRule
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from tests import reference
from tests.lattices import CASES, EXAMPLES, JIT, PLANAR, Case

UNKNOWN, FREE, OCCUPIED = CellState

pytestmark = pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")
each = pytest.mark.parametrize("case", CASES, ids=str)
A2 = Lattice.named("A2", 0.1)
LEVELS = 3


def random_pose(rng: np.random.Generator, dim: int, reach: float = 1.0) -> Pose:
    if dim == 2:
        return Pose.planar(*rng.uniform(-reach, reach, 2), rng.uniform(-math.pi, math.pi))
    return Pose.from_quaternion(rng.uniform(-reach, reach, 3), rng.normal(size=4))


def random_scans(case: Case, seed: int, n: int = 5, points: int = 30, reach: float = 1.5) -> list[tuple[Scan, Pose]]:
    rng = np.random.default_rng(seed)
    scans = []
    for k in range(n):
        directions = rng.normal(size=(4, case.dim))
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        scan = Scan(float(k), rng.uniform(-reach, reach, (points, case.dim)), directions)
        scans.append((scan, random_pose(rng, case.dim)))
    return scans


def build(case: Case, scans: list[tuple[Scan, Pose]], **settings: float) -> Map:
    builder = MapBuilder(case.lattice, LEVELS, **settings)
    for scan, pose in scans:
        builder.fuse(scan, pose)
    return builder.build()


@each
def test_the_order_of_scans_does_not_count(case: Case) -> None:
    scans = random_scans(case, 1)
    expected = build(case, scans)
    rng = np.random.default_rng(2)
    for _ in range(3):
        found = build(case, [scans[i] for i in rng.permutation(len(scans))])
        assert found == expected
        for a, b in zip(found.levels, expected.levels, strict=True):
            for x, y in ((a.hits, b.hits), (a.passes, b.passes)):
                assert x.keys.tobytes() == y.keys.tobytes() and x.counts.tobytes() == y.counts.tobytes()


@each
def test_parts_merge_to_the_whole_in_any_order(case: Case) -> None:
    scans = random_scans(case, 3, n=4)
    whole = build(case, scans)
    a, b, c = build(case, scans[:1]), build(case, scans[1:3]), build(case, scans[3:])
    nothing = build(case, [])
    for found in (
        a.merge(b).merge(c), a.merge(b.merge(c)), c.merge(a).merge(b), b.merge(c).merge(a), whole.merge(nothing),
        nothing.merge(whole),
    ):  # fmt: skip
        assert found == whole


@each
def test_every_level_is_quantised_from_the_points(case: Case) -> None:
    scans = random_scans(case, 4)
    points = np.vstack([pose.apply(scan.points) for scan, pose in scans])
    made = build(case, scans)
    assert len(made.levels) == LEVELS
    for k, level in enumerate(made.levels):
        assert level.hits == VoxelList.from_points(points, case.lattice.scaled(2.0**k))
        assert level.hits.total == len(points)
        assert level.lattice.resolution == pytest.approx(case.lattice.resolution * 2**k)
        assert level is made.level(k)


@each
def test_passes_are_the_cells_the_beams_went_through(case: Case) -> None:
    scans = random_scans(case, 5, n=2, points=8 if JIT else 4, reach=8 * case.lattice.resolution)
    made = build(case, scans)
    counts: Counter[tuple[int, ...]] = Counter()
    for scan, pose in scans:
        for end in pose.apply(scan.points):
            counts.update(reference.traversed(case, pose.translation, end)[:-1])
    assert made.levels[0].passes.rows().tolist() == reference.rows(dict(counts))


@each
def test_ranges_limit_hits_and_clear_up_to_the_limit(case: Case) -> None:
    scans = random_scans(case, 6)
    low, high = 0.6, 1.3
    made = build(case, scans, min_range=low, max_range=high)
    hits, passes = [], []
    for scan, pose in scans:
        r = np.sqrt((scan.points**2).sum(axis=1))
        used = (r >= low) & (r <= high)
        hits.append(pose.apply(scan.points[used]))
        origin = np.broadcast_to(pose.translation, hits[-1].shape)
        passes.append(traverse(case.lattice, origin, hits[-1]).without_ends())
        beyond = pose.apply(scan.points[r > high] * (high / r[r > high])[:, None])
        passes.append(traverse(case.lattice, np.broadcast_to(pose.translation, beyond.shape), beyond).index)
    assert 0 < sum(map(len, hits)) < sum(len(s.points) for s, _ in scans)
    assert made.levels[0].hits == VoxelList.from_points(np.vstack(hits), case.lattice)
    assert made.levels[0].passes == VoxelList.from_cells(np.vstack(passes), case.lattice)
    for k, level in enumerate(made.levels):
        assert level.hits.total == sum(map(len, hits)), f"level {k}"


def test_a_point_at_a_limit_is_used() -> None:
    scan = Scan(0.0, [[1.0, 0.0], [2.0, 0.0], [0.999, 0.0], [2.001, 0.0]])
    builder = MapBuilder(Lattice.named("Z2", 0.1), 1, min_range=1.0, max_range=2.0)
    builder.fuse(scan, Pose.identity(2))
    assert builder.build().levels[0].hits.rows().tolist() == [[10, 0, 1], [20, 0, 1]]


@each
def test_beams_without_return_clear_only_when_asked(case: Case) -> None:
    rng = np.random.default_rng(7)
    d = rng.normal(size=(6, case.dim))
    d /= np.linalg.norm(d, axis=1)[:, None]
    pose = random_pose(rng, case.dim)
    scan = Scan(0.0, np.empty((0, case.dim)), d)
    silent = build(case, [(scan, pose)])
    assert all(len(level.hits) == len(level.passes) == 0 for level in silent.levels)
    for metres, settings_ in ((0.8, {}), (0.5, {"max_range": 0.5})):
        cleared = build(case, [(scan, pose)], clear_no_return=0.8, **settings_)
        ends = pose.apply(d * metres)
        for level in cleared.levels:
            cells = traverse(level.lattice, np.broadcast_to(pose.translation, ends.shape), ends)
            assert level.passes == VoxelList.from_cells(cells.index, level.lattice) and len(level.hits) == 0


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@each
def test_a_scan_that_does_not_fit_is_left_out_as_a_whole(case: Case) -> None:
    good = random_scans(case, 8, n=1)
    builder = MapBuilder(case.lattice, 2)
    builder.fuse(*good[0])
    before = builder.build()
    far = np.zeros((2, case.dim))
    far[1, 0] = 4 * case.lattice.limit * case.lattice.resolution
    for bad in (far, np.full((1, case.dim), math.inf)):
        with pytest.raises(BoundsError):
            builder.fuse(Scan(1.0, bad), Pose.identity(case.dim))
        assert builder.build() == before and builder.scans == 1


def test_dimensions_have_to_agree() -> None:
    flat, deep = Scan(0.0, np.ones((2, 2))), Scan(0.0, np.ones((2, 3)))
    with pytest.raises(ArgumentError, match=r"dimension 2.*dimension 3"):
        MapBuilder(Lattice.named("D3")).fuse(flat, Pose.identity(2))
    with pytest.raises(ArgumentError):
        MapBuilder(A2).fuse(deep, Pose.identity(3))
    with pytest.raises(ArgumentError):
        MapBuilder(A2).fuse(flat, Pose.identity(3))
    with pytest.raises(ArgumentError):
        Scan(0.0, np.ones((2, 2)), np.ones((1, 3)))
    with pytest.raises(ArgumentError):
        Scan(0.0, np.ones(3))


@pytest.mark.parametrize(
    "settings",
    [
        {"levels": 0},
        {"levels": 17},
        {"min_range": -1.0},
        {"min_range": 2.0, "max_range": 1.0},
        {"min_range": math.nan},
        {"max_range": math.nan},
        {"clear_no_return": -1.0},
        {"clear_no_return": math.inf},
        {"clear_no_return": math.nan},
    ],
)
def test_settings_of_the_builder_are_checked(settings: dict) -> None:
    with pytest.raises(ArgumentError):
        MapBuilder(A2, **settings)


@each
def test_an_empty_map_works_everywhere(case: Case) -> None:
    nothing = build(case, [])
    builder = MapBuilder(case.lattice, LEVELS)
    builder.fuse(Scan(0.0, np.empty((0, case.dim))), Pose.identity(case.dim))
    assert builder.build() == nothing and builder.scans == 1
    assert nothing.bounds() is None
    assert nothing.merge(nothing) == nothing
    assert nothing.crop([-1] * case.dim, [1] * case.dim) == nothing
    assert nothing.transform(random_pose(np.random.default_rng(9), case.dim)) == nothing
    states = nothing.state()
    assert len(states.occupied) == len(states.free) == 0
    assert states.of([[0] * case.dim]).tolist() == [UNKNOWN]
    assert len(nothing.diff(nothing).kept) == 0


# ---------------------------------------------------------------------- states


@settings(max_examples=4 * EXAMPLES, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 30), st.integers(0, 30)), min_size=1, max_size=20),
    st.integers(1, 4),
    st.integers(0, 100),
    st.integers(1, 4),
)
def test_states_follow_the_rule(counts: list, min_hits: int, percent: int, min_passes: int) -> None:
    """With the ratio taken as the decimal number that a user wrote: 7 of 25 is at least 0.28."""
    cells = np.array([[k, -k] for k in range(len(counts))])
    h, p = np.array(counts).T
    hits = VoxelList.from_cells(cells[h > 0], A2, h[h > 0])
    passes = VoxelList.from_cells(cells[p > 0], A2, p[p > 0])
    ratio = f"{percent / 100:.2f}"
    states = Map([Level(hits, passes)]).state(StateRule(min_hits, float(ratio), min_passes))
    expected = [reference.state(a, b, min_hits, ratio, min_passes) for a, b in counts]
    assert states.of(cells).tolist() == expected
    assert states.occupied.counts.tolist() == [a for (a, _), s in zip(counts, expected, strict=True) if s == OCCUPIED]
    assert states.free.counts.tolist() == [b for (_, b), s in zip(counts, expected, strict=True) if s == FREE]
    assert states.occupied.count_coincident(states.free) == 0
    assert states.of([[1000, 1000]]).tolist() == [UNKNOWN]


def test_seven_of_twenty_five_is_at_least_028() -> None:
    cell = [[0, 0]]  # in floats 0.28 * 25 is more than 7
    level = Level(VoxelList.from_cells(cell, A2, [7]), VoxelList.from_cells(cell, A2, [18]))
    assert Map([level]).state(StateRule(min_ratio=0.28)).of(cell).tolist() == [OCCUPIED]


@pytest.mark.parametrize("rule", [(0, 0.2, 1), (1, -0.1, 1), (1, 1.1, 1), (1, math.nan, 1), (1, 0.2, 0)])
def test_rules_are_checked(rule: tuple) -> None:
    with pytest.raises(ArgumentError):
        StateRule(*rule)


# ---------------------------------------------------------------------- crop, transform, diff


@each
def test_cropping_keeps_the_cells_in_the_box(case: Case) -> None:
    made = build(case, random_scans(case, 10))
    low, high = np.full(case.dim, -0.7), np.full(case.dim, 0.9)
    cut = made.crop(low, high)
    for before, after in zip(made.levels, cut.levels, strict=True):
        for x, y in ((before.hits, after.hits), (before.passes, after.passes)):
            inside = ((x.centres() >= low) & (x.centres() <= high)).all(axis=1)
            assert y == x.select(inside)
    assert 0 < len(cut.levels[0].hits) < len(made.levels[0].hits)
    assert made.crop([-99] * case.dim, [99] * case.dim) == made
    corners = cut.bounds()
    assert corners is not None and (corners[0] >= low).all() and (corners[1] <= high).all()
    for bad in ((low[:-1], high[:-1]), (high, low), (low, np.full(case.dim, math.nan))):
        with pytest.raises(ArgumentError):
            made.crop(*bad)


@each
def test_two_halves_merge_to_the_whole(case: Case) -> None:
    made = build(case, random_scans(case, 11))
    edge = 0.123456789
    left_high, right_low = np.full(case.dim, 99.0), np.full(case.dim, -99.0)
    left_high[0], right_low[0] = edge, np.nextafter(edge, 1)
    assert made.crop([-99] * case.dim, left_high).merge(made.crop(right_low, [99] * case.dim)) == made


@each
def test_transforms_keep_all_counts(case: Case) -> None:
    made = build(case, random_scans(case, 12))
    rng = np.random.default_rng(13)
    assert made.transform(Pose.identity(case.dim)) == made
    moved = made.transform(random_pose(rng, case.dim), frame="world")
    assert moved.frame == "world" and made.frame == "map"
    for a, b in zip(made.levels, moved.levels, strict=True):
        assert a.hits.total == b.hits.total and a.passes.total == b.passes.total


@each
def test_a_move_by_a_lattice_vector_is_a_shift(case: Case) -> None:
    made = build(case, random_scans(case, 14))
    v = np.array([5, -3, 2][: case.dim])
    coarse = 2 ** (LEVELS - 1)
    metres = case.lattice.centres((v * coarse)[None])[0]
    moved = made.transform(Pose(np.eye(case.dim), metres))
    for k, (a, b) in enumerate(zip(made.levels, moved.levels, strict=True)):
        assert b.hits == a.hits.shift(v * coarse // 2**k) and b.passes == a.passes.shift(v * coarse // 2**k)
    back = moved.transform(Pose(np.eye(case.dim), -metres))
    assert back == made


@each
def test_a_turn_that_the_lattice_has_is_a_permutation(case: Case) -> None:
    made = build(case, random_scans(case, 15, n=2))
    B = case.lattice.basis
    for M in case.lattice.point_group:
        if round(np.linalg.det(M)) == 1:
            turned = made.transform(Pose(B @ M @ np.linalg.inv(B), np.zeros(case.dim)))
            for a, b in zip(made.levels, turned.levels, strict=True):
                assert b.hits == VoxelList.from_cells(a.hits.index.astype(np.int64) @ M.T, a.lattice, a.hits.counts)


def test_what_changed_between_two_maps() -> None:
    def made(hits: list[int], passes: list[int]) -> Map:
        return Map([Level(*(VoxelList.from_cells([[k, 0] for k in row], A2) for row in (hits, passes)))])

    before = made(hits=[0, 1, 2], passes=[5, 6])
    after = made(hits=[0, 5, 9], passes=[1, 6])
    diff = before.diff(after, StateRule())
    assert diff.kept.index.tolist() == [[0, 0]]
    assert diff.appeared.index.tolist() == [[5, 0], [9, 0]], "free or unknown before"
    assert diff.vanished.index.tolist() == [[1, 0]], "free now; the third was merely not seen again"
    same = before.diff(before)
    assert len(same.appeared) == len(same.vanished) == 0 and same.kept == before.state().occupied
    with pytest.raises(LatticeError):
        before.diff(Map([Level(VoxelList.empty(A2.scaled(2.0)), VoxelList.empty(A2.scaled(2.0)))]))


@pytest.mark.parametrize("case", PLANAR, ids=str)
def test_diff_covers_what_is_occupied_now(case: Case) -> None:
    a, b = build(case, random_scans(case, 16)), build(case, random_scans(case, 17))
    diff = a.diff(b)
    assert diff.kept.merge(diff.appeared) == b.state().occupied
    assert a.state().occupied.contains(diff.kept.index).all()
    assert (b.state().of(diff.vanished.index) == FREE).all()


# ---------------------------------------------------------------------- the value


def test_provenance_is_a_set() -> None:
    builder = MapBuilder(A2, 1)
    a = builder.build(source={"log": "b.clf", "settings": {"z": 1, "a": 2}})
    b = builder.build(source={"log": "a.clf"})
    assert a.merge(b) == b.merge(a)
    assert a.merge(b).merge(a).provenance == a.merge(b).provenance
    assert [s["log"] for s in a.merge(b).sources()] == ["a.clf", "b.clf"]
    assert a != b and a != "a map"
    assert builder.build().sources() == []


def test_levels_have_to_be_one_lattice_at_doubling_resolutions() -> None:
    def empty(lattice: Lattice) -> Level:
        return Level(VoxelList.empty(lattice), VoxelList.empty(lattice))

    with pytest.raises(ArgumentError):
        Map([])
    with pytest.raises(LatticeError):
        Map([empty(A2), empty(A2)])
    with pytest.raises(LatticeError):
        Map([empty(A2), empty(Lattice.named("Z2", 0.2))])
    with pytest.raises(LatticeError):
        Map([Level(VoxelList.empty(A2), VoxelList.empty(A2.scaled(2.0)))])
    made = Map([empty(A2), empty(A2.scaled(2.0))])
    for k in (-1, 2):
        with pytest.raises(ArgumentError, match="levels 0 to 1"):
            made.level(k)
    with pytest.raises(LatticeError):
        made.merge(Map([empty(A2)]))
    with pytest.raises(LatticeError):
        made.merge(Map([empty(Lattice.named("Z2", 0.1)), empty(Lattice.named("Z2", 0.2))]))
    with pytest.raises(ArgumentError, match="frame"):
        made.merge(Map(made.levels, frame="odom"))


@each
def test_bounds_hold_all_cells(case: Case) -> None:
    made = build(case, random_scans(case, 18))
    for k, level in enumerate(made.levels):
        centres = np.vstack([level.hits.centres(), level.passes.centres()])
        low, high = made.bounds(k) or (None, None)
        np.testing.assert_allclose(low, centres.min(axis=0))
        np.testing.assert_allclose(high, centres.max(axis=0))
    keys, hits, passes = made.levels[0].columns()
    assert (np.diff(keys) > 0).all() and (hits + passes > 0).all()
    assert hits.sum() == made.levels[0].hits.total and passes.sum() == made.levels[0].passes.total


def test_a_map_from_a_building_in_use_stays_as_it_was() -> None:
    """What build returned does not change when more scans come."""
    case = PLANAR[0]
    scans = random_scans(case, 19)
    builder = MapBuilder(case.lattice, 2)
    builder.fuse(*scans[0])
    early = builder.build()
    rows = [level.hits.rows().copy() for level in early.levels]
    for scan, pose in itertools.islice(scans, 1, None):
        builder.fuse(scan, pose)
    for level, before in zip(early.levels, rows, strict=True):
        np.testing.assert_array_equal(level.hits.rows(), before)
    assert builder.counter().to_list() == builder.build().levels[0].hits
