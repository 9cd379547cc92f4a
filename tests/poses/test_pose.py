"""Poses: composing, inverting, converting, refusing."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexmap.base.errors import ArgumentError, HexmapError
from hexmap.poses.pose import Pose, wrap_angle

metres = st.floats(-1e3, 1e3)
angles = st.floats(-math.pi, math.pi)
planar_poses = st.builds(Pose.planar, metres, metres, angles)
quaternions = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)
spatial_poses = st.builds(Pose.from_quaternion, st.tuples(metres, metres, metres), quaternions)


@given(st.one_of(st.tuples(*[planar_poses] * 3), st.tuples(*[spatial_poses] * 3)))
def test_poses_are_a_group(poses: tuple[Pose, Pose, Pose]) -> None:
    a, b, c = poses
    assert ((a @ b) @ c).is_close(a @ (b @ c), 1e-8, 1e-7)
    assert (a @ a.inverse()).is_close(Pose.identity(a.dim), 1e-8, 1e-7)
    points = np.arange(4.0 * a.dim).reshape(4, a.dim)
    np.testing.assert_allclose((a @ b).apply(points), a.apply(b.apply(points)), atol=1e-8)


@given(spatial_poses)
def test_quaternion_and_matrix_give_the_pose_back(pose: Pose) -> None:
    q = pose.quaternion()
    assert q[3] >= 0 and np.linalg.norm(q) == pytest.approx(1.0)
    assert Pose.from_quaternion(pose.translation, q).is_close(pose, 1e-9, 1e-7)
    assert Pose.from_matrix(pose.matrix()).is_close(pose, 1e-9, 1e-7)


@given(planar_poses)
def test_planar_pose_has_its_heading(pose: Pose) -> None:
    assert Pose.planar(pose.x, pose.y, pose.theta).is_close(pose, 1e-9, 1e-9)
    assert pose.angle == pytest.approx(abs(pose.theta))
    q = pose.quaternion()
    assert q[0] == q[1] == 0.0
    assert math.remainder(2 * math.atan2(q[2], q[3]) - pose.theta, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)


def test_quarter_turn_is_counter_clockwise() -> None:
    np.testing.assert_allclose(Pose.planar(1.0, 2.0, math.pi / 2).apply([[1.0, 0.0]]), [[1.0, 3.0]], atol=1e-12)


@given(st.floats(-1e4, 1e4))
def test_wrapped_angles_are_the_same_direction(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -math.pi <= wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)


def test_pose_is_a_value() -> None:
    pose = Pose.planar(1.0, 2.0, 0.5)
    with pytest.raises(AttributeError):
        pose.translation = np.zeros(2)
    with pytest.raises(ValueError):
        pose.translation[0] = 3.0
    assert pickle.loads(pickle.dumps(pose)) == pose
    assert hash(Pose.planar(1.0, 2.0, 0.5)) == hash(pose)
    assert pose != Pose.planar(1.0, 2.0, 0.6)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Pose.planar(math.nan, 0, 0),
        lambda: Pose.planar(0, math.inf, 0),
        lambda: Pose(np.eye(2), [math.nan, 0]),
        lambda: Pose(np.diag([1.0, -1.0]), [0, 0]),
        lambda: Pose(np.eye(2) * 2, [0, 0]),
        lambda: Pose(np.eye(3), [0, 0]),
        lambda: Pose.from_quaternion([0, 0, 0], [0, 0, 0, 0]),
        lambda: Pose.from_matrix(np.eye(2)),
        lambda: Pose.identity(2) @ Pose.identity(3),
        lambda: Pose.identity(2).apply(np.zeros((3, 3))),
    ],
)
def test_what_is_no_pose_is_refused(make) -> None:
    with pytest.raises(ArgumentError) as caught:
        make()
    assert isinstance(caught.value, HexmapError) and isinstance(caught.value, ValueError)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("dim", [2, 3])
def test_long_chains_of_motions_stay_rotations(dim: int) -> None:
    # Dead reckoning by the last motion, a thousand times over: each step multiplies the rounding of the one before.
    before, now = Pose.identity(dim), Pose.planar(0.1, 0.0, 0.05)
    if dim == 3:
        now = Pose.from_quaternion([0.1, 0.0, 0.02], [0.01, 0.02, 0.03, 1.0])
    for _ in range(1000):
        before, now = now, now @ (before.inverse() @ now)
    assert np.abs(now.rotation @ now.rotation.T - np.eye(dim)).max() < 1e-12
