"""Graphs of grids in which the whole area of an occupied cell counts: no path runs through the walls of the source."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.optimize import linprog

from hexmap.base.errors import ArgumentError
from hexmap.io.grids.grid_map import GridMap
from hexmap.lattice.lattice import Lattice
from hexmap.maps.cell_state import CellState
from planners import any_angle, astar

FREE, OCCUPIED, UNKNOWN = CellState.FREE.value, CellState.OCCUPIED.value, CellState.UNKNOWN.value
SKEWED = Lattice([[0.31, 0.13], [0.02, 0.23]], "skewed")
LATTICES = {"Z2": Lattice.named("Z2", 0.25), "A2": Lattice.named("A2", 0.25), "skewed": SKEWED}


def deepest(grid: GridMap, points: np.ndarray) -> float:
    """Return the length, in cells, of the longest piece of a line that lies in one occupied cell: by clipping."""
    c, s = np.cos(grid.yaw), np.sin(grid.yaw)
    local = (points - grid.origin) @ np.array([[c, -s], [s, c]]) / grid.cell
    longest = 0.0
    for a, b in itertools.pairwise(local):
        d = b - a
        for cell in np.argwhere(grid.states == OCCUPIED):
            t0, t1 = 0.0, 1.0
            for k in range(2):
                if abs(d[k]) < 1e-12:
                    if not cell[k] < a[k] < cell[k] + 1:
                        t1 = -1.0
                    continue
                u, v = sorted(((cell[k] - a[k]) / d[k], (cell[k] + 1 - a[k]) / d[k]))
                t0, t1 = max(t0, u), min(t1, v)
            # Along a border rounding may put a whole side inside, by 1e-16 of a cell.
            middle = a + 0.5 * (t0 + t1) * d - cell
            if t1 > t0 and min(middle.min(), (1 - middle).min()) > 1e-5:
                longest = max(longest, (t1 - t0) * float(np.hypot(*d)))
    return longest


def share_a_point(centre: np.ndarray, lattice: Lattice, grid: GridMap, cube: np.ndarray) -> bool:
    """Tell whether a cell and an occupied cell of the grid have inner points in common: a linear programme."""
    n = lattice.dim
    middle = grid.centre([cube])[0]
    axes = (grid.centre(np.eye(n) + cube) - middle) / grid.cell
    faces = lattice.cell.normals
    normals = np.concatenate([faces, axes, -axes])
    half = 0.5 * grid.cell
    limits = np.concatenate(
        [faces @ centre + 0.5 * (faces**2).sum(axis=1), axes @ middle + half, -axes @ middle + half]
    )
    # The largest t for which a point keeps t from all planes.
    found = linprog(
        [0.0] * n + [-1.0], np.column_stack([normals, np.ones(len(normals))]), limits, bounds=[(None, None)] * (n + 1)
    )
    return bool(found.x[-1] > 0.0)


def a_grid(yaw: float, origin: tuple[float, float] = (-4.03, -2.96)) -> GridMap:
    rng = np.random.default_rng(5)
    states = rng.choice(np.array([OCCUPIED, FREE], np.uint8), (16, 12), p=[0.12, 0.88])
    states[6, :9] = OCCUPIED
    states[0, 0] = states[-1, -1] = states[:2, :2] = states[-2:, -2:] = FREE
    return GridMap(states, 0.5, list(origin), yaw=yaw)


@pytest.mark.parametrize("name", LATTICES)
@pytest.mark.parametrize("yaw", [0.0, 0.4])
def test_no_path_runs_through_an_occupied_cell(name: str, yaw: float) -> None:
    grid, lattice = a_grid(yaw), LATTICES[name]
    graph = grid.to_graph(lattice, rule="area")
    a, b = lattice.quantise(grid.centre([[0.5, 0.5], [14.5, 10.5]]))
    for plan in (any_angle, astar):
        path = plan(graph, a, b)
        assert path.length > 5.0
        assert deepest(grid, path.points) < 1e-5
    # Cells whose centre is free are open but for those that reach into a wall, which by the centre they do.
    by_centre = grid.to_graph(lattice)
    assert (graph.free <= by_centre.free).all() and graph.free.sum() < by_centre.free.sum()
    assert np.array_equal(graph.clearance("cell"), by_centre.clearance("cell"))


@pytest.mark.parametrize("lattice", [*LATTICES.values(), Lattice.named("D3*", 0.9), Lattice.named("Z3", 0.9)], ids=str)
def test_the_cells_that_are_blocked_are_those_that_meet_a_wall(lattice: Lattice) -> None:
    rng = np.random.default_rng(2)
    states = rng.choice(np.array([OCCUPIED, FREE, UNKNOWN], np.uint8), (6,) * lattice.dim, p=[0.1, 0.6, 0.3])
    grid = GridMap(states, 0.8, [-2.21] * lattice.dim, yaw=0.3)
    graph = grid.to_graph(lattice, rule="area")
    walls = grid.states == OCCUPIED
    by_centre = np.flatnonzero(grid.to_graph(lattice).free)
    # Points of each cell, as weighted means of its corners, and of those which come nearest to filling it.
    corners = lattice.cell.vertices
    weights = rng.dirichlet(np.full(len(corners), 0.3), 1500)
    inside = np.concatenate([weights @ corners, 0.9999 * corners])
    for flat in by_centre:
        met = (grid.state_at(graph.centres([flat]) + inside, outside=UNKNOWN) == OCCUPIED).any()
        if met:
            assert not graph.free[flat]
        elif not graph.free[flat]:
            # Too small a corner for samples: a linear programme finds a point inside both.
            assert any(share_a_point(graph.centres([flat])[0], lattice, grid, cube) for cube in np.argwhere(walls))


def test_squares_that_nest_in_those_of_the_grid_lose_nothing() -> None:
    grid = a_grid(0.0, origin=(-4.125, -3.125))
    lattice = LATTICES["Z2"]
    assert np.array_equal(grid.to_graph(lattice, rule="area").free, grid.to_graph(lattice).free)


def test_there_are_two_rules() -> None:
    with pytest.raises(ArgumentError, match="by centre or area, not by 'corner'"):
        a_grid(0.0).to_graph("Z2", rule="corner")  # type: ignore[arg-type]
