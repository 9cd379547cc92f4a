"""Weights of a map's cells with their maxima over boxes, so that a search can bound the scores of many poses at once.

No coarse hexagon is made of finer ones, so a coarser level of a map bounds nothing. A sliding maximum over boxes of
lattice indices does, on every lattice, because a lattice in its own basis is Z^n.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.base.errors import ArgumentError, TooLargeError
from hexmap.base.sparse_arrays import sparse_zeros
from hexmap.lattice.lattice import Lattice
from hexmap.maps.voxel_list import VoxelList
from localisation.matching.occupancy import Occupancy
from localisation.matching.sheets import Sheet, make_sheet

__all__ = [
    "FARTHEST_PART",
    "MOST_WEIGHT",
    "PARTS",
    "OccupancyPyramid",
    "Tables",
    "cell_reach",
    "level_windows",
    "most_motion",
    "most_spread",
]

# Tiles of 1024 or 4096 entries, in the plane one page of memory: those that are never written cost nothing.
_TILE_BITS = {2: 5, 3: 4}
_MOST_ENTRIES = 1 << 31
# Tables are in small pages from so many bytes on where cells lie in fewer than one of so many tiles: large pages would
# hold them whole. A submap that sees far over open ground touches a fifth of its tables.
_SPARSE, _FEW = 1 << 20, 2
MOST_WEIGHT = 65535
PARTS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""What the points of a scan move, as parts of what its median point does, for which there are boxes."""
FARTHEST_PART = PARTS[-1]
# Up to this level, by dimension; in space low levels are most of the search.
_LOWEST = {2: 2, 3: 0}
# Sheets are made for reaches in whole steps of so many indices, so that scans share them.
_MARGIN = 128


class Tables(NamedTuple):
    """The pyramid as the kernels see it; an index is counted from ``low``, and there are ``length`` an axis.

    Attributes:
        cells: flat uint16, the weight of each cell.
        cell_address: (n * length,) int32, what an index adds to the flat address in ``cells``, axis by axis.
        packed: flat; an entry holds the maxima over 2^n boxes, a byte each.
        address: (T * n * length,) int32, the same for the tables in ``packed``.
        windows: (levels, V) indices along an axis of the boxes of each level's tables, ascending.
        low: (n,) the index that stands first.
        length: indices an axis.
        unit: weight that one of a byte stands for.
        most: the largest weight.
    """

    cells: NDArray[np.uint16]
    cell_address: NDArray[np.int32]
    packed: NDArray[Any]
    address: NDArray[np.int32]
    windows: IntArray
    low: IntArray
    length: int
    unit: int
    most: int


class _Grid(NamedTuple):
    """The layout of one table: entries from ``first`` on, ``shape`` of them, at every ``step``-th index, in tiles."""

    window: int
    apart: int
    step: int
    first: IntArray
    shape: IntArray
    tiles: IntArray


def most_spread(lattice: Lattice, level: int, part: float = FARTHEST_PART) -> int:
    """Return over how many indices along an axis a moving point may reach at a level of the search.

    A cell reaches ``2 h`` along each axis, h the extent of the Voronoi cell in lattice coordinates; the arc of a point
    over the angles of a node at most ``part`` times :func:`most_motion`, and in space its sway over the node's tilts as
    much again.
    """
    moves = 1 if lattice.dim == 2 else 2
    return math.floor(2.0 * float(cell_reach(lattice).max()) + moves * part * most_motion(level) + 1e-6) + 1


def most_motion(level: int) -> float:
    """Return how many indices the rotations of a node may move the median point of a scan.

    Half of its block, one at the lowest levels. Points farther away have boxes of their own, nearer ones too.
    """
    return max(1.0, 0.5 * (1 << level))


def cell_reach(lattice: Lattice) -> FloatArray:
    """Return h (n,): how far the Voronoi cell reaches from its centre along each axis, in lattice coordinates."""
    return np.asarray((lattice.cell.vertices @ np.linalg.inv(lattice.basis).T).max(axis=0))


def level_windows(lattice: Lattice, level: int) -> tuple[int, ...]:
    """Return the boxes of a level's tables: one for each of :data:`PARTS` of what the median point moves.

    On the lowest levels, where tables are largest and points move by a cell or two, the smallest boxes are left out.
    """
    parts = [max(part, 1.0) if level <= _LOWEST[lattice.dim] else part for part in PARTS]
    return tuple((1 << level) - 1 + most_spread(lattice, level, part) for part in parts)


class OccupancyPyramid:
    """One non-negative whole number a cell, and the largest of them in boxes of 1, 2, 3, 4, 6, 8, ... indices.

    A table of level k serves blocks of 2^k shifts of points that themselves reach over some cells: its boxes hold 2^k
    indices along each axis and up to ``spread[k]`` - 1 more. An entry packs the boxes of the 2^n blocks that make up a
    block of level k + 1, so that one look-up bounds them all. Entries of the higher levels stand at every second,
    fourth, ... place only, and their boxes hold that much more: an upper bound stays one.

    Args:
        cells: the cells, with their weights as counts.
        levels: how many levels of blocks; None: as many as a search over the whole map wants.

    Raises:
        TooLargeError: the box around the cells has more entries than can be addressed.
        ArgumentError: a weight is larger than 65,535.
    """

    def __init__(self, cells: VoxelList, levels: int | None = None) -> None:
        """Build all tables."""
        from localisation.matching import _pyramid_kernels as kernels

        self.lattice: Lattice = cells.lattice
        self._source = cells
        n = self.lattice.dim
        index = cells.index.astype(np.int64)
        weights = np.asarray(cells.counts)
        self.most = int(weights.max()) if len(weights) else 0
        if self.most > MOST_WEIGHT:
            raise ArgumentError(f"a weight of {self.most:,} is more than {MOST_WEIGHT:,}")
        # A byte holds 255 steps; larger weights are rounded up to whole steps in the bounds, never in the score.
        self.unit = max(1, -(-self.most // 255))
        self.low = index.min(axis=0) if len(index) else np.zeros(n, np.int64)
        self.high = index.max(axis=0) if len(index) else np.zeros(n, np.int64)
        shape = self.high - self.low + 1
        if levels is None:
            levels = min(9, max(2, int(shape.max()).bit_length() - 3))
        self.levels = levels
        self._cell_grid = self._grid(1, 0, shape)
        # Equal boxes of a level share a table.
        wanted = [(k, window) for k in range(levels) for window in level_windows(self.lattice, k)]
        tables = list(dict.fromkeys(wanted))
        self._table_of = [tables.index(table) for table in wanted]
        self._grids = [self._grid(window, 1 << k, shape) for k, window in tables]
        self._windows = np.array([window for _, window in wanted]).reshape(-1, len(PARTS))
        sizes = [self._size(grid) for grid in self._grids]
        if sum(sizes) >= _MOST_ENTRIES:
            raise TooLargeError(
                f"a map over {' x '.join(str(s) for s in shape)} cells needs a pyramid of {sum(sizes):,} entries, more "
                f"than {_MOST_ENTRIES:,}; take a coarser level"
            )
        self._starts = np.cumsum([0, *sizes[:-1]]).tolist()
        addresses = self._addresses(self._cell_grid)
        large = self._sparse_from(index)
        self.cells = sparse_zeros(self._size(self._cell_grid), np.uint16, large)
        self.packed = sparse_zeros(sum(sizes), np.uint32 if n == 2 else np.uint64, large)
        kernels.raise_cells(index, weights.astype(np.uint16), self.low, addresses, self.cells)
        steps = (-(-weights // self.unit)).astype(np.uint8)
        for grid, start in zip(self._grids, self._starts, strict=True):
            values = self.packed[start : start + self._size(grid)]
            kernels.raise_entries(
                index, steps, self.low, grid.apart, grid.step, grid.window, grid.first, self._addresses(grid), values
            )
        self._tables: dict[int, Tables] = {}
        self._sheets: dict[int, Sheet] = {}

    def __repr__(self) -> str:
        """Say how many cells it bounds."""
        return f"<OccupancyPyramid of {len(self._source)} cells, {self.levels} levels on {self.lattice!r}>"

    def _grid(self, window: int, apart: int, shape: IntArray) -> _Grid:
        step = max(1, apart // 4)
        reach = window + step - 2 + apart
        first = np.full(len(shape), -(reach // step))
        count = (shape - 1) // step - first + 1
        side = 1 << _TILE_BITS[len(shape)]
        # One tile more along each axis: it stays empty, and everything outside has its address there.
        return _Grid(window, apart, step, first, count, -(-count // side) + 1)

    def _sparse_from(self, index: IntArray) -> int | None:
        """Return from how many bytes on tables are in small pages: at once where most tiles stay empty."""
        tiles = np.unique((index - self.low) >> _TILE_BITS[self.lattice.dim], axis=0)
        return _SPARSE if len(tiles) * _FEW < math.prod(int(t) for t in self._cell_grid.tiles) else None

    @staticmethod
    def _size(grid: _Grid) -> int:
        n = len(grid.shape)
        return math.prod(int(t) for t in grid.tiles) << (_TILE_BITS[n] * n)

    @staticmethod
    def _addresses(grid: _Grid) -> IntArray:
        """Return what each entry adds to the flat address along each axis, (n, E)."""
        n = len(grid.shape)
        bits = _TILE_BITS[n]
        side = 1 << bits
        out = np.zeros((n, int(grid.shape.max())), np.int64)
        for a in range(n):
            entry = np.arange(out.shape[1])
            tile = side**n * math.prod(int(t) for t in grid.tiles[a + 1 :])
            out[a] = (entry >> bits) * tile + (entry & (side - 1)) * side ** (n - 1 - a)
        return out

    def tables(self, reach: int) -> Tables:
        """Return the tables for kernels that look up to ``reach`` indices beyond the box of the cells."""
        wanted = 1 << max(6, int(reach).bit_length())
        wanted = max(wanted, max(self._tables, default=0))
        if wanted not in self._tables:
            length = int((self.high - self.low).max()) + 1 + 2 * wanted
            rows = [
                self._reaching(grid, start, wanted, length)
                for grid, start in zip([self._cell_grid, *self._grids], [0, *self._starts], strict=True)
            ]
            address = np.stack([rows[1 + table] for table in self._table_of]).ravel()
            self._tables = {
                wanted: Tables(
                    self.cells, rows[0].ravel(), self.packed, address, self._windows,
                    self.low - wanted, length, self.unit, self.most,
                )
            }  # fmt: skip
        return self._tables[wanted]

    def sheet(self, level: int, reach: int, span: IntArray) -> Sheet:
        """Return the tables that bound all blocks of a level at once.

        Args:
            level: of the blocks.
            reach: how many indices beyond the cells' box are looked up, and
            span: (n,) over how many at once along each axis: farther away all is zero.
        """
        wanted = -(-int(reach) // _MARGIN) * _MARGIN
        beyond = np.minimum(wanted, span)
        if level not in self._sheets or (self._sheets[level].beyond < beyond).any():
            weights = np.asarray(self._source.counts)
            steps = (-(-weights // self.unit)).astype(np.uint8)
            index = self._source.index.astype(np.int64)
            self._sheets[level] = make_sheet(index, steps, level_windows(self.lattice, level), level, beyond)
        return self._sheets[level]

    def forget_sheets(self) -> None:
        """Give back the memory of all sheets; they are made again when they are asked for."""
        self._sheets.clear()

    def _reaching(self, grid: _Grid, start: int, margin: int, length: int) -> NDArray[np.int32]:
        """Return what each index from ``margin`` before the box on adds to the address, (n, length)."""
        n = self.lattice.dim
        inner = self._addresses(grid)
        out = np.empty((n, length), np.int32)
        for a in range(n):
            entry = (np.arange(length) - margin) // grid.step - grid.first[a]
            outside = (int(grid.tiles[a]) - 1) * math.prod(int(v) for v in grid.tiles[a + 1 :]) << (_TILE_BITS[n] * n)
            inside = (entry >= 0) & (entry < grid.shape[a])
            out[a] = np.where(inside, inner[a][np.clip(entry, 0, grid.shape[a] - 1)], outside)
        out[0] += start
        return out

    def weights(self, index: NDArray[np.integer[Any]]) -> IntArray:
        """Return the weight (M,) of each of the cells ``index`` (M, n), 0 outside the map."""
        from localisation.matching import _pose_kernels as kernels

        out = np.empty(len(index), np.int64)
        kernels.weights_of(self.tables(0), np.ascontiguousarray(index, dtype=np.int64), out)
        return out

    @cached_property
    def occupancy(self) -> Occupancy:
        """The cells that have a weight, for the refinement."""
        return Occupancy.of_list(self._source)

    @property
    def nbytes(self) -> int:
        """Bytes of all tables, those made on demand included."""
        return int(self.cells.nbytes + self.packed.nbytes + sum(s.values.nbytes for s in self._sheets.values()))
