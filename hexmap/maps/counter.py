"""A grid of counts that grows where it is written: what a map is before it is finished.

:class:`CellCounter` is the only mutable thing on the way from scans to a map. It serves the map builder, which adds
scans, and whoever follows it: a scan matcher that keeps the occupied cells of the growing map.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.base.errors import TooLargeError
from hexmap.base.values import read_only
from hexmap.lattice.convert import LatticeLike, as_lattice
from hexmap.lattice.rays import MAX_CELLS, traverse
from hexmap.maps.voxel_list import VoxelList

__all__ = ["HITS", "PASSES", "CellCounter", "Follower", "Rows"]

HITS, PASSES = 0, 1
_BITS = {2: 4, 3: 3}  # tiles of 16 x 16 or 8 x 8 x 8 cells
_EMPTY = -(2**63)
_TILES, _MANY_TILES = 64, 1 << 15
_JOURNAL = 4096
# Cells of a layer of tiles that are looked at at once for the rows in them, of 24 bytes.
_LAYER = 1 << 18

Rows: TypeAlias = tuple[IntArray, IntArray, IntArray]
"""Keys (M,) of cells in ascending order, each once, and the hits and passes (M,) of each."""

Follower: TypeAlias = Callable[[IntArray, IntArray], None]


class CellCounter:
    """Counts of hits and passes by lattice point, in tiles made when they are first needed.

    A count takes four bytes until one of them is full, then all take eight: they never wrap.
    """

    def __init__(self, lattice: LatticeLike) -> None:
        """Make an empty counter on ``lattice``."""
        from hexmap.maps import _counter_kernels as kernels

        self.lattice = lattice = as_lattice(lattice)
        bits = _BITS[lattice.dim]
        self._arrays = kernels.TileArrays(
            np.full(1024, _EMPTY, np.int64),
            np.zeros(1024, np.int64),
            np.zeros((_TILES, 3), np.int64),
            np.zeros((_TILES, 1 << (bits * lattice.dim), 2), np.int32),
            np.empty(0, np.int64),
            bits,
        )
        self._used = 0
        self._noted = 0
        self._followers: list[Follower] = []

    def __repr__(self) -> str:
        """Show the lattice."""
        return f"<CellCounter on {self.lattice!r}>"

    def __getstate__(self) -> dict[str, Any]:
        """Leave out spare tiles and those who follow: what they hold is made anew when they follow again."""
        a = self._arrays
        arrays = a._replace(tiles=a.tiles[: self._used], corners=a.corners[: self._used])
        return {**self.__dict__, "_arrays": arrays, "_followers": []}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Own the arrays, which otherwise cannot grow in place."""
        self.__dict__.update(state)
        owned: dict[str, Any] = {k: a.copy() for k, a in self._arrays._asdict().items() if isinstance(a, np.ndarray)}
        self._arrays = self._arrays._replace(**owned)

    # ------------------------------------------------------------------ counting

    def add(self, index: NDArray[np.int32], channel: int = HITS) -> None:
        """Count each of the cells ``index`` (N, n), which may repeat, once."""
        from hexmap.maps import _counter_kernels as kernels

        row = 0
        while row < len(index):
            row, self._used, self._noted = kernels.add(
                self._arrays, index, row, len(index), channel, self._used, self._noted, self._most
            )
            if row < len(index):
                self._make_room()
        self._tell()

    def fuse(self, origin: FloatArray, ends: FloatArray, hits: int, *, spare_hits: bool = False) -> None:
        """Count a scan: hits at the ends of its rays, passes in the cells before them.

        Args:
            origin: (n,) where the rays begin, metres.
            ends: (R, n) where they end, metres.
            hits: the first so many rays hit what is at their end; the others only cleared their cells, all of them.
            spare_hits: whether cells that one of these rays hit get no pass from the others: at a grazing angle dozens
                of beams go through a cell of floor before one ends there.

        Raises:
            BoundsError: an end is not finite or out of range; nothing is counted then.
            TooLargeError: the rays pass too many cells for one scan; nothing is counted then.
        """
        from hexmap.maps import _counter_kernels as kernels

        rays = len(ends)
        start = np.ascontiguousarray(origin[None])
        tables, faces = self.lattice.quantiser_tables, self.lattice.ray_tables
        bad, prepared = kernels.prepare(tables, faces, start, ends)
        total = max(int(prepared.room[:hits].sum()), int(prepared.room[hits:].sum()))
        if bad or total > MAX_CELLS:
            # The same rays once more, for the sake of the message.
            for some in (ends[:hits], ends[hits:]):
                traverse(self.lattice, np.broadcast_to(origin, some.shape), some)
            raise TooLargeError(f"rays of up to {total:,} cells are more than {MAX_CELLS:,}")
        spared = np.unique(self.lattice.quantise(ends[:hits]), axis=0) if spare_hits else np.empty((0, 0), np.int32)
        before = self.find(spared, PASSES) if len(spared) else np.empty(0, np.int64)
        chunk = row = 0
        while chunk < rays:
            chunk, row, self._used, self._noted = kernels.fuse(
                self._arrays, prepared, faces, hits, chunk, row, self._used, self._noted, self._most
            )
            if chunk < rays:
                self._make_room()
        if len(spared):
            kernels.put(self._arrays, spared, PASSES, before)
        self._tell()

    @property
    def bytes_a_count(self) -> int:
        """4, or 8 once a count needed more."""
        return int(self._arrays.tiles.dtype.itemsize)

    @property
    def _most(self) -> int:
        return int(np.iinfo(self._arrays.tiles.dtype).max)

    def _make_room(self) -> None:
        """Make room for what did not fit: tiles, their keys, the notes, or a count."""
        from hexmap.maps import _counter_kernels as kernels

        a = self._arrays
        if len(a.journal) and self._noted >= len(a.journal):
            journal = np.empty(2 * len(a.journal), np.int64)
            journal[: self._noted] = a.journal[: self._noted]
            self._arrays = a._replace(journal=journal)
        elif self._used >= len(a.tiles):
            if self._used < _MANY_TILES:
                # Memory that is asked for as zeros costs nothing before it is used, and comes in large pages.
                count = max(_TILES, 4 * self._used)
                tiles = np.zeros((count, *a.tiles.shape[1:]), a.tiles.dtype)
                corners = np.zeros((count, 3), np.int64)
                tiles[: self._used], corners[: self._used] = a.tiles, a.corners
                self._arrays = a._replace(tiles=tiles, corners=corners)
            else:
                # An array of this size grows in place, without a copy; an eighth more keeps the spare memory small.
                count = self._used + self._used // 8
                a.tiles.resize((count, *a.tiles.shape[1:]), refcheck=False)
                a.corners.resize((count, 3), refcheck=False)
        elif self._used >= len(a.table) // 2:
            table = np.full(2 * len(a.table), _EMPTY, np.int64)
            numbers = np.zeros(2 * len(a.table), np.int64)
            kernels.rehash(a.table, a.numbers, table, numbers)
            self._arrays = a._replace(table=table, numbers=numbers)
        else:
            self._arrays = a._replace(tiles=a.tiles.astype(np.int64))

    # ------------------------------------------------------------------ following

    def follow(self, follower: Follower) -> None:
        """Tell ``follower`` of cells whose state may have changed, after each addition, and of all there are now.

        It is called with the cells (M, n) int64 that have hits and were counted, and with their hits and passes (M, 2)
        int64 as they are then.
        """
        if not self._followers:
            self._arrays = self._arrays._replace(journal=np.empty(_JOURNAL, np.int64))
        self._followers.append(follower)
        hits = self.to_list(HITS)
        counts = np.stack([hits.counts, self.find(hits.index, PASSES)], axis=1)
        if len(hits):
            follower(hits.index.astype(np.int64), counts)

    def forget_followers(self) -> None:
        """Tell nobody any more, and let go of what those who followed hold."""
        self._followers.clear()
        self._arrays = self._arrays._replace(journal=np.empty(0, np.int64))

    def _tell(self) -> None:
        from hexmap.maps import _counter_kernels as kernels

        if not self._noted:
            return
        index = np.empty((self._noted, self.lattice.dim), np.int64)
        counts = np.empty((self._noted, 2), np.int64)
        m = kernels.noted_cells(self._arrays, self._noted, self.lattice.dim, index, counts)
        self._noted = 0
        for follower in self._followers:
            follower(index[:m], counts[:m])

    # ------------------------------------------------------------------ reading

    def find(self, index: NDArray[np.int32], channel: int = HITS) -> IntArray:
        """Return the count (M,) of each of the cells ``index`` (M, n)."""
        from hexmap.maps import _counter_kernels as kernels

        out = np.zeros(len(index), np.int64)
        kernels.find(self._arrays, np.ascontiguousarray(index), channel, out)
        return out

    @property
    def nbytes(self) -> int:
        """Bytes of the tiles in use."""
        return int(self._used * self._arrays.tiles[:1].nbytes)

    def rows(self) -> Iterator[Rows]:
        """Yield all cells that were hit or passed, in ascending order, so many at a time as lie side by side."""
        from hexmap.maps import _counter_kernels as kernels

        a, n = self._arrays, self.lattice.dim
        corners = a.corners[: self._used]
        order = np.lexsort(corners.T[::-1])
        first = np.flatnonzero(np.diff(corners[order, 0], prepend=corners[order[:1], 0] - 1))
        side, cells = 1 << a.bits, a.tiles.shape[1]
        for begin, end in itertools.pairwise([*first.tolist(), len(order)]):
            layer = (end - begin) * cells // side
            count = min(side, max(1, _LAYER // layer))
            for i in range(0, side, count):
                rows = tuple(np.empty(layer * count, np.int64) for _ in range(3))
                m = kernels.sorted_rows(a, order[begin:end], i, min(side, i + count), n, *rows)
                if m:
                    yield rows[0][:m], rows[1][:m], rows[2][:m]

    def to_list(self, channel: int = HITS) -> VoxelList:
        """Return the counts as a sorted, immutable list."""
        from hexmap.maps import _counter_kernels as kernels

        m = kernels.count_cells(channel, self._arrays.tiles, self._used)
        keys, counts = np.empty(m, np.int64), np.empty(m, np.int64)
        order = np.lexsort(self._arrays.corners[: self._used].T[::-1])
        kernels.sorted_cells(channel, self._arrays, order, self.lattice.dim, keys, counts)
        return VoxelList(self.lattice, read_only(keys), read_only(counts))
