"""The occupied voxel list: lattice points and how often each was hit, sorted, immutable.

The paper keeps tuples [a, b, c, o]. Here they are two columns, sorted by index: the packed keys
and the occupancy o as an int64 count that never saturates. Union by key adds the counts, so it is
associative and commutative with the empty list as identity; thresholds are taken when a list is
read and never while it is built, so the result cannot depend on the order of the scans.
"""

from __future__ import annotations

import itertools
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError, BoundsError, LatticeError
from hexmap.base.pictures import drawing, picture_html
from hexmap.base.values import Immutable, integers, kept, read_only
from hexmap.lattice.convert import LatticeLike, as_lattice
from hexmap.lattice.keys import KeyArray, key_delta, layout, pack, unpack
from hexmap.lattice.lattice import Lattice

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["VoxelList"]

CountArray: TypeAlias = NDArray[np.int64]

_MOST = 2**63 - 1  # that a count can be


class VoxelList(Immutable):
    """Lattice points with a count each, sorted by index; immutable.

    Attributes:
        lattice: the lattice the indices refer to.
        keys: (M,) int64 packed indices in ascending order, each once.
        counts: (M,) int64 occupancy o of each, at least 1.

    Examples:
        >>> from hexmap import Lattice, VoxelList
        >>> squares = Lattice.named("Z2", resolution=1.0)
        >>> walls = VoxelList.from_points([[0.1, 0.0], [0.2, 0.1], [2.0, 0.0]], squares)
        >>> walls.rows().tolist()
        [[0, 0, 2], [2, 0, 1]]
        >>> walls.merge(walls).at_least(3).rows().tolist()
        [[0, 0, 4]]
    """

    __slots__ = ("__dict__", "counts", "keys", "lattice")

    lattice: Lattice
    keys: KeyArray
    counts: CountArray

    def __init__(self, lattice: LatticeLike, keys: KeyArray, counts: CountArray) -> None:
        """Wrap columns that are already sorted and unique; use the ``from_`` functions otherwise.

        Columns that can be written to are copied.

        Raises:
            ArgumentError: not two columns of the same length.
        """
        keys, counts = kept(keys, np.int64), kept(counts, np.int64)
        if keys.ndim != 1 or keys.shape != counts.shape:
            raise ArgumentError(f"keys and counts are two columns of the same length, not {keys.shape}, {counts.shape}")
        object.__setattr__(self, "lattice", as_lattice(lattice))
        object.__setattr__(self, "keys", keys)
        object.__setattr__(self, "counts", counts)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy through the constructor: arrays that are unpickled can be written to."""
        return VoxelList, (self.lattice, self.keys, self.counts)

    @classmethod
    def empty(cls, lattice: LatticeLike) -> VoxelList:
        """Return the list without a point: the identity of :meth:`merge`."""
        return cls(lattice, read_only(np.empty(0, np.int64)), read_only(np.empty(0, np.int64)))

    @classmethod
    def from_points(cls, points: ArrayLike, lattice: LatticeLike, resolution: float | None = None) -> VoxelList:
        """Quantise ``points`` (N, n), metres, and count them by lattice point.

        Args:
            points: (N, n) metres.
            lattice: a lattice, the name of one, or a basis.
            resolution: of the cells, metres; see :func:`~hexmap.lattice.as_lattice`.

        Raises:
            ArgumentError: the array is not (N, n).
            BoundsError: a point is not finite or out of range.
        """
        on = as_lattice(lattice, resolution)
        return cls._from_index(on.quantise(points), on)

    @classmethod
    def from_cells(cls, index: ArrayLike, lattice: LatticeLike, counts: ArrayLike | None = None) -> VoxelList:
        """Make a list of indices (M, n), which may repeat, with a count each (1 where none is given).

        Raises:
            ArgumentError: shapes that do not fit, indices that are not integers, or a count below 1.
            BoundsError: an index is out of range, or the counts of a cell add up to more than 2^63 - 1.
        """
        lattice = as_lattice(lattice)
        i = lattice.check_index(cls._integers(index, lattice))
        if counts is None:
            return cls._from_index(i, lattice)
        c = np.asarray(counts)
        if c.shape != (len(i),) or (c.size and not np.issubdtype(c.dtype, np.integer)) or (c.size and c.min() < 1):
            raise ArgumentError("counts must be one integer of at least 1 for each index")
        if c.size and int(c.max()) > _MOST:
            raise BoundsError(f"a count is at most 2^63 - 1, not {int(c.max())}")
        keys = pack(i)
        order = np.argsort(keys, kind="stable")
        keys, c = keys[order], c[order].astype(np.int64)
        first = np.flatnonzero(np.diff(keys, prepend=keys[:1] - 1)) if len(keys) else np.empty(0, np.int64)
        # Of non-negative numbers no sum wraps whose float64 is well below the limit; near it, Python's integers tell.
        if c.astype(np.float64).sum() >= 2.0**62:
            ends = [*first.tolist(), len(c)]
            for a, b in itertools.pairwise(ends):
                if (total := sum(c[a:b].tolist())) > _MOST:
                    raise BoundsError(f"the counts of cell {i[order[a]].tolist()} add up to {total}, beyond 2^63 - 1")
        return cls(lattice, read_only(keys[first]), read_only(np.add.reduceat(c, first) if len(first) else c))

    @staticmethod
    def _integers(index: ArrayLike, lattice: Lattice) -> NDArray[np.int64]:
        """Return indices (M, n) as int64, if that is what they are."""
        if np.size(index) == 0:
            return np.empty((0, lattice.dim), np.int64)
        found = integers(index)
        if found is None or found.ndim != 2 or found.shape[1] != lattice.dim:
            raw = np.asarray(index)
            raise ArgumentError(f"indices must be integers (M, {lattice.dim}), not {raw.dtype} {raw.shape}")
        return found

    @classmethod
    def _from_index(cls, index: NDArray[np.int32], lattice: Lattice) -> VoxelList:
        """Sort and count quantised indices (N, n)."""
        if len(index) == 0:
            return cls.empty(lattice)
        from hexmap.maps import _voxel_kernels as kernels

        dim = lattice.dim
        low, high = np.empty(dim, np.int64), np.empty(dim, np.int64)
        kernels.bounds(index, low, high)
        bits = [int(b - a).bit_length() for a, b in zip(low, high, strict=True)]
        shifts = np.array([sum(bits[k + 1 :]) for k in range(dim)], dtype=np.int64)
        dtype = np.uint32 if sum(bits) <= 32 else np.uint64
        keys = np.empty(len(index), dtype)
        scratch = np.empty(len(index), dtype)
        kernels.pack_relative(index, low, shifts, keys)
        if kernels.radix_sort(keys, scratch, max(1, sum(bits))):
            keys, scratch = scratch, keys
        m = kernels.count_distinct(keys)
        unique, counts = np.empty(m, np.int64), np.empty(m, np.int64)
        field, offset = layout(dim)
        kernels.run_lengths(keys, low, shifts, field, offset, unique, counts)
        return cls(lattice, read_only(unique), read_only(counts))

    # ------------------------------------------------------------------ reading

    @cached_property
    def index(self) -> NDArray[np.int32]:
        """(M, n) int32 lattice indices, lexicographically ascending."""
        return read_only(unpack(self.keys, self.lattice.dim))

    def rows(self) -> NDArray[np.int64]:
        """Return the paper's tuples: (M, n + 1) int64, index and occupancy."""
        return np.column_stack([self.index.astype(np.int64), self.counts])

    def centres(self) -> NDArray[np.float64]:
        """Return the centres (M, n) of the cells, metres."""
        return self.lattice.centres(self.index)

    def __len__(self) -> int:
        """Return the voxel count: how many lattice points are in the list."""
        return len(self.keys)

    @property
    def total(self) -> int:
        """Sum of all counts, however large."""
        high, low = self.counts >> 32, self.counts & 0xFFFFFFFF  # the sums of which cannot wrap
        return (int(high.sum()) << 32) + int(low.sum())

    def find(self, index: ArrayLike) -> CountArray:
        """Return the count (K,) of each of the indices (K, n); 0 where it is not in the list."""
        raw = self._integers(index, self.lattice)
        if len(self) == 0 or len(raw) == 0:
            return np.zeros(len(raw), np.int64)
        inside = np.all((raw < self.lattice.limit) & (raw > -self.lattice.limit), axis=1)
        keys = pack(np.where(inside[:, None], raw, 0).astype(np.int32))
        at = np.minimum(np.searchsorted(self.keys, keys), len(self) - 1)
        return np.where(inside & (self.keys[at] == keys), self.counts[at], 0)

    def contains(self, index: ArrayLike) -> NDArray[np.bool_]:
        """Tell for each of the indices (K, n) whether it is in the list."""
        return np.asarray(self.find(index) > 0)

    def __eq__(self, other: object) -> bool:
        """Tell whether two lists are the same: lattice, points and counts."""
        if not isinstance(other, VoxelList):
            return NotImplemented
        return (
            self.lattice == other.lattice
            and np.array_equal(self.keys, other.keys)
            and np.array_equal(self.counts, other.counts)
        )

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        """Show size and lattice."""
        return f"<VoxelList of {len(self)} points on {self.lattice!r}>"

    def plot(self, ax: Axes | None = None, *, height: float | None = None, **style: Any) -> Axes:
        """Draw the cells on axes of matplotlib, in metres; the darker, the more often they were hit.

        In space they are seen from above, the highest of each column in the colour of its height; or cut through.

        Args:
            ax: axes to draw on; new ones where none are given.
            height: of a horizontal cut through cells in space, metres.
            style: ``colour`` for one colour instead of shades; ``alpha``; ``colorbar=False`` for no bar of the heights.

        Returns:
            The axes.

        Raises:
            ArgumentError: a height that is not finite, or of cells in the plane.

        Examples:
            >>> from hexmap import VoxelList
            >>> axes = VoxelList.from_points([[0.0, 0.0], [0.3, 0.1]], "A2", 0.1).plot()
            >>> axes.get_xlabel(), axes.get_ylabel()
            ('x, m', 'y, m')
        """
        return drawing().plot_cells(self, ax, height=height, **style)

    def _repr_html_(self) -> str:
        """Show a small picture in a notebook."""
        return picture_html(self)

    # ------------------------------------------------------------------ algebra

    def _check_same(self, other: VoxelList) -> None:
        if self.lattice != other.lattice:
            raise LatticeError(f"the lists are on different lattices: {self.lattice!r} and {other.lattice!r}")

    def merge(self, other: VoxelList) -> VoxelList:
        """Return the union, the counts of points in both added.

        Raises:
            LatticeError: the lists are on different lattices.
            BoundsError: the counts of a point add up to more than 2^63 - 1.
        """
        self._check_same(other)
        if len(other) == 0:
            return self
        if len(self) == 0:
            return other
        from hexmap.maps import _voxel_kernels as kernels

        keys = np.empty(len(self) + len(other), np.int64)
        counts = np.empty_like(keys)
        m = kernels.merge(self.keys, self.counts, other.keys, other.counts, keys, counts)
        # Of two counts, none of them negative, a sum that wraps is.
        if (counts[:m] < 0).any():
            row = int(np.argmax(counts[:m] < 0))
            cell = tuple(unpack(keys[row : row + 1], self.lattice.dim)[0].tolist())
            raise BoundsError(f"the counts of cell {cell} add up to {int(counts[row]) + 2**64}, beyond 2^63 - 1")
        return VoxelList(self.lattice, read_only(keys[:m].copy()), read_only(counts[:m].copy()))

    def at_least(self, occupancy: int) -> VoxelList:
        """Return the points with a count of at least ``occupancy``."""
        return self.select(self.counts >= occupancy)

    def select(self, mask: NDArray[np.bool_]) -> VoxelList:
        """Return the points where ``mask`` (M,) is true.

        Raises:
            ArgumentError: not one boolean for each point.
        """
        asked = np.asarray(mask)
        if asked.shape != self.keys.shape or asked.dtype != np.bool_:
            raise ArgumentError(f"a mask of {len(self)} points is as many booleans, not {asked.dtype} {asked.shape}")
        return VoxelList(self.lattice, read_only(self.keys[asked]), read_only(self.counts[asked]))

    def count_coincident(self, other: VoxelList) -> int:
        """Return how many lattice points are in both lists: the paper's match score."""
        self._check_same(other)
        if len(self) == 0 or len(other) == 0:
            return 0
        from hexmap.maps import _voxel_kernels as kernels

        return int(kernels.count_common(self.keys, other.keys))

    def shift(self, vector: ArrayLike) -> VoxelList:
        """Return the list moved by the lattice vector (n,), given by its index.

        Raises:
            BoundsError: a point would leave the range of indices.
        """
        v = integers(vector)
        if v is None or v.shape != (self.lattice.dim,):
            raise ArgumentError(f"a shift of {self.lattice.name} takes {self.lattice.dim} integers, not {vector!r}")
        if len(self) == 0:
            return self
        low, high = self.index.min(axis=0).astype(np.int64), self.index.max(axis=0).astype(np.int64)
        moved, limit = [int(x) for x in v], self.lattice.limit  # Python's integers do not wrap
        if any(a + x <= -limit or b + x >= limit for a, b, x in zip(low.tolist(), high.tolist(), moved, strict=True)):
            raise BoundsError(f"a shift by {tuple(moved)} leaves the range of indices, {limit}")
        return VoxelList(self.lattice, read_only(self.keys + key_delta(v)), self.counts)
