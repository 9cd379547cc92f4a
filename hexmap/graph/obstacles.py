"""Which cells of a window are obstacles: those of a list, or those that are blocked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from hexmap.base.values import one_line
from hexmap.graph.window import Window, cells_in_box

__all__ = ["BlockedCells", "FoundCells", "ListedCells", "ObstacleCells"]


class FoundCells(NamedTuple):
    """The cells that are obstacles.

    Attributes:
        cells: (M, n) int64, of solid areas only the surface, where the cells are that can be nearest to one outside.
        solid: (size / 8,) uint8, bits by flat position of all of them, or None where ``cells`` has them all.
    """

    cells: NDArray[np.int64]
    solid: NDArray[np.uint8] | None


class ObstacleCells(Protocol):
    """Where the cells that are obstacles come from."""

    def find(self, window: Window) -> FoundCells:
        """Return the cells."""
        ...


@dataclass(frozen=True, eq=False)
class ListedCells:
    """The cells ``index`` (M, n) int64, which may lie outside the window."""

    index: NDArray[np.int64]

    __repr__ = one_line

    def find(self, window: Window) -> FoundCells:
        """Return all of them."""
        return FoundCells(self.index, None)


@dataclass(frozen=True, eq=False)
class BlockedCells:
    """The cells that are 0 in an array of states.

    Attributes:
        states: (size,) uint8, of all cells of the window.
        box: the corners, metres, of the box that their centres must lie in, if not the whole window counts.
        outside: whether the cells outside the window are obstacles as well: then those of its padding stand for them.
    """

    states: NDArray[np.uint8]
    box: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    outside: bool = False

    __repr__ = one_line

    def find(self, window: Window) -> FoundCells:
        """Return those on the surface."""
        from hexmap.graph import _kernels as kernels

        solid = np.zeros(window.size, np.uint8)
        if self.box is not None:
            for flat, _ in cells_in_box(window, *self.box):
                solid[flat] = self.states[flat] == 0
        elif self.outside:
            np.equal(self.states, 0, out=solid, casting="unsafe")
        else:
            inner, states = (window.box.without_padding(a, window.pad) for a in (solid, self.states))
            np.equal(states, 0, out=inner, casting="unsafe")
        surface = np.zeros(window.size, np.uint8)
        faces = np.ascontiguousarray(window.lattice.faces @ window.strides)
        kernels.mark_surface(solid, faces, window.layout, surface)
        # In 64 bits: cells of the padding may lie beyond the range of int32.
        index = window.box.index(np.flatnonzero(surface))
        return FoundCells(np.ascontiguousarray(index, dtype=np.int64), np.packbits(solid))
