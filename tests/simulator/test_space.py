"""The simulator in space: rays against an obvious reference, drives clear of solids, sweeps that say what was there."""

import dataclasses
import math

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import euler_to_quaternions, quaternions_to_rotations
from hexmap.simulator.space import (
    Building3D,
    Drive3D,
    People,
    RingLidar,
    SolidList,
    cast_in_space,
    lidar_poses,
    make_building_3d,
    scan_stamps,
    simulate_lidar,
)

SEEDS = range(10)
STOREY = 3.6
PATH = [(0.0, 0.0, 0.0), (4.0, 0.0, 0.0)]
EXACT = RingLidar(rings=8, azimuths=90, rate=0.1, noise=0.0, resolution=0.0, missing=0.0, min_range=0.0)


def reference_range(building, origin, direction):
    """One ray, one face after the other: where it meets the plane of each face, is that within the face?"""
    hits = [math.inf]
    for centre, rotation, half in zip(building.box_centres, building.box_rotations, building.box_halves, strict=True):
        o, d = rotation.T @ (origin - centre), rotation.T @ direction
        if (np.abs(o) <= half).all():
            return 0.0
        for i in range(3):
            for side in (-half[i], half[i]):
                if d[i] != 0.0:
                    t = (side - o[i]) / d[i]
                    others = np.arange(3) != i
                    if t >= 0.0 and (np.abs(o + t * d)[others] <= half[others]).all():
                        hits.append(t)
    for x, y, radius, bottom, top in building.cylinders:
        o = origin - [x, y, 0.0]
        if np.hypot(o[0], o[1]) <= radius and bottom <= o[2] <= top:
            return 0.0
        for t in np.roots(
            [direction[0] ** 2 + direction[1] ** 2, 2 * (o[:2] @ direction[:2]), o[:2] @ o[:2] - radius**2]
        ):
            if np.isreal(t) and t.real >= 0.0 and bottom <= o[2] + t.real * direction[2] <= top:
                hits.append(t.real)
        for end in (bottom, top):
            if direction[2] != 0.0:
                t = (end - o[2]) / direction[2]
                if t >= 0.0 and np.hypot(*(o + t * direction)[:2]) <= radius:
                    hits.append(t)
    return min(hits)


def gaps(building, points):
    """Distance of each point (N, 3) from the nearest surface of a solid, and which solid that is."""
    every = []
    for centre, rotation, half in zip(building.box_centres, building.box_rotations, building.box_halves, strict=True):
        beyond = np.abs((points - centre) @ rotation) - half
        every.append(np.linalg.norm(np.maximum(beyond, 0.0), axis=1) - np.minimum(beyond.max(axis=1), 0.0))
    for x, y, radius, bottom, top in building.cylinders:
        out = np.hypot(points[:, 0] - x, points[:, 1] - y) - radius
        up = np.abs(points[:, 2] - 0.5 * (bottom + top)) - 0.5 * (top - bottom)
        outside = np.hypot(np.maximum(out, 0.0), np.maximum(up, 0.0))
        every.append(outside - np.minimum(np.maximum(out, up), 0.0))
    return np.min(every, axis=0)


def up(height):
    return np.array([0.0, 0.0, height])


def unit_vectors(rng, n):
    v = rng.standard_normal((n, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


def random_building(rng, boxes=25, cylinders=10):
    x, y, r = rng.uniform(-6, 6, cylinders), rng.uniform(-6, 6, cylinders), rng.uniform(0.1, 1.5, cylinders)
    bottom = rng.uniform(-6, 5, cylinders)
    return Building3D(
        "random",
        rng.uniform(-6, 6, (boxes, 3)),
        quaternions_to_rotations(euler_to_quaternions(rng.uniform(-3, 3, (boxes, 3)))),
        rng.uniform(0.1, 1.5, (boxes, 3)),
        np.column_stack([x, y, r, bottom, bottom + rng.uniform(0.1, 4, cylinders)]),
        np.full(boxes + cylinders, 0.5),
        PATH,
    )


def in_map(simulated, drive, lidar):
    """Put each point where it was, by the true pose at its own time."""
    positions, rotations = lidar_poses(drive, lidar, simulated.scan.stamp + simulated.scan.times)
    return np.einsum("nij,nj->ni", rotations, simulated.scan.points) + positions


# --- rays ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_rays_equal_the_reference(seed):
    rng = np.random.default_rng(seed)
    building = random_building(rng)
    origins, directions = rng.uniform(-6, 6, (100, 3)), unit_vectors(rng, 100)
    expected = [reference_range(building, o, d) for o, d in zip(origins, directions, strict=True)]
    assert 20 < np.isfinite(expected).sum() < 100
    ranges, hits = cast_in_space(building, origins, directions)
    np.testing.assert_allclose(ranges, expected, rtol=0, atol=1e-7)
    assert ((hits >= 0) == np.isfinite(ranges)).all()


def test_rays_along_the_axes_equal_the_reference():
    """Such rays run along the sides of the grid's cells and never cross the others."""
    rng = np.random.default_rng(5)
    building = random_building(rng)
    directions = np.concatenate([np.eye(3), -np.eye(3)])[rng.integers(6, size=120)]
    origins = np.round(rng.uniform(-9, 9, (120, 3)))
    expected = [reference_range(building, o, d) for o, d in zip(origins, directions, strict=True)]
    np.testing.assert_allclose(cast_in_space(building, origins, directions)[0], expected, rtol=0, atol=1e-7)


def test_rays_in_the_warehouse_equal_the_reference():
    building = make_building_3d("warehouse3d", seed=3)
    rng = np.random.default_rng(0)
    positions, _ = Drive3D(building.waypoints).poses(rng.uniform(0, 300, 40))
    origins, directions = positions + up(1.0), unit_vectors(rng, 40)
    expected = [reference_range(building, o, d) for o, d in zip(origins, directions, strict=True)]
    np.testing.assert_allclose(cast_in_space(building, origins, directions)[0], expected, rtol=0, atol=1e-7)


def test_a_ray_says_which_solid_it_hit_and_looks_no_farther_than_asked():
    solids = SolidList()
    solids.box((5.0, -1.0, -1.0), (6.0, 1.0, 1.0))
    solids.box((2.0, -1.0, -1.0), (3.0, 1.0, 1.0))
    solids.cylinder(-3.0, 0.0, 0.5, -1.0, 1.0)
    building = solids.building("row", PATH)
    rays = [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    ranges, hits = cast_in_space(building, np.zeros((3, 3)), rays)
    assert ranges.tolist() == [2.0, 2.5, math.inf] and hits.tolist() == [1, 2, -1]
    ranges, hits = cast_in_space(building, np.zeros((3, 3)), rays, max_range=2.2)
    assert ranges.tolist() == [2.0, math.inf, math.inf] and hits.tolist() == [1, -1, -1]
    assert cast_in_space(building, [[5.5, 0.0, 0.0]], [[0.0, 0.0, 1.0]])[0].tolist() == [0.0]


def test_rays_refuse_other_shapes_and_nan():
    building = random_building(np.random.default_rng(0))
    with pytest.raises(ArgumentError, match="as many directions"):
        cast_in_space(building, np.zeros((2, 3)), [[1.0, 0.0, 0.0]])
    with pytest.raises(ArgumentError, match="finite"):
        cast_in_space(building, [[math.nan, 0.0, 0.0]], [[1.0, 0.0, 0.0]])
    with pytest.raises(ArgumentError, match="unit vectors"):
        cast_in_space(building, [[0.0, 0.0, 0.0]], [[2.0, 0.0, 0.0]])


# --- buildings ----------------------------------------------------------------------------------------------------


def test_buildings_refuse_nonsense():
    with pytest.raises(ArgumentError, match="'moon'; known are warehouse3d"):
        make_building_3d("moon")
    with pytest.raises(ArgumentError, match="seed"):
        make_building_3d("warehouse3d", seed=-1)
    with pytest.raises(ArgumentError, match="floors"):
        make_building_3d("warehouse3d", floors=0)
    solids = SolidList()
    with pytest.raises(ArgumentError, match="at least one solid"):
        solids.building("empty", PATH)
    solids.box((0.0, 0.0, 0.0), (1.0, 1.0, 0.0))
    with pytest.raises(ArgumentError, match="volume"):
        solids.building("flat", PATH)
    good = make_building_3d("warehouse3d")
    with pytest.raises(ArgumentError, match="finite"):
        dataclasses.replace(good, box_centres=good.box_centres * math.nan)
    with pytest.raises(ArgumentError, match="rotations"):
        dataclasses.replace(good, box_rotations=2.0 * good.box_rotations)
    with pytest.raises(ValueError, match="read-only"):
        good.box_centres[0] = 0.0


def test_a_wall_has_the_openings_that_were_asked_for():
    solids = SolidList()
    solids.wall((0.0, 0.0), (8.0, 0.0), (0.0, 3.0), 0.2, [(5.0, 6.0, 0.0, 2.0), (1.0, 2.0, 1.0, 2.0)])
    building = solids.building("wall", PATH)
    x, z = np.meshgrid(np.arange(0.05, 8.0, 0.1), np.arange(0.05, 3.0, 0.1))
    origins = np.column_stack([x.ravel(), np.full(x.size, -2.0), z.ravel()])
    through = np.isinf(cast_in_space(building, origins, np.tile([0.0, 1.0, 0.0], (x.size, 1)))[0])
    window = (x > 1.0) & (x < 2.0) & (z > 1.0) & (z < 2.0)
    door = (x > 5.0) & (x < 6.0) & (z < 2.0)
    assert (through == (window | door).ravel()).all()


def test_floors_resemble_one_another_and_seeds_differ():
    def on_floor(building, floor):
        """Boxes within a storey, moved to the ground floor."""
        middle = building.box_centres - [0.0, 0.0, floor * STOREY]
        inside = (middle[:, 2] > 0.0) & (middle[:, 2] < STOREY - 0.3)
        return {tuple(np.round(row, 6)) for row in np.column_stack([middle, building.box_halves])[inside]}

    a, b = make_building_3d("warehouse3d", seed=1), make_building_3d("warehouse3d", seed=2)
    for building in (a, b):
        ground, first = on_floor(building, 0), on_floor(building, 1)
        shared = len(ground & first) / len(ground | first)
        assert 0.4 < shared < 0.95
    assert on_floor(a, 0) != on_floor(b, 0)
    again = make_building_3d("warehouse3d", seed=1)
    assert np.array_equal(a.box_centres, again.box_centres) and np.array_equal(a.cylinders, again.cylinders)


@pytest.mark.parametrize("floors", [1, 2, 4])
def test_the_path_visits_every_floor_and_ends_where_it_began(floors):
    building = make_building_3d("warehouse3d", floors=floors)
    path = building.waypoints
    assert set(path[:, 2].round(6)) == {round(STOREY * k, 6) for k in range(floors)}
    np.testing.assert_allclose(path[0], path[-1])


# --- drives -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", SEEDS)
def test_drives_keep_clear_of_solids_and_stay_on_the_ground(seed):
    building = make_building_3d("warehouse3d", seed=seed)
    drive = Drive3D(building.waypoints)
    positions, _ = drive.poses(np.arange(0.0, drive.duration, 0.25))
    for height in (0.5, 0.9, 1.3):
        assert gaps(building, positions + up(height)).min() > 0.45
    down, _ = cast_in_space(building, positions + up(1.0), np.tile([0.0, 0.0, -1.0], (len(positions), 1)))
    # Where the ground bends the middle of the robot is a little above or below it.
    assert np.abs(down - 1.0).max() < 0.03 and np.median(np.abs(down - 1.0)) < 1e-9


def test_drives_are_smooth_and_keep_their_limits():
    building = make_building_3d("warehouse3d")
    drive = Drive3D(building.waypoints, speed=1.0, turn_rate=0.7)
    dt = 0.01
    positions, rotations = drive.poses(np.arange(0.0, drive.duration, dt))
    steps = np.diff(positions, axis=0)
    assert np.hypot(steps[:, 0], steps[:, 1]).max() <= dt + 1e-9
    slope = STOREY / 16.0
    assert np.abs(steps[:, 2]).max() <= slope * dt + 1e-9
    # Nothing jumps: the second difference of the height is a slope over a wheelbase.
    assert np.abs(np.diff(steps[:, 2])).max() <= 1.5 * slope / 0.8 * dt**2
    turns = np.einsum("nji,njk->nik", rotations[:-1], rotations[1:])
    angles = np.arccos(np.clip((np.trace(turns, axis1=1, axis2=2) - 1.0) / 2.0, -1.0, 1.0))
    assert angles.max() < 0.8 * dt
    # Nor do the speed and the turn rate: each changes over most of a second.
    assert np.linalg.norm(np.diff(steps[:, :2], axis=0), axis=1).max() < 0.1 * dt
    assert np.linalg.norm(steps[0]) < 0.1 * dt and np.linalg.norm(steps[-1]) < 0.1 * dt
    # Up and down the ramps the robot pitches with them.
    rising = np.arcsin(rotations[:, 2, 0])
    assert rising.max() == pytest.approx(math.atan(slope), abs=0.02) == -rising.min()
    np.testing.assert_allclose(drive.poses([-5.0, drive.duration + 5.0])[0], building.waypoints[[0, -1]], atol=1e-9)


def test_drives_refuse_nonsense():
    with pytest.raises(ArgumentError, match="way point 1 of the drive is a corner beside a leg that rises"):
        Drive3D([(0, 0, 0), (4, 0, 0), (4, 4, 1)])
    with pytest.raises(ArgumentError, match="way point 1 of the drive is a corner beside a leg that rises"):
        Drive3D([(0, 0, 0), (4, 0, 1), (0, 0, 0)])
    with pytest.raises(ArgumentError, match="way points"):
        Drive3D([(0, 0), (1, 0)])
    with pytest.raises(ArgumentError, match="sway"):
        Drive3D(PATH, sway=1.0)
    with pytest.raises(ArgumentError, match="easing"):
        Drive3D(PATH, easing=-1.0)


# --- sweeps -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", SEEDS[:2])
def test_points_at_the_true_pose_of_their_own_time_lie_on_solids(seed):
    building = make_building_3d("warehouse3d", seed=seed)
    drive = Drive3D(building.waypoints, seed=seed)
    for simulated in simulate_lidar(building, drive, EXACT, seed):
        seen = in_map(simulated, drive, EXACT)
        assert gaps(building, seen).max() < 1e-7


def test_a_sweep_taken_for_an_instant_is_distorted():
    building = make_building_3d("warehouse3d")
    drive = Drive3D(building.waypoints)
    wrong = [gaps(building, s.T_map_lidar.apply(s.scan.points)).max() for s in simulate_lidar(building, drive, EXACT)]
    assert np.median(wrong) > 0.05
    at_once = dataclasses.replace(EXACT, sweep=0.0)
    for simulated in simulate_lidar(building, drive, at_once, duration=40.0):
        assert gaps(building, simulated.T_map_lidar.apply(simulated.scan.points)).max() < 1e-7


def test_what_is_seen_from_a_floor_is_on_it_except_through_the_opening():
    """Nothing is seen through a floor: a point of another storey is seen past the bay of the ramps."""
    building = make_building_3d("warehouse3d", seed=4)
    drive = Drive3D(building.waypoints)
    elsewhere = 0
    for simulated in simulate_lidar(building, drive, EXACT):
        if simulated.T_map_lidar.translation[1] < 2.6:
            continue
        floor = math.floor(simulated.T_map_lidar.translation[2] / STOREY)
        seen = in_map(simulated, drive, EXACT)
        other = (seen[:, 2] < floor * STOREY - 0.3 - 1e-6) | (seen[:, 2] > (floor + 1) * STOREY + 1e-6)
        elsewhere += other.sum()
        assert (seen[other, 1] < 2.8).all()
    assert elsewhere > 0


def test_times_rings_and_columns_say_when_a_point_was_measured():
    lidar = RingLidar(rings=4, azimuths=100, rate=10.0, missing=0.3)
    building = make_building_3d("warehouse3d")
    stamps = scan_stamps(Drive3D(building.waypoints), lidar, scans=3)
    np.testing.assert_allclose(stamps, [0.1, 0.2, 0.3])
    for simulated, stamp in zip(simulate_lidar(building, lidar=lidar, scans=3), stamps, strict=True):
        scan = simulated.scan
        assert scan.stamp == stamp and scan.times is not None
        assert scan.times.max() <= 0.0 and scan.times.min() > -0.1 and (np.diff(scan.times) >= 0.0).all()
        np.testing.assert_allclose(scan.times, lidar.column_times[simulated.columns])
        rays = lidar.directions[simulated.columns, simulated.rings]
        ranges = np.linalg.norm(scan.points, axis=1)
        np.testing.assert_allclose(scan.points, rays * ranges[:, None], atol=1e-9)
        assert len(scan.points) + len(scan.no_return) == 400
        np.testing.assert_allclose(np.linalg.norm(scan.no_return, axis=1), 1.0)


def test_a_sweep_is_clockwise_from_behind():
    rays = RingLidar(rings=3, azimuths=4, lowest=-0.2, highest=0.2).directions
    np.testing.assert_allclose(rays[:, 1], [[-1, 0, 0], [0, 1, 0], [1, 0, 0], [0, -1, 0]], atol=1e-12)
    assert (rays[:, 0, 2] < 0.0).all() and (rays[:, 2, 2] > 0.0).all()


def test_noise_missing_returns_and_limits_have_the_size_that_was_asked_for():
    building = make_building_3d("warehouse3d")
    drive = Drive3D(building.waypoints)
    lidar = RingLidar(rings=16, azimuths=256, noise=0.03, missing=0.2, resolution=0.0, max_range=15.0)
    clean = dataclasses.replace(lidar, noise=0.0, missing=0.0, min_range=0.0, max_range=200.0)
    errors, lost, rays = [], 0, 0
    for noisy, true in zip(
        simulate_lidar(building, drive, lidar, scans=20), simulate_lidar(building, drive, clean, scans=20), strict=True
    ):
        grid = np.full((256, 16), np.inf)
        grid[true.columns, true.rings] = np.linalg.norm(true.scan.points, axis=1)
        seen = np.linalg.norm(noisy.scan.points, axis=1)
        assert seen.max() <= 15.0 + 1e-9 and seen.min() >= 0.3
        errors.append(seen - grid[noisy.columns, noisy.rings])
        near = grid < 14.5
        rays += near.sum()
        lost += near.sum() - near[noisy.columns, noisy.rings].sum()
        assert np.isinf(grid).any()  # through a window or a door
    assert np.std(np.concatenate(errors)) == pytest.approx(0.03, rel=0.03)
    assert lost / rays == pytest.approx(0.2, abs=0.01)


def test_a_run_is_the_same_again_and_a_short_one_begins_like_a_long_one():
    building = make_building_3d("warehouse3d", seed=2)
    lidar = RingLidar(rings=4, azimuths=64)
    people = People(5)
    short = list(simulate_lidar(building, None, lidar, 2, people=people, scans=3))
    long = list(simulate_lidar(building, None, lidar, 2, people=people, duration=2.0))
    other = list(simulate_lidar(building, None, lidar, 3, people=people, scans=3))
    assert len(long) == 10
    for a, b, c in zip(short, long, other, strict=False):
        assert np.array_equal(a.scan.points, b.scan.points) and a.T_map_lidar == b.T_map_lidar
        assert np.array_equal(a.scan.intensity, b.scan.intensity)
        assert not np.array_equal(a.scan.points, c.scan.points)


def test_a_mounted_lidar_sees_from_where_it_sits():
    building = make_building_3d("warehouse3d")
    drive = Drive3D(building.waypoints)
    mount = Pose.from_quaternion([0.3, -0.1, 1.2], [0.0, 0.1, 0.2, 0.97])
    lidar = dataclasses.replace(EXACT, mount=mount)
    for simulated in simulate_lidar(building, drive, lidar, duration=30.0):
        positions, rotations = drive.poses([simulated.scan.stamp])
        assert simulated.T_map_lidar.is_close(Pose(rotations[0], positions[0]) @ mount)
        assert gaps(building, in_map(simulated, drive, lidar)).max() < 1e-7


def test_people_are_seen_where_they_walk_and_stand_nowhere_near_the_lidar():
    building = make_building_3d("warehouse3d", floors=1)
    drive = Drive3D(building.waypoints)
    lidar = dataclasses.replace(EXACT, rings=16, azimuths=180)
    crowd = list(simulate_lidar(building, drive, lidar, people=People(12)))
    nobody = list(simulate_lidar(building, drive, lidar))
    on_people = 0
    for a, b in zip(crowd, nobody, strict=True):
        person = a.solids == -1
        on_people += person.sum()
        seen = in_map(a, drive, lidar)
        assert gaps(building, seen[~person]).max() < 1e-7
        assert (seen[person, 2] <= 1.75 + 1e-6).all()
        assert (np.linalg.norm(a.scan.points, axis=1) > 0.3).all()
        assert not (b.solids == -1).any()
    assert on_people > 20


def test_the_robot_sees_itself_where_that_is_asked_for():
    building = make_building_3d("warehouse3d")
    lidar = RingLidar(rings=8, azimuths=360, own_body=True)
    for simulated in simulate_lidar(building, lidar=lidar, scans=2):
        own = simulated.scan.points[simulated.solids == -2]
        assert len(own) > 10
        np.testing.assert_allclose(np.hypot(own[:, 0] + 0.4, np.abs(own[:, 1]) - 0.25), 0.03, atol=0.1)


def test_settings_out_of_range_are_refused_at_once():
    building = make_building_3d("warehouse3d")
    for bad in ({"seed": -1}, {"duration": 0.0}, {"duration": math.nan}, {"scans": 0}, {"duration": 0.05}):
        with pytest.raises(ArgumentError):
            simulate_lidar(building, **bad)
    for bad in (
        {"rings": 0},
        {"azimuths": 0},
        {"rate": 0.0},
        {"sweep": 0.3},
        {"noise": -1.0},
        {"resolution": math.nan},
        {"missing": 1.5},
        {"min_range": 70.0},
        {"max_range": math.inf},
        {"lowest": 0.5},
        {"mount": Pose.identity(2)},
    ):
        with pytest.raises(ArgumentError):
            RingLidar(**bad)
    with pytest.raises(ArgumentError, match="people"):
        People(-1)
