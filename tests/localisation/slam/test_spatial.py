"""Poses of space as rows, against Pose and numerical derivatives; the graph of poses in space."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hexmap.poses.pose import Pose
from hexmap.poses.rotations import exponential
from localisation.slam import spatial
from localisation.slam.pose_graph import Edge, PoseGraph, import_gtsam

SIGMAS = np.array([0.05, 0.05, 0.03, 0.005, 0.005, 0.01])


def random_poses(rng: np.random.Generator, n: int) -> list[Pose]:
    return [Pose(exponential(rng.uniform(-1.8, 1.8, 3)), rng.uniform(-5.0, 5.0, 3)) for _ in range(n)]


def rows(poses: list[Pose]) -> np.ndarray:
    return np.array([spatial.of_pose(pose) for pose in poses])


# --- rows -----------------------------------------------------------------------------------------------------------


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6))
def test_rows_are_composed_and_inverted_as_poses_are(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = random_poses(rng, 6), random_poses(rng, 6)
    A, B = rows(a), rows(b)
    for k in range(6):
        assert spatial.to_pose(spatial.compose(A, B)[k]).is_close(a[k] @ b[k])
        assert spatial.to_pose(spatial.invert(A)[k]).is_close(a[k].inverse())
        assert spatial.to_pose(spatial.between(A, B)[k]).is_close(a[k].inverse() @ b[k])
        assert spatial.to_pose(A[k]).is_close(a[k])
        np.testing.assert_array_equal(spatial.compose(A[k], B[k]), spatial.compose(A, B)[k])
    # Of any shape.
    np.testing.assert_array_equal(
        spatial.between(A.reshape(2, 3, 12), B.reshape(2, 3, 12)).reshape(6, 12), spatial.between(A, B)
    )


def test_a_row_that_rounding_has_bent_is_a_pose_again() -> None:
    pose = random_poses(np.random.default_rng(0), 1)[0]
    row = spatial.of_pose(pose) + 1e-7 * np.random.default_rng(1).standard_normal(12)
    R = spatial.to_pose(row).rotation
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert spatial.to_pose(row).is_close(pose, 1e-6, 1e-6)


@settings(max_examples=60)
@given(seed=st.integers(0, 10**6), size=st.sampled_from([0.0, 1e-14, 1e-11, 1e-8, 1e-4, 0.1, 1.0, 3.1]))
def test_small_motions_and_back(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    axes = rng.standard_normal((4, 3))
    v = np.column_stack([rng.uniform(-2, 2, (4, 3)), size * axes / np.linalg.norm(axes, axis=1)[:, None]])
    T = spatial.motion(v)
    np.testing.assert_allclose(spatial.small(T), v, rtol=1e-7, atol=1e-13)
    for row, one in zip(T, v, strict=True):
        assert Pose(exponential(one[3:]), one[:3]).is_close(spatial.to_pose(row), 1e-12, 1e-7)
        np.testing.assert_allclose(row[:9].reshape(3, 3) @ row[:9].reshape(3, 3).T, np.eye(3), atol=1e-14)
    assert spatial.small(spatial.of_pose(Pose.identity(3))).tolist() == [0.0] * 6


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6))
def test_the_adjoint_moves_small_motions_to_the_outer_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rows(random_poses(rng, 5)), rows(random_poses(rng, 5))
    A = spatial.adjoint(a)
    step = 1e-6
    for column in range(6):
        v = np.zeros((5, 6))
        v[:, column] = step
        # a moved within its own frame, seen from outside.
        outer = spatial.small(spatial.compose(spatial.compose(a, spatial.motion(v)), spatial.invert(a))) / step
        np.testing.assert_allclose(A[:, :, column], outer, atol=1e-4)
    np.testing.assert_allclose(spatial.adjoint(spatial.compose(a, b)), A @ spatial.adjoint(b), atol=1e-12)
    np.testing.assert_allclose(spatial.adjoint(spatial.invert(a)), np.linalg.inv(A), atol=1e-10)


# --- graph ----------------------------------------------------------------------------------------------------------


def helix(laps: int = 3, seed: int = 0, loops: bool = True) -> tuple[PoseGraph, np.ndarray]:
    """A drive up and around, 8 nodes a lap, with noise; loops from each lap to the one below; and the true poses."""
    rng = np.random.default_rng(seed)
    step = spatial.of_pose(Pose(exponential(np.array([0.02, -0.05, math.pi / 4.0])), [4.0, 0.0, 0.4]))
    graph = PoseGraph(spatial.SPACE)
    true = [spatial.of_pose(Pose(exponential(np.array([0.1, 0.2, 0.3])), [1.0, 2.0, 3.0]))]
    graph.add_node(true[0])
    for k in range(8 * laps):
        true.append(spatial.compose(true[-1], step))
        motion = spatial.compose(step, spatial.motion(SIGMAS * rng.standard_normal(6)))
        graph.add_node(spatial.compose(graph.pose(k), motion))
        graph.add_edge(Edge(k, k + 1, motion, np.diag(SIGMAS**2)))
    poses = np.array(true)
    for k in range(8, 8 * laps + 1) if loops else ():
        off = spatial.motion(0.3 * SIGMAS * rng.standard_normal(6))
        seen = spatial.compose(spatial.between(poses[k - 8], poses[k]), off)
        graph.add_edge(Edge(k - 8, k, seen, np.diag((0.3 * SIGMAS) ** 2), loop=True))
    return graph, poses


def off(graph: PoseGraph, true: np.ndarray) -> float:
    return float(np.linalg.norm((graph.poses - true)[:, 9:], axis=1).max())


def test_loops_pull_the_poses_to_where_they_are() -> None:
    before, after, turned = [], [], []
    for seed in range(5):
        graph, true = helix(seed=seed)
        before.append(off(graph, true))
        graph.optimise()
        after.append(off(graph, true))
        turned.append(np.abs(spatial.small(spatial.between(true, graph.poses))[:, 3:]).max())
        assert (graph.pose(0) == true[0]).all()
    assert np.mean(after) < 0.6 * np.mean(before) and max(turned) < 0.15


def test_without_noise_the_truth_is_found_from_far_off() -> None:
    graph, true = helix()
    exact = PoseGraph(spatial.SPACE)
    rng = np.random.default_rng(1)
    exact.add_node(true[0])
    for row in true[1:]:
        exact.add_node(spatial.compose(row, spatial.motion(rng.standard_normal(6) * [0.5, 0.5, 0.5, 0.1, 0.1, 0.2])))
    for edge in graph.edges:
        exact.add_edge(Edge(edge.i, edge.j, spatial.between(true[edge.i], true[edge.j]), edge.covariance, edge.loop))
    exact.optimise()
    assert off(exact, true) < 1e-4 and exact.residuals().max() < 1e-4


def test_false_loops_are_thrown_out_and_true_ones_stay() -> None:
    graph, true = helix()
    good = [k for k, edge in enumerate(graph.edges) if edge.loop]
    odd = spatial.of_pose(Pose(exponential(np.array([0.0, 0.0, 0.5])), [0.3, 0.2, 0.0]))
    # One floor looks like the other.
    false = [
        graph.add_edge(Edge(a, b, odd, np.diag((0.3 * SIGMAS) ** 2), loop=True)) for a, b in ((0, 8), (2, 15), (5, 21))
    ]
    out = graph.optimise_robustly()
    assert set(out) >= set(false) and len(set(out) & set(good)) <= 1
    alone, _ = helix()
    alone.optimise()
    assert off(graph, true) < off(alone, true) + 0.05
    assert graph.optimise_robustly() == []


def dense_covariances(graph: PoseGraph, origin: int, others: list[int]) -> np.ndarray:
    """All poses but one, moved numerically: the inverse of the normal equations, block by block."""
    n, poses = len(graph), graph.poses
    free = [k for k in range(n) if k != origin]
    J, W = [], []
    for edge, weight in zip(graph.edges, graph.weights, strict=True):
        if weight < 0.5:
            continue

        def residual(a: np.ndarray, b: np.ndarray, seen: np.ndarray = edge.pose) -> np.ndarray:
            return spatial.small(spatial.between(seen, spatial.between(a, b)))

        row = np.zeros((6, 6 * n))
        for node, first in ((edge.i, True), (edge.j, False)):
            for c in range(6):
                side = []
                for sign in (1e-6, -1e-6):
                    moved = spatial.compose(poses[node], spatial.motion(sign * np.eye(6)[c]))
                    side.append(residual(moved, poses[edge.j]) if first else residual(poses[edge.i], moved))
                row[:, 6 * node + c] = (side[0] - side[1]) / 2e-6
        J.append(row)
        W.append(np.linalg.inv(edge.covariance))
    H = sum(j.T @ w @ j for j, w in zip(J, W, strict=True))
    keep = np.concatenate([np.arange(6 * k, 6 * k + 6) for k in free])
    C = np.linalg.inv(H[np.ix_(keep, keep)])
    out = np.zeros((len(others), 6, 6))
    for m, node in enumerate(others):
        if node != origin:
            at = 6 * free.index(node)
            out[m] = C[at : at + 6, at : at + 6]
    return out


@pytest.mark.parametrize("origin", [0, 6, 16])
def test_relative_covariances_are_those_of_the_dense_inverse(origin: int) -> None:
    graph, _ = helix(laps=2)
    graph.edges[3] = Edge(3, 4, graph.edges[3].pose, np.diag(SIGMAS**2) + 1e-4 * np.outer(SIGMAS, SIGMAS) / SIGMAS[0])
    graph.optimise()
    others = [3, 11, origin, 16, 0]
    found = graph.relative_covariances(origin, others)
    # At small residuals the linearisation of the edges is theirs to a hundredth.
    for C, D in zip(found, dense_covariances(graph, origin, others), strict=True):
        scale = np.sqrt(np.outer(np.diag(D), np.diag(D))) + 1e-12
        assert np.abs((C - D) / scale).max() < 0.05
    assert (found[2] == 0.0).all()


def test_the_ellipses_hold_what_they_say() -> None:
    inside, normalised = [], []
    for seed in range(40):
        graph, true = helix(laps=2, seed=seed)
        graph.optimise()
        C = graph.relative_covariances(0, [12])[0]
        error = spatial.small(spatial.between(true[12], graph.pose(12)))
        normalised.append(float(error @ np.linalg.solve(C, error)))
        inside.append(normalised[-1] < 12.592)  # 95 % of chi-squared with six degrees of freedom
    assert np.mean(inside) >= 0.85 and 4.5 < np.mean(normalised) < 7.5


def test_the_file_is_read_back_by_gtsam(tmp_path: Path) -> None:
    graph, _ = helix()
    graph.optimise()
    path = tmp_path / "helix.g2o"
    graph.write_g2o(path)
    factors, values = import_gtsam().readG2o(str(path), True)
    assert values.size() == len(graph) and factors.size() == len(graph.edges)
    for k, row in enumerate(graph.poses):
        read = values.atPose3(k)
        np.testing.assert_allclose(np.asarray(read.rotation().matrix()).ravel(), row[:9], atol=1e-8)
        np.testing.assert_allclose(read.translation(), row[9:], atol=1e-8)
    # A file's numbers are those of a quaternion's vector, which gtsam takes for a rotation's, twice as long.
    wider = PoseGraph(spatial.SPACE)
    for row in graph.poses:
        wider.add_node(row)
    scale = np.outer([1, 1, 1, 0.5, 0.5, 0.5], [1, 1, 1, 0.5, 0.5, 0.5])
    for edge in graph.edges:
        wider.add_edge(Edge(edge.i, edge.j, edge.pose, scale * edge.covariance, edge.loop))
    assert factors.error(values) == pytest.approx(0.5 * wider.residuals().sum(), rel=0.02)


def test_the_text_of_a_file_says_nodes_and_edges_as_g2o_does(tmp_path: Path) -> None:
    graph, _ = helix(laps=1, loops=False)
    graph.add_edge(Edge(0, 8, graph.edges[0].pose, np.diag(SIGMAS**2), loop=True))
    graph.weights[-1] = 0.0
    graph.write_g2o(tmp_path / "g.g2o")
    lines = [line.split() for line in (tmp_path / "g.g2o").read_text().splitlines()]
    nodes = [line for line in lines if line[0] == "VERTEX_SE3:QUAT"]
    edges = [line for line in lines if line[0] == "EDGE_SE3:QUAT"]
    assert len(nodes) == 9 and len(edges) == 8, "an edge that is not believed is not written"
    assert [int(line[1]) for line in nodes] == list(range(9))
    for line, row in zip(nodes, graph.poses, strict=True):
        numbers = np.array(line[2:], float)
        assert Pose.from_quaternion(numbers[:3], numbers[3:]).is_close(spatial.to_pose(row), 1e-8, 1e-7)
    for line, edge in zip(edges, graph.edges, strict=False):
        assert (int(line[1]), int(line[2])) == (edge.i, edge.j) and len(line) == 3 + 7 + 21
        # Of x, y, z and of a quaternion's vector, which is half of a rotation's.
        information = np.zeros((6, 6))
        information[np.triu_indices(6)] = np.array(line[10:], float)
        np.testing.assert_allclose(np.diag(information), [*SIGMAS[:3] ** -2.0, *4.0 * SIGMAS[3:] ** -2.0], rtol=1e-6)


def test_a_graph_that_is_moved_says_the_same() -> None:
    graph, _ = helix()
    graph.optimise()
    turn = random_poses(np.random.default_rng(3), 1)[0]
    moved = graph.moved(spatial.compose(spatial.of_pose(turn), graph.poses))
    np.testing.assert_allclose(moved.residuals(), graph.residuals(), atol=1e-6)
    np.testing.assert_allclose(
        moved.relative_covariances(0, [5, 20]), graph.relative_covariances(0, [5, 20]), rtol=1e-6, atol=1e-12
    )
