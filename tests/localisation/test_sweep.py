"""Sweeps brought to one time: each point against a pose of its own."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hexmap.poses.pose import Pose
from hexmap.poses.rotations import exponential
from hexmap.poses.scan import Scan
from hexmap.simulator.space import Drive3D, RingLidar, lidar_poses, make_building_3d, simulate_lidar
from localisation.odometry.sweep import Velocity, deskewed


@settings(max_examples=50)
@given(seed=st.integers(0, 10**6), turning=st.floats(0.0, 4.0), begin=st.floats(-0.1, 0.1))
def test_every_point_is_placed_by_the_pose_at_its_own_time(seed: int, turning: float, begin: float) -> None:
    rng = np.random.default_rng(seed)
    linear, angular = rng.uniform(-3.0, 3.0, 3), turning * rng.standard_normal(3) / np.sqrt(3.0)
    points, times = rng.uniform(-30.0, 30.0, (40, 3)), begin + np.sort(rng.uniform(0.0, 0.1, 40))
    got = deskewed(Scan(5.0, points, times=times), Velocity(linear, angular))
    for p, t, q in zip(points, times.tolist(), got, strict=True):
        # T_stamp_sensor(t): how the sensor lies at its point's time, as seen from where it is at the stamp.
        np.testing.assert_allclose(q, Pose(exponential(angular * t), linear * t).apply(p[None])[0], atol=1e-10)


def test_without_times_or_velocity_or_motion_points_stay() -> None:
    points = np.random.default_rng(0).uniform(-5, 5, (10, 3))
    moving, still = Velocity(np.ones(3), np.ones(3)), Velocity(np.zeros(3), np.zeros(3))
    np.testing.assert_array_equal(deskewed(Scan(0.0, points), moving), points)
    timed = Scan(0.0, points, times=np.linspace(-0.1, 0.0, 10))
    np.testing.assert_array_equal(deskewed(timed, None), points)
    np.testing.assert_array_equal(deskewed(timed, still), points)
    assert deskewed(Scan(0.0, points[:0], times=np.zeros(0)), None).shape == (0, 3)
    assert deskewed(Scan(0.0, points[:0], times=np.zeros(0)), moving).shape == (0, 3)


@settings(max_examples=100)
@given(seed=st.integers(0, 10**6), size=st.sampled_from([1e-9, 1e-6, 1e-3, 0.1, 1.0, 3.1]))
def test_the_velocity_of_a_motion_makes_that_motion(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    axis = rng.standard_normal(3)
    motion = Pose(exponential(size * axis / np.linalg.norm(axis)), rng.uniform(-1.0, 1.0, 3))
    velocity = Velocity.between(motion, 0.25)
    assert velocity is not None
    again = Pose(exponential(0.25 * velocity.angular), 0.25 * velocity.linear)
    np.testing.assert_allclose(again.matrix(), motion.matrix(), atol=2e-8)


@pytest.mark.parametrize("seconds", [0.0, -0.1, 2.5, float("nan")])
def test_stamps_that_do_not_tell_give_no_velocity(seconds: float) -> None:
    assert Velocity.between(Pose(np.eye(3), [1.0, 0.0, 0.0]), seconds) is None


def test_a_simulated_sweep_lies_on_the_walls_again() -> None:
    """A robot that turns while its LiDAR does: what was off by a hand is off by the sway of its frame."""
    building = make_building_3d("warehouse3d", seed=2)
    drive, lidar = Drive3D(building.waypoints, seed=2, speed=2.0), RingLidar(rings=8, azimuths=256, noise=0.0)
    before, skewed, right = None, [], []
    for simulated in simulate_lidar(building, drive, lidar, seed=2, duration=16.0):
        scan, T = simulated.scan, simulated.T_map_lidar
        if before is not None:
            velocity = Velocity.between(before.inverse() @ T, 0.2)
            positions, rotations = lidar_poses(drive, lidar, scan.stamp + scan.times)
            true = np.einsum("nij,nj->ni", rotations, scan.points) + positions
            skewed.append(np.linalg.norm(T.apply(scan.points) - true, axis=1).max())
            right.append(np.linalg.norm(T.apply(deskewed(scan, velocity)) - true, axis=1).max())
        before = T
    assert max(skewed) > 0.2 and np.median(right) < 0.1 * np.median(skewed)
