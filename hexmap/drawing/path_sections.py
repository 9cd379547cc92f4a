"""Paths in space: sections through the cells along the path, from above and along its length.

From above every point shows the cell at the height of that point of the path which is nearest to it; below that the
section that stands on the path is rolled out: the length along the path across, the height up. Both are exact: every
sample of every pixel is quantised, and what is unknown is told from what is free.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hexmap.drawing.figure_layout import FAINT, FRAME, FigureLayout, label_axes
from hexmap.drawing.pixels import PointClasses, put_image, sample_image

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph

__all__ = ["PathSections"]

_GAP = 0.5  # inches between the two sections, for coordinates
_TALLEST = 9.0  # inches of both sections together
_LEAST_HEIGHT, _MOST_HEIGHT = 0.8, 3.5  # inches of the rolled-out section
_SAMPLES = 2  # of a pixel, along each side
_FINEST = 1024  # points along each side, at most, at which the height of the path is looked up

KindsOf = Callable[[NDArray[np.int64], NDArray[np.float64]], NDArray[np.uint8]]


class PathSections:
    """The cells of space along a path.

    Args:
        graph: that was searched.
        kinds_of: returns the kinds (M,) of cells of the graph by index (M, n) and centre (M, n).
        colours: of the kinds; the first one is what lies outside.
        line: (M, 3) the path, metres.
        box: the corners (3,) of what is to be seen.
        dpi: pixels an inch.
        titled: whether there is a title above.
    """

    def __init__(
        self,
        graph: LatticeGraph,
        kinds_of: KindsOf,
        colours: tuple[str, ...],
        line: NDArray[np.float64],
        box: tuple[NDArray[np.float64], NDArray[np.float64]],
        dpi: float,
        titled: bool,
    ) -> None:
        self._line, self._colours = line, colours
        room = 2.0 * graph.lattice.covering_radius
        low, high = box[0][2] - room, box[1][2] + room
        self._along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        length = max(float(self._along[-1]), graph.lattice.resolution)
        flat = np.array([box[0][:2], box[1][:2]])
        layout = FigureLayout.around(flat, graph.lattice, dpi, titled)
        wide = layout.pixels[0] / dpi
        # The same scale along and up where the page allows it.
        inches = min(max((high - low) / length * wide, _LEAST_HEIGHT), _MOST_HEIGHT)
        tall = layout.pixels[1] / dpi + inches
        if tall > _TALLEST:
            layout = FigureLayout.around(flat, graph.lattice, dpi, titled, shrink=_TALLEST / tall)
        self._rows = max(1, round(inches * dpi))
        extra = max(0.0, inches * length / wide - (high - low))
        self._span = float(low - 0.5 * extra), float(high + 0.5 * extra)
        self._length = length
        self._kinds = _Kinds(graph, kinds_of)
        self.layout = replace(layout, below=layout.below + self._rows / dpi + _GAP)

    @property
    def profile(self) -> NDArray[np.float64]:
        """The path (M, 2) as the rolled-out section shows it: the length so far and the height, metres."""
        return np.column_stack([self._along, self._line[:, 2]])

    def kinds_seen(self) -> set[int]:
        """Return the kinds that the pictures show, once they are drawn."""
        return self._kinds.seen

    def draw(self, figure: Any, axes: Any, suffix: str) -> None:
        """Draw the section at the heights of the path, seen from above."""
        layout = self.layout
        table = _AtHeights(self._kinds, self._line, layout.low, layout.high)
        step = layout.metres_per_pixel
        image = sample_image(
            (layout.low[0], layout.high[1]), (step, -step), layout.pixels, table, self._colours, _SAMPLES
        )
        corners = (layout.low[0], layout.high[0], layout.low[1], layout.high[1])
        self._place(figure, axes, image, corners, layout.bottom, suffix)
        _caption(axes, "at the heights of the path, from above")

    def draw_profile(self, figure: Any, suffix: str) -> Any:
        """Draw the section that stands on the path, rolled out, and return its axes."""
        layout = self.layout
        bottom = layout.bottom - self._rows / layout.dpi - _GAP
        size = layout.pixels[0] / layout.dpi / layout.width, self._rows / layout.dpi / layout.height
        axes = figure.add_axes((layout.left / layout.width, bottom / layout.height, *size))
        low, high = self._span
        axes.set_xlim(0.0, self._length)
        axes.set_ylim(low, high)
        table = _OnPath(self._kinds, self._line, self._along)
        steps = self._length / layout.pixels[0], -(high - low) / self._rows
        image = sample_image((0.0, high), steps, (layout.pixels[0], self._rows), table, self._colours, _SAMPLES)
        self._place(figure, axes, image, (0.0, self._length, low, high), bottom, suffix)
        label_axes(axes, "along the path, m", "z, m")
        for spine in axes.spines.values():
            spine.set(visible=True, edgecolor=FRAME, linewidth=0.6)
        _caption(axes, "under and over the path, rolled out")
        return axes

    def _place(
        self,
        figure: Any,
        axes: Any,
        image: NDArray[np.uint8],
        corners: tuple[float, float, float, float],
        bottom: float,
        suffix: str,
    ) -> None:
        """Put an image into axes: pixel by pixel where the file is one of pixels."""
        if suffix == ".png":
            put_image(figure, image, round(self.layout.left * self.layout.dpi), round(bottom * self.layout.dpi))
        else:
            axes.imshow(image, extent=corners, aspect="auto", interpolation="none", zorder=-1)


def _caption(axes: Any, text: str) -> None:
    # Outside the frame, where it hides nothing.
    style = dict(fontsize=7.5, color=FAINT, ha="right", va="bottom", annotation_clip=False)
    axes.annotate(text, (1, 1), (0, 2.5), xycoords="axes fraction", textcoords="offset points", **style)


class _Kinds:
    """The kinds of the graph's cells by points in space; cells are asked for when the first of their points is."""

    def __init__(self, graph: LatticeGraph, kinds_of: KindsOf) -> None:
        self._graph, self._kinds_of = graph, kinds_of
        self._known = np.full(graph.size, 255, np.uint8)
        self.lattice = graph.lattice
        self.seen: set[int] = set()

    def at(self, points: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Return the kind (N,) at each of the points (N, 3), metres; 0 outside the graph's window."""
        flat = self._graph.index_to_flat(self.lattice.quantise(points))
        inside = flat >= 0
        new = np.unique(flat[inside][self._known[flat[inside]] == 255])
        if len(new):
            index = self._graph.flat_to_index(new).astype(np.int64)
            self._known[new] = self._kinds_of(index, self.lattice.centres(index))
        kinds = np.where(inside, self._known[np.where(inside, flat, 0)], 0).astype(np.uint8)
        self.seen.update(np.flatnonzero(np.bincount(kinds)).tolist())
        return kinds


class _AtHeights(PointClasses):
    """Points of the plane, each at the height of the nearest point of the path."""

    def __init__(
        self, kinds: _Kinds, line: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]
    ) -> None:
        from scipy.spatial import cKDTree

        self.lattice, self._kinds = kinds.lattice, kinds
        self._step = max(0.5 * self.lattice.resolution, float((high - low).max()) / _FINEST)
        self._low = low
        self._counts = np.ceil((high - low) / self._step).astype(np.int64) + 1
        dense = _dense(line, self._step)
        at = np.stack(np.meshgrid(*(np.arange(c) for c in self._counts), indexing="ij"), axis=-1).reshape(-1, 2)
        nearest = cKDTree(dense[:, :2]).query(low + (at + 0.5) * self._step)[1]
        self._heights = dense[nearest, 2]

    def at(self, points: NDArray[np.float64]) -> NDArray[np.uint8]:
        column = np.clip(((points - self._low) / self._step).astype(np.int64), 0, self._counts - 1)
        return self._kinds.at(np.column_stack([points, self._heights[column[:, 0] * self._counts[1] + column[:, 1]]]))


class _OnPath(PointClasses):
    """Points of the rolled-out section: the length along the path and the height."""

    def __init__(self, kinds: _Kinds, line: NDArray[np.float64], along: NDArray[np.float64]) -> None:
        self.lattice, self._kinds, self._line, self._along = kinds.lattice, kinds, line, along

    def at(self, points: NDArray[np.float64]) -> NDArray[np.uint8]:
        x, y = (np.interp(points[:, 0], self._along, self._line[:, k]) for k in (0, 1))
        return self._kinds.at(np.column_stack([x, y, points[:, 1]]))


def _dense(line: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """Return points (K, n) along a line (M, n) that are no more than ``step`` apart."""
    pieces = [line[:1]]
    for a, b in pairwise(line):
        count = max(1, math.ceil(float(np.linalg.norm(b - a)) / step))
        pieces.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
    return np.concatenate(pieces)
