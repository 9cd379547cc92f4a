"""What a search takes as given: the map's tables, where the sensor may be, and the scan as the kernels see it."""

from __future__ import annotations

import math
import threading
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.base.sparse_arrays import sparse_zeros
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.window import IndexBox
from hexmap.maps.voxel_list import VoxelList
from localisation.matching.pyramid import OccupancyPyramid, cell_reach
from localisation.matching.search_region import SearchRegion

__all__ = ["Scratch", "SearchSpace", "region_box", "scan_arrays", "stops_within"]

# Lanes of 16 bits add up 257 times a byte.
_LANE = 257
# Bytes of a line of the processor's cache.
_LINE = 64


class Scratch(threading.local):
    """Memory that the searches of a thread work in, one after the other; it keeps what was touched of it.

    Searches of many small maps share one, where asking the system for it anew would take as long as some of them.

    Args:
        sparse: whether it is in small pages: most slots are filled to a part.
    """

    def __init__(self, sparse: bool = False) -> None:
        """Ask for nothing yet; each thread has its own."""
        self._sparse = sparse
        self.key: tuple[int, ...] | None = None
        self.arcs: Any = None
        self._memory: NDArray[np.uint8] | None = None

    def __reduce__(self) -> tuple[type[Scratch], tuple[bool]]:
        """Pickle nothing of it: it is made anew."""
        return Scratch, (self._sparse,)

    def arrays(self, *kinds: tuple[tuple[int, ...], DTypeLike]) -> list[NDArray[Any]]:
        """Return arrays of these shapes and types, which hold anything, in place of those returned before."""
        sizes = [-(-math.prod(shape) * np.dtype(kind).itemsize // _LINE) * _LINE for shape, kind in kinds]
        if self._memory is None or len(self._memory) < sum(sizes):
            self.give_back()
            self._memory = sparse_zeros(sum(sizes), np.uint8, 0) if self._sparse else np.empty(sum(sizes), np.uint8)
        ends = np.cumsum([0, *sizes]).tolist()
        return [
            self._memory[begin : begin + math.prod(shape) * np.dtype(kind).itemsize].view(kind).reshape(shape)
            for begin, (shape, kind) in zip(ends, kinds, strict=False)
        ]

    def give_back(self) -> None:
        """Give the memory back to the system."""
        self.key = self.arcs = self._memory = None


class SearchSpace:
    """What stays the same from scan to scan: the map's tables, and where the sensor may be.

    Args:
        pyramid: the weights of the map's cells.
        known: the cells in which the sensor may be, or the box of all of them; None: anywhere in the box around the
            weights.
        scratch: memory to work in, which searches of other spaces may share.

    Attributes:
        low: (n,) the lowest indices of those cells.
        high: (n,) the highest.
    """

    def __init__(
        self, pyramid: OccupancyPyramid, known: VoxelList | IndexBox | None, scratch: Scratch | None = None
    ) -> None:
        """Prepare the tables of the lattice and of the cells in which the sensor may be."""
        from localisation.matching import _global_kernels as kernels
        from localisation.matching import _pyramid_kernels

        self.pyramid = pyramid
        self.lattice: Lattice = pyramid.lattice
        inverse = np.ascontiguousarray(np.linalg.inv(self.lattice.basis))
        self.row_norms = np.linalg.norm(inverse, axis=1)
        self.lattice_arrays = kernels.LatticeArrays(
            np.array(self.lattice.basis, order="C"),
            np.array(inverse, order="C"),
            np.concatenate([cell_reach(self.lattice), self.row_norms]),
            np.array(self.lattice.cell.faces, np.int64, order="C"),
            np.array(self.lattice.cell.normals, np.float64, order="C"),
        )
        n = self.lattice.dim
        if known is None:
            self.low, self.high = pyramid.low, pyramid.high
            self.allowed = (np.zeros(0, np.uint8), self.low, np.zeros(1, np.int64), np.zeros((1, n), np.int64))
        else:
            index = np.empty((0, n), np.int64)
            if isinstance(known, IndexBox):
                self.low, self.high = known.low, known.low + known.shape - 1
            else:
                index = known.index.astype(np.int64)
                self.low = index.min(axis=0) if len(index) else np.zeros(n, np.int64)
                self.high = index.max(axis=0) if len(index) else np.zeros(n, np.int64)
            shapes = [((self.high - self.low) >> level) + 1 for level in range(pyramid.levels + 1)]
            starts = np.cumsum([0, *[math.prod(int(s) for s in shape) for shape in shapes]])
            marked = np.full(starts[-1], isinstance(known, IndexBox), np.uint8)
            for level, shape in enumerate(shapes):
                _pyramid_kernels.mark_blocks(index, self.low, level, shape, marked[starts[level] : starts[level + 1]])
            self.allowed = (marked, self.low, starts[:-1], np.array(shapes))
        self.scratch = scratch or Scratch()


def scan_arrays(space: SearchSpace, points: FloatArray, weights: IntArray) -> Any:
    """Return the scan as the kernels see it, no point heavier than a lane of a sum holds."""
    from localisation.matching import _global_kernels as kernels

    # A lane of a sum holds 257 bytes: heavier points go in several times.
    pieces = -(-weights // _LANE)
    repeated = np.repeat(np.arange(len(points)), pieces)
    share = weights[repeated] // pieces[repeated]
    first = np.concatenate([[0], np.cumsum(pieces)[:-1]])
    share[first] += weights - (weights // pieces) * pieces
    order = _spread_order(len(repeated))
    p = np.ascontiguousarray(points[repeated][order])
    w = share[order]
    rest = np.append(np.cumsum(w[::-1])[::-1], 0) * space.pyramid.most
    inverse = space.lattice_arrays.inverse
    x, y = p[:, :1], p[:, 1:2]
    # Written out: a matrix product may round a row differently when the number of rows changes.
    waves = np.stack([x * inverse[:, 0] + y * inverse[:, 1], x * inverse[:, 1] - y * inverse[:, 0]], axis=-1)
    return kernels.ScanArrays(p, waves, w.astype(np.uint64), rest, stops_within(w, _LANE, 16))


def region_box(space: SearchSpace, region: SearchRegion) -> tuple[FloatArray, IntArray, IntArray]:
    """Return the corners of a region in metres, and the lowest and highest shifts of it."""
    n = space.lattice.dim
    box = region.box(space.lattice)
    if box is None:
        return np.array([np.full(n, -np.inf), np.full(n, np.inf)]), space.low, space.high
    corners = np.stack(np.meshgrid(*np.stack(box).T, indexing="ij"), axis=-1).reshape(-1, n)
    u = corners @ space.lattice_arrays.inverse.T
    low = np.maximum(space.low, np.floor(u.min(axis=0) - 1e-9).astype(np.int64))
    high = np.minimum(space.high, np.ceil(u.max(axis=0) + 1e-9).astype(np.int64))
    return np.stack(box), low, high


def _spread_order(count: int) -> IntArray:
    """Return 0 to ``count`` - 1 so that the first few are spread over all: the bits of a counter reversed."""
    bits = max(1, (count - 1).bit_length())
    numbers = np.arange(1 << bits)
    reverse = np.zeros_like(numbers)
    for b in range(bits):
        reverse |= ((numbers >> b) & 1) << (bits - 1 - b)
    return reverse[reverse < count]


def stops_within(weights: IntArray, lane: int, most: int | None = None) -> IntArray:
    """Return after how many points a sum is put away: before more than ``lane`` weights, after ``most`` points."""
    stops: list[int] = []
    total = since = 0
    for p, w in enumerate(weights.tolist()):
        if p > since and (total + w > lane or (most is not None and p - since >= most)):
            stops.append(p)
            total, since = 0, p
        total += w
    return np.array([*stops, len(weights)])
