"""Scores of trajectories."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError, TrajectoryError
from hexmap.io.trajectories import read_relations
from hexmap.poses.pose import Pose
from hexmap.poses.trajectory import Relations, Trajectory
from localisation.evaluation import absolute_error, evaluate_relations, relative_error


def loop(n: int = 60, start: float = 100.0) -> Trajectory:
    k = np.arange(n)
    return Trajectory.from_poses(
        start + 0.5 * k,
        [Pose.planar(5 * math.cos(0.1 * i), 3 * math.sin(0.1 * i), 0.1 * i + math.pi / 2) for i in k],
    )


def moved(trajectory: Trajectory, T: Pose) -> Trajectory:
    return Trajectory.from_poses(trajectory.stamps, [T @ pose for pose in trajectory])


def relations_of(t: Trajectory, pairs: list[tuple[int, int]]) -> Relations:
    relative = [t[i].inverse() @ t[j] for i, j in pairs]
    R = np.tile(np.eye(3), (len(pairs), 1, 1))
    p = np.zeros((len(pairs), 3))
    for k, T in enumerate(relative):
        R[k, :2, :2], p[k, :2] = T.rotation, T.translation
    return Relations([t.stamps[i] for i, _ in pairs], [t.stamps[j] for _, j in pairs], p, R)


def test_truth_scores_zero_wherever_the_frame_is() -> None:
    t = loop()
    relations = relations_of(t, [(0, 5), (5, 40), (40, 3)])
    score = evaluate_relations(moved(t, Pose.planar(10, -3, 2.0)), relations)
    assert score.used == 3 and score.skipped == 0
    assert score.translation.max < 1e-9 and score.rotation_deg.max < 1e-6


def test_score_is_the_mean_absolute_error() -> None:
    t = Trajectory.from_poses([0.0, 1.0, 2.0], [Pose.planar(0, 0, 0), Pose.planar(1, 0, 0), Pose.planar(2, 0, 0)])
    R = np.tile(np.eye(3), (2, 1, 1))
    turn = math.radians(10)
    R[1, :2, :2] = [[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]
    relations = Relations([0.0, 1.0], [1.0, 2.0], [[1.0, 0.3, 0.4], [1.0, 0.0, 0.0]], R)
    score = evaluate_relations(t, relations)
    assert score.translation.mean == pytest.approx(0.25)
    assert score.translation.max == pytest.approx(0.5) and score.translation.median == pytest.approx(0.25)
    assert score.translation.std == pytest.approx(0.25) and score.translation.mean_squared == pytest.approx(0.125)
    assert score.rotation_deg.mean == pytest.approx(5.0)


def test_order_of_the_poses_does_not_matter_to_relations() -> None:
    t = loop()
    relations = relations_of(t, [(0, 5), (5, 40), (40, 3)])
    shuffled = t[np.random.default_rng(1).permutation(len(t))]
    assert evaluate_relations(shuffled, relations).translation.max < 1e-9


def test_relations_without_a_pose_near_are_skipped() -> None:
    t = loop()
    relations = relations_of(t, [(0, 5), (5, 40)])
    late = Relations(
        [*relations.from_stamps, 500.0], [*relations.to_stamps, 501.0],
        np.vstack([relations.translations, np.zeros((1, 3))]), np.concatenate([relations.rotations, np.eye(3)[None]]),
    )  # fmt: skip
    score = evaluate_relations(t, late)
    assert (score.used, score.skipped) == (2, 1)
    with pytest.raises(TrajectoryError, match=r"2 relations at .*60 poses at 1000\.0") as caught:
        evaluate_relations(loop(start=1000.0), relations)
    assert "0.1 s" in str(caught.value)


def test_rigidly_moved_trajectory_has_no_absolute_error() -> None:
    t = loop()
    T = Pose.planar(10, -3, 2.0)
    result = absolute_error(t, moved(t, T))
    assert result.used == 60 and result.translation.rmse < 1e-9 and result.rotation_deg.max < 1e-6
    assert result.T_reference_estimate.is_close(T.inverse(), 1e-8, 1e-9)


def test_scale_is_an_error() -> None:
    t = loop()
    larger = Trajectory(t.stamps, t.positions * 1.1, t.quaternions)
    assert absolute_error(t, larger).translation.rmse > 0.3


def test_absolute_error_in_space() -> None:
    rng = np.random.default_rng(2)
    t = Trajectory.from_poses(
        np.arange(30), [Pose.from_quaternion(rng.normal(size=3), rng.normal(size=4)) for _ in range(30)]
    )
    T = Pose.from_quaternion([1, 2, 3], [0.1, -0.5, 0.3, 0.6])
    result = absolute_error(t, moved(t, T))
    assert result.translation.rmse < 1e-9 and result.T_reference_estimate.is_close(T.inverse(), 1e-8, 1e-7)


def test_alignment_never_mirrors() -> None:
    t = loop()
    mirrored = Trajectory(t.stamps, t.positions * [1, -1, 1], t.quaternions)
    assert np.linalg.det(absolute_error(t, mirrored).T_reference_estimate.rotation) == pytest.approx(1.0)


def test_dense_estimate_against_sparse_reference_and_back() -> None:
    t = loop()
    sparse = t[::7]
    for a, b in ((sparse, t), (t, sparse)):
        result = absolute_error(a, b)
        assert result.used == len(sparse) and result.translation.max < 1e-9


def test_association_by_order_needs_no_stamps() -> None:
    t = loop()
    useless = Trajectory(np.full(len(t), 1018930000.0), t.positions, t.quaternions)
    assert absolute_error(useless, t, associate="order").translation.max < 1e-9
    with pytest.raises(TrajectoryError, match=r"--associate order"):
        absolute_error(useless, useless)
    with pytest.raises(TrajectoryError, match=r"60.*59"):
        absolute_error(t, t[:-1], associate="order")


def test_nothing_in_common_says_what_there_is() -> None:
    with pytest.raises(TrajectoryError) as caught:
        absolute_error(loop(), loop(start=9000.0))
    for part in ("60 stamps", "100.000000 to", "9000.000000 to", "0.1 s", "--associate order"):
        assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_relative_error_over_poses_and_metres() -> None:
    k = np.arange(11)
    t = Trajectory.from_poses(k, [Pose.planar(i, 0, 0) for i in k])
    drifting = Trajectory.from_poses(k, [Pose.planar(1.02 * i, 0, 0) for i in k])
    one = relative_error(t, drifting)
    assert one.used == 10 and one.translation.mean == pytest.approx(0.02)
    five = relative_error(t, drifting, step=5, unit="metres")
    assert five.used == 6 and five.translation.mean == pytest.approx(0.1)
    with pytest.raises(TrajectoryError, match="50 metres"):
        relative_error(t, drifting, step=50, unit="metres")


def test_arguments_are_checked() -> None:
    t = loop()
    for call in (
        lambda: absolute_error(t, t, associate="luck"),
        lambda: absolute_error(t, t, tolerance=-1.0),
        lambda: relative_error(t, t, step=0),
        lambda: relative_error(t, t, step=1.5),
        lambda: relative_error(t, t, unit="miles"),
        lambda: evaluate_relations(t, relations_of(t, [(0, 1)]), tolerance=math.nan),
    ):
        with pytest.raises(ArgumentError):
            call()
    with pytest.raises(TrajectoryError):
        absolute_error(t, t[:0])


@pytest.mark.data
def test_raw_odometry_of_intel_scores_as_documented(data_dir: Path) -> None:
    from hexmap.io.logs.open_log import open_log
    from hexmap.poses.scan import Scan

    events = list(open_log(data_dir / "laser2d" / "intel.clf.gz"))
    poses = [event.odometry if isinstance(event, Scan) else event.pose for event in events]
    t = Trajectory.from_poses([event.stamp for event in events], poses)
    score = evaluate_relations(t, read_relations(data_dir / "laser2d" / "intel.relations"))
    assert (score.used, score.skipped) == (2984, 0)
    assert score.translation.mean == pytest.approx(7.383, abs=5e-4)
    assert score.rotation_deg.mean == pytest.approx(39.48, abs=5e-3)


def test_the_order_of_lines_does_not_matter_by_time() -> None:
    rng = np.random.default_rng(0)
    stamps = np.arange(60) * 0.5
    poses = [Pose.planar(0.3 * k, 0.01 * k * k, 0.02 * k) for k in range(60)]
    noisy = [Pose.planar(*rng.normal(0.0, 0.05, 2), rng.normal(0.0, 0.02)) @ pose for pose in poses]
    truth = Trajectory.from_poses(stamps, poses)
    for estimate in (
        Trajectory.from_poses(stamps, noisy),
        Trajectory.from_poses(stamps[::2] + 0.01, noisy[::2]),
        Trajectory.from_poses(np.repeat(stamps, 2) + np.tile([0.0, 0.02], 60), [p for p in noisy for _ in range(2)]),
    ):
        shuffled = estimate[rng.permutation(len(estimate))]
        mixed = truth[rng.permutation(len(truth))]
        for unit in ("poses", "metres"):
            expected = relative_error(truth, estimate, 1, unit)  # type: ignore[arg-type]
            assert relative_error(truth, shuffled, 1, unit) == expected  # type: ignore[arg-type]
            assert relative_error(mixed, shuffled, 1, unit) == expected  # type: ignore[arg-type]
        assert absolute_error(mixed, shuffled).translation == absolute_error(truth, estimate).translation
