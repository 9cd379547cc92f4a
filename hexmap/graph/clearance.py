"""Clearance in the graph layer: which cells are obstacles, how far away they are, and what is too near to them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError
from hexmap.graph.window import CHUNK, Window, cells_in_box
from hexmap.lattice.lattice import Lattice

__all__ = ["Boxes", "Obstacles", "To", "check_to"]

To: TypeAlias = Literal["centre", "cell"]

_NEARER = 1e-9  # a clearance this little short of a radius is as large
_LEAF = 8  # bodies in a leaf of the search tree
_STAMPED_BOXES = 4  # index boxes hold so many times the cells of a ball before stamping them loses


def check_to(to: str) -> None:
    """Check what clearance is asked to.

    Raises:
        ArgumentError: it is neither "centre" nor "cell".
    """
    if to not in ("centre", "cell"):
        raise ArgumentError(f"clearance is that to an obstacle's centre or cell, not to {to!r}")


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


@dataclass(frozen=True)
class _Bodies:
    """Equal convex bodies around points, in a search tree.

    Attributes:
        centres: (M, n), metres.
        shape: what the kernels take for the body: frame, half edges, grain, normals, heights, edges.
        covering: distance, metres, of a body's farthest point from its centre.
        inradius: distance, metres, of its nearest border.
    """

    centres: NDArray[np.float64]
    shape: Any
    covering: float
    inradius: float

    @classmethod
    def of_cells(cls, lattice: Lattice, cells: NDArray[np.int64]) -> _Bodies:
        """Return the Voronoi cells of ``cells`` (M, n)."""
        cell, n = lattice.cell, lattice.dim
        lengths = np.linalg.norm(cell.normals, axis=1)
        pairs = {tuple(sorted((int(a), int(b)))) for r in cell.rings for a, b in zip(r, np.roll(r, 1), strict=True)}
        edges = np.ascontiguousarray(cell.vertices[np.array(sorted(pairs))])
        normals = np.ascontiguousarray(cell.normals / lengths[:, None])
        shape = (np.zeros((n, n)), np.empty(0), 0.0, normals, lengths / 2.0, edges)
        return cls(lattice.centres(cells), shape, lattice.covering_radius, lattice.inradius)

    @classmethod
    def of_boxes(cls, boxes: Boxes) -> _Bodies:
        """Return the boxes."""
        n = boxes.centres.shape[1]
        half = np.full(n, boxes.edge / 2.0)
        shape = (boxes.frame, half, boxes.grain, np.empty((0, n)), np.empty(0), np.empty((0, 2, n)))
        return cls(boxes.centres, shape, boxes.edge / 2.0 * math.sqrt(n), boxes.edge / 2.0)

    @cached_property
    def _tree(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The centres (M, n) in the order of a binary tree's leaves, and the boxes (2 P, 2, n) of its nodes."""
        from scipy.spatial import cKDTree

        order = cKDTree(self.centres, balanced_tree=False, compact_nodes=False).indices
        centres = np.ascontiguousarray(self.centres[order])
        starts = np.arange(0, len(centres), _LEAF)
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
        return centres, boxes

    def offsets(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distance (N,), metres, of points (N, n) to the body around the origin."""
        from hexmap.graph import _kernels as kernels

        out = np.empty(len(points), np.float64)
        kernels.to_body(*(np.ascontiguousarray(points), *self.shape, out))
        return out

    def nearest(self, points: NDArray[np.float64], limit: float, enough: float) -> NDArray[np.float64]:
        """Return the distance (N,), metres, of points (N, n) to the nearest body.

        Infinite from ``limit`` on; a distance below ``enough`` may be any that is below.
        """
        from hexmap.graph import _kernels as kernels

        out = np.full(len(points), np.inf)
        if len(self.centres):
            centres, boxes = self._tree
            # The bounds may not cut off by rounding what is exactly at them.
            slack = 1e-9 * self.covering
            bounds = (self.covering + slack, self.inradius - slack)
            tree = (np.ascontiguousarray(points), centres, _LEAF, boxes)
            kernels.nearest_body(*(*tree, *bounds, *self.shape, limit, enough, out))
        return out


@dataclass
class Obstacles:
    """Where clearance is measured from; graphs derived from one another share it.

    Attributes:
        cells: (M, n) int64 index of all of them, once known.
        free: the states (size,) that they are found in otherwise: all blocked cells of the window.
        box: the corners, metres, of the box that they must lie in, if not the whole window counts.
        outside: whether the cells outside the window are obstacles as well.
        source: makes the boxes that the obstacles truly are, where the cells are only their image.
        solid: the bits (size / 8,) of the obstacles among the window's cells, where ``cells`` are their surface.
    """

    cells: NDArray[np.int64] | None = None
    free: NDArray[np.uint8] | None = None
    box: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    outside: bool = False
    source: Callable[[], Boxes] | None = None
    solid: NDArray[np.uint8] | None = field(default=None, repr=False)
    tree: Any = field(default=None, repr=False)
    boxes: Boxes | None = field(default=None, repr=False)
    bodies: _Bodies | None = field(default=None, repr=False)

    def find(self, window: Window) -> NDArray[np.int64]:
        """Return the cells (M, n); computed once, and of blocked cells only those on the surface."""
        if self.cells is None and self.free is not None:
            from hexmap.graph import _kernels as kernels

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
            self.solid = np.packbits(solid)
            self.free = None
        assert self.cells is not None
        return self.cells

    def _find_bodies(self, window: Window) -> _Bodies:
        """Return what clearance "to the cell" is measured from; computed once."""
        if self.bodies is None:
            if self.source is not None:
                self.boxes = self.source()
                self.bodies = _Bodies.of_boxes(self.boxes)
            else:
                self.bodies = _Bodies.of_cells(window.lattice, self.find(window))
        return self.bodies

    def _beneath(self, flat: NDArray[np.int64], points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell of cells (M,), by their centres (M, n), which are within the obstacles that have a surface only."""
        if self.boxes is not None:
            return self.boxes.contains(points)
        if self.solid is None:
            return np.zeros(len(flat), np.bool_)
        return (self.solid[flat >> 3] >> (7 - (flat & 7)).astype(np.uint8)) & 1 != 0

    def distances(
        self,
        window: Window,
        flat: NDArray[np.int64],
        limit: float = math.inf,
        to: To = "centre",
        enough: float = 0.0,
    ) -> NDArray[np.float64]:
        """Return the distance (M,), metres, of cells' centres to the nearest obstacle; inf beyond ``limit``.

        To the nearest obstacle's cell a distance below ``enough`` may be any that is below.
        """
        out = np.full(len(flat), np.inf)
        if to == "cell":
            bodies = self._find_bodies(window)
            for begin in range(0, len(flat), CHUNK):
                part = slice(begin, begin + CHUNK)
                points = window.centres(flat[part])
                beneath = self._beneath(flat[part], points)
                found = np.zeros(len(points))
                found[~beneath] = bodies.nearest(points[~beneath], limit, enough)
                out[part] = found
            return out
        cells = self.find(window)
        if len(cells) == 0:
            return out
        if self.tree is None:
            from scipy.spatial import cKDTree

            self.tree = cKDTree(window.lattice.centres(cells), balanced_tree=False, compact_nodes=False)
        for begin in range(0, len(flat), CHUNK):
            part = slice(begin, begin + CHUNK)
            out[part] = self.tree.query(window.centres(flat[part]), distance_upper_bound=limit)[0]
        return out

    def block_near(self, window: Window, radius: float, free: NDArray[np.uint8], most: int, to: To = "centre") -> None:
        """Block the cells of ``free`` (size,) that are nearer to an obstacle than a radius, metres.

        Offsets of all cells in the radius are stamped around the obstacles, or where that may be more
        than ``most`` of them, a search tree is asked. Which offsets from a cell are near hangs on the
        difference of the two alone, also where the distance is that to the whole cell.
        """
        from hexmap.graph import _kernels as kernels

        if radius <= 0.0:
            return
        bound = radius * (1.0 - _NEARER)
        lattice, n = window.lattice, window.lattice.dim
        wide = radius
        if to == "cell":
            bodies = self._find_bodies(window)
            wide += bodies.covering
        # Over-estimates the lattice points of the ball: one cell's width is added to the radius.
        edge = 2.0 * (wide + lattice.covering_radius) / lattice.resolution
        many = edge > most ** (1.0 / n)
        reach = np.zeros(n)
        if not many:
            # |index_i| <= |row i of the inverse basis| * |x|
            reach = np.linalg.norm(np.linalg.inv(lattice.basis), axis=1) * wide * 1.000001
        if to == "cell" and self.boxes is not None:
            many = many or bool(np.prod(2.0 * reach + 1.0) > _STAMPED_BOXES * most)
        if many:
            nodes = np.flatnonzero(free)
            free[nodes[self.distances(window, nodes, radius, to, bound) < bound]] = 0
            return
        if to == "cell" and self.boxes is not None:
            self._block_near_boxes(window, self.boxes, reach, bound, free)
            return
        top = np.floor(reach).astype(np.int64)
        box = np.indices(tuple(int(t) for t in 2 * top + 1)).reshape(n, -1).T - top
        away = np.sqrt((lattice.centres(box) ** 2).sum(axis=1))
        if to == "cell":
            # Few of a sheared basis's box can be near.
            box = box[away < wide * 1.000001]
            away = bodies.offsets(lattice.centres(box))
        ball = np.ascontiguousarray(box[away < bound])
        kernels.block_around(
            self.find(window), ball, window.first, window.inner_shape, window.pad, window.strides, free
        )
        if to == "cell" and self.solid is not None:
            # Beneath the surface a cell may be free where the obstacles were told apart from what is blocked.
            for begin in range(0, window.size, CHUNK):
                end = min(begin + CHUNK, window.size)
                solid = np.unpackbits(self.solid[begin // 8 : (end + 7) // 8], count=end - begin)
                free[begin:end][solid != 0] = 0

    def _block_near_boxes(
        self, window: Window, boxes: Boxes, reach: NDArray[np.float64], bound: float, free: NDArray[np.uint8]
    ) -> None:
        """Block the cells that are nearer than ``bound`` to a box, trying ``reach`` (n,) indices around each."""
        from hexmap.graph import _kernels as kernels

        n = window.lattice.dim
        # In the plane a dimension without extent comes first, for one loop serves both.
        flat, here = 3 - n, slice(3 - n, 3)
        columns = np.zeros((3, 3))
        columns[here, here] = boxes.frame @ window.lattice.basis
        half = np.zeros(3)
        half[here] = boxes.edge / 2.0
        inverse = np.linalg.inv(window.lattice.basis)

        def lifted(values: NDArray[np.int64], fill: int) -> NDArray[np.int64]:
            return np.concatenate([np.full(flat, fill, np.int64), values])

        for begin in range(0, len(boxes.centres), CHUNK):
            part = boxes.centres[begin : begin + CHUNK]
            centres, at = np.zeros((len(part), 3)), np.zeros((len(part), 3))
            centres[:, here] = part @ boxes.frame.T
            at[:, here] = part @ inverse.T
            kernels.block_around_boxes(
                centres,
                at,
                np.concatenate([np.zeros(flat), reach]),
                bound,
                columns,
                half,
                boxes.grain,
                lifted(window.first, 0),
                lifted(window.inner_shape, 1),
                lifted(window.pad, 0),
                lifted(window.strides, 0),
                free,
            )
