"""Paths between points begin and end there, are as long as they are drawn, and meet no blocked cell."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError
from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.rays import traverse
from planners import any_angle, astar, between_points, canonical, dijkstra, path_between, shortcut, to_cell
from tests.lattices import CASES, Case

each = pytest.mark.parametrize("case", CASES, ids=str)


def maze(case: Case, seed: int, density: float = 0.3) -> LatticeGraph:
    size = 14 if case.dim == 2 else 8
    free = np.random.default_rng(seed).random((size,) * case.dim) > density
    return LatticeGraph.from_states(case.lattice, [0] * case.dim, free.astype(np.uint8))


def check(graph: LatticeGraph, path: object, a: np.ndarray, b: np.ndarray) -> None:
    points, cells = path.points, path.cells  # type: ignore[attr-defined]
    assert np.array_equal(points[0], a)
    assert np.array_equal(points[-1], b)
    assert len(points) == len(cells)
    assert np.array_equal(cells[[0, -1]], graph.lattice.quantise(np.stack([a, b])))
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    assert path.length == pytest.approx(length, rel=1e-12)  # type: ignore[attr-defined]
    assert length >= np.linalg.norm(b - a) - 1e-12
    if len(points) > 1:
        met = traverse(graph.lattice, points[:-1], points[1:]).index
        assert graph.free[graph.index_to_flat(met)].all()


@each
def test_paths_begin_and_end_in_the_points_that_were_asked_for(case: Case) -> None:
    rng = np.random.default_rng(3)
    found = 0
    for seed in range(6):
        graph = maze(case, seed)
        free = graph.flat_to_index(np.flatnonzero(graph.free))
        inside = case.lattice.cell.vertices.mean(axis=0)
        corner = case.lattice.cell.vertices[0] - inside
        for _ in range(4):
            ends = case.lattice.centres(free[rng.integers(len(free), size=2)])
            a, b = ends + 0.95 * corner * rng.uniform(-1.0, 1.0, (2, 1))
            if not graph.connected(to_cell(graph, a), to_cell(graph, b)):
                continue
            found += 1
            for planner in (astar, canonical, any_angle):
                check(graph, path_between(graph, a, b, planner), a, b)
            field = dijkstra(graph, to_cell(graph, a)).path_to(to_cell(graph, b))
            check(graph, between_points(graph, field, a, b), a, b)
            straight = shortcut(graph, astar(graph, to_cell(graph, a), to_cell(graph, b)))
            check(graph, between_points(graph, straight, a, b), a, b)
    assert found


@each
def test_with_terrain_the_end_pieces_cost_what_their_cells_do(case: Case) -> None:
    graph = maze(case, 0, density=0.0)
    graph = graph.with_terrain(np.random.default_rng(1).uniform(1.0, 4.0, graph.size))
    centre = case.lattice.centres(np.array([[2] * case.dim, [5] * case.dim]))
    corner = 0.4 * case.lattice.cell.vertices[0]
    plain = astar(graph, [2] * case.dim, [5] * case.dim)
    path = path_between(graph, centre[0] + corner, centre[1] - corner)
    ends = graph.terrain[graph.index_to_flat(plain.cells[[0, -1]])]  # type: ignore[index]
    assert path.cost == pytest.approx(plain.cost + float(np.linalg.norm(corner)) * ends.sum(), rel=1e-12)


def test_in_the_open_a_straight_path_is_as_long_as_the_line() -> None:
    graph = LatticeGraph.from_states(Lattice.named("A2", 0.1), [-50, -50], np.ones((200, 200), np.uint8))
    for a, b in (((0.02, 0.03), (5.31, 2.17)), ((0.02, 0.03), (0.02, 0.031)), ((1.0, 1.0), (1.0, 1.0))):
        path = path_between(graph, a, b, any_angle)
        assert math.dist(a, b) <= path.length <= math.dist(a, b) * 1.001 + 1e-12
        assert path.points[0].tolist() == list(a) and path.points[-1].tolist() == list(b)


def test_a_path_that_does_not_reach_the_goal_ends_in_a_cell() -> None:
    free = np.ones((9, 9), np.uint8)
    free[:, 6] = 0
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], free)
    path = path_between(graph, (0.2, 0.1), (0.0, 8.3), nearest=True)
    assert not path.goal_reached
    assert path.points[0].tolist() == [0.2, 0.1] and path.points[-1].tolist() == [0.0, 5.0]


@each
def test_a_point_of_whole_metres_is_not_taken_for_a_cell(case: Case) -> None:
    graph = maze(case, 0, density=0.0)
    a, b = (0,) * case.dim, (5,) * case.dim
    for planner in (astar, canonical, any_angle):
        with pytest.raises(ArgumentError, match="to_cell makes one of a point in metres"):
            planner(graph, a, list(b))
        with pytest.raises(ArgumentError, match="to_cell makes one of a point in metres"):
            planner(graph, list(a), b)
    with pytest.raises(ArgumentError, match="to_cell makes one"):
        dijkstra(graph, a)
