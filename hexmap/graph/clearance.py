"""Clearance in the graph layer: how far cells are from obstacles, and which are too near to them.

Clearance is measured to one of three kinds of obstacles: the centres of occupied cells, their Voronoi cells, or the
squares and cubes of a map that others made. Each kind is a class; :class:`Clearance` makes them when they are first
asked for and gives a query to the right one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any, Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError
from hexmap.graph.bodies import Bodies, Boxes
from hexmap.graph.obstacles import FoundCells, ObstacleCells
from hexmap.graph.window import CHUNK, Layout, Window
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.window import IndexBox

__all__ = ["BoxObstacles", "CellObstacles", "CentreObstacles", "Clearance", "Obstacles", "To", "check_to"]

To: TypeAlias = Literal["centre", "cell"]

_NEARER = 1e-9  # a clearance this little short of a radius is as large
_BALL = 20_000  # offsets of a clearance ball up to which stamping beats a search tree
_STAMPED_BOXES = 4  # index boxes hold so many times the cells of a ball before stamping them loses


def check_to(to: str) -> None:
    """Check what clearance is asked to.

    Raises:
        ArgumentError: it is neither "centre" nor "cell".
    """
    if to not in ("centre", "cell"):
        raise ArgumentError(f"clearance is that to an obstacle's centre or cell, not to {to!r}")


class Obstacles(Protocol):
    """Obstacles of one kind: how far away they are, and how to block what is near to them."""

    covering: float
    """Metres from the centre of an obstacle to the farthest point of it."""

    def distances(self, window: Window, flat: NDArray[np.int64], limit: float, enough: float) -> NDArray[np.float64]:
        """Return the distance (M,), metres, of cells' centres to the nearest obstacle.

        Infinite beyond ``limit``; a distance below ``enough`` may be any that is below.
        """
        ...

    def may_stamp(self, reach: NDArray[np.float64], most: int) -> bool:
        """Tell whether stamping is worth it where indices up to ``reach`` (n,) around each obstacle may be near."""
        ...

    def stamp(self, window: Window, radius: float, reach: NDArray[np.float64], free: NDArray[np.uint8]) -> None:
        """Block the cells of ``free`` (size,) nearer than ``radius``; indices up to ``reach`` (n,) around may be."""
        ...


class CentreObstacles:
    """The centres of cells."""

    covering = 0.0

    def __init__(self, lattice: Lattice, cells: NDArray[np.int64]) -> None:
        """Take the cells (M, n)."""
        self._lattice, self._cells = lattice, cells

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import cKDTree

        return cKDTree(self._lattice.centres(self._cells), balanced_tree=False, compact_nodes=False)

    def distances(self, window: Window, flat: NDArray[np.int64], limit: float, enough: float) -> NDArray[np.float64]:
        """Return the exact distance (M,), metres, to the nearest centre; infinite beyond ``limit``."""
        out = np.full(len(flat), np.inf)
        if len(self._cells):
            for piece in _pieces(len(flat)):
                out[piece] = self._tree.query(window.centres(flat[piece]), distance_upper_bound=limit)[0]
        return out

    def may_stamp(self, reach: NDArray[np.float64], most: int) -> bool:
        """Always."""
        return True

    def stamp(self, window: Window, radius: float, reach: NDArray[np.float64], free: NDArray[np.uint8]) -> None:
        """Stamp the ball of offsets around each cell."""
        offsets = _offsets_within(reach)
        away = np.sqrt((self._lattice.centres(offsets) ** 2).sum(axis=1))
        _stamp_ball(window, self._cells, offsets[away < _bound(radius)], free)


class CellObstacles:
    """Whole Voronoi cells: those on the surface as bodies, those beneath it as bits."""

    def __init__(self, lattice: Lattice, found: FoundCells) -> None:
        """Take the cells that were found."""
        self._lattice, self._found = lattice, found
        self._bodies = Bodies.of_cells(lattice, found.cells)
        self.covering = self._bodies.covering

    def distances(self, window: Window, flat: NDArray[np.int64], limit: float, enough: float) -> NDArray[np.float64]:
        """Return the distance (M,), metres, to the nearest cell; 0 for cells that are obstacles."""
        return _distances_to_bodies(self._bodies, lambda at, _: self._beneath(at), window, flat, limit, enough)

    def _beneath(self, flat: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Tell of cells (M,) which are obstacles, where only the surface of these is known as bodies."""
        solid = self._found.solid
        if solid is None:
            return np.zeros(len(flat), np.bool_)
        return (solid[flat >> 3] >> (7 - (flat & 7)).astype(np.uint8)) & 1 != 0

    def may_stamp(self, reach: NDArray[np.float64], most: int) -> bool:
        """Always."""
        return True

    def stamp(self, window: Window, radius: float, reach: NDArray[np.float64], free: NDArray[np.uint8]) -> None:
        """Stamp the offsets around each cell: which are near depends on the offset alone, not on the cell."""
        offsets = _offsets_within(reach)
        away = np.sqrt((self._lattice.centres(offsets) ** 2).sum(axis=1))
        # Few of a sheared basis's box can be near; the margin covers the rounding of the bound.
        offsets = offsets[away < (radius + self.covering) * 1.000001]
        away = self._bodies.offsets(self._lattice.centres(offsets))
        _stamp_ball(window, self._found.cells, offsets[away < _bound(radius)], free)
        if self._found.solid is not None:
            # Beneath the surface a cell may be free where the obstacles were told apart from what is blocked.
            for begin in range(0, window.size, CHUNK):
                end = min(begin + CHUNK, window.size)
                solid = np.unpackbits(self._found.solid[begin // 8 : (end + 7) // 8], count=end - begin)
                free[begin:end][solid != 0] = 0


class BoxObstacles:
    """Squares or cubes of a map that others made, of which the window's blocked cells are only the image."""

    def __init__(self, boxes: Boxes) -> None:
        """Take the boxes."""
        self._boxes = boxes
        self._bodies = Bodies.of_boxes(boxes)
        self.covering = self._bodies.covering

    def distances(self, window: Window, flat: NDArray[np.int64], limit: float, enough: float) -> NDArray[np.float64]:
        """Return the distance (M,), metres, to the nearest box; 0 for cells whose centre is in one."""
        inside = self._boxes.contains
        return _distances_to_bodies(self._bodies, lambda _, points: inside(points), window, flat, limit, enough)

    def may_stamp(self, reach: NDArray[np.float64], most: int) -> bool:
        """Tell whether the boxes of indices are small enough: boxes lie anywhere, so that all of each is tried."""
        return not bool(np.prod(2.0 * reach + 1.0) > _STAMPED_BOXES * most)

    def stamp(self, window: Window, radius: float, reach: NDArray[np.float64], free: NDArray[np.uint8]) -> None:
        """Try all cells of the index box around each box."""
        from hexmap.graph import _kernels as kernels

        boxes, layout, n = self._boxes, window.layout, window.lattice.dim
        # In the plane a dimension without extent comes first, for one loop serves both.
        flat, here = 3 - n, slice(3 - n, 3)
        columns, half = np.zeros((3, 3)), np.zeros(3)
        columns[here, here] = boxes.frame @ window.lattice.basis
        half[here] = boxes.edge / 2.0
        inverse = np.linalg.inv(window.lattice.basis)

        def lifted(values: NDArray[np.int64], fill: int) -> NDArray[np.int64]:
            return np.concatenate([np.full(flat, fill, np.int64), values])

        lifted_layout = Layout(
            lifted(layout.first, 0), lifted(layout.inner, 1), lifted(layout.pad, 0), lifted(layout.strides, 0)
        )
        lifted_reach = np.concatenate([np.zeros(flat), reach])
        for piece in _pieces(len(boxes.centres)):
            given = boxes.centres[piece]
            centres, at = np.zeros((len(given), 3)), np.zeros((len(given), 3))
            centres[:, here] = given @ boxes.frame.T
            at[:, here] = given @ inverse.T
            kernels.block_around_boxes(
                centres, at, lifted_reach, _bound(radius), columns, half, boxes.grain, lifted_layout, free
            )


def _bound(radius: float) -> float:
    """Return the distance below which a cell is too near for a robot of a radius, metres."""
    return radius * (1.0 - _NEARER)


def _pieces(count: int) -> Iterator[slice]:
    """Cut ``count`` rows into pieces of bounded size."""
    for begin in range(0, count, CHUNK):
        yield slice(begin, begin + CHUNK)


def _distances_to_bodies(
    bodies: Bodies,
    beneath: Callable[[NDArray[np.int64], NDArray[np.float64]], NDArray[np.bool_]],
    window: Window,
    flat: NDArray[np.int64],
    limit: float,
    enough: float,
) -> NDArray[np.float64]:
    """Return distances (M,) to the bodies of a surface; ``beneath`` tells which cells lie in it, by flat and centre."""
    out = np.full(len(flat), np.inf)
    for piece in _pieces(len(flat)):
        points = window.centres(flat[piece])
        within = beneath(flat[piece], points)
        found = np.zeros(len(points))
        found[~within] = bodies.nearest(points[~within], limit, enough)
        out[piece] = found
    return out


def _offsets_within(reach: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return all offsets (K, n) of up to ``reach`` (n,) along each index."""
    top = np.floor(reach).astype(np.int64)
    return IndexBox.of_corners(-top, top).cells()


def _stamp_ball(window: Window, cells: NDArray[np.int64], ball: NDArray[np.int64], free: NDArray[np.uint8]) -> None:
    """Block what is one of the offsets ``ball`` (B, n) away from one of the cells (M, n)."""
    from hexmap.graph import _kernels as kernels

    kernels.block_around(cells, np.ascontiguousarray(ball), window.layout, free)


class Clearance:
    """Where clearance is measured from; graphs derived from one another share it, and what it has found.

    Args:
        cells: tells which cells are obstacles, when first asked for.
        boxes: makes the boxes that the obstacles truly are, where the cells are only their image.
    """

    def __init__(self, cells: ObstacleCells, boxes: Callable[[], Boxes] | None = None) -> None:
        """Take where obstacles come from; nothing is computed yet."""
        self._source: ObstacleCells | None = cells
        self._boxes = boxes
        self._found: FoundCells | None = None
        self._kinds: dict[To, Obstacles] = {}

    def cells(self, window: Window) -> NDArray[np.int64]:
        """Return the cells (M, n); computed once, and of blocked cells only those on the surface."""
        return self._find(window).cells

    def _find(self, window: Window) -> FoundCells:
        # The source is read first: it goes only after the cells are there, so that a thread that sees no cells has it.
        source = self._source
        found = self._found
        if found is None:
            assert source is not None
            found = self._found = source.find(window)
            # The states that they were found in may be as large as the window.
            self._source = None
        return found

    def obstacles(self, window: Window, to: To) -> Obstacles:
        """Return the obstacles of the kind that clearance to their "centre" or "cell" is measured to; made once."""
        if to not in self._kinds:
            made: Obstacles
            if to == "centre":
                made = CentreObstacles(window.lattice, self._find(window).cells)
            elif self._boxes is None:
                made = CellObstacles(window.lattice, self._find(window))
            else:
                made = BoxObstacles(self._boxes())
            self._kinds[to] = made
        return self._kinds[to]

    def distances(
        self, window: Window, flat: NDArray[np.int64], limit: float = math.inf, to: To = "centre"
    ) -> NDArray[np.float64]:
        """Return the distance (M,), metres, of cells' centres to the nearest obstacle; inf beyond ``limit``."""
        return self.obstacles(window, to).distances(window, flat, limit, 0.0)

    def block_near(self, window: Window, radius: float, free: NDArray[np.uint8], to: To = "centre") -> None:
        """Block the cells of ``free`` (size,) that are nearer to an obstacle than a radius, metres.

        Offsets of all cells in the radius are stamped around the obstacles, or where that may be more than some
        thousands of them, a search tree is asked for each free cell.
        """
        if radius <= 0.0:
            return
        obstacles = self.obstacles(window, to)
        lattice, n = window.lattice, window.lattice.dim
        wide = radius + obstacles.covering
        # Over-estimates the lattice points of the ball: one cell's width is added to the radius.
        edge = 2.0 * (wide + lattice.covering_radius) / lattice.resolution
        if edge <= _BALL ** (1.0 / n):
            # |index_i| <= |row i of the inverse basis| * |x|
            reach = np.linalg.norm(np.linalg.inv(lattice.basis), axis=1) * wide * 1.000001
            if obstacles.may_stamp(reach, _BALL):
                obstacles.stamp(window, radius, reach, free)
                return
        nodes, bound = np.flatnonzero(free), _bound(radius)
        free[nodes[obstacles.distances(window, nodes, radius, bound) < bound]] = 0
