"""Maps in space in the formats of others: octrees, bands of heights, points; what is lost is counted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError, BoundsError
from hexmap.io.clouds.read_points import read_points
from hexmap.io.exports import export
from hexmap.io.grids.open_grid import open_grid
from hexmap.io.octomap_export import export_octomap, octree
from hexmap.lattice.lattice import Lattice
from hexmap.maps.cell_state import CellState
from hexmap.maps.cubes import cubes_of
from hexmap.maps.state_rule import States
from hexmap.maps.voxel_list import VoxelList
from tests.lattices import SPATIAL, Case
from tests.mapping import room_in_space

NAMES = ("Z3", "D3", "D3*", "A2xZ")


def some_states(lattice: Lattice, seed: int = 0) -> States:
    """Occupied and free cells of a ball, a third of them unknown."""
    cells = lattice.disk([3, -2, 1], 4)
    kind = np.random.default_rng(seed).integers(0, 3, len(cells))
    return States(*(VoxelList.from_cells(cells[kind == k], lattice) for k in (1, 2)))


def reference_cubes(states: States, edge: float) -> dict[tuple[int, ...], CellState]:
    """The rule word by word: every cube near a known cell is asked."""
    lattice = states.occupied.lattice
    holding: dict[tuple[int, ...], set[CellState]] = {}
    for cells, state in ((states.occupied, CellState.OCCUPIED), (states.free, CellState.FREE)):
        for centre in cells.centres():
            at = tuple(np.floor(np.rint(centre / edge * 2.0**32) / 2.0**32).astype(int).tolist())
            holding.setdefault(at, set()).add(state)
    low, high = np.min(list(holding), axis=0) - 3, np.max(list(holding), axis=0) + 4
    for at in np.ndindex(*(high - low)):
        cube = tuple((np.array(at) + low).tolist())
        (state,) = states.of(lattice.quantise([(np.array(cube) + 0.5) * edge]))
        if state != CellState.UNKNOWN:
            holding.setdefault(cube, set()).add(CellState(int(state)))
    return {c: CellState.OCCUPIED if CellState.OCCUPIED in kinds else CellState.FREE for c, kinds in holding.items()}


@pytest.mark.parametrize("case", SPATIAL, ids=str)
def test_cubes_are_what_the_rule_says(case: Case) -> None:
    states = some_states(case.lattice)
    cubes = cubes_of(states)
    found = {tuple(c): CellState.OCCUPIED for c in cubes.occupied.tolist()}
    found |= {tuple(c): CellState.FREE for c in cubes.free.tolist()}
    assert len(found) == len(cubes.occupied) + len(cubes.free)
    assert found == reference_cubes(states, cubes.edge)


def test_cubes_of_cubes_lose_nothing() -> None:
    states = some_states(Lattice.named("Z3", 0.1))
    cubes = cubes_of(states)
    assert np.array_equal(cubes.occupied, states.occupied.index) and np.array_equal(cubes.free, states.free.index)
    assert (cubes.shared, cubes.buried) == (0, 0) and "lost: 0 occupied cells" in cubes.words()


@pytest.mark.parametrize("name", NAMES)
def test_an_octree_is_read_back_voxel_by_voxel(name: str, tmp_path: Path) -> None:
    made = room_in_space(Lattice.named(name, 0.125))
    cubes = export_octomap(made.state(), tmp_path / "a.bt")
    grid = open_grid(tmp_path / "a.bt")
    assert grid.cell == cubes.edge and np.count_nonzero(grid.states) <= grid.states.size
    for cells, state in ((cubes.occupied, CellState.OCCUPIED), (cubes.free, CellState.FREE)):
        assert np.count_nonzero(grid.states == state.value) == len(cells) > 0
        assert (grid.state_at((cells + 0.5) * cubes.edge) == state).all()
    # Air in the room takes few nodes: blocks of eight are one.
    nodes = int((tmp_path / "a.bt").read_bytes().split(b"size ")[1].split(b"\n")[0])
    assert nodes < 0.8 * (len(cubes.occupied) + len(cubes.free))


def walk(words: NDArray[np.uint16]) -> tuple[int, dict[tuple[int, int, int], int]]:
    """Nodes and voxels of an octree, by the description of the format, one child after the other."""
    leaves: dict[tuple[int, int, int], int] = {}
    position = 0

    def node(depth: int, x: int, y: int, z: int) -> int:
        nonlocal position
        word = int(words[position])
        position += 1
        count, side = 1, 1 << (15 - depth)
        for child in range(8):
            kind = word >> 2 * child & 3
            at = (x + side * (child & 1), y + side * (child >> 1 & 1), z + side * (child >> 2 & 1))
            if kind == 3:
                count += node(depth + 1, *at)
            elif kind:
                count += 1
                for i, j, k in np.ndindex(side, side, side):
                    leaves[at[0] + i, at[1] + j, at[2] + k] = kind
        return count

    nodes = node(0, 0, 0, 0)
    assert position == len(words)
    return nodes, leaves


def test_an_octree_is_pruned_and_holds_every_voxel_once() -> None:
    block = np.argwhere(np.ones((8, 8, 8))) + 32768
    lone = np.array([[0, 0, 0], [65535, 65535, 65535], [32767, 32768, 5]])
    nodes, words = octree(np.vstack([block[block[:, 0] < 32772], lone]), block[block[:, 0] >= 32772])
    found, leaves = walk(words)
    assert found == nodes and len(leaves) == 515
    assert all(leaves[tuple(v)] == (2 if v[0] < 32772 else 1) for v in block.tolist())
    assert all(leaves[tuple(v)] == 2 for v in lone.tolist())
    # The block is one inner node with eight leaves.
    assert 0b1001_1001_1001_1001 in words.tolist() or 0b0110_0110_0110_0110 in words.tolist()
    assert octree(np.empty((0, 3), np.int64), np.empty((0, 3), np.int64))[0] == 0


def test_what_an_octree_cannot_hold(tmp_path: Path) -> None:
    lattice = Lattice.named("D3", 0.1)
    far = States(VoxelList.from_points([[4000.0, 0.0, 0.0]], lattice), VoxelList.empty(lattice))
    with pytest.raises(BoundsError, match=r"far\.bt: an OctoMap with voxels of 0\.1 m ends 3276\.8 m .* 3999\.9"):
        export_octomap(far, tmp_path / "far.bt")
    flat = VoxelList.from_points([[0.0, 0.0]], Lattice.named("A2", 0.1))
    with pytest.raises(ArgumentError, match="an OctoMap is in space"):
        export_octomap(States(flat, VoxelList.empty(flat.lattice)), tmp_path / "flat.bt")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", NAMES)
def test_a_band_of_heights_becomes_a_map_to_drive_in(name: str, tmp_path: Path) -> None:
    made = room_in_space(Lattice.named(name, 0.1), beams=60_000)
    said: list[str] = []
    paths = export(made, tmp_path / "band.yaml", heights=(0.3, 1.5), report=said.append)
    assert [p.name for p in paths] == ["band.yaml", "band.pgm"]
    assert len(said) == 1 and said[0].startswith("heights from 0.3 to 1.5 m: ")
    grid = open_grid(tmp_path / "band.yaml")
    middle = np.array([[-1.5, -0.7], [0.0, 0.8], [1.7, -0.5], [-0.5, 0.0], [0.0, -1.0]])
    assert (grid.state_at(middle) == CellState.FREE).all()
    # The walls and the pillar; beyond the walls nothing was seen.
    y = np.arange(-1.35, 1.4, 0.1)
    beside = np.stack([np.stack([np.full(len(y), 2.5 + d), y], axis=1) for d in (-0.05, 0.0, 0.05)])
    assert (grid.state_at(beside.reshape(-1, 2)).reshape(3, -1) == CellState.OCCUPIED).any(axis=0).all()
    pillar = np.array([[0.6 + d, 0.0] for d in (-0.08, 0.0, 0.08)])
    assert (grid.state_at(pillar) == CellState.OCCUPIED).any()
    assert (grid.state_at([[0.8, 0.0]]) == CellState.UNKNOWN).all()
    with pytest.raises(ArgumentError, match=r"from a lower one to a higher one, not 2 to 1 m"):
        export(made, tmp_path / "x.yaml", heights=(2.0, 1.0))
    with pytest.raises(ArgumentError, match=r"no known cell lies between 50 and 60 m"):
        export(made, tmp_path / "x.yaml", heights=(50.0, 60.0))
    with pytest.raises(ArgumentError, match=r"is for a ROS map \(\.yaml\), not for \.bt"):
        export(made, tmp_path / "x.bt", heights=(0.0, 1.0))


def test_points_for_pcl(tmp_path: Path) -> None:
    made = room_in_space(Lattice.named("D3", 0.2))
    (path,) = export(made, tmp_path / "a.pcd")
    occupied = made.state().occupied
    assert np.allclose(read_points(path).points, occupied.centres(), atol=1e-6)
    assert np.array_equal(np.frombuffer(path.read_bytes()[-16 * len(occupied) :], "<u4")[3::4], occupied.counts)
