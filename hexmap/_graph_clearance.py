"""Clearance in the graph layer: which cells are obstacles, how far away they are, and what is too near to them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap._graph_window import CHUNK, Window, cells_in_box

__all__ = ["Obstacles"]

_NEARER = 1e-9  # a clearance this little short of a radius is as large


@dataclass
class Obstacles:
    """Where clearance is measured from; graphs derived from one another share it.

    Attributes:
        cells: (M, n) int64 index of all of them, once known.
        free: the states (size,) that they are found in otherwise: all blocked cells of the window.
        box: the corners, metres, of the box that they must lie in, if not the whole window counts.
        outside: whether the cells outside the window are obstacles as well.
    """

    cells: NDArray[np.int64] | None = None
    free: NDArray[np.uint8] | None = None
    box: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    outside: bool = False
    tree: Any = field(default=None, repr=False)

    def find(self, window: Window) -> NDArray[np.int64]:
        """Return the cells (M, n); computed once, and of blocked cells only those on the surface."""
        if self.cells is None and self.free is not None:
            from hexmap import _graph_kernels as kernels

            solid = np.zeros(window.size, np.uint8)
            if self.box is not None:
                for flat, _ in cells_in_box(window, *self.box):
                    solid[flat] = self.free[flat] == 0
            elif self.outside:
                np.equal(self.free, 0, out=solid, casting="unsafe")
            else:
                cut = tuple(slice(int(p), int(s - p)) for p, s in zip(window.pad, window.shape, strict=True))
                shape = tuple(int(s) for s in window.shape)
                np.equal(self.free.reshape(shape)[cut], 0, out=solid.reshape(shape)[cut], casting="unsafe")
            surface = np.zeros(window.size, np.uint8)
            faces = np.ascontiguousarray(window.lattice.faces @ window.strides)
            kernels.mark_surface(solid, faces, window.inner_shape, window.pad, window.strides, surface)
            # Not by flat_to_index: cells of the padding may lie beyond the range of int32.
            at = np.unravel_index(np.flatnonzero(surface), tuple(int(s) for s in window.shape))
            self.cells = np.ascontiguousarray(np.stack(at, axis=1) + window.low, dtype=np.int64)
            self.free = None
        assert self.cells is not None
        return self.cells

    def distances(self, window: Window, flat: NDArray[np.int64], limit: float = math.inf) -> NDArray[np.float64]:
        """Return the distance (M,), metres, of cells' centres to the nearest obstacle's; inf beyond ``limit``."""
        cells = self.find(window)
        out = np.full(len(flat), np.inf)
        if len(cells) == 0:
            return out
        if self.tree is None:
            from scipy.spatial import cKDTree

            self.tree = cKDTree(window.lattice.centres(cells), balanced_tree=False, compact_nodes=False)
        for begin in range(0, len(flat), CHUNK):
            part = slice(begin, begin + CHUNK)
            out[part] = self.tree.query(window.centres(flat[part]), distance_upper_bound=limit)[0]
        return out

    def block_near(self, window: Window, radius: float, free: NDArray[np.uint8], most: int) -> None:
        """Block the cells of ``free`` (size,) that are nearer to an obstacle than a radius, metres.

        Offsets of all cells in the radius are stamped around the obstacles, or where that may be more
        than ``most`` of them, a search tree is asked.
        """
        bound = radius * (1.0 - _NEARER)
        # Over-estimates the lattice points of the ball: one cell's width is added to the radius.
        n = window.lattice.dim
        if (2.0 * (radius + window.lattice.covering_radius)) ** n / window.lattice.cell_volume > most:
            nodes = np.flatnonzero(free)
            free[nodes[self.distances(window, nodes, radius) < bound]] = 0
        elif radius > 0.0:
            from hexmap import _graph_kernels as kernels

            # |index_i| <= |row i of the inverse basis| * |x|
            reach = np.floor(np.linalg.norm(np.linalg.inv(window.lattice.basis), axis=1) * radius * 1.000001)
            box = np.indices((2 * reach + 1).astype(np.int64)).reshape(n, -1).T - reach.astype(np.int64)
            ball = np.ascontiguousarray(box[np.sqrt((window.lattice.centres(box) ** 2).sum(axis=1)) < bound])
            kernels.block_around(
                self.find(window), ball, window.first, window.inner_shape, window.pad, window.strides, free
            )
