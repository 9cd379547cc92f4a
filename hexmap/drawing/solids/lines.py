"""The line of a trajectory in a picture of solids: what is seen of it, and what cells hide."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError
from hexmap.base.values import one_line
from hexmap.drawing.figure_layout import PATH_COLOUR
from hexmap.drawing.solids.renderer import Camera

if TYPE_CHECKING:
    from hexmap.poses.trajectory import Trajectory

__all__ = ["SeenLine", "add_line_legend", "positions_in_space"]

_WIDTH = 1.2  # points
_MOST = 100_000  # points along a line whose depth is asked for


def positions_in_space(trajectory: Trajectory | ArrayLike | None) -> FloatArray:
    """Return the positions (N, 3), metres, of what was given as a trajectory; rows that are not finite are NaN.

    Raises:
        ArgumentError: the positions are of another shape.
    """
    if trajectory is None:
        return np.empty((0, 3))
    positions = np.asarray(getattr(trajectory, "positions", trajectory), dtype=np.float64)
    if positions.size == 0:
        return np.empty((0, 3))
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise ArgumentError(f"the positions of a trajectory in space must be (N, 3), not {positions.shape}")
    finite = np.asarray(np.isfinite(positions).all(axis=1))
    return np.where(finite[:, None], positions, np.nan) if finite.any() else np.empty((0, 3))


@dataclass(frozen=True, eq=False)
class SeenLine:
    """A line as a camera sees it.

    Attributes:
        pixels: (K, 2) float64 along the line; NaN where it is interrupted.
        visible: (K,) whether no cell hides that point.
    """

    pixels: FloatArray
    visible: NDArray[np.bool_]

    __repr__ = one_line

    @classmethod
    def of(cls, positions: FloatArray, camera: Camera, nearness: NDArray[np.float32], step: float) -> SeenLine:
        """Look at a line through ``positions`` (N, 3), metres, with a point at least every ``step`` metres.

        ``nearness`` (H, W) is 1 / distance of what the picture shows. A point within a ``step`` behind a surface
        counts as visible: it lies in the cell that the surface is of.
        """
        points = _dense(positions, step)
        far = camera.distances(points)
        front = np.isfinite(far) & (far > 1e-6)
        pixels = np.full((len(points), 2), np.nan)
        pixels[front] = camera.project(points[front])
        height, width = nearness.shape
        inside = front & (pixels >= 0.0).all(axis=1) & (pixels < (width, height)).all(axis=1)
        column, row = pixels[inside].astype(np.int64).T
        visible = np.zeros(len(points), np.bool_)
        visible[inside] = (far[inside] - step) * nearness[row, column] <= 1.0
        return cls(pixels, visible)

    def draw(self, sheet: Any, height: float, dpi: float) -> None:
        """Draw it onto axes in inches, ``height`` inches high: a ring where it starts, a disc where it ends."""
        x, y = self.pixels[:, 0] / dpi, height - self.pixels[:, 1] / dpi
        for visible, style in (
            (False, dict(color=PATH_COLOUR, linewidth=0.8 * _WIDTH, linestyle=(0, (0.6, 2.0)), zorder=5)),
            (True, dict(color="white", linewidth=_WIDTH + 1.3, alpha=0.7, solid_capstyle="round", zorder=6)),
            (True, dict(color=PATH_COLOUR, linewidth=_WIDTH, solid_capstyle="round", zorder=7)),
        ):
            kept = self.visible == visible
            if not visible:
                # The hidden parts begin where the visible ones end, so that no gap shows.
                kept[:-1] |= kept[1:].copy()
                kept[1:] |= kept[:-1].copy()
            if kept.any():
                sheet.plot(np.where(kept, x, np.nan), np.where(kept, y, np.nan), **style)
        ends = np.flatnonzero(np.isfinite(x))
        for end, face in ((ends[:1], "white"), (ends[-1:], PATH_COLOUR)):
            mark = dict(marker="o", markersize=5.0, markerfacecolor=face, markeredgecolor=PATH_COLOUR)
            sheet.plot(x[end], y[end], **mark, markeredgewidth=1.2, linestyle="none", zorder=8)


def add_line_legend(sheet: Any, right: float, row: float) -> None:
    """Write what the line is, to the left of ``right``, inches."""
    text = sheet.text(right, row, "trajectory (dotted: hidden)", fontsize=7.5, ha="right", va="center")
    figure = sheet.figure
    x = right - text.get_window_extent(figure.canvas.get_renderer()).width / figure.dpi - 0.08
    sheet.plot([x - 0.25, x], [row, row], color=PATH_COLOUR, linewidth=_WIDTH)


def _dense(positions: FloatArray, step: float) -> FloatArray:
    """Return points (K, 3) of the line through ``positions``, at most ``step`` metres apart but for very long lines."""
    if len(positions) < 2:
        return positions
    lengths = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    total = float(np.nansum(lengths))
    step = max(step, total / _MOST)
    counts = [1 if math.isnan(d) else max(1, math.ceil(d / step)) for d in lengths.tolist()]
    segment = np.repeat(np.arange(len(counts)), counts)
    first = np.cumsum(counts) - counts
    fraction = (np.arange(len(segment)) - first[segment]) / np.array(counts)[segment]
    inner = positions[segment] + fraction[:, None] * (positions[segment + 1] - positions[segment])
    # A point before a gap is a point of its own all the same.
    inner = np.where(fraction[:, None] == 0.0, positions[segment], inner)
    return np.vstack([inner, positions[-1:]])
