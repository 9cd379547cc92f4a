"""Which cells a straight line passes, exactly, on any lattice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError, TooLargeError
from hexmap.base.values import lossless, one_line
from hexmap.lattice.convert import LatticeLike, as_lattice

__all__ = ["RayCells", "traverse"]

MAX_CELLS = 1 << 26  # of one call: half a gibibyte in the plane


@dataclass(frozen=True, eq=False)
class RayCells:
    """The cells of many rays, one ray after the other.

    Attributes:
        index: (M, n) int32 cells, each ray's in order from its start to its end.
        offsets: (R + 1,) int64; ray r has the rows ``offsets[r]`` to ``offsets[r + 1]``.
    """

    index: NDArray[np.int32]
    offsets: NDArray[np.int64]

    __repr__ = one_line

    def __len__(self) -> int:
        """Return the number of rays."""
        return len(self.offsets) - 1

    def ray(self, r: int) -> NDArray[np.int32]:
        """Return the cells (K, n) of ray ``r``."""
        return self.index[self.offsets[r] : self.offsets[r + 1]]

    def without_ends(self) -> NDArray[np.int32]:
        """Return all cells but each ray's last: what the beams went through before they hit."""
        keep = np.ones(len(self.index), dtype=bool)
        keep[self.offsets[1:] - 1] = False
        return self.index[keep]


def traverse(lattice: LatticeLike, starts: ArrayLike, ends: ArrayLike) -> RayCells:
    """Return the cells that the straight lines from ``starts`` to ``ends`` (R, n), metres, pass in order.

    The first is the cell of the start and the last that of the end, by the quantiser's tie rule;
    between them stand exactly the cells that the line crosses along some length (to 2^-32 of a
    cell). Where the line runs along a face, the lower index counts, as in ``Lattice.quantise``.

    Raises:
        ArgumentError: shapes that do not fit.
        BoundsError: an end is not finite or out of range.
        TooLargeError: the rays pass too many cells for one call.
    """
    lattice = as_lattice(lattice)
    given = lossless(starts), lossless(ends)
    if given[0] is None or given[1] is None:
        raise ArgumentError("the ends of rays must be real numbers without a mask")
    p0, p1 = (np.ascontiguousarray(values, dtype=np.float64) for values in given)
    if p0.shape != p1.shape or p0.ndim != 2 or p0.shape[1] != lattice.dim:
        raise ArgumentError(f"rays need two arrays of the same shape (R, {lattice.dim}), not {p0.shape} and {p1.shape}")
    if len(p0) == 0:
        return RayCells(np.empty((0, lattice.dim), np.int32), np.zeros(1, np.int64))
    from hexmap.lattice import _ray_kernels as kernels

    first, last = lattice.quantise(p0), lattice.quantise(p1)
    u0, u1 = lattice.coordinates(p0), lattice.coordinates(p1)
    offset = u0 - lattice.reduced_index(first)
    tables = lattice.ray_tables
    room = kernels.count_bound(u0, u1, tables)
    total = int(room.sum())
    if total > MAX_CELLS:
        raise TooLargeError(
            f"rays of up to {total:,} cells at resolution {lattice.resolution:g} m are more than {MAX_CELLS:,}; "
            "take a coarser resolution or shorter rays"
        )
    out = np.empty((total, lattice.dim), np.int32)
    offsets = np.zeros(len(p0) + 1, np.int64)
    used = kernels.traverse(u0, u1, offset, first, last, tables, room, out, offsets[1:])
    return RayCells(out[:used], offsets)
