"""Maxima of a map's weights over boxes, laid out so that a search can bound a whole level at once.

A look-up a point and a block jumps about in memory and waits for it. Where most blocks of a level have to be bounded
anyhow, it is some hundred times faster to take the points one after the other and to add, for each, one row of bytes
to the bounds of all blocks. For that the boxes whose places differ by whole blocks have to lie side by side.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import IntArray

__all__ = ["Sheet", "make_sheet"]

# Places that a block of a level has along an axis; tables of higher levels round places down to these.
_MOST_PHASES = 8


class Sheet(NamedTuple):
    """The tables of one level of blocks of ``side`` = 2^level indices, one for each size of box.

    A place is an index counted from ``low``. It lies in block ``place // side``; its remainder, in steps of ``step``,
    is its phase. ``values`` holds a byte a box: size of box by size, phase by phase along each axis, and of each phase
    all blocks, row-major by ``strides``, block 0 at ``front``. Rows are parted by blocks outside the map, which hold
    zero: a row of blocks may begin up to ``margin`` blocks before the map, and lies there as far as it lies outside.

    Attributes:
        values: flat uint8.
        windows: (V,) indices along an axis of the boxes, ascending.
        low: (n,) index of the first place.
        strides: (n,) of the blocks of one phase.
        front: blocks before the first of a phase.
        size: blocks of a phase, with all margins.
        blocks: (n,) blocks along each axis that may hold something.
        level: of the blocks.
        step: indices from phase to phase.
        margin: (n,) blocks beyond the map on each side.
        beyond: (n,) indices for which it was made.
    """

    values: NDArray[np.uint8]
    windows: IntArray
    low: IntArray
    strides: IntArray
    front: int
    size: int
    blocks: IntArray
    level: int
    step: int
    margin: IntArray
    beyond: IntArray

    @property
    def phases(self) -> int:
        """Phases along an axis."""
        return (1 << self.level) // self.step


def make_sheet(
    cells: IntArray, weights: NDArray[np.uint8], windows: tuple[int, ...], level: int, beyond: IntArray
) -> Sheet:
    """Return the tables of a level.

    Args:
        cells: (M, n) indices of the cells that have a weight, at least one.
        weights: (M,) what each weighs, in steps.
        windows: indices along an axis of the boxes.
        level: of the blocks.
        beyond: (n,) over how many indices along each axis all shifts reach.
    """
    n = cells.shape[1]
    side = 1 << level
    step = max(1, side // _MOST_PHASES)
    phases = side // step
    # The lowest box that holds a cell begins this far before it.
    widest = max(windows) + step - 2
    low = cells.min(axis=0) - widest
    blocks = ((cells.max(axis=0) - low) >> level) + 1
    margin = (beyond >> level) + 2
    strides = np.ones(n, np.int64)
    for a in range(n - 2, -1, -1):
        strides[a] = strides[a + 1] * (blocks[a + 1] + margin[a + 1])
    front = int((margin * strides).sum())
    size = front + int(blocks[0] * strides[0]) + front
    values = np.zeros((len(windows), phases**n, size), np.uint8)
    # Entries of one step along each axis, raised by the cells; what a box holds beyond them is its sliding maximum.
    shape = tuple(int(b) * phases for b in blocks)
    for v, window in enumerate(windows):
        held = np.zeros(tuple(int(b) * side for b in blocks), np.uint8)
        np.maximum.at(held, tuple((cells - low).T), weights)
        for a in range(n):
            held = _sliding_maximum(held, window + step - 1, a)
            held = held.take(np.arange(0, held.shape[a], step), axis=a)
        assert held.shape == shape
        # (block, phase) of each axis, then phases first.
        parted = held.reshape([k for b in blocks for k in (int(b), phases)])
        parted = parted.transpose([2 * a + 1 for a in range(n)] + [2 * a for a in range(n)])
        parted = parted.reshape(phases**n, *[int(b) for b in blocks])
        room = values[v].reshape(phases**n, size)
        inner = np.lib.stride_tricks.as_strided(
            room[:, front:], shape=parted.shape, strides=(size, *[int(s) for s in strides])
        )
        inner[...] = parted
    return Sheet(values.reshape(-1), np.array(windows), low, strides, front, size, blocks, level, step, margin, beyond)


def _sliding_maximum(values: NDArray[np.uint8], window: int, axis: int) -> NDArray[np.uint8]:
    """Return the largest of the ``window`` values from each place on along an axis; beyond the end all is zero."""
    out = values.copy()
    held = 1
    while held < window:
        more = min(held, window - held)
        moved = np.moveaxis(out, axis, 0)
        later = moved[more:].copy()
        np.maximum(moved[: len(later)], later, out=moved[: len(later)])
        held += more
    return out
