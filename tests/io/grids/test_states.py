"""Maps of others as occupied and free cells of any lattice."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError, BoundsError, LatticeError
from hexmap.io.grids import grid_map
from hexmap.io.grids.grid_map import GridMap
from hexmap.io.grids.open_grid import open_grid
from hexmap.lattice.lattice import Lattice
from hexmap.maps.cell_state import CellState
from tests.lattices import ALL, CASES, JIT, SHEARED, Case

UNKNOWN, FREE, OCCUPIED = CellState


def random_grid(rng: np.random.Generator, shape: tuple[int, ...], cell: float, yaw: float = 0.0) -> GridMap:
    states = rng.choice(np.array([OCCUPIED, FREE, FREE, UNKNOWN], np.uint8), shape)
    return GridMap(states, cell, rng.uniform(-1.0, 1.0, len(shape)), yaw=yaw)


def slow_states(grid: GridMap, lattice: Lattice) -> tuple[set, set]:
    """Occupied and free cells, cell by cell and sample by sample, as the docstring has it."""
    n = grid.dim
    width = 2.0 * lattice.inradius
    parts = 1
    while grid.cell / parts > 0.5 * min(grid.cell, width) * (1.0 + 1e-9):
        parts += 1
    along = [min(max(k / parts, 1e-6), 1.0 - 1e-6) for k in range(parts + 1)]
    occupied, free = set(), set()
    for cell in itertools.product(*map(range, grid.states.shape)):
        if grid.states[cell] == OCCUPIED:
            for sample in itertools.product(along, repeat=n):
                point = grid.centre([[c + s - 0.5 for c, s in zip(cell, sample, strict=True)]])
                occupied.add(tuple(lattice.quantise(point)[0].tolist()))
    # All cells that can have their centre in the grid.
    corners = np.array(list(itertools.product(*zip(grid.low, grid.high, strict=True))))
    u = corners @ np.linalg.inv(lattice.basis).T
    ranges = [range(math.floor(a), math.ceil(b) + 1) for a, b in zip(u.min(axis=0), u.max(axis=0), strict=True)]
    for index in itertools.product(*ranges):
        centre = lattice.centres(np.array([index]))
        if index not in occupied and grid.state_at(centre, outside=UNKNOWN)[0] == FREE:
            free.add(index)
    return occupied, free


@pytest.mark.parametrize("case", [*CASES, *SHEARED], ids=str)
@pytest.mark.parametrize(("ratio", "yaw"), [(1.0, 0.0), (0.6, 0.4), (2.7, -2.0)])
def test_cells_are_those_of_the_slow_reference(case: Case, ratio: float, yaw: float) -> None:
    rng = np.random.default_rng(3)
    shape = (7, 5) if case.dim == 2 else (4, 3, 3)
    # Cells of the grid as large as those of the lattice, smaller and larger.
    grid = random_grid(rng, shape, ratio * case.lattice.resolution, yaw)
    states = grid.to_states(case.lattice)
    occupied, free = slow_states(grid, case.lattice)
    assert {tuple(i) for i in states.occupied.index.tolist()} == occupied
    assert {tuple(i) for i in states.free.index.tolist()} == free
    assert not states.free.contains(states.occupied.index).any()
    assert (states.occupied.counts == 1).all() and (states.free.counts == 1).all()


@pytest.mark.parametrize("dim", [2, 3])
def test_the_grid_s_own_cells_come_back_index_for_index(dim: int) -> None:
    rng = np.random.default_rng(6)
    values = rng.choice(np.array([OCCUPIED, FREE, UNKNOWN], np.uint8), (9, 8, 7)[:dim])
    grid = GridMap(values, 0.1, [-0.05] * dim)
    states = grid.to_states()
    assert states.occupied.lattice == Lattice.named(f"Z{dim}", 0.1)
    assert np.array_equal(states.occupied.index, np.argwhere(values == OCCUPIED))
    assert np.array_equal(states.free.index, np.argwhere(values == FREE))
    assert grid.to_states(f"Z{dim}").free == states.free


@pytest.mark.parametrize("case", [case for case in ALL if case.dim == 2], ids=str)
def test_a_wall_has_no_gap_on_any_lattice(case: Case) -> None:
    values = np.full((60, 40), FREE, np.uint8)
    values[:, 17] = OCCUPIED
    grid = GridMap(values, 0.8 * case.lattice.resolution, [0.03, -0.02], yaw=0.35)
    states = grid.to_states(case.lattice)
    points = grid.centre(np.column_stack([np.linspace(0.0, 59.0, 4000), np.full(4000, 17.0)]))
    assert states.occupied.contains(case.lattice.quantise(points)).all()


def test_pieces_make_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    grid = random_grid(np.random.default_rng(1), (40, 30), 0.1, yaw=0.2)
    lattice = Lattice.named("A2", 0.07)
    whole = grid.to_states(lattice)
    monkeypatch.setattr(grid_map, "_SAMPLES_AT_ONCE", 50)
    pieces = grid.to_states(lattice)
    assert pieces.occupied == whole.occupied and pieces.free == whole.free


def test_a_grid_without_walls_or_without_free_cells() -> None:
    for state, occupied, free in ((OCCUPIED, 4, 0), (FREE, 0, 4), (UNKNOWN, 0, 0)):
        states = GridMap(np.full((2, 2), state, np.uint8), 1.0, [-0.5, -0.5]).to_states("Z2")
        assert (len(states.occupied), len(states.free)) == (occupied, free)


def test_wrong_lattices_are_refused() -> None:
    grid = GridMap(np.full((2, 2), OCCUPIED, np.uint8), 1.0, [0, 0])
    with pytest.raises(ArgumentError, match="a grid of dimension 2 does not fit D3, of dimension 3"):
        grid.to_states("D3")
    with pytest.raises(LatticeError, match="Q7"):
        grid.to_states("Q7")
    with pytest.raises(BoundsError):
        GridMap(grid.states, 1.0, [1e12, 0]).to_states("A2")


@pytest.mark.data
@pytest.mark.skipif(not JIT, reason="takes minutes without the compiler")
@pytest.mark.parametrize("name", ["Z3", "D3", "D3*"])
def test_an_octomap_of_a_real_place(data_dir: Path, name: str) -> None:
    grid = open_grid(data_dir / "maps" / "geb079.bt")
    states = grid.to_states(name)
    assert len(states.occupied) >= 185_673 and len(states.free) > 0.7 * 950_759
    # Every cell that is said to be free has its centre in a free cell of the grid.
    assert grid.free_at(states.free.centres()).all()
