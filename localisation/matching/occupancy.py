"""The occupied cells of a map, as matchers look at them: finished, or growing while it is built."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import IntArray
from hexmap.lattice.convert import LatticeLike, as_lattice
from hexmap.lattice.keys import unpack
from hexmap.maps.counter import CellCounter
from hexmap.maps.map import Map
from hexmap.maps.state_rule import StateRule
from hexmap.maps.voxel_list import VoxelList

__all__ = ["BOX_SIDE", "Occupancy"]

# Cells along a side of the box that a word of 64 bits shows.
BOX_SIDE = {2: 8, 3: 4}
_TILE_BITS = {2: 4, 3: 3}
_EMPTY = -(2**63)
_TILES = 64
# Bounds stand at every so-many-th cell, as a power of two: one in sixteen costs a search little and changes less.
_LOG_STEP = {2: 2, 3: 1}


class Occupancy:
    """Which cells are occupied, kept up to date in place: in tiles near occupied cells, wherever those are.

    A change costs 64 bits, a look-up the same however large the map is. Reading and changing at the same time needs a
    lock of the caller's.

    Examples:
        >>> import numpy as np
        >>> from hexmap import Lattice, VoxelList
        >>> from localisation.matching import Occupancy
        >>> walls = VoxelList.from_points([[0.0, 0.0], [5.0, 1.0]], Lattice.named("A2", resolution=0.1))
        >>> from localisation.matching import Occupancy
        >>> occupancy = Occupancy.of_list(walls)
        >>> occupancy.change(walls.index[:1], np.array([False]))
        >>> occupancy.contains(walls.index).tolist()
        [False, True]
    """

    def __init__(self, lattice: LatticeLike) -> None:
        """Make one without an occupied cell."""
        self.lattice = lattice = as_lattice(lattice)
        self._near = _Tiles(lattice.dim)
        self._wide: _Tiles | None = None

    def __repr__(self) -> str:
        """Show the lattice."""
        return f"<Occupancy on {self.lattice!r}>"

    @classmethod
    def of_list(cls, cells: VoxelList) -> Occupancy:
        """Return the occupancy of the cells of a list."""
        occupancy = cls(cells.lattice)
        occupancy.change(cells.index, np.ones(len(cells), np.bool_))
        return occupancy

    @classmethod
    def of_map(cls, map: Map, rule: StateRule | None = None, level: int = 0) -> Occupancy:
        """Return the occupied cells of a level of a finished map."""
        return cls.of_list(map.state(rule, level).occupied)

    @classmethod
    def of_counter(cls, counter: CellCounter, rule: StateRule | None = None) -> Occupancy:
        """Return the occupied cells of a map that is being built, by the rule that finished maps use.

        It follows the counter from now on.
        """
        occupancy = cls(counter.lattice)
        rule = rule or StateRule()
        counter.follow(lambda index, counts: occupancy.change(index, rule.occupied(counts[:, 0], counts[:, 1])))
        return occupancy

    def change(self, index: NDArray[np.integer], occupied: NDArray[np.bool_]) -> None:
        """Make each of the cells ``index`` (M, n) occupied or not, in this order."""
        from localisation.matching import _kernels as kernels

        cells = np.ascontiguousarray(index, dtype=np.int64)
        states = np.ascontiguousarray(occupied, dtype=np.bool_)
        risen = np.zeros(len(cells), np.bool_)
        row = 0
        while row < len(cells):
            row, self._near.used = kernels.change(self._near.arrays, cells, states, risen, row, self._near.used)
            if row < len(cells):
                self._near.make_room()
        if self._wide is not None:
            self._raise_bounds(self._wide, cells, risen)

    def _raise_bounds(self, wide: _Tiles, cells: IntArray, risen: NDArray[np.bool_]) -> None:
        from localisation.matching import _kernels as kernels

        row = 0
        while row < len(cells):
            row, wide.used = kernels.raise_bounds(wide.arrays, cells, risen, 1 << self.log_step, row, wide.used)
            if row < len(cells):
                wide.make_room()

    @property
    def tiles(self) -> Any:
        """The words that show the boxes of cells, for kernels; others after a change."""
        return self._near.arrays

    @property
    def bounds(self) -> Any:
        """The words that bound sums over those, for kernels; made when they are first asked for."""
        if self._wide is None:
            wide = _Tiles(self.lattice.dim)
            cells = self.cells()
            self._raise_bounds(wide, cells, np.ones(len(cells), np.bool_))
            self._wide = wide
        return self._wide.arrays

    @property
    def log_step(self) -> int:
        """Bounds stand at every 2^log_step-th cell along each axis."""
        return _LOG_STEP[self.lattice.dim]

    def cells(self) -> IntArray:
        """Return the occupied cells (M, n), in no order."""
        from localisation.matching import _kernels as kernels

        near, corners = self._near, self._near.corners()
        m = kernels.occupied_cells(near.arrays, corners, near.used, np.empty((0, self.lattice.dim), np.int64))
        out = np.empty((m, self.lattice.dim), np.int64)
        kernels.occupied_cells(near.arrays, corners, near.used, out)
        return out

    def contains(self, index: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Tell for each of the cells ``index`` (M, n) whether it is occupied."""
        from localisation.matching import _kernels as kernels

        out = np.zeros(len(index), np.bool_)
        kernels.occupied(self._near.arrays, np.ascontiguousarray(index, dtype=np.int64), out)
        return out

    @property
    def nbytes(self) -> int:
        """Bytes of all tiles."""
        return self._near.nbytes + (self._wide.nbytes if self._wide is not None else 0)


class _Tiles:
    """Words in tiles that are made when they are first needed."""

    def __init__(self, dim: int) -> None:
        from localisation.matching import _kernels as kernels

        bits = _TILE_BITS[dim]
        self.dim = dim
        self.used = 0
        self.arrays = kernels.BoxTiles(
            np.full(1024, _EMPTY, np.int64),
            np.zeros(1024, np.int64),
            np.zeros((_TILES, 1 << (bits * dim)), np.uint64),
            bits,
        )

    def make_room(self) -> None:
        """Make room for more tiles, or for their keys."""
        from hexmap.maps._counter_kernels import rehash

        t = self.arrays
        # A cell needs up to 32 tiles at once.
        if 2 * (self.used + 32) > len(t.table):
            table, numbers = np.full(2 * len(t.table), _EMPTY, np.int64), np.zeros(2 * len(t.table), np.int64)
            rehash(t.table, t.numbers, table, numbers)
            self.arrays = t._replace(table=table, numbers=numbers)
        else:
            # An array of this size grows in place, without a copy.
            t.words.resize((self.used + max(_TILES, self.used // 8), t.words.shape[1]), refcheck=False)

    def corners(self) -> IntArray:
        """Return the coordinates (T, n) of all tiles."""
        there = self.arrays.table != _EMPTY
        out = np.empty((int(there.sum()), self.dim), np.int64)
        out[self.arrays.numbers[there]] = unpack(self.arrays.table[there], self.dim)
        return out

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays."""
        return int(self.arrays.words.nbytes + self.arrays.table.nbytes + self.arrays.numbers.nbytes)


def box_offsets(dim: int) -> IntArray:
    """Return the cells (64, n) of a box from its first cell, in the order of the bits of a word."""
    side = BOX_SIDE[dim]
    return np.stack(np.unravel_index(np.arange(64), (side,) * dim), axis=1).astype(np.int64)
