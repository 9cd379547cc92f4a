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
from localisation.matching.pyramid import FARTHEST_PART, OccupancyPyramid, level_windows
from localisation.matching.rotation_cells import cut_tilts
from localisation.matching.score import coincidence, hits, likelihood
from localisation.matching.search_region import SearchRegion
from tests.lattices import CASES, PART, PLANAR, SHEARED, SPATIAL, Case

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
        ends = zip(corners.min(0), corners.max(0), strict=True)
        ranges = [range(math.floor(a) - 1, math.ceil(b) + 2) for a, b in ends]
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
            # The planes across v through the cells around: v . x = v . centre + |v|^2 / 2.
            around = np.random.default_rng(0).uniform(-1.5, 1.5, (20000, lattice.dim)) * np.linalg.norm(p)
            centres = np.unique(lattice.quantise(around), axis=0)
            levels = np.unique(np.round((lattice.centres(centres) @ v) + 0.5 * float(v @ v), 12))
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


@pytest.mark.parametrize("case", SPATIAL, ids=str)
def test_the_tilts_of_a_ball_are_searched_too(case: Case) -> None:
    rng = np.random.default_rng(case.dim)
    lattice = scaled(case, 1.3)
    weights = random_map(lattice, rng, most=3, size=3.0)
    points = rng.uniform(-2.0, 2.0, (12, 3))
    low, high = np.full(3, -1.5), np.full(3, 1.5)
    every = EveryPose(weights, low, high)
    matcher = GlobalMatcher(OccupancyPyramid(weights), VoxelList.from_cells(every.shifts, lattice))
    tilt, step = 0.5, 2 * math.pi / 16
    match = matcher.match(points, SearchRegion(low, high, tilt=tilt), angles=step, refine=False, runner_up=None)
    kept, point_weights = thin(points, lattice)
    ranges = np.sqrt((kept**2).sum(axis=1))
    typical = max(float(np.median(ranges)), float(ranges.max()) / FARTHEST_PART)
    motion = typical * float(np.linalg.norm(np.linalg.inv(lattice.basis), axis=1).max())
    tilts, _, starts, _, _ = cut_tilts(3, tilt, motion, 2)
    finest = tilts[: starts[1]]
    assert len(finest) > 4
    # Neighbouring tilts move half of the points by no more than a cell.
    turn = exponential(np.array([tilt / math.ceil(tilt * motion), 0, 0])) - np.eye(3)
    moved = np.median(np.linalg.norm(kept @ turn.T, axis=1))
    assert moved <= 1.0 / np.linalg.norm(np.linalg.inv(lattice.basis), axis=1).max() + 1e-9
    best = max(every.best(kept, point_weights, turned(3, k * step, T)) for k in range(16) for T in finest)
    assert match is not None and match.score == best and match.gap == 0


@pytest.mark.parametrize("case", PLANAR, ids=str)
@pytest.mark.parametrize("seed", range(4))
def test_the_runner_up_is_the_best_of_all_that_lies_apart(case: Case, seed: int) -> None:
    rng = np.random.default_rng([seed, 5])
    lattice = scaled(case, 0.7)
    weights = random_map(lattice, rng, most=2, size=5.0)
    points = rng.uniform(-3.0, 3.0, (10, 2))
    low, high = np.full(2, -4.0), np.full(2, 4.0)
    every = EveryPose(weights, low, high)
    matcher = GlobalMatcher(OccupancyPyramid(weights), VoxelList.from_cells(every.shifts, lattice))
    step, apart = 2 * math.pi / 36, (1.5, math.radians(25.0))
    match = matcher.match(points, SearchRegion(low, high), angles=step, apart=apart, runner_up=0.0, refine=False)
    assert match is not None and match.runner_up is not None and match.apart == apart
    kept, point_weights = thin(points, lattice)
    shifts, best = every.shifts, -1
    near = np.linalg.norm(lattice.centres(shifts) - match.searched.translation, axis=1) <= apart[0]
    for k in range(36):
        turn = abs((k * step - match.searched.theta + math.pi) % (2 * math.pi) - math.pi)
        every.shifts = shifts[~near] if turn <= apart[1] + 1e-9 else shifts
        best = max(best, every.best(kept, point_weights, turned(2, k * step)))
    assert match.runner_up.score == best == match.runner_up_bound
    away = match.searched.inverse() @ match.runner_up.pose
    assert np.linalg.norm(away.translation) > apart[0] or away.angle > apart[1]
    # Asked for no less than the best itself, it says only that nothing else reaches it.
    strict = matcher.match(points, SearchRegion(low, high), angles=step, apart=apart, runner_up=1.0, refine=False)
    assert strict is not None and strict.runner_up is None and strict.runner_up_bound == strict.score


def office(rng: np.random.Generator) -> NDArray:
    """Walls of a few rooms of different sizes, points every 2 cm with the sensor's noise."""
    lines = [((0, 0), (9, 0)), ((9, 0), (9, 6)), ((9, 6), (0, 6)), ((0, 6), (0, 0)), ((4, 0), (4, 2)), ((4, 3), (4, 6)),
             ((4, 3.5), (7, 3.5)), ((1, 1), (1.6, 1)), ((1.6, 1), (1.6, 1.8)), ((6, 1.5), (7.3, 2.2))]  # fmt: skip
    points = [np.linspace(a, b, int(math.dist(a, b) / 0.02)) for a, b in lines]
    walls = np.concatenate(points)
    return walls + rng.normal(0, 0.005, walls.shape)


def seen_from(walls: NDArray, pose: Pose) -> NDArray:
    """What a laser of 180 beams sees of walls given by points: the nearest of each degree."""
    at = pose.inverse().apply(walls)
    ranges, beams = np.linalg.norm(at, axis=1), np.floor(np.degrees(np.arctan2(at[:, 1], at[:, 0]))).astype(int)
    order = np.lexsort([ranges, beams])
    _, first = np.unique(beams[order], return_index=True)
    return at[order[first]]


@pytest.mark.parametrize("name", ["Z2", "A2"])
def test_a_scan_is_found_anywhere_below_a_cell(name: str) -> None:
    walls = office(np.random.default_rng(0))
    lattice = Lattice.named(name, 0.05)
    matcher = GlobalMatcher(OccupancyPyramid(coincidence(VoxelList.from_points(walls, lattice))))
    for k, true in enumerate([Pose.planar(2.2, 3.1, 2.6), Pose.planar(6.0, 4.8, -1.0), Pose.planar(8.0, 1.0, 0.4)]):
        match = matcher.match(seen_from(office(np.random.default_rng(k + 1)), true))
        assert match is not None and match.certified and match.gap == 0
        assert match.pose.is_close(true, metres=0.04, radians=math.radians(0.6)), k
        assert match.margin > 0.05 and match.overlap > 0.6
        assert match.contradicted is not None and match.contradicted < 0.1
        assert match.information is not None and (np.linalg.eigvalsh(match.information) > 0).all()


def test_two_equal_rooms_give_both_poses() -> None:
    walls = office(np.random.default_rng(0))
    twin = np.concatenate([walls, walls + np.array([12.0, 0.0])])
    lattice = Lattice.named("A2", 0.05)
    matcher = GlobalMatcher(OccupancyPyramid(coincidence(VoxelList.from_points(twin, lattice))))
    true = Pose.planar(2.2, 3.1, 2.6)
    match = matcher.match(seen_from(walls, true))
    assert match is not None and match.runner_up is not None
    found = sorted([match.searched.x, match.runner_up.pose.x])
    assert found == pytest.approx([2.2, 14.2], abs=0.1)
    assert match.margin < 0.1


def test_a_search_that_is_stopped_says_so_and_its_bound_holds() -> None:
    rng = np.random.default_rng(3)
    lattice = Lattice.named("A2", 0.05)
    walls = office(rng)
    matcher = GlobalMatcher(OccupancyPyramid(coincidence(VoxelList.from_points(walls, lattice))))
    scan = np.concatenate([seen_from(walls, Pose.planar(2.2, 3.1, 2.6))[::3], rng.uniform(-4, 4, (120, 2))])
    whole = matcher.match(scan, runner_up=None)
    stopped = matcher.match(scan, time_limit=0.0)
    assert whole is not None and whole.certified and stopped is not None
    assert stopped.score <= whole.score <= stopped.bound
    few = [matcher.match(scan, node_limit=1, runner_up=None) for _ in range(2)]
    assert few[0] is not None and few[1] is not None and few[0].score <= whole.score <= few[0].bound
    assert (few[0].pose, few[0].bound, few[0].nodes) == (few[1].pose, few[1].bound, few[1].nodes)
    if not stopped.certified:
        assert stopped.runner_up is None and stopped.runner_up_bound is None and "at most" in repr(stopped)


def test_every_score_has_the_same_search_and_certificate() -> None:
    walls = office(np.random.default_rng(0))
    cells = VoxelList.from_points(walls, Lattice.named("A2", 0.05))
    true = Pose.planar(6.0, 4.8, -1.0)
    own = VoxelList(cells.lattice, cells.keys, 1 + (cells.keys % 1000))
    for weights in (coincidence(cells), hits(cells), likelihood(cells, 0.05), own):
        match = GlobalMatcher(OccupancyPyramid(weights)).match(seen_from(walls, true))
        assert match is not None and match.gap == 0 and match.certified
        assert match.pose.is_close(true, metres=0.05, radians=math.radians(1.0))


def test_the_same_scan_gives_the_same_match_bit_for_bit() -> None:
    from concurrent.futures import ThreadPoolExecutor

    walls = office(np.random.default_rng(0))
    matcher = GlobalMatcher(OccupancyPyramid(coincidence(VoxelList.from_points(walls, Lattice.named("A2", 0.05)))))
    scan = seen_from(walls, Pose.planar(6.0, 4.8, -1.0))

    def once(_: int) -> tuple:
        match = matcher.match(scan)
        assert match is not None
        return match.pose, match.score, match.nodes, match.runner_up_bound, match.information.tobytes()

    with ThreadPoolExecutor(4) as threads:
        assert len(set(threads.map(once, range(8)))) == 1


def test_a_map_and_a_scan_in_one_line() -> None:
    from hexmap.maps.builder import MapBuilder
    from hexmap.poses.scan import Scan

    walls = office(np.random.default_rng(0))
    builder = MapBuilder(Lattice.named("A2", 0.05), levels=2)
    for x, y in ((2.2, 3.1), (6.0, 4.8), (7.0, 1.0), (3.0, 5.0), (5.0, 2.8)):
        pose = Pose.planar(x, y, 0.3)
        builder.fuse(Scan(0.0, seen_from(walls, pose)), pose)
    true = Pose.planar(6.4, 4.5, 1.9)
    match = match_anywhere(builder.build(), seen_from(walls, true))
    assert match is not None and match.pose.is_close(true, metres=0.1, radians=math.radians(2.0))


def test_thinned_points_keep_their_weight_and_their_cells() -> None:
    rng = np.random.default_rng(0)
    lattice = Lattice.named("A2", 0.5)
    points = rng.uniform(-2, 2, (500, 2))
    kept, weights = thin(points, lattice)
    assert weights.sum() == 500 and len(kept) == len(VoxelList.from_points(points, lattice))
    np.testing.assert_allclose((kept * weights[:, None]).sum(axis=0), points.sum(axis=0), atol=1e-9)
    heavy = np.repeat(points[:3], 2000, axis=0)
    cells = VoxelList.from_points(points[:3], lattice)
    match = GlobalMatcher(OccupancyPyramid(cells)).match(heavy, refine=False)
    assert match is not None and match.score >= 2000 and match.gap == 0


def test_windows_of_the_tables_cover_what_a_point_may_touch() -> None:
    for case in EVERY:
        for level in range(5):
            windows = level_windows(case.lattice, level)
            assert windows[0] >= 1 << level and list(windows) == sorted(windows)


def test_nothing_to_find_is_no_match() -> None:
    lattice = Lattice.named("A2", 0.1)
    empty = GlobalMatcher(OccupancyPyramid(VoxelList.empty(lattice)))
    assert empty.match([[1.0, 0.0]]) is None
    one = GlobalMatcher(OccupancyPyramid(VoxelList.from_points([[5.0, 5.0]], lattice)))
    assert one.match(np.empty((0, 2))) is None
    assert one.match([[1.0, 0.0]], SearchRegion([50, 50], [60, 60])) is None


def test_wrong_input_is_named() -> None:
    matcher = GlobalMatcher(OccupancyPyramid(VoxelList.from_points([[0.0, 0.0]], Lattice.named("A2", 0.1))))
    with pytest.raises(ArgumentError, match="dimension 2"):
        matcher.match(np.zeros((4, 3)))
    with pytest.raises(BoundsError):
        matcher.match([[math.nan, 0.0]])
    with pytest.raises(ArgumentError, match="angles"):
        matcher.match([[0.0, 0.0]], angles="all")
    with pytest.raises(ArgumentError, match="tilted"):
        matcher.match([[0.0, 0.0]], SearchRegion(tilt=0.1))
    with pytest.raises(ArgumentError, match="corners"):
        SearchRegion([1.0, 0.0], [0.0, 1.0])
    with pytest.raises(ArgumentError):
        SearchRegion([1.0, 0.0])
    with pytest.raises(ArgumentError, match="weight"):
        OccupancyPyramid(VoxelList.from_cells([[0, 0]], Lattice.named("A2", 0.1), [70_000]))
