"""Graphs from arrays and as arrays, the numbers of their cells, and their nodes in networkx."""

from __future__ import annotations

from typing import Any

import networkx as nx
import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra as scipy_dijkstra

from hexmap import LatticeGraph
from hexmap.base.errors import ArgumentError, BoundsError
from planners import dijkstra
from tests.lattices import CASES, Case

each = pytest.mark.parametrize("case", CASES, ids=str)


def blocked_for(case: Case) -> Any:
    """Make an array with a different length along each axis, about a quarter of it blocked."""
    array = np.random.default_rng(3).random((7, 5, 4)[: case.dim]) < 0.25
    array[(0,) * case.dim] = False
    return array


@each
def test_each_entry_is_the_cell_of_its_indices(case: Case) -> None:
    blocked, first = blocked_for(case), np.array([-3, 2, 5])[: case.dim]
    graph = LatticeGraph.from_array(blocked, case.lattice, first=first)
    for at in np.ndindex(blocked.shape):
        flat = graph.index_to_flat((first + at)[None])
        assert graph.free[flat[0]] != blocked[at]
        np.testing.assert_allclose(graph.centres(flat)[0], case.lattice.basis @ (first + at), atol=1e-12)
    assert graph.first.tolist() == first.tolist()
    assert graph.free.sum() == (~blocked).sum()


@each
def test_an_array_comes_back_and_so_do_values(case: Case) -> None:
    blocked = blocked_for(case)
    graph = LatticeGraph.from_array(blocked, case.lattice)
    assert np.array_equal(graph.to_array(), blocked)
    assert np.array_equal(LatticeGraph.from_array(graph.to_array().astype(np.int8), case.lattice).free, graph.free)
    distance = dijkstra(graph, [0] * case.dim)
    shaped = graph.to_array(distance.distance)
    cells = np.argwhere(~blocked)
    assert np.array_equal(shaped[tuple(cells.T)], distance.distance_to(cells))


@each
def test_ids_are_those_of_the_matrix(case: Case) -> None:
    graph = LatticeGraph.from_array(blocked_for(case), case.lattice, first=[4] * case.dim)
    cells = graph.ids_to_cells()
    assert np.array_equal(cells, graph.ids_to_cells(np.arange(len(cells))))
    assert np.array_equal(graph.cells_to_ids(cells), np.arange(len(cells)))
    assert np.array_equal(cells[np.lexsort(cells.T[::-1])], cells)
    matrix, _ = graph.to_csr()
    start = int(graph.cells_to_ids([[4] * case.dim])[0])
    np.testing.assert_allclose(
        scipy_dijkstra(matrix, indices=start), dijkstra(graph, [4] * case.dim).distance_to(cells), rtol=1e-12
    )
    outside = np.array([[3] * case.dim, [2**40] * case.dim])
    assert graph.cells_to_ids(outside).tolist() == [-1, -1]
    for wrong in ([-1], [len(cells)], [0.5], [[0]], "a"):
        with pytest.raises(ArgumentError, match=r"integers \(M,\)"):
            graph.ids_to_cells(wrong)


@each
def test_nodes_of_networkx_have_positions_in_metres(case: Case) -> None:
    made = LatticeGraph.from_array(blocked_for(case), case.lattice).to_networkx()
    positions = nx.get_node_attributes(made, "pos")
    assert len(positions) == len(made) > 0
    for node, position in positions.items():
        np.testing.assert_allclose(position, case.lattice.basis @ node, atol=1e-12)
        assert all(type(v) is float for v in position)
    for a, b, cost in made.edges(data="weight"):
        assert cost == pytest.approx(np.linalg.norm(np.subtract(positions[a], positions[b])))


def test_the_first_axis_runs_along_x_on_squares() -> None:
    picture = np.array([[0, 0, 1], [0, 0, 0]])  # rows from the top
    graph = LatticeGraph.from_array(picture[::-1].T, "Z2")
    assert graph.cells_to_ids([[2, 1]])[0] == -1  # the right end of the upper row
    assert graph.free.sum() == 5


@pytest.mark.parametrize(
    ("array", "words"),
    [
        (np.zeros((2, 2, 2), bool), "2 axes"),
        (np.zeros((0, 2), bool), "a cell at least"),
        (np.zeros((2, 2)), "booleans or integers, not float64"),
        (np.full((2, 2), "x"), "booleans or integers"),
        ([[0, 1], [0]], "one length"),
        (5, "2 axes"),
    ],
)
def test_what_is_no_such_array_is_refused(array: Any, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        LatticeGraph.from_array(array, "A2")


def test_arrays_keep_to_the_range_of_indices() -> None:
    with pytest.raises(BoundsError):
        LatticeGraph.from_array(np.zeros((2, 2, 2), bool), "D3", first=[2**20 - 1, 0, 0])
    graph = LatticeGraph.from_array([[0, 0]], "Z2")
    with pytest.raises(ArgumentError, match="flat position"):
        graph.to_array(np.zeros(2))


@each
def test_a_field_becomes_an_array_of_the_shape_of_the_graph(case: Case) -> None:
    blocked = np.zeros((4,) * case.dim, bool)
    blocked[2] = True
    graph = LatticeGraph.from_array(blocked, case.lattice)
    field = dijkstra(graph, [0] * case.dim)
    array = field.to_array()
    assert array.shape == blocked.shape
    cells = np.argwhere(np.ones_like(blocked))
    np.testing.assert_array_equal(array[tuple(cells.T)], field.distance_to(cells + graph.first))
    assert np.isinf(array[2]).all()
    assert repr(field).startswith("<DistanceField from 1 source to ") and len(repr(field)) < 300
