"""The covariance of a match: what it says of corridors and rooms, and its kernels, on every lattice."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose, wrap_angle
from hexmap.poses.rotations import exponential
from hexmap.simulator.buildings import make_building
from hexmap.simulator.events import OdometryNoise, simulate
from hexmap.simulator.laser import Laser
from localisation.matching import _pose_kernels as kernels
from localisation.matching.global_matcher import GlobalMatcher, thin
from localisation.matching.information import score_covariance
from localisation.matching.pyramid import OccupancyPyramid
from localisation.matching.score import coincidence
from localisation.matching.search_region import SearchRegion
from tests.lattices import CASES, JIT, PLANAR, SHEARED, SPATIAL, Case

EVERY = [*CASES, *SHEARED]


def scaled(case: Case, resolution: float) -> Lattice:
    return case.lattice.scaled(resolution / case.lattice.resolution)


def box_walls(half: NDArray, open_axis: int | None, spacing: float) -> NDArray:
    """Points on the walls of a box about the origin, without those across ``open_axis``: a room, or a corridor."""
    n = len(half)
    grids = [np.arange(-h, h + 0.5 * spacing, spacing) for h in half]
    walls = []
    for axis in range(n):
        if axis != open_axis:
            for side in (-half[axis], half[axis]):
                parts = [np.array([side]) if a == axis else grids[a] for a in range(n)]
                walls.append(np.stack(np.meshgrid(*parts, indexing="ij"), axis=-1).reshape(-1, n))
    return np.concatenate(walls)


def covariance_in(walls: NDArray, seen: float, lattice: Lattice, turn: NDArray, count: int, **how: bool) -> NDArray:
    """The covariance of the pose at the origin, which sees ``count`` points of the walls up to ``seen`` metres away."""
    rng = np.random.default_rng(0)
    inside = walls[np.linalg.norm(walls, axis=1) <= seen]
    scan = inside[rng.choice(len(inside), min(count, len(inside)), replace=False)]
    pyramid = OccupancyPyramid(coincidence(VoxelList.from_points(walls @ turn.T, lattice)))
    kept, weights = thin(scan, lattice)
    return score_covariance(pyramid, kept, weights, Pose(turn, np.zeros(len(turn))), **how)


@pytest.mark.parametrize("case", PLANAR, ids=str)
@pytest.mark.parametrize("degrees", [0.0, 5.0, 17.0, 30.0, 45.0, 80.0] if JIT else [17.0])
def test_it_is_long_along_a_corridor_and_short_across(case: Case, degrees: float) -> None:
    turn = Pose.planar(0.0, 0.0, math.radians(degrees)).rotation
    walls = box_walls(np.array([20.0, 1.2]), 0, 0.01)
    C = covariance_in(walls, 6.0, scaled(case, 0.05), turn, 180 if JIT else 30)
    size, axes = np.linalg.eigh(C[:2, :2])
    assert math.sqrt(size[1]) > 0.5 and math.sqrt(size[0]) < 0.05  # metres
    assert abs(axes[:, 1] @ turn[:, 0]) > math.cos(math.radians(5.0))
    assert math.degrees(math.sqrt(C[2, 2])) < 1.0


@pytest.mark.parametrize("case", PLANAR, ids=str)
def test_it_is_short_both_ways_in_a_room(case: Case) -> None:
    walls = box_walls(np.array([3.0, 2.0]), None, 0.01)
    C = covariance_in(walls, 9.0, scaled(case, 0.05), np.eye(2), 180 if JIT else 30)
    size = np.sqrt(np.linalg.eigvalsh(C[:2, :2]))
    assert size[1] < 0.05 and size[1] < 4.0 * size[0]


# The surface is looked at cell by cell: a tunnel askew to the lattice, as all are to skew3, is not found to be long.
@pytest.mark.parametrize("case", [case for case in SPATIAL if case.label != "skew3"], ids=str)
def test_in_space_it_is_long_along_a_tunnel_of_the_lattice_and_short_across(case: Case) -> None:
    if not JIT:
        pytest.skip("too slow without the compiler")
    turn = np.eye(3)
    walls = box_walls(np.array([15.0, 2.0, 1.5]), 0, 0.1)
    C = covariance_in(walls, 6.0, scaled(case, 0.25), turn, 150)
    size, axes = np.linalg.eigh(C[:3, :3])
    assert math.sqrt(size[2]) > 2.0 * 0.25 and math.sqrt(size[1]) < 0.25
    assert abs(axes[:, 2] @ turn[:, 0]) > math.cos(math.radians(15.0))


@pytest.mark.parametrize("case", EVERY, ids=str)
def test_it_is_symmetric_and_positive_definite(case: Case) -> None:
    n = case.dim
    lattice = scaled(case, 0.1 if n == 2 else 0.3)
    rng = np.random.default_rng(n)
    scan = rng.uniform(-2.0, 2.0, (40 if JIT else 6, n))
    pose = Pose.planar(0.3, -0.2, 0.7) if n == 2 else Pose(exponential(np.array([0.2, 0.3, -0.4])), [0.3, -0.2, 0.1])
    kept, weights = thin(scan, lattice)
    size = 3 if n == 2 else 6
    # A map that fits, one that the scan misses altogether, and one of a single cell.
    maps = [pose.apply(scan), pose.apply(scan) + 50.0, np.zeros((1, n))] if n == 2 or JIT else [pose.apply(scan)]
    for points in maps:
        pyramid = OccupancyPyramid(coincidence(VoxelList.from_points(points, lattice)))
        C = score_covariance(pyramid, kept, weights, pose)
        assert C.shape == (size, size) and np.isfinite(C).all()
        np.testing.assert_array_equal(C, C.T)
        assert np.linalg.eigvalsh(C).min() > 0.0
        np.testing.assert_allclose(np.linalg.inv(C) @ C, np.eye(size), atol=1e-6)


@pytest.mark.parametrize("case", PLANAR, ids=str)
def test_a_pose_that_was_not_refined_is_less_sure_by_what_refining_takes_away(case: Case) -> None:
    walls = box_walls(np.array([3.0, 2.0]), None, 0.02)
    lattice = scaled(case, 0.05)
    count = 60 if JIT else 10
    refined, searched = (covariance_in(walls, 9.0, lattice, np.eye(2), count, refined=r) for r in (True, False))
    more = searched - refined
    assert more[0, 0] == pytest.approx(more[1, 1]) and 0.0 < more[0, 0] < lattice.cell.second_moment * 0.05**2
    np.testing.assert_allclose(more, np.diag(np.diag(more)), atol=1e-15)


@pytest.mark.parametrize("case", EVERY, ids=str)
def test_the_surface_is_equal_to_looking_every_cell_up(case: Case) -> None:
    n = case.dim
    rng = np.random.default_rng([n, 3])
    index = np.unique(rng.integers(-6, 7, (60, n)), axis=0)
    cells = VoxelList.from_cells(index, case.lattice, rng.integers(1, 1001, len(index)))
    tables = OccupancyPyramid(cells, 2).tables(0)
    known = {tuple(c): int(w) for c, w in zip(cells.index.tolist(), cells.counts.tolist(), strict=True)}
    # Points and shifts reach far beyond the map, and beyond all addresses of its tables.
    at = rng.integers(-9, 10, (4, 12, n))
    at[0, 0] = 100_000
    at[1, 1] = -100_000
    weights = rng.integers(1, 50, 12)
    shifts = np.concatenate([rng.integers(-4, 5, (20, n)), np.full((1, n), 1_000), np.zeros((1, n), np.int64)])
    out = np.empty((len(at), len(shifts)), np.int64)
    kernels.surface(tables, at, weights, shifts, out)
    slow = [
        [
            sum(int(w) * known.get(tuple((p + s).tolist()), 0) for p, w in zip(turn, weights, strict=True))
            for s in shifts
        ]
        for turn in at
    ]
    assert out.tolist() == slow
    assert out.any()
    flat = at.reshape(-1, n)
    found = np.empty(len(flat), np.int64)
    kernels.weights_of(tables, flat, found)
    assert found.tolist() == [known.get(tuple(c), 0) for c in flat.tolist()]


@pytest.mark.parametrize("case", EVERY, ids=str)
@pytest.mark.parametrize("table", [0, 2, 4])
def test_the_widened_surface_takes_the_largest_weight_of_the_box_around_each_cell(case: Case, table: int) -> None:
    n = case.dim
    rng = np.random.default_rng([n, table])
    index = np.unique(rng.integers(-5, 6, (25, n)), axis=0)
    cells = VoxelList.from_cells(index, case.lattice, rng.integers(1, 256, len(index)))
    tables = OccupancyPyramid(cells, 2).tables(0)
    window = int(tables.windows.ravel()[table])
    back = (window - 1) // 2
    at = rng.integers(-8, 9, (3, 5, n))
    at[0, 0] = 100_000
    weights = rng.integers(1, 50, 5)
    shifts = np.concatenate([rng.integers(-4, 5, (8, n)), np.zeros((1, n), np.int64)])
    out = np.empty((len(at), len(shifts)), np.int64)
    kernels.widened_surface(tables, table, back, at, weights, shifts, out)

    def largest(cell: NDArray) -> int:
        off = cells.index - (cell - back)
        inside = ((off >= 0) & (off < window)).all(axis=1)
        return int(np.where(inside, cells.counts, 0).max())

    slow = [[sum(int(w) * largest(p + s) for p, w in zip(turn, weights, strict=True)) for s in shifts] for turn in at]
    assert out.tolist() == slow
    assert out.any()


@pytest.mark.skipif(not JIT, reason="too slow without the compiler")
@pytest.mark.parametrize("name", ["Z2", "A2"])
def test_errors_in_a_simulated_building_are_as_large_as_it_says(name: str) -> None:
    """The error, squared and normalised, is about 3, its degrees of freedom (the full figure is a benchmark)."""
    building = make_building("room")
    laser = Laser(beams=180, rate=2.0)
    builder = MapBuilder(Lattice.named(name, 0.05), levels=1)
    for e in simulate(building, laser, OdometryNoise(rate=0.0), seed=1):
        builder.fuse(e.event, e.T_map_robot)
    matcher = GlobalMatcher.of_map(builder.build())
    errors = []
    for e in list(simulate(building, laser, OdometryNoise(rate=0.0), seed=2, speed=0.37))[5::4]:
        true = e.T_map_robot
        region = SearchRegion(true.translation - 0.4, true.translation + 0.4, yaw=true.theta + 0.03, yaw_range=0.3)
        match = matcher.match(e.event.points, region, runner_up=None, beams=False)
        assert match is not None and match.information is not None
        off = np.array([*(match.pose.translation - true.translation), wrap_angle(match.pose.theta - true.theta)])
        errors.append(off @ match.information @ off)
    assert len(errors) > 25
    assert 1.0 < np.mean(errors) < 6.0
    assert 0.8 < np.mean(np.array(errors) < 7.81) <= 1.0  # the 95 % ellipse
