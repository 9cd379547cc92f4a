"""Pictures of paths: the cells that were searched and the path through them.

In the plane the true cells are drawn as :mod:`hexmap.drawing` draws those of maps. Of paths in space two sections
through the cells are drawn, see :mod:`hexmap.drawing.path_sections`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError
from hexmap.drawing.figure_layout import (
    FRAME,
    FREE_COLOUR,
    NEAR_COLOUR,
    PATH_COLOUR,
    SHADES,
    UNKNOWN_COLOUR,
    FigureLayout,
    draw_path_captions,
)
from hexmap.drawing.map_drawing import add_cells, check_picture, draw_areas, draw_line, save_figure
from hexmap.drawing.path_sections import PathSections
from hexmap.drawing.pixels import draw_pixels
from hexmap.lattice.window import IndexBox, box_coordinates
from hexmap.maps.cell_state import CellState
from hexmap.maps.outlines import ClassTable
from hexmap.maps.voxel_list import VoxelList

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph

__all__ = ["draw_path"]

Corners: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float64]]

_WALL = SHADES[-2]
_NEAR = 3  # after the states
_COLOURS = (UNKNOWN_COLOUR, FREE_COLOUR, _WALL, NEAR_COLOUR)
_MARGIN, _MARGIN_CELLS = 0.15, 8  # around the path, as a fraction of its longer side, and in cells at least
_EDGED_WIDTH, _EDGED_CELLS = 0.05, 40_000  # cells at least so wide, inches, get an outline, if no more than so many
_LINE = 1.8  # points, of the path


def draw_path(
    points: ArrayLike,
    path: str | os.PathLike[str],
    graph: LatticeGraph,
    state_at: Callable[[NDArray[np.float64]], NDArray[np.uint8]] | None = None,
    *,
    goal: ArrayLike | None = None,
    extent: tuple[ArrayLike, ArrayLike] | None = None,
    whole: bool = False,
    y_down: bool = False,
    title: str | None = None,
    words: str = "",
    dpi: float = 200.0,
) -> Path:
    """Draw a path and the cells around it into a file; the suffix says which kind.

    Args:
        points: the path (M, n), metres.
        path: ``.png``, ``.svg`` or ``.pdf``.
        graph: that was searched; its free cells are drawn as free.
        state_at: returns the :class:`~hexmap.maps.CellState` (N,) of points (N, n), metres. Cells that are
            free by it and blocked in the graph are drawn as too near to an obstacle. Where none is given, what
            is not free is occupied.
        goal: where the path should have led (n,), metres, if it ends elsewhere; left out beyond the extent.
        extent: low and high corner (n,), metres, of what the source of the graph covers; no cell beyond is
            drawn. All free cells where none is given.
        whole: show all of it, not the path's surroundings only.
        y_down: draw low y at the top, as the maps of games count.
        title: a line above the picture, if any.
        words: what to add to the small print.
        dpi: pixels an inch of a PNG; the longer side of the map is 8 inches.

    Returns:
        The path of the file.

    Raises:
        ArgumentError: a suffix that is not known, points, goal or extent of another shape, or more
            pixels than an image should have.
        FileAccessError: the file cannot be written.
    """
    file = Path(path)
    suffix = check_picture(file)
    if not 10.0 <= dpi <= 5000.0:
        raise ArgumentError(f"a picture has 10 to 5000 pixels an inch, not {dpi:g}")
    n = graph.lattice.dim
    line = np.asarray(points, dtype=np.float64)
    if line.ndim != 2 or line.shape[1] != n or len(line) == 0 or not np.isfinite(line).all():
        raise ArgumentError(f"a path in this graph must be finite points (M, {n}), not {line.shape}")
    target = None if goal is None else np.asarray(goal, dtype=np.float64)
    if target is not None and (target.shape != (n,) or not np.isfinite(target).all()):
        raise ArgumentError(f"a goal in this graph must be {n} finite numbers, not {goal!r}")
    covered = _extent(graph) if extent is None else _corners(extent, n)
    if target is not None and ((target < covered[0]) | (target > covered[1])).any():
        target = None  # so far away, it would make all else small
    seen = line if target is None else np.vstack([line, target])
    box = _box(graph, seen, covered, whole)
    scene: _Plane | PathSections
    if n == 2:
        layout = FigureLayout.around(np.array(box), graph.lattice, dpi, title is not None, y_down)
        scene = _Plane(graph, state_at, layout, covered)
    else:
        kinds_of = partial(_kinds_within, graph, state_at, covered)
        scene = PathSections(graph, kinds_of, _COLOURS, line, box, dpi, title is not None)

    def draw(figure: Any, axes: Any) -> None:
        scene.draw(figure, axes, suffix)
        draw_line(axes, line[:, :2], _LINE)
        if isinstance(scene, PathSections):
            draw_line(scene.draw_profile(figure, suffix), scene.profile, _LINE)
        if target is not None:
            mark = dict(marker="x", markersize=6.5, markeredgecolor=PATH_COLOUR, markeredgewidth=1.6)
            axes.plot(*target[:2], **mark, zorder=8)
        kinds = _legend(scene.kinds_seen())
        draw_path_captions(figure, scene.layout, graph.lattice, kinds, title, words, target is not None)

    save_figure(scene.layout, file, draw)
    return file


def _legend(seen: set[int]) -> list[tuple[str, str]]:
    """Return names and colours of the kinds of cells for the legend: unknown and too near ones where there are any."""
    kinds = [("free", FREE_COLOUR), ("occupied", _WALL)]
    if int(CellState.UNKNOWN) in seen:
        kinds.append(("unknown", UNKNOWN_COLOUR))
    if _NEAR in seen:
        kinds.insert(1, ("too near", NEAR_COLOUR))
    return kinds


def _box(graph: LatticeGraph, seen: NDArray[np.float64], covered: Corners, whole: bool) -> Corners:
    """Return the box of the picture: the path and some room around it, or all that is covered."""
    low, high = seen.min(axis=0), seen.max(axis=0)
    if whole:
        return np.minimum(low, covered[0]), np.maximum(high, covered[1])
    room = max(_MARGIN * float((high - low).max()), _MARGIN_CELLS * graph.lattice.resolution)
    return np.minimum(low, np.maximum(low - room, covered[0])), np.maximum(high, np.minimum(high + room, covered[1]))


def _corners(extent: tuple[ArrayLike, ArrayLike], n: int) -> Corners:
    low, high = (np.asarray(corner, dtype=np.float64) for corner in extent)
    if low.shape != (n,) or high.shape != (n,) or not (np.isfinite([low, high]).all() and (low <= high).all()):
        raise ArgumentError(f"an extent takes two corners of {n} finite numbers, the low one first, not {extent!r}")
    return low, high


def _extent(graph: LatticeGraph) -> Corners:
    """Return the low and the high corner (n,), metres, of the free cells' centres."""
    low, high = np.full(graph.lattice.dim, np.inf), np.full(graph.lattice.dim, -np.inf)
    free = np.flatnonzero(graph.free)
    for k in range(0, len(free), 1 << 20):
        centres = graph.centres(free[k : k + (1 << 20)])
        low, high = np.minimum(low, centres.min(axis=0)), np.maximum(high, centres.max(axis=0))
    return low, high


def _cells_in_box(
    graph: LatticeGraph, low: NDArray[np.float64], high: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return index (M, n) and centres (M, n), metres, of the graph's cells whose centre is in a box."""
    u = box_coordinates(graph.lattice.basis, low, high)
    first = np.maximum(np.floor(u.min(axis=0)).astype(np.int64), graph.first)
    last = np.minimum(np.ceil(u.max(axis=0)).astype(np.int64), graph.first + graph.inner_shape - 1)
    cells, centres = [np.empty((0, len(low)), np.int64)], [np.empty((0, len(low)))]
    # Row by row: of a sheared basis's box most cells may lie outside.
    for a in range(first[0], last[0] + 1):
        index = IndexBox.of_corners(np.array([a, *first[1:]]), np.array([a, *last[1:]])).cells()
        at = graph.lattice.centres(index)
        inside = np.all((at >= low) & (at <= high), axis=1)
        cells.append(index[inside])
        centres.append(at[inside])
    return np.concatenate(cells), np.concatenate(centres)


def _kinds_of(
    graph: LatticeGraph,
    state_at: Callable[[NDArray[np.float64]], NDArray[np.uint8]] | None,
    index: NDArray[np.int64],
    centres: NDArray[np.float64],
) -> NDArray[np.uint8]:
    """Return the states (M,), too near among them, of cells of the graph."""
    free = graph.free[graph.index_to_flat(index)] != 0
    if state_at is None:
        return np.where(free, CellState.FREE, CellState.OCCUPIED).astype(np.uint8)
    states = np.asarray(state_at(centres)).astype(np.uint8)
    return np.where((states == CellState.FREE) & ~free, _NEAR, states).astype(np.uint8)


def _kinds_within(
    graph: LatticeGraph,
    state_at: Callable[[NDArray[np.float64]], NDArray[np.uint8]] | None,
    covered: Corners,
    index: NDArray[np.int64],
    centres: NDArray[np.float64],
) -> NDArray[np.uint8]:
    """Return the kinds (M,) of cells of the graph; beyond what its source covers they are unknown."""
    inside = ((centres >= covered[0]) & (centres <= covered[1])).all(axis=1)
    kinds = np.full(len(index), CellState.UNKNOWN, np.uint8)
    kinds[inside] = _kinds_of(graph, state_at, index[inside], centres[inside])
    return kinds


# ---------------------------------------------------------------------- in the plane


class _Plane:
    """The cells of the plane that the figure shows."""

    def __init__(self, graph: LatticeGraph, state_at: Any, layout: FigureLayout, covered: Corners) -> None:
        self.layout = layout
        self._lattice = graph.lattice
        room = 2.0 * graph.lattice.covering_radius
        low, high = np.maximum(layout.low - room, covered[0]), np.minimum(layout.high + room, covered[1])
        self._index, self._centres = _cells_in_box(graph, low, high)
        self._classes = _kinds_of(graph, state_at, self._index, self._centres)

    def kinds_seen(self) -> set[int]:
        """Return the kinds of cells that are shown."""
        return set(np.unique(self._classes).tolist())

    def _cells(self, *classes: int) -> VoxelList:
        return VoxelList.from_cells(self._index[np.isin(self._classes, classes)], self._lattice)

    def draw(self, figure: Any, axes: Any, suffix: str) -> None:
        """Draw the cells: pixel by pixel or as outlines."""
        if suffix == ".png":
            walls = self._classes == CellState.OCCUPIED
            lists = [self._cells(k) for k in (CellState.FREE, CellState.OCCUPIED, _NEAR)]
            table = ClassTable(
                self._lattice,
                [
                    (cells, np.full(len(cells), k, np.uint8))
                    for k, cells in zip((CellState.FREE, CellState.OCCUPIED, _NEAR), lists, strict=True)
                ],
            )
            draw_pixels(figure, self.layout, table, _COLOURS, self._centres[walls], self._classes[walls])
        else:
            # Each area holds the ones after it, so no seam can show.
            known, near = self._cells(CellState.FREE, CellState.OCCUPIED, _NEAR), self._cells(CellState.OCCUPIED, _NEAR)
            draw_areas(axes, [(known, FREE_COLOUR), (near, NEAR_COLOUR), (self._cells(CellState.OCCUPIED), _WALL)])
        if self._lattice.resolution >= _EDGED_WIDTH * self.layout.metres_per_inch and len(self._index) <= _EDGED_CELLS:
            walls = self._classes == CellState.OCCUPIED
            for chosen, colour in ((~walls, FRAME), (walls, FREE_COLOUR)):
                add_cells(
                    axes, self.layout, self._lattice, self._centres[chosen],
                    facecolors="none", edgecolors=colour, linewidths=0.3,
                )  # fmt: skip

