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
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from localisation.matching.local_matcher import LocalMatcher
from localisation.matching.occupancy import Occupancy
from localisation.matching.search_region import SearchWindow, shifts_in_ball
from tests.lattices import CASES, EXAMPLES, Case


def room(dim: int, count: int, seed: int) -> np.ndarray:
    """Points on the walls of a room with a corner cut off, off centre, so that no symmetry hides a mistake."""
    rng = np.random.default_rng(seed)
    p = rng.uniform(-2.0, 3.0, (count, dim))
    wall = rng.integers(0, 2 * dim, count)
    p[np.arange(count), wall % dim] = np.where(wall < dim, -2.0, 3.0)
    inside = p.sum(axis=1) < 3.5 + dim
    return p[inside]


def brute_force(points, predicted, occupied, window, matcher):
    """Score every angle and shift by the definition: distinct quantised points that are occupied cells."""
    lattice = occupied.lattice
    best = None
    cells = set(map(tuple, occupied.index.tolist()))
    shifts = shifts_in_ball(lattice, window.metres)
    farthest = np.sqrt((points**2).sum(axis=1).max())
    for r, turn in enumerate(matcher.rotations(points, lattice, window.radians)):
        rotation = turn @ predicted.rotation
        index = lattice.quantise(points @ rotation.T + predicted.translation)
        distinct = set(map(tuple, index.tolist()))
        trace = np.trace(turn)
        angle = math.acos(min(1.0, max(-1.0, trace / 2 if lattice.dim == 2 else (trace - 1) / 2)))
        for shift in shifts:
            score = sum(tuple(np.add(c, shift)) in cells for c in distinct)
            cost = float((lattice.centres(shift[None]) ** 2).sum()) + (angle * farthest) ** 2
            if best is None or score > best[0] or (score == best[0] and cost < best[1] - 1e-9):
                best = (score, cost, r, tuple(int(s) for s in shift))
    return best


@pytest.mark.parametrize("case", CASES, ids=str)
@pytest.mark.parametrize("seed", range(3))
def test_the_best_pose_of_the_window_is_never_lost(case: Case, seed: int) -> None:
    lattice = case.lattice.scaled(0.5 / case.lattice.resolution)
    rng = np.random.default_rng(seed)
    walls = room(lattice.dim, 120, seed)
    occupied = VoxelList.from_points(walls, lattice)
    scan = room(lattice.dim, 25, seed + 50) + rng.normal(0, 0.1, lattice.dim)
    predicted = Pose.identity(lattice.dim)
    window = SearchWindow(0.9 if lattice.dim == 3 else 1.6, 0.12 if lattice.dim == 3 else 0.35)
    matcher = LocalMatcher(window, refine=False)
    match = matcher.match(scan, predicted, Occupancy.of_list(occupied))
    score, cost, _, _ = brute_force(scan, predicted, occupied, window, matcher)
    assert match is not None and match.score == score
    found = predicted.inverse() @ match.pose
    farthest = np.sqrt((scan**2).sum(axis=1).max())
    assert (found.translation**2).sum() + (found.angle * farthest) ** 2 == pytest.approx(cost, abs=1e-6)
    assert match.candidates == len(matcher.rotations(scan, lattice, window.radians)) * len(
        shifts_in_ball(lattice, window.metres)
    )


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
