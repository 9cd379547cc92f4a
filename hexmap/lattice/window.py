"""Dense boxes of lattice indices: which cells they hold and where each lies in a flat array, in one place.

A dense array is the fastest map from a cell to a value, and in the basis of its lattice every set of cells fits in a
box of indices. Graphs, pictures, meshes and matchers all number the cells of such a box in row-major order, as numpy
does: the last index changes fastest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.base.values import one_line

__all__ = ["IndexBox", "box_coordinates", "strides"]


def strides(shape: IntArray) -> IntArray:
    """Return what one step along each index adds to a flat position in a row-major array of ``shape`` (n,)."""
    strides = np.ones(len(shape), np.int64)
    for k in range(len(shape) - 2, -1, -1):
        strides[k] = strides[k + 1] * shape[k + 1]
    return strides


def box_coordinates(basis: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the coordinates (2^n, n), in ``basis``, of the corners of the box from ``low`` to ``high`` (n,), metres.

    The box leans in those coordinates where the basis does, so its range of indices is that of all its corners.
    """
    n = len(basis)
    corners = np.array([[(low, high)[(c >> i) & 1][i] for i in range(n)] for c in range(2**n)])
    return np.asarray(corners @ np.linalg.inv(basis).T)


@dataclass(frozen=True, eq=False)
class IndexBox:
    """A box of lattice indices, for arrays that hold a value for each of its cells.

    Attributes:
        low: (n,) int64 index of the first cell.
        shape: (n,) int64 how many cells there are along each index; a box with a 0 holds no cell.

    Examples:
        >>> import numpy as np
        >>> from hexmap.lattice.window import IndexBox
        >>> box = IndexBox.of_cells(np.array([[1, 2], [3, 5]]))
        >>> box.low.tolist(), box.shape.tolist(), box.strides.tolist()
        ([1, 2], [3, 4], [4, 1])
        >>> box.flat(np.array([[1, 2], [2, 2], [9, 9]])).tolist()
        [0, 4, -1]
    """

    low: IntArray
    shape: IntArray

    __repr__ = one_line

    @classmethod
    def of_cells(cls, index: NDArray[np.integer[Any]]) -> IndexBox:
        """Return the smallest box that holds all cells of ``index`` (M, n), of which there is at least one."""
        low = index.min(axis=0).astype(np.int64)
        return cls(low, index.max(axis=0).astype(np.int64) - low + 1)

    @classmethod
    def of_corners(cls, first: IntArray, last: IntArray) -> IndexBox:
        """Return the box from the index ``first`` to ``last`` (n,), both included; empty where last is before first."""
        return cls(first, np.maximum(last - first + 1, 0))

    def padded(self, pad: IntArray) -> IndexBox:
        """Return the box with ``pad`` (n,) more cells on either side."""
        return IndexBox(self.low - pad, self.shape + 2 * pad)

    @property
    def dims(self) -> tuple[int, ...]:
        """The shape as numpy wants it."""
        return tuple(int(s) for s in self.shape)

    @property
    def size(self) -> int:
        """How many cells it holds, in Python's integers, which do not overflow."""
        return math.prod(self.dims)

    @cached_property
    def strides(self) -> IntArray:
        """(n,) int64 what one step along each index adds to a flat position."""
        return strides(self.shape)

    def contains(self, index: NDArray[np.integer[Any]]) -> NDArray[np.bool_]:
        """Tell for each of the cells ``index`` (M, n) whether it is in the box."""
        return np.asarray(np.all((index >= self.low) & (index < self.low + self.shape), axis=1))

    def flat(self, index: NDArray[np.integer[Any]]) -> IntArray:
        """Return the flat position (M,) of each of the cells ``index`` (M, n), -1 outside the box."""
        inside = np.ones(len(index), np.bool_)
        position = np.zeros(len(index), np.int64)
        # Column by column: one pass each, and no (M, n) array of relative indices.
        for k, (low, size) in enumerate(zip(self.low.tolist(), self.shape.tolist(), strict=True)):
            # An int32 index and a low beyond that range must not wrap.
            relative = index[:, k].astype(np.int64) - low
            inside &= (relative >= 0) & (relative < size)
            position = position * size + relative
        position[~inside] = -1
        return position

    def index(self, flat: NDArray[np.integer[Any]]) -> IntArray:
        """Return the cells (M, n) int64 at the flat positions ``flat`` (M,), which are in the box."""
        return np.asarray(np.stack(np.unravel_index(flat, self.dims), axis=1) + self.low)

    def cells(self) -> IntArray:
        """Return all cells (size, n) of the box, lexicographically: in the order of their flat positions."""
        return np.asarray(np.indices(self.dims).reshape(len(self.shape), -1).T + self.low)

    def without_padding(self, values: NDArray[Any], pad: IntArray) -> NDArray[Any]:
        """Return the ``values`` (size,) of the cells that are not padding, as a view with a dimension an index."""
        cut = tuple(slice(int(p), int(s - p)) for p, s in zip(pad, self.shape, strict=True))
        return values.reshape(self.dims)[cut]
