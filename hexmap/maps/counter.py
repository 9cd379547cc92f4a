"""A grid of counts that grows where it is written: what a map is before it is finished.

:class:`CellCounter` is the only mutable thing on the way from scans to a map. It serves the map
builder, which adds hits and passes, and the scan matcher, which asks for the counts of a box.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import TooLargeError
from hexmap.lattice.keys import pack
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.window import IndexBox
from hexmap.maps.voxel_list import VoxelList

__all__ = ["HITS", "PASSES", "CellCounter"]

HITS, PASSES = 0, 1
MAX_WINDOW = 1 << 25  # cells of a dense window: 0.25 GiB a channel
_BITS = {2: 4, 3: 3}  # tiles of 16 x 16 or 8 x 8 x 8 cells


class CellCounter:
    """Counts of hits and passes by lattice point, int64, in tiles made when they are first needed."""

    def __init__(self, lattice: Lattice) -> None:
        """Make an empty counter on ``lattice``."""
        self.lattice = lattice
        self._bits = _BITS[lattice.dim]
        self._table = np.full(1024, -(2**63), np.int64)
        self._numbers = np.zeros(1024, np.int64)
        self._tiles = np.zeros((64, 2, 1 << (self._bits * lattice.dim)), np.int64)
        self._corners = np.zeros((64, 3), np.int64)
        self._used = 0

    def add(self, index: NDArray[np.int32], channel: int = HITS) -> None:
        """Count each of the cells ``index`` (N, n), which may repeat, once."""
        from hexmap.maps import _counter_kernels as kernels

        row = 0
        while row < len(index):
            row, self._used = kernels.add(
                index, row, channel, self._bits, self._table, self._numbers, self._corners, self._tiles, self._used
            )
            if row < len(index):
                self._grow()

    def _grow(self) -> None:
        """Make room for more tiles, and for their keys where the table is half full."""
        from hexmap.maps import _counter_kernels as kernels

        if self._used >= len(self._tiles):
            # Half as much again: doubling would cost twice the memory of the map at the worst moment.
            more = max(64, len(self._tiles) // 2)
            tiles = np.zeros((len(self._tiles) + more, *self._tiles.shape[1:]), np.int64)
            tiles[: self._used] = self._tiles[: self._used]
            corners = np.zeros((len(tiles), 3), np.int64)
            corners[: self._used] = self._corners[: self._used]
            self._tiles, self._corners = tiles, corners
        if self._used >= len(self._table) // 2:
            table = np.full(2 * len(self._table), -(2**63), np.int64)
            numbers = np.zeros(2 * len(self._table), np.int64)
            kernels.rehash(self._table, self._numbers, table, numbers)
            self._table, self._numbers = table, numbers

    def window(self, low: NDArray[np.int64], shape: NDArray[np.int64], channel: int = HITS) -> NDArray[np.int64]:
        """Return the counts in the box of ``shape`` (n,) cells from the index ``low`` (n,) on, as a dense array.

        Raises:
            TooLargeError: the box holds more than :data:`MAX_WINDOW` cells.
        """
        from hexmap.maps import _counter_kernels as kernels

        box = IndexBox(np.asarray(low, np.int64), np.asarray(shape, np.int64))
        size = box.size
        if size > MAX_WINDOW:
            raise TooLargeError(
                f"a window of {size:,} cells at resolution {self.lattice.resolution:g} m is more than {MAX_WINDOW:,}; "
                "take a coarser resolution or a shorter maximum range"
            )
        out = np.zeros(size, np.int64)
        if out.size:
            kernels.window(
                box.low, box.shape, channel, self._bits,
                self._table, self._numbers, self._tiles, self.lattice.dim, out,
            )  # fmt: skip
        return out.reshape(box.dims)

    def to_list(self, channel: int = HITS) -> VoxelList:
        """Return the counts as a sorted, immutable list."""
        from hexmap.maps import _counter_kernels as kernels

        m = kernels.count_cells(channel, self._tiles, self._used)
        index = np.empty((m, self.lattice.dim), np.int32)
        counts = np.empty(m, np.int64)
        kernels.cells(channel, self._bits, self._corners, self._tiles, self._used, self.lattice.dim, index, counts)
        keys = pack(index)
        order = np.argsort(keys, kind="stable")
        return VoxelList(self.lattice, keys[order], counts[order])
