"""The scan matcher: the best pose of the window, on every lattice, and below a cell."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hexmap.base.errors import ArgumentError, BoundsError
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.maps.map import Map
from hexmap.maps.state_rule import StateRule
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import exponential
from hexmap.poses.scan import Scan
from localisation.matching.local_matcher import LocalMatcher
from localisation.matching.occupancy import Occupancy
from localisation.matching.refinement import REFINE_STEPS, refine_on
from localisation.matching.search_region import SearchWindow, shifts_in_ball
from tests.lattices import CASES, EXAMPLES, PART, PLANAR, SHEARED, Case

# The hash of a tile wraps around on purpose; numpy warns of it where the JIT is off.
pytestmark = pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")


def room(dim: int, count: int, seed: int) -> np.ndarray:
    """Points on the walls of a room with a corner cut off, off centre, so that no symmetry hides a mistake."""
    rng = np.random.default_rng(seed)
    p = rng.uniform(-2.0, 3.0, (count, dim))
    wall = rng.integers(0, 2 * dim, count)
    p[np.arange(count), wall % dim] = np.where(wall < dim, -2.0, 3.0)
    inside = p.sum(axis=1) < 3.5 + dim
    return p[inside]


def brute_force(points, predicted, occupied, window, matcher):
    """Score every angle and shift by the definition: distinct quantised points that are occupied cells.

    Equal scores: the least squared shift plus squared way of the farthest point, to a billionth of it, which no two
    different sums here come near; then the lower rotation, then the lower shift.
    """
    lattice = occupied.lattice
    found = []
    shifts = shifts_in_ball(lattice, window.metres)
    squared = (lattice.centres(shifts) ** 2).sum(axis=1)
    farthest = np.sqrt((points**2).sum(axis=1).max())
    for r, turn in enumerate(matcher.rotations(points, lattice, window.radians)):
        rotation = turn @ predicted.rotation
        distinct = np.unique(lattice.quantise(points @ rotation.T + predicted.translation), axis=0).astype(np.int64)
        moved = (distinct[None] + shifts[:, None]).reshape(-1, lattice.dim)
        scores = occupied.contains(moved).reshape(len(shifts), -1).sum(axis=1)
        trace = np.trace(turn)
        angle = math.acos(min(1.0, max(-1.0, trace / 2 if lattice.dim == 2 else (trace - 1) / 2)))
        for k in np.flatnonzero(scores == scores.max()):
            cost = float(squared[k]) + (angle * farthest) ** 2
            found.append((int(scores[k]), cost, r, tuple(shifts[k].tolist()), len(distinct)))
    score = max(f[0] for f in found)
    cost = min(f[1] for f in found if f[0] == score)
    return min((f for f in found if f[0] == score and f[1] <= cost * (1 + 1e-7) + 1e-12), key=lambda f: f[2:])


def check_best(scan, predicted, occupied, occupancy, matcher):
    """Hold a match against the brute force; returns it."""
    lattice = occupied.lattice
    window = matcher.window
    score, _, r, shift, cells = brute_force(scan, predicted, occupied, window, matcher)
    match = matcher.match(scan, predicted, occupancy)
    if score == 0:
        assert match is None
        return None
    assert match is not None and (match.score, match.total, match.bound) == (score, cells, score)
    turns = matcher.rotations(scan, lattice, window.radians)
    np.testing.assert_allclose(match.searched.rotation, turns[r] @ predicted.rotation, atol=1e-12)
    moved = match.searched.translation - predicted.translation
    np.testing.assert_allclose(moved, lattice.centres(np.array([shift]))[0], atol=1e-9)
    assert match.candidates == len(turns) * len(shifts_in_ball(lattice, window.metres))
    return match


@pytest.mark.parametrize("case", [*CASES, *SHEARED], ids=str)
@pytest.mark.parametrize("seed", range(3))
def test_the_best_pose_of_the_window_is_never_lost(case: Case, seed: int) -> None:
    lattice = case.lattice.scaled(0.5 / case.lattice.resolution)
    rng = np.random.default_rng(seed)
    occupied = VoxelList.from_points(room(lattice.dim, 120, seed), lattice)
    scan = room(lattice.dim, 25, seed + 50) + rng.normal(0, 0.1, lattice.dim)
    window = SearchWindow(0.9 if lattice.dim == 3 else 1.6, 0.12 if lattice.dim == 3 else 0.35)
    check_best(
        scan, Pose.identity(lattice.dim), occupied, Occupancy.of_list(occupied), LocalMatcher(window, refine=False)
    )


@pytest.mark.parametrize("case", PLANAR, ids=str)
@pytest.mark.parametrize(("metres", "points"), [(0.5, 400), (2.0, 400), (4.5, 60)])
def test_whole_scans_in_wide_windows(case: Case, metres: float, points: int) -> None:
    """Hundreds of cells and shifts of several words; far from the origin, on both sides of it."""
    lattice = case.lattice
    rng = np.random.default_rng(7)
    walls = room(2, 2500, 5)
    scan = room(2, round(points * PART), 6)
    for far in ([0.0, 0.0], [-3.0e4, 7.0e3]):
        at = np.array(far)
        occupied = VoxelList.from_points(walls + at, lattice)
        predicted = Pose.planar(*(at + rng.normal(0, 0.2, 2)), 0.05)
        matcher = LocalMatcher(SearchWindow(metres, 0.1), refine=False)
        occupancy = Occupancy.of_list(occupied)
        match = check_best(scan, predicted, occupied, occupancy, matcher)
        # A floor below the best changes nothing; at the best there is nothing above.
        same = matcher.match(scan, predicted, occupancy, above=match.score - 1)
        assert same is not None and (same.score, same.searched) == (match.score, match.searched)
        assert matcher.match(scan, predicted, occupancy, above=match.score) is None


@pytest.mark.parametrize("case", [*CASES, *SHEARED], ids=str)
def test_of_equal_scores_the_nearest_then_the_lowest(case: Case) -> None:
    """A single point, and occupied cells all around it: shifts of equal lengths, which rounding must not tell apart."""
    lattice = case.lattice
    n = lattice.dim
    scan = np.full((1, n), 1e-9)
    radius = 3.5 * float(np.linalg.norm(lattice.basis @ lattice.nearest[0]))
    shifts = shifts_in_ball(lattice, radius)
    rng = np.random.default_rng(0)
    matcher = LocalMatcher(SearchWindow(radius, 0.0), refine=False)
    for _ in range(round(60 * PART)):
        # The images of a few cells under the lattice's symmetries: many shifts of one length.
        some = shifts[rng.integers(0, len(shifts), 2)]
        some = some[(some != 0).any(axis=1)]
        if not len(some):
            continue
        images = (lattice.point_group @ some.T).transpose(0, 2, 1).reshape(-1, n)
        occupied = VoxelList.from_cells(np.unique(images, axis=0), lattice)
        check_best(scan, Pose.identity(n), occupied, Occupancy.of_list(occupied), matcher)


def test_the_lower_of_two_shifts_to_either_side_wins() -> None:
    lattice = Lattice.named("Z2", 0.1)
    cells = Occupancy.of_list(VoxelList.from_cells([[-1, 0], [1, 0]], lattice))
    match = LocalMatcher(SearchWindow(0.5, 0.0), refine=False).match([[0.0, 0.0]], Pose.identity(2), cells)
    assert match is not None and match.pose.translation.tolist() == [-0.1, 0.0]


def test_the_lower_of_two_turns_to_either_side_wins() -> None:
    lattice = Lattice.named("Z2", 0.1)
    scan = np.array([[1.0, 0.0]])
    cells = Occupancy.of_list(VoxelList.from_cells([[10, 2], [10, -2]], lattice))
    match = LocalMatcher(SearchWindow(0.0, 0.3), refine=False).match(scan, Pose.identity(2), cells)
    assert match is not None and match.pose.theta < 0.0


@pytest.mark.parametrize("case", [*CASES, *SHEARED], ids=str)
def test_cells_change_in_place_wherever_they_are(case: Case) -> None:
    """Against a set: cells that come and go, near and far, on both sides of zero."""
    rng = np.random.default_rng(3)
    top = case.lattice.limit - 1
    places = np.array([[0] * case.dim, [top] * case.dim, [-top] * case.dim, [-top // 3] + [7] * (case.dim - 1)])
    occupancy = Occupancy(case.lattice)
    expected: set = set()
    seen: set = set()
    for _ in range(round(60 * PART)):
        place = places[rng.integers(len(places))] + rng.integers(-300, 300, case.dim) * rng.integers(0, 2)
        index = np.clip(place + rng.integers(-12, 12, (25, case.dim)), -top, top)
        states = rng.random(25) < 0.6
        occupancy.change(index, states)
        for cell, state in zip(map(tuple, index.tolist()), states, strict=True):
            (expected.add if state else expected.discard)(cell)
            seen.add(cell)
    cells = np.array(sorted(seen))
    assert occupancy.contains(cells).tolist() == [tuple(c) in expected for c in cells.tolist()]
    around = (cells[:, None] + np.array([[-1] * case.dim, [1] * case.dim])).reshape(-1, case.dim)
    assert occupancy.contains(around).tolist() == [tuple(c) in expected for c in around.tolist()]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_growing_map_has_the_occupied_cells_of_the_finished_one(case: Case) -> None:
    """Also where cells stop being occupied because later beams pass through them."""
    builder = MapBuilder(case.lattice, levels=2)
    rule = StateRule(min_hits=2, min_ratio=0.4)
    rng = np.random.default_rng(5)
    early = [Occupancy.of_counter(builder.counter(level), rule) for level in (0, 1)]
    gone = 0
    before: set = set()
    for k in range(round(8 * PART) + 2):
        walls = room(case.dim, 60, 1) * (1.0 if k < 3 else 1.5)
        pose = Pose(np.eye(case.dim), rng.normal(0.0, 0.02, case.dim))
        builder.fuse(Scan(0.0, walls), pose)
        done = builder.build()
        for level, occupancy in enumerate(early):
            hits = done.levels[level].hits
            occupied = done.state(rule, level).occupied
            assert occupancy.contains(hits.index).tolist() == occupied.contains(hits.index).tolist()
        now = set(map(tuple, done.state(rule, 0).occupied.index.tolist()))
        gone += len(before - now)
        before = now
    assert gone > 0
    late = Occupancy.of_counter(builder.counter(0), rule)
    hits = done.levels[0].hits.index
    assert late.contains(hits).tolist() == early[0].contains(hits).tolist()


def slow_refinement(points, pose, cells, widths, steps, tolerance):
    """Expectation maximisation by whole matrices: every point and every cell."""
    lattice = cells.lattice
    n = lattice.dim
    centres = cells.centres()
    for sigma in widths:
        for _ in range(steps):
            at = pose.apply(points)
            d = centres[None] - at[:, None]
            squared = (d**2).sum(axis=2)
            w = np.where(squared <= (2.5 * sigma) ** 2, np.exp(-0.5 * squared / sigma**2), 0.0)
            A = np.zeros((3, 3) if n == 2 else (6, 6))
            g = np.zeros(len(A))
            for p, r in enumerate(at - pose.translation):
                turn = [[-r[1]], [r[0]]] if n == 2 else [[0, r[2], -r[1]], [-r[2], 0, r[0]], [r[1], -r[0], 0]]
                J = np.hstack([np.eye(n), turn])
                A += w[p].sum() * J.T @ J
                g += J.T @ (w[p][:, None] * d[p]).sum(axis=0)
            step = np.linalg.solve(A + 1e-6 * np.trace(A) * np.eye(len(A)), g)
            R = exponential(step[n:]) if n == 3 else Pose.planar(0, 0, step[2]).rotation
            pose = Pose(R @ pose.rotation, pose.translation + step[:n])
            if np.abs(step).max() < tolerance:
                break
    return pose, A / sigma**2


@pytest.mark.parametrize("case", CASES, ids=str)
@pytest.mark.parametrize("factor", [1.0, 2.0, 5.0])
def test_the_refinement_is_expectation_maximisation(case: Case, factor: float) -> None:
    lattice = case.lattice
    walls = room(case.dim, 3000, 4)
    cells = VoxelList.from_points(walls, lattice)
    points = room(case.dim, round(80 * PART), 9)
    start = Pose(np.eye(case.dim), np.full(case.dim, 0.03))
    searched = lattice.scaled(factor)
    found = refine_on(Occupancy.of_list(cells), points, start, searched=searched)
    widths = [0.5 * lattice.resolution] if factor == 1.0 else [0.5 * searched.resolution, 0.5 * lattice.resolution]
    pose, information = slow_refinement(points, start, cells, widths, REFINE_STEPS, 0.002 * lattice.resolution)
    assert found.converged and found.pose.is_close(pose, metres=1e-5, radians=1e-5)
    np.testing.assert_allclose(found.information, information, rtol=2e-3, atol=1e-3 * np.abs(information).max())


@given(x=st.floats(-0.3, 0.3), y=st.floats(-0.3, 0.3), theta=st.floats(-0.3, 0.3), name=st.sampled_from(["Z2", "A2"]))
@settings(max_examples=EXAMPLES // 2, deadline=None)
def test_a_scan_is_found_below_a_cell(x: float, y: float, theta: float, name: str) -> None:
    lattice = Lattice.named(name, 0.05)
    walls = room(2, 4000, 1)
    truth = Pose.planar(x, y, theta)
    scan = truth.inverse().apply(walls[::10])
    match = LocalMatcher().match(scan, Pose.identity(2), Occupancy.of_list(VoxelList.from_points(walls, lattice)))
    assert match is not None and match.pose.is_close(truth, metres=0.02, radians=0.01)
    assert match.fraction > 0.35


@pytest.mark.parametrize("name", ["Z3", "D3", "D3*", "A2xZ"])
def test_a_scan_is_found_in_space(name: str) -> None:
    lattice = Lattice.named(name, 0.2)
    walls = room(3, 20_000, 2)
    half = math.radians(2.0)
    truth = Pose.from_quaternion([0.23, -0.17, 0.11], [0.0, math.sin(half), 0.0, math.cos(half)])
    scan = truth.inverse().apply(walls[::40])
    match = LocalMatcher(SearchWindow(0.5, 0.15)).match(
        scan, Pose.identity(3), Occupancy.of_list(VoxelList.from_points(walls, lattice))
    )
    assert match is not None and match.pose.is_close(truth, metres=0.1, radians=0.03)  # half a cell


@pytest.mark.parametrize("name", ["Z2", "A2"])
def test_a_pose_refined_far_beyond_the_search_falls_back_to_the_searched_one(name: str) -> None:
    """A scan of one short wall 50 m away: turning by a hundredth of a radian to fit it moves the robot by metres."""
    lattice = Lattice.named(name, 0.1)
    along = np.linspace(-2.0, 2.0, 400)
    wall = np.stack([along, np.full(400, 50.0)], axis=1)
    window = SearchWindow(0.2, 0.004)
    for slant in (0.0005, 0.05):  # how much the wall of the map is turned about its middle
        turned = np.stack([along, 50.0 + slant * along + 0.02], axis=1)
        world = Occupancy.of_list(VoxelList.from_points(turned, lattice))
        searched = LocalMatcher(window, refine=False).match(wall, Pose.identity(2), world)
        refined = LocalMatcher(window).match(wall, Pose.identity(2), world)
        assert searched is not None and refined is not None
        moved = float(np.linalg.norm(refined.pose.translation - searched.pose.translation))
        if slant == 0.05:
            assert refined.pose == searched.pose
        else:
            assert 0.0 < moved <= 2.0 * lattice.resolution


def test_equal_scores_go_to_the_pose_nearest_to_the_prediction() -> None:
    lattice = Lattice.named("Z2", 0.1)
    corridor = np.stack([np.arange(-50, 51) * 0.1, np.full(101, 1.0)], axis=1)
    match = LocalMatcher(SearchWindow(0.5, 0.0), refine=False).match(
        corridor[40:60], Pose.identity(2), Occupancy.of_list(VoxelList.from_points(corridor, lattice))
    )
    assert match is not None and match.pose == Pose.identity(2)


def test_a_map_that_grows_and_the_finished_map_match_alike() -> None:
    lattice = Lattice.named("A2", 0.1)
    builder = MapBuilder(lattice, levels=2)
    walls = room(2, 1500, 3)
    builder.fuse(Scan(0.0, walls), Pose.identity(2))
    world: Map = builder.build()
    scan = Pose.planar(0.1, 0.05, 0.06).inverse().apply(walls[::7])
    for level in (0, 1):
        grows = LocalMatcher().match(scan, Pose.identity(2), Occupancy.of_counter(builder.counter(level)))
        done = LocalMatcher().match(scan, Pose.identity(2), Occupancy.of_map(world, level=level))
        assert grows is not None and done is not None
        assert grows.score == done.score and grows.pose == done.pose


def test_the_angular_step_moves_the_farthest_point_by_one_cell() -> None:
    lattice = Lattice.named("A2", 0.1)
    points = np.array([[1.0, 0.0], [0.0, 8.0]])
    step = LocalMatcher().angular_step(points, lattice)
    assert 2 * 8.0 * math.sin(step / 2) == pytest.approx(0.1)


def test_nothing_in_reach_is_no_match() -> None:
    lattice = Lattice.named("A2", 0.1)
    far = Occupancy.of_list(VoxelList.from_points([[50.0, 50.0]], lattice))
    empty = Occupancy.of_list(VoxelList.empty(lattice))
    matcher = LocalMatcher()
    assert matcher.match([[1.0, 0.0]], Pose.identity(2), far) is None
    assert matcher.match([[1.0, 0.0]], Pose.identity(2), empty) is None
    assert matcher.match(np.empty((0, 2)), Pose.identity(2), far) is None


def test_wrong_input_is_named() -> None:
    world = Occupancy.of_list(VoxelList.from_points([[0.0, 0.0]], Lattice.named("A2", 0.1)))
    matcher = LocalMatcher()
    with pytest.raises(ArgumentError):
        matcher.match(np.zeros((4, 3)), Pose.identity(2), world)
    with pytest.raises(ArgumentError):
        matcher.match(np.zeros((4, 2)), Pose.identity(3), world)
    with pytest.raises(BoundsError):
        matcher.match(np.array([[np.nan, 0.0]]), Pose.identity(2), world)
    with pytest.raises(ArgumentError):
        SearchWindow(-1.0, 0.1)
