"""Equal convex bodies around points, and how far points are from the nearest of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hexmap.base.values import one_line
from hexmap.lattice.lattice import Lattice

__all__ = ["Bodies", "BodyShape", "BodyTree", "Boxes"]

_LEAF = 8  # bodies in a leaf of the search tree


@dataclass(frozen=True)
class Boxes:
    """Equal squares or cubes, all turned alike.

    Attributes:
        centres: (M, n) float64, metres; only of those on the surface, which are the ones that can be nearest.
        edge: metres.
        frame: (n, n) float64, the boxes' axes as rows.
        grain: metres; a point that is no farther than this from a box is on its border.
        contains: tells for points (N, n), metres, whether they are in any box, also beneath the surface.
    """

    centres: NDArray[np.float64]
    edge: float
    frame: NDArray[np.float64]
    grain: float
    contains: Callable[[NDArray[np.float64]], NDArray[np.bool_]]

    __repr__ = one_line


class BodyShape(NamedTuple):
    """One body around the origin, as the kernels take it: a box, or a polytope where ``half`` is empty.

    Attributes:
        frame: (n, n) float64, the axes of a box as rows.
        half: (n,) float64 half edges of a box, metres; empty for a polytope.
        grain: metres; what is less than this outside a box is on its border.
        normals: (F, n) float64 unit normals of a polytope's faces.
        heights: (F,) float64 distance of each face from the origin, metres.
        edges: (E, 2, n) float64 ends of a polytope's edges, metres.
    """

    frame: NDArray[np.float64]
    half: NDArray[np.float64]
    grain: float
    normals: NDArray[np.float64]
    heights: NDArray[np.float64]
    edges: NDArray[np.float64]


class BodyTree(NamedTuple):
    """A binary tree over the bodies' centres, as the kernels take it.

    Attributes:
        centres: (M, n) float64, metres, in the order of the leaves: ``leaf`` of them to each.
        leaf: centres in a leaf.
        boxes: (2 P, 2, n) float64 low and high corner of each node, around its centres; node k has the children
            2 k and 2 k + 1, the root is 1 and the leaves begin at P. Nodes without a centre have an empty box.
        covering: metres; no body is nearer than its centre less this.
        inradius: metres; no body is farther than its centre less this.
    """

    centres: NDArray[np.float64]
    leaf: int
    boxes: NDArray[np.float64]
    covering: float
    inradius: float


@dataclass(frozen=True)
class Bodies:
    """Equal convex bodies around points.

    Attributes:
        centres: (M, n), metres.
        shape: the body.
        covering: distance, metres, of a body's farthest point from its centre.
        inradius: distance, metres, of its nearest border.
    """

    centres: NDArray[np.float64]
    shape: BodyShape
    covering: float
    inradius: float

    __repr__ = one_line

    @classmethod
    def of_cells(cls, lattice: Lattice, cells: NDArray[np.int64]) -> Bodies:
        """Return the Voronoi cells of ``cells`` (M, n)."""
        cell, n = lattice.cell, lattice.dim
        lengths = np.linalg.norm(cell.normals, axis=1)
        # Every edge is in the rings of two faces.
        pairs = {tuple(sorted((int(a), int(b)))) for r in cell.rings for a, b in zip(r, np.roll(r, 1), strict=True)}
        edges = np.ascontiguousarray(cell.vertices[np.array(sorted(pairs))])
        normals = np.ascontiguousarray(cell.normals / lengths[:, None])
        shape = BodyShape(np.zeros((n, n)), np.empty(0), 0.0, normals, lengths / 2.0, edges)
        return cls(lattice.centres(cells), shape, lattice.covering_radius, lattice.inradius)

    @classmethod
    def of_boxes(cls, boxes: Boxes) -> Bodies:
        """Return the boxes."""
        n = boxes.centres.shape[1]
        half = np.full(n, boxes.edge / 2.0)
        shape = BodyShape(boxes.frame, half, boxes.grain, np.empty((0, n)), np.empty(0), np.empty((0, 2, n)))
        return cls(boxes.centres, shape, boxes.edge / 2.0 * math.sqrt(n), boxes.edge / 2.0)

    @cached_property
    def _tree(self) -> BodyTree:
        """The tree of the centres, of which there is at least one."""
        from scipy.spatial import cKDTree

        # Its order puts centres that are near one another side by side: each run of a few is a leaf.
        order = cKDTree(self.centres, balanced_tree=False, compact_nodes=False).indices
        centres = np.ascontiguousarray(self.centres[order])
        starts = np.arange(0, len(centres), _LEAF)
        # As many leaves as a power of two, so that children are found by number; those too many stay empty.
        wide = 1 << max(len(starts) - 1, 0).bit_length()
        boxes = np.empty((2 * wide, 2, centres.shape[1]))
        boxes[:, 0], boxes[:, 1] = np.inf, -np.inf
        boxes[wide : wide + len(starts), 0] = np.minimum.reduceat(centres, starts)
        boxes[wide : wide + len(starts), 1] = np.maximum.reduceat(centres, starts)
        while wide > 1:
            below = boxes[wide : 2 * wide].reshape(wide // 2, 2, 2, -1)
            wide //= 2
            boxes[wide : 2 * wide, 0] = below[:, :, 0].min(axis=1)
            boxes[wide : 2 * wide, 1] = below[:, :, 1].max(axis=1)
        # The bounds may not cut off by rounding what is exactly at them.
        slack = 1e-9 * self.covering
        return BodyTree(centres, _LEAF, boxes, self.covering + slack, self.inradius - slack)

    def offsets(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distance (N,), metres, of points (N, n) to the body around the origin."""
        from hexmap.graph import _kernels as kernels

        out = np.empty(len(points), np.float64)
        kernels.to_body(np.ascontiguousarray(points), self.shape, out)
        return out

    def nearest(self, points: NDArray[np.float64], limit: float, enough: float) -> NDArray[np.float64]:
        """Return the distance (N,), metres, of points (N, n) to the nearest body.

        Infinite from ``limit`` on; a distance below ``enough`` may be any that is below.
        """
        from hexmap.graph import _kernels as kernels

        out = np.full(len(points), np.inf)
        if len(self.centres):
            kernels.nearest_body(np.ascontiguousarray(points), self._tree, self.shape, limit, enough, out)
        return out
