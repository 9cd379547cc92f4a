"""The occupied cells of a map, as matchers look at them: finished, or growing while it is built."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import IntArray
from hexmap.lattice.lattice import Lattice
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


class Occupancy:
    """Which cells are occupied, kept up to date in place: in tiles near occupied cells, wherever those are.

    A change costs 64 bits, a look-up the same however large the map is. Reading and changing at the same time needs a
    lock of the caller's.

    Examples:
        >>> import numpy as np
        >>> from hexmap import Lattice, VoxelList
        >>> walls = VoxelList.from_points([[0.0, 0.0], [5.0, 1.0]], Lattice.named("A2", resolution=0.1))
        >>> occupancy = Occupancy.of_list(walls)
        >>> occupancy.change(walls.index[:1], np.array([False]))
        >>> occupancy.contains(walls.index).tolist()
        [False, True]
    """

    def __init__(self, lattice: Lattice) -> None:
        """Make one without an occupied cell."""
        from localisation.matching import _kernels as kernels

        self.lattice = lattice
        bits = _TILE_BITS[lattice.dim]
        # The tiles, for kernels: they may be others after a change.
        self.tiles = kernels.BoxTiles(
            np.full(1024, _EMPTY, np.int64),
            np.zeros(1024, np.int64),
            np.zeros((_TILES, 1 << (bits * lattice.dim)), np.uint64),
            bits,
        )
        self._used = 0

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
        from hexmap.maps._counter_kernels import rehash
        from localisation.matching import _kernels as kernels

        cells = np.ascontiguousarray(index, dtype=np.int64)
        row = 0
        while row < len(cells):
            row, self._used = kernels.change(self.tiles, cells, occupied, row, self._used)
            if row == len(cells):
                return
            t = self.tiles
            if 2 * self._used + 16 > len(t.table):
                table, numbers = np.full(2 * len(t.table), _EMPTY, np.int64), np.zeros(2 * len(t.table), np.int64)
                rehash(t.table, t.numbers, table, numbers)
                self.tiles = t._replace(table=table, numbers=numbers)
            else:
                # An array of this size grows in place, without a copy.
                t.words.resize((self._used + max(_TILES, self._used // 8), t.words.shape[1]), refcheck=False)

    def contains(self, index: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Tell for each of the cells ``index`` (M, n) whether it is occupied."""
        from localisation.matching import _kernels as kernels

        out = np.zeros(len(index), np.bool_)
        kernels.occupied(self.tiles, np.ascontiguousarray(index, dtype=np.int64), out)
        return out

    @property
    def nbytes(self) -> int:
        """Bytes of the tiles."""
        return int(self.tiles.words.nbytes + self.tiles.table.nbytes + self.tiles.numbers.nbytes)


def box_offsets(dim: int) -> IntArray:
    """Return the cells (64, n) of a box from its first cell, in the order of the bits of a word."""
    side = BOX_SIDE[dim]
    return np.stack(np.unravel_index(np.arange(64), (side,) * dim), axis=1).astype(np.int64)
