"""The graph of poses: solved, robust, how sure, and as a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from localisation.slam import planar
from localisation.slam.pose_graph import Edge, PoseGraph, import_gtsam

SIGMAS = np.array([0.05, 0.05, 0.02])


def square(laps: int = 2, seed: int = 0, loops: bool = True) -> tuple[PoseGraph, np.ndarray]:
    """A drive around a square of 8 nodes, with noise, and loops from each lap to the one before; and the true poses."""
    rng = np.random.default_rng(seed)
    step = np.array([4.0, 0.0, np.pi / 4.0])
    true = [np.zeros(3)]
    graph = PoseGraph()
    graph.add_node(true[0])
    for k in range(8 * laps):
        true.append(planar.compose(true[-1], step))
        motion = planar.compose(step, SIGMAS * rng.standard_normal(3))
        graph.add_node(planar.compose(graph.pose(k), motion))
        graph.add_edge(Edge(k, k + 1, motion, np.diag(SIGMAS**2)))
    poses = np.array(true)
    for k in range(8, 8 * laps + 1) if loops else ():
        seen = planar.compose(planar.between(poses[k - 8], poses[k]), 0.3 * SIGMAS * rng.standard_normal(3))
        graph.add_edge(Edge(k - 8, k, seen, np.diag((0.3 * SIGMAS) ** 2), loop=True))
    return graph, poses


def off(graph: PoseGraph, true: np.ndarray) -> float:
    return float(np.hypot(*(graph.poses - true)[:, :2].T).max())


def test_loops_pull_the_poses_to_where_they_are() -> None:
    graph, true = square()
    before = off(graph, true)
    graph.optimise()
    assert off(graph, true) < before
    assert (graph.pose(0) == 0.0).all()


def test_false_loops_are_thrown_out_and_true_ones_stay() -> None:
    graph, true = square(laps=3)
    good = [k for k, edge in enumerate(graph.edges) if edge.loop]
    false = [
        graph.add_edge(Edge(a, b, np.array([0.3, 0.2, 0.5]), np.diag((0.3 * SIGMAS) ** 2), loop=True))
        for a, b in ((0, 4), (2, 15), (5, 18))
    ]
    out = graph.optimise_robustly()
    assert set(out) >= set(false)
    assert len(set(out) & set(good)) <= 1
    assert off(graph, true) < 0.5
    assert graph.optimise_robustly() == []


def test_relative_covariances_are_gtsams() -> None:
    graph, _ = square()
    graph.optimise()
    gtsam = import_gtsam()
    values, factors = gtsam.Values(), gtsam.NonlinearFactorGraph()
    for k, pose in enumerate(graph.poses):
        values.insert(k, gtsam.Pose2(*pose))
    for edge in graph.edges:
        noise = gtsam.noiseModel.Gaussian.Covariance(edge.covariance)
        factors.add(gtsam.BetweenFactorPose2(edge.i, edge.j, gtsam.Pose2(*edge.pose), noise))
    for origin in (0, 6):
        held = gtsam.NonlinearFactorGraph(factors)
        fixed = gtsam.noiseModel.Isotropic.Sigma(3, 1e-7)
        held.add(gtsam.PriorFactorPose2(origin, gtsam.Pose2(*graph.pose(origin)), fixed))
        marginals = gtsam.Marginals(held, values)
        others = [3, 11, origin, 16]
        found = graph.relative_covariances(origin, others)
        for k, C in zip(others, found, strict=True):
            want = np.zeros((3, 3)) if k == origin else marginals.marginalCovariance(k)
            assert pytest.approx(want, rel=0.05, abs=1e-6) == C


def test_the_ellipses_hold_what_they_say() -> None:
    inside, normalised = [], []
    for seed in range(40):
        graph, true = square(seed=seed)
        graph.optimise()
        C = graph.relative_covariances(0, [12])[0]
        error = planar.between(true[12], graph.pose(12))
        normalised.append(float(error @ np.linalg.solve(C, error)))
        inside.append(normalised[-1] < 7.815)
    assert np.mean(inside) >= 0.85 and 1.8 < np.mean(normalised) < 4.2


def test_the_file_is_read_back_by_gtsam(tmp_path: Path) -> None:
    graph, _ = square()
    graph.optimise()
    path = tmp_path / "square.g2o"
    graph.write_g2o(path)
    factors, values = import_gtsam().readG2o(str(path), False)
    assert values.size() == len(graph) and factors.size() == len(graph.edges)
    for k, pose in enumerate(graph.poses):
        read = values.atPose2(k)
        assert [read.x(), read.y(), read.theta()] == pytest.approx(pose.tolist(), abs=1e-8)
    assert factors.error(values) == pytest.approx(0.5 * graph.residuals().sum(), rel=0.02)


def test_poses_as_rows_compose_as_poses_do() -> None:
    rng = np.random.default_rng(5)
    a, b = rng.uniform(-3.0, 3.0, (2, 20, 3))
    for x, y, both, back in zip(a, b, planar.compose(a, b), planar.between(a, b), strict=True):
        assert planar.to_pose(both).is_close(planar.to_pose(x) @ planar.to_pose(y))
        assert planar.to_pose(back).is_close(planar.to_pose(x).inverse() @ planar.to_pose(y))
    small = 1e-6 * rng.standard_normal(3)
    moved = planar.compose(planar.compose(a, np.broadcast_to(small, a.shape)), planar.invert(a))
    assert planar.adjoint(a) @ small == pytest.approx(moved, abs=1e-10)
