"""The window of the graph layer: what a graph is without its moves, and its cells in a box of metres."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.window import IndexBox, box_coordinates

__all__ = ["CHUNK", "Layout", "Window", "cells_in_box", "window_of_box"]

CHUNK = 1 << 18  # cells handled at a time
_SLACK = 1e-6  # of an index: more than rounding moves a corner by, less than any cell


class Layout(NamedTuple):
    """How the cells of a window lie in memory, as plain arrays for the kernels.

    Attributes:
        first: (n,) int64 index of the first cell inside the padding.
        inner: (n,) int64 cells along each index, without the padding.
        pad: (n,) int64 width of the padding on either side.
        strides: (n,) int64 what one step along each index adds to a flat position.
    """

    first: NDArray[np.int64]
    inner: NDArray[np.int64]
    pad: NDArray[np.int64]
    strides: NDArray[np.int64]


class Window(Protocol):
    """What is needed of a :class:`~hexmap.graph.LatticeGraph`, which says what each of these is."""

    lattice: Lattice
    low: NDArray[np.int64]
    shape: NDArray[np.int64]
    pad: NDArray[np.int64]
    strides: NDArray[np.int64]
    size: int

    @property
    def box(self) -> IndexBox:
        """The box of all cells, padding included."""

    @property
    def layout(self) -> Layout:
        """How the cells lie in memory."""

    def centres(self, flat: ArrayLike) -> NDArray[np.float64]:
        """Return the centres (M, n), metres, of the cells at flat positions (M,)."""


def window_of_box(lattice: Lattice, low: NDArray[np.float64], high: NDArray[np.float64]) -> IndexBox:
    """Return the box of indices that holds all cells whose centre is in a box, metres.

    Raises:
        ArgumentError: it holds no such cell, or more than can be counted.
    """
    u = box_coordinates(lattice.basis, low, high)
    if not np.abs(u).max() < 2.0**62:
        raise ArgumentError(f"the box {low.tolist()} to {high.tolist()} is too large for its resolution")
    first = np.ceil(u.min(axis=0) - _SLACK).astype(np.int64)
    last = np.floor(u.max(axis=0) + _SLACK).astype(np.int64)
    if (first > last).any():
        raise ArgumentError(f"no centre of a cell lies in the box {low.tolist()} to {high.tolist()}")
    return IndexBox.of_corners(first, last)


def cells_in_box(
    window: Window, low: NDArray[np.float64], high: NDArray[np.float64]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]:
    """Yield, in pieces, the flat positions (N,) and centres (N, n) of the inner cells in a box, metres."""
    from hexmap.graph import _kernels as kernels

    layout, n = window.layout, window.lattice.dim
    total = int(np.prod(layout.inner))
    basis = np.ascontiguousarray(window.lattice.basis).copy()
    for begin in range(0, total, CHUNK):
        end = min(total, begin + CHUNK)
        flat = np.empty(end - begin, np.int64)
        points = np.empty((end - begin, n), np.float64)
        m = kernels.cells_in_box(begin, end, layout, basis, low, high, flat, points)
        if m:
            yield flat[:m], points[:m]
