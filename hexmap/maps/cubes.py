"""A map's cells as cubes, for programs that know no other grid, and what is lost on the way."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError
from hexmap.base.values import one_line
from hexmap.lattice.keys import KeyArray, pack, unpack
from hexmap.lattice.lattice import Lattice
from hexmap.maps.state_rule import States
from hexmap.maps.voxel_list import VoxelList

__all__ = ["Cubes", "cubes_of"]

_FINE = 2.0**32  # parts of a cube that quotients are rounded to, so that ties fall the same way everywhere
_AT_ONCE = 1 << 20


@dataclass(frozen=True, eq=False)
class Cubes:
    """Occupied and free cubes; the cube i holds the points [i edge, (i + 1) edge) along each axis.

    Attributes:
        edge: metres.
        occupied: (A, 3) int64, lexicographically.
        free: (B, 3) int64, lexicographically; none of them is occupied.
        cells: how many occupied and free cells of the lattice there were.
        shared: how many of the occupied cells have their centre in the cube of another one.
        buried: how many of the free cells have their centre in an occupied cube.
    """

    edge: float
    occupied: NDArray[np.int64]
    free: NDArray[np.int64]
    cells: tuple[int, int]
    shared: int
    buried: int

    __repr__ = one_line

    def words(self) -> str:
        """Say in a line what the cubes lose of the cells."""
        return (
            f"{self.cells[0]:,} occupied and {self.cells[1]:,} free cells became {len(self.occupied):,} and "
            f"{len(self.free):,} cubes of {self.edge:g} m; lost: {self.shared:,} occupied cells that share a cube with "
            f"another, {self.buried:,} free cells in occupied cubes, hits and passes of all"
        )


def cubes_of(states: States, edge: float | None = None) -> Cubes:
    """Return the cubes that the cells of a map in space fill.

    A cube is occupied where the centre of an occupied cell lies in it or its own centre lies in an occupied cell, so
    that a wall without holes stays one; it is free where it is not occupied and the same holds for a free cell.

    Args:
        states: the occupied and free cells.
        edge: of a cube, metres; the lattice's resolution where none is given, so that a cube is as large as a cell.

    Raises:
        ArgumentError: the map is in the plane, or the edge is not positive.
        BoundsError: a cube leaves the range of indices.
    """
    lattice = states.occupied.lattice
    if lattice.dim != 3:
        raise ArgumentError(f"only cells in space become cubes; {lattice.name} is a lattice of the plane")
    # Twelve digits are what files say, so they are also what is computed with.
    edge = float(f"{lattice.resolution if edge is None else edge:.12g}")
    if not 0.0 < edge < float("inf"):
        raise ArgumentError(f"the edge of a cube must be a positive number of metres, not {edge}")
    grid = Lattice(np.eye(3) * edge)
    of_occupied = _cubes_at(states.occupied.centres(), grid, edge)
    of_free = _cubes_at(states.free.centres(), grid, edge)
    distinct = _distinct(of_occupied)
    occupied = _distinct(np.concatenate([distinct, _around(states.occupied, grid, edge)]))
    free = _distinct(np.concatenate([of_free, _around(states.free, grid, edge)]))
    return Cubes(
        edge,
        unpack(occupied, 3).astype(np.int64),
        unpack(free[~_contains(occupied, free)], 3).astype(np.int64),
        (len(states.occupied), len(states.free)),
        len(of_occupied) - len(distinct),
        int(np.count_nonzero(_contains(occupied, of_free))),
    )


def _cubes_at(points: FloatArray, grid: Lattice, edge: float) -> KeyArray:
    """Return the keys (N,) of the cubes that points (N, 3), metres, lie in."""
    index = np.floor(np.rint(points / edge * _FINE) / _FINE).astype(np.int64)
    return pack(grid.check_index(index))


def _around(cells: VoxelList, grid: Lattice, edge: float) -> KeyArray:
    """Return the keys of the cubes whose own centre lies in one of the cells."""
    lattice = cells.lattice
    reach = lattice.covering_radius * (1.0 + 1e-9)
    # Cube centres within reach of a cell's centre are so many steps from the cube that the cell's centre lies in.
    steps = np.arange(-1 - int(reach / edge), 2 + int(reach / edge))
    found = []
    for begin in range(0, len(cells), _AT_ONCE):
        part = VoxelList(lattice, cells.keys[begin : begin + _AT_ONCE], cells.counts[begin : begin + _AT_ONCE])
        centres = part.centres()
        base = np.floor(centres / edge)
        # Squared distances along each axis, once for each step.
        apart = [((base + step + 0.5) * edge - centres) ** 2 for step in steps]
        for i, j, k in itertools.product(range(len(steps)), repeat=3):
            near = np.flatnonzero(apart[i][:, 0] + apart[j][:, 1] + apart[k][:, 2] <= reach**2)
            if len(near) == 0:
                continue
            cubes = base[near] + steps[[i, j, k]]
            inside = pack(lattice.quantise((cubes + 0.5) * edge)) == part.keys[near]
            found.append(pack(grid.check_index(cubes[inside].astype(np.int64))))
    return np.concatenate(found) if found else np.empty(0, np.int64)


def _distinct(keys: KeyArray) -> KeyArray:
    """Return the different keys, sorted."""
    ordered = np.sort(keys)
    return ordered[np.diff(ordered, prepend=ordered[:1] - 1) != 0]


def _contains(keys: KeyArray, wanted: KeyArray) -> NDArray[np.bool_]:
    """Tell which of ``wanted`` (N,) are among the sorted ``keys``."""
    if len(keys) == 0:
        return np.zeros(len(wanted), np.bool_)
    return np.asarray(keys[np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)] == wanted)
