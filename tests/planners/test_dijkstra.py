"""Dijkstra's fields against a slow search with the same sums: equal to the last bit on every lattice."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hexmap.graph.lattice_graph import LatticeGraph, Neighbourhood
from hexmap.lattice.lattice import Lattice
from planners import dijkstra
from planners.search import _bucket_kernels, _dijkstra_kernels
from planners.search.dijkstra import field_kernel
from tests.lattices import CASES, EXAMPLES, JIT, Case
from tests.reference import least_costs


def random_graph(
    case: Case, neighbourhood: Neighbourhood, seed: int, obstacles: float, terrain: bool, side: int
) -> LatticeGraph:
    """A random window around a random index."""
    rng = np.random.default_rng(seed)
    shape = rng.integers(1, side, case.dim, endpoint=True)
    free = rng.random(shape) >= obstacles
    low = rng.integers(-20, 20, case.dim)
    graph = LatticeGraph.from_states(case.lattice, low, free, neighbourhood=neighbourhood)
    return graph.with_terrain(rng.uniform(0.5, 9.0, shape)) if terrain else graph


def largest(lattice: Lattice) -> int:
    """A neighbourhood of more moves than three bytes have bits, longer than twice the shortest in the plane."""
    return min(size for size in lattice.shell_sizes if size > 24)


@pytest.mark.parametrize("case", CASES, ids=str)
@pytest.mark.parametrize("terrain", [False, True], ids=["plain", "terrain"])
@settings(max_examples=max(EXAMPLES // 4, 2), deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    obstacles=st.sampled_from([0.0, 0.1, 0.3]),
    neighbourhood=st.sampled_from(["nearest", "extended", "extended", "large"]),
)
def test_fields_are_those_of_the_slow_search_to_the_last_bit(
    case: Case, terrain: bool, seed: int, obstacles: float, neighbourhood: Neighbourhood
) -> None:
    side = (30 if case.dim == 2 else 9) if JIT else 6
    shells = largest(case.lattice) if neighbourhood == "large" else neighbourhood
    graph = random_graph(case, shells, seed, obstacles, terrain, side)
    free = np.flatnonzero(graph.free)
    if len(free) == 0:
        return
    rng = np.random.default_rng(seed)
    flat = rng.choice(free, 5)
    cells = graph.flat_to_index(flat)
    expected = least_costs(graph, flat[:2].tolist())
    field = dijkstra(graph, cells[:2])
    if field.steps is not None:  # moves are counted, and their number is multiplied instead of added up
        np.testing.assert_allclose(field.distance, expected, rtol=1e-12)
        expected = field.distance
    assert (field.distance == expected).all()
    assert field.settled == np.isfinite(expected).sum() <= field.pushes
    # Up to a limit that is the cost of a cell itself, and to goals: what is finite is final.
    limit = float(np.quantile(expected[np.isfinite(expected)], 0.5, method="nearest"))
    near = dijkstra(graph, cells[:2], limit=limit)
    assert (near.distance == np.where(expected <= limit * (1 + 1e-12), expected, np.inf)).all()
    early = dijkstra(graph, cells[:2], goals=cells[2:])
    final = np.isfinite(early.distance)
    assert (early.distance[final] == expected[final]).all()
    assert (early.distance_to(cells) == expected[flat]).all()


@pytest.mark.skipif(not JIT, reason="large windows")
@pytest.mark.parametrize(
    ("name", "size", "shape"),
    [("Z2", 8, (300, 301)), ("A2", 12, (300, 301)), ("Z3", 26, (40, 41, 42)), ("D3", 18, (40, 41, 42)),
     ("D3*", 14, (40, 41, 42))],
)  # fmt: skip
def test_large_fields_from_many_cells_are_the_same_in_a_ring_and_in_lists(
    name: str, size: int, shape: tuple[int, ...]
) -> None:
    """More sources, and more cells in a bucket, than either begins with room for."""
    rng = np.random.default_rng(0)
    lattice = Lattice.named(name)
    graph = LatticeGraph.from_states(lattice, [0] * lattice.dim, rng.random(shape) >= 0.2, neighbourhood=size)
    assert field_kernel(graph) is _bucket_kernels.ring
    # Terrain of one everywhere costs the same, and is searched by the other kernel.
    same = graph.with_terrain(np.ones(shape))
    assert field_kernel(same) is _dijkstra_kernels.buckets
    free = np.flatnonzero(graph.free)
    for count in (1, 6000):
        cells = graph.flat_to_index(rng.choice(free, count, replace=False))
        field = dijkstra(graph, cells)
        assert (field.distance == dijkstra(same, cells).distance).all()
        assert field.settled == np.isfinite(field.distance).sum()


def test_moves_of_very_different_lengths_are_exact_too() -> None:
    """A basis whose cells are a hundred times as long as wide: a ring of that many buckets is not made."""
    for stretch, ring in ((20.0, True), (200.0, False)):
        lattice = Lattice(np.array([[1.0, 0.3], [0.0, stretch]]))
        size = next(s for s in lattice.shell_sizes if np.abs(lattice.shell(s)[:, 1]).max() > 0)
        rng = np.random.default_rng(3)
        graph = LatticeGraph.from_states(lattice, [0, 0], rng.random((60, 8)) >= 0.1, neighbourhood=size)
        assert (field_kernel(graph) is _bucket_kernels.ring) == ring
        source = int(np.flatnonzero(graph.free)[0])
        field = dijkstra(graph, graph.flat_to_index(np.array([source])))
        assert (field.distance == least_costs(graph, [source])).all()
