"""The window of the graph layer: what a graph is without its moves, and its cells in a box of metres."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError
from hexmap.lattice.lattice import Lattice

__all__ = ["CHUNK", "Window", "cells_in_box", "window_of_box"]

CHUNK = 1 << 18  # cells handled at a time


class Window(Protocol):
    """What is needed of a :class:`~hexmap.graph.LatticeGraph`, which says what each of these is."""

    lattice: Lattice
    low: NDArray[np.int64]
    shape: NDArray[np.int64]
    pad: NDArray[np.int64]
    strides: NDArray[np.int64]
    size: int

    @property
    def first(self) -> NDArray[np.int64]:
        """(n,) index of the first cell inside the padding."""

    @property
    def inner_shape(self) -> NDArray[np.int64]:
        """(n,) cells along each index, without the padding."""

    def centres(self, flat: ArrayLike) -> NDArray[np.float64]:
        """Return the centres (M, n), metres, of the cells at flat positions (M,)."""


def window_of_box(
    lattice: Lattice, low: NDArray[np.float64], high: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first index (n,) and the sizes (n,) of a window of all cells whose centre is in a box, metres."""
    corners = np.array([[(low, high)[(c >> i) & 1][i] for i in range(lattice.dim)] for c in range(2**lattice.dim)])
    u = corners @ np.linalg.inv(lattice.basis).T
    if not np.abs(u).max() < 2.0**62:
        raise ArgumentError(f"the box {low.tolist()} to {high.tolist()} is too large for its resolution")
    first = np.ceil(u.min(axis=0) - 1e-6).astype(np.int64)
    last = np.floor(u.max(axis=0) + 1e-6).astype(np.int64)
    if (first > last).any():
        raise ArgumentError(f"no centre of a cell lies in the box {low.tolist()} to {high.tolist()}")
    return first, last - first + 1


def cells_in_box(
    window: Window, low: NDArray[np.float64], high: NDArray[np.float64]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]:
    """Yield, in pieces, the flat positions (N,) and centres (N, n) of the inner cells in a box, metres."""
    from hexmap.graph import _kernels as kernels

    n = window.lattice.dim
    inner = window.inner_shape
    total = math.prod(int(s) for s in inner)
    basis = np.ascontiguousarray(window.lattice.basis).copy()
    for begin in range(0, total, CHUNK):
        end = min(total, begin + CHUNK)
        flat = np.empty(end - begin, np.int64)
        points = np.empty((end - begin, n), np.float64)
        m = kernels.cells_in_box(
            begin, end, window.first, inner, window.pad, window.strides, basis, low, high, flat, points
        )
        if m:
            yield flat[:m], points[:m]
