"""Pictures of maps: the true cells, shaded by how often they were hit.

PNG images are computed cell by cell, exactly: every sample of every pixel is quantised, so a hexagon
is a hexagon at any size. SVG and PDF hold the outlines of whole areas as curves without rounding, one
shape a shade. Maps in space are drawn from above, the highest occupied cell of each column
coloured by its height. No display is needed, and the same arguments give the same bytes.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.atomic_files import atomic_write
from hexmap.base.errors import ArgumentError
from hexmap.base.values import one_line
from hexmap.drawing.extent import bulk
from hexmap.drawing.figure_layout import (
    FAINT,
    FREE_COLOUR,
    HEIGHTS,
    PATH_COLOUR,
    SHADES,
    UNKNOWN_COLOUR,
    FigureLayout,
    draw_captions,
    has_hits,
    thresholds,
)
from hexmap.drawing.pixels import draw_pixels
from hexmap.lattice.lattice import Lattice
from hexmap.maps.map import Map
from hexmap.maps.outlines import ClassTable, Rings, outline, silhouette
from hexmap.maps.state_rule import StateRule, States
from hexmap.maps.voxel_list import VoxelList

if TYPE_CHECKING:
    from hexmap.poses.trajectory import Trajectory

__all__ = ["SUFFIXES", "HighestCells", "check_picture", "draw_map", "draw_states", "highest_cells"]

SUFFIXES = (".png", ".svg", ".pdf")

# Cells at least this wide, in inches, get an outline of their own, if they are not too many.
_OUTLINED_WIDTH, _OUTLINED_CELLS = 0.07, 40_000


def check_picture(path: Path) -> str:
    """Return the suffix of a picture that is to be drawn, lower case.

    Raises:
        ArgumentError: it is none that can be drawn.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        kind = suffix or "a file without a suffix"
        raise ArgumentError(f"{path}: cannot draw {kind}; known are {', '.join(SUFFIXES)}")
    return suffix


def draw_map(
    map: Map,
    path: str | os.PathLike[str],
    level: int = 0,
    trajectory: Trajectory | ArrayLike | None = None,
    rule: StateRule | None = None,
    dpi: float = 200.0,
    title: str | None = None,
    whole: bool = False,
) -> Path:
    """Draw a level of a map into a file; the suffix says which kind.

    Args:
        map: the map; an empty one gives an empty picture that says so.
        path: ``.png``, ``.svg`` or ``.pdf``.
        level: which level, 0 is the finest.
        trajectory: where the robot went, in the map's frame: a trajectory or positions (N, 2) or
            (N, 3), metres; a row that is not finite interrupts the line.
        rule: what makes a cell occupied or free; the default rule where none is given.
        dpi: pixels an inch of a PNG; the longer side of the map is 8 inches.
        title: a line above the map, if any.
        whole: show strays, too: the few cells far from all others that beams through windows or off mirrors leave.

    Returns:
        The path of the file.

    Raises:
        ArgumentError: a suffix that is not known, no such level, positions of another shape, or
            more pixels than an image should have.
        FileAccessError: the file cannot be written.
    """
    check_picture(Path(path))
    return draw_states(map.state(rule, level), path, trajectory, dpi, title, whole=whole)


def draw_states(
    states: States,
    path: str | os.PathLike[str],
    trajectory: Trajectory | ArrayLike | None = None,
    dpi: float = 200.0,
    title: str | None = None,
    overlay: Callable[[Any], None] | None = None,
    whole: bool = False,
    offset: ArrayLike = 0.0,
) -> Path:
    """Draw occupied and free cells, of a level of a map or of a map of others, as :func:`draw_map` does.

    ``overlay`` draws on the axes what else is to be seen, in metres. Where the cell 0 of the lattice has its centre
    is at ``offset`` (2,), metres. Where no cell has more than one hit, as in maps of others, occupied cells have one
    shade.

    Raises:
        ArgumentError: a suffix that is not known, positions of another shape, or more pixels than an image should have.
        FileAccessError: the file cannot be written.
    """
    path = Path(path)
    suffix = check_picture(path)
    if not 10.0 <= dpi <= 5000.0:
        raise ArgumentError(f"a picture has 10 to 5000 pixels an inch, not {dpi:g}")
    positions = _trajectory_positions(trajectory)
    highest = highest_cells(states.occupied) if states.occupied.lattice.dim == 3 else None
    cells = [highest.centres] if highest is not None else [states.occupied.centres(), states.free.centres()]
    moved = np.broadcast_to(np.asarray(offset, dtype=np.float64), 2)
    cells = [c[:, :2] + moved for c in cells]
    finite = positions[np.isfinite(positions).all(axis=1)]
    seen = np.concatenate([*cells, finite])
    if not whole:
        hits = states.occupied.counts if highest is None else None
        seen = np.concatenate([*bulk(*cells, hits=hits), finite])
    layout = FigureLayout.around(seen, states.occupied.lattice, dpi, title is not None)
    outside = sum(layout.count_outside(c) for c in cells)

    def draw(figure: Any, axes: Any) -> None:
        if highest is not None:
            _draw_highest(axes, layout, highest)
        elif suffix == ".png":
            _draw_states_as_pixels(figure, layout, states, moved)
        else:
            _draw_outlines(axes, states, moved)
        if highest is None:
            _draw_cell_edges(axes, layout, states, moved)
        draw_line(axes, positions)
        if overlay is not None:
            overlay(axes)
        if len(states.occupied) + (len(states.free) if highest is None else 0) == 0:
            words = "empty map: no cell is occupied" + (" or free" if highest is None else "")
            axes.text(0.5, 0.5, words, transform=axes.transAxes, ha="center", va="center", color=FAINT, fontsize=11)
        draw_captions(figure, layout, states, highest.heights if highest else None, len(positions) > 0, title, outside)

    save_figure(layout, path, draw)
    return path


def save_figure(layout: FigureLayout, path: Path, draw: Callable[[Any, Any], None]) -> None:
    """Write a figure into a file of a known suffix; ``draw`` takes the figure and the axes of the map."""
    import matplotlib
    from matplotlib import style
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    suffix = path.suffix.lower()
    # The user's own style must not leak in, nor ours out; the salt makes ids in SVG repeatable.
    with style.context("default", after_reset=True), matplotlib.rc_context(_SETTINGS):
        figure = Figure(figsize=(layout.width, layout.height), dpi=layout.dpi, facecolor="white")
        FigureCanvasAgg(figure)
        draw(figure, layout.add_axes(figure))
        buffer = io.BytesIO()
        figure.savefig(buffer, format=suffix[1:], dpi=layout.dpi, metadata=_METADATA[suffix])
    content = buffer.getvalue()
    with atomic_write(path) as handle:
        handle.write(_shorten(content) if suffix == ".svg" else content)


def _shorten(svg: bytes) -> bytes:
    """Cut the coordinates of curves to thousandths of a point; six digits are half of the file."""
    return re.sub(rb' d="[^"]*"', lambda curve: re.sub(rb"(\.\d{3})\d+", rb"\1", curve[0]), svg)


_SETTINGS: dict[Any, Any] = {"svg.hashsalt": "hexmap", "pdf.fonttype": 42, "font.family": ["DejaVu Sans"]}
# Dates and versions would make the same picture differ from day to day and from machine to machine.
_METADATA: dict[str, dict[str, None]] = {
    ".png": {"Software": None},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}


# ---------------------------------------------------------------------- what goes where


@dataclass(frozen=True)
class HighestCells:
    """The highest occupied cell of each column, from the lowest to the highest."""

    lattice: Lattice
    centres: NDArray[np.float64]

    __repr__ = one_line

    @property
    def heights(self) -> tuple[float, float] | None:
        """The lowest and the highest height, metres; None where there is no cell."""
        if len(self.centres) == 0:
            return None
        return float(self.centres[0, 2]), float(self.centres[-1, 2])


def highest_cells(occupied: VoxelList) -> HighestCells:
    """Return the highest cell of each column; cells are in one column where their x and y agree to a millionth."""
    lattice, centres = occupied.lattice, occupied.centres()
    if len(centres):
        column = np.round(centres[:, :2] / (1e-6 * lattice.resolution)).astype(np.int64)
        order = np.lexsort((-centres[:, 2], column[:, 1], column[:, 0]))
        first = np.ones(len(order), np.bool_)
        first[1:] = (np.diff(column[order], axis=0) != 0).any(axis=1)
        centres = centres[order[first]]
        # Painted in this order a higher cell hides what it is above.
        centres = centres[np.argsort(centres[:, 2], kind="stable")]
    return HighestCells(lattice, centres)


def _trajectory_positions(trajectory: Trajectory | ArrayLike | None) -> NDArray[np.float64]:
    """Return the positions (N, 2), metres, of what was given as a trajectory."""
    if trajectory is None:
        return np.empty((0, 2))
    positions = np.asarray(getattr(trajectory, "positions", trajectory), dtype=np.float64)
    if positions.size == 0:
        return np.empty((0, 2))
    if positions.ndim != 2 or positions.shape[1] not in (2, 3):
        raise ArgumentError(f"the positions of a trajectory must be (N, 2) or (N, 3), not {positions.shape}")
    finite = np.asarray(np.isfinite(positions).all(axis=1))
    return np.where(finite[:, None], positions[:, :2], np.nan) if finite.any() else np.empty((0, 2))


def _shades(occupied: VoxelList) -> NDArray[np.int64]:
    """Return the shade (M,) of each cell, 0 for one hit and darker by the logarithm; dark where hits say nothing."""
    if len(occupied) == 0:
        return np.empty(0, np.int64)
    if not has_hits(occupied):
        return np.full(len(occupied), len(SHADES) - 2)
    return np.searchsorted(thresholds(occupied), occupied.counts, side="right")


# ---------------------------------------------------------------------- cells of the plane


class _Moved:
    """Classes of cells whose lattice lies at an offset (2,), metres."""

    def __init__(self, table: ClassTable, offset: NDArray[np.float64]) -> None:
        self.lattice = table.lattice
        self._table, self._offset = table, offset

    def at(self, points: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Return the class (N,) of each of ``points`` (N, 2), metres."""
        return self._table.at(points - self._offset)


def _draw_states_as_pixels(figure: Any, layout: FigureLayout, states: States, offset: NDArray[np.float64]) -> None:
    """Put the exact image of the map onto the figure, pixel by pixel."""
    occupied, free = states.occupied, states.free
    shades = (_shades(occupied) + 2).astype(np.uint8)
    table = ClassTable(occupied.lattice, [(free, np.ones(len(free), np.uint8)), (occupied, shades)])
    colours = (UNKNOWN_COLOUR, FREE_COLOUR, *SHADES)
    draw_pixels(figure, layout, _Moved(table, offset), colours, occupied.centres() + offset, shades)


def _draw_outlines(axes: Any, states: States, offset: NDArray[np.float64]) -> None:
    """Draw whole areas as curves: what is known, then the occupied cells from pale to dark."""
    shades = _shades(states.occupied)
    # Each area holds the darker ones, so no seam can show between two shades.
    areas = [states.free.merge(states.occupied), *(states.occupied.select(shades >= k) for k in range(len(SHADES)))]
    draw_areas(axes, list(zip(areas, (FREE_COLOUR, *SHADES), strict=True)), offset)


def draw_areas(
    axes: Any, areas: list[tuple[VoxelList, str]], offset: NDArray[np.float64] | float = 0.0
) -> None:
    """Draw whole areas as curves in their colours, the first one lowest, on the colour of the unknown.

    The lattice lies at ``offset`` (2,), metres.
    """
    from matplotlib.patches import Rectangle

    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, facecolor=UNKNOWN_COLOUR, linewidth=0))
    for cells, colour in areas:
        rings = outline(cells)
        if len(rings.ends):
            # Not add_patch, which walks through the curve in Python to find limits that are fixed here.
            axes.add_artist(area_patch(Rings(rings.points + offset, rings.ends), colour))


def area_patch(rings: Rings, colour: Any) -> Any:
    """Return one filled shape of many rings."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Curve

    # matplotlib wants one more vertex a ring, where it closes.
    starts = np.concatenate([[0], rings.ends[:-1]])
    vertices = np.insert(rings.points, rings.ends, rings.points[starts], axis=0)
    codes = np.full(len(vertices), Curve.LINETO, np.uint8)
    last = rings.ends + np.arange(len(rings.ends))
    codes[last] = Curve.CLOSEPOLY
    codes[np.concatenate([[0], last[:-1] + 1])] = Curve.MOVETO
    return PathPatch(Curve(vertices, codes), facecolor=colour, edgecolor="none", linewidth=0)


def _draw_cell_edges(axes: Any, layout: FigureLayout, states: States, offset: NDArray[np.float64]) -> None:
    """Draw the edges of single cells where they are large enough to be seen as cells."""
    lattice = states.occupied.lattice
    if lattice.resolution < _OUTLINED_WIDTH * layout.metres_per_inch:
        return
    if len(states.occupied) + len(states.free) > _OUTLINED_CELLS:
        return
    for cells, colour in ((states.free, UNKNOWN_COLOUR), (states.occupied, FREE_COLOUR)):
        add_cells(axes, layout, lattice, cells.centres() + offset, facecolors="none", edgecolors=colour, linewidths=0.4)


def add_cells(
    axes: Any,
    layout: FigureLayout,
    lattice: Lattice,
    centres: NDArray[np.float64],
    seen: tuple[int, int] = (0, 1),
    **style: Any,
) -> None:
    """Add the cell's silhouette at each of the centres (N, n), metres, along the two axes that are seen."""
    from matplotlib.collections import PathCollection
    from matplotlib.path import Path as Curve
    from matplotlib.transforms import Affine2D

    corners = silhouette(lattice, seen)
    shape = Curve(np.vstack([corners, corners[:1]]), closed=True)
    cells = PathCollection([shape], offsets=centres[:, seen], offset_transform=axes.transData, **style)
    # In inches, not through the axes' own transform, so that it holds at any resolution of the output.
    scale = 1.0 / layout.metres_per_inch
    cells.set_transform(Affine2D().scale(scale, -scale if layout.y_down else scale) + axes.figure.dpi_scale_trans)
    axes.add_collection(cells, autolim=False)


# ---------------------------------------------------------------------- cells of space


def _draw_highest(axes: Any, layout: FigureLayout, highest: HighestCells) -> None:
    """Draw the highest occupied cells as they are seen from above."""
    import matplotlib
    from matplotlib.patches import Rectangle

    size = layout.high - layout.low
    axes.add_patch(Rectangle(tuple(layout.low), size[0], size[1], facecolor=UNKNOWN_COLOUR, linewidth=0))
    if highest.heights is None:
        return
    low, high = highest.heights
    fraction = (highest.centres[:, 2] - low) / ((high - low) or 1.0)
    points = 72.0 * highest.lattice.resolution / layout.metres_per_inch
    faces = matplotlib.colormaps[HEIGHTS](fraction)
    # Edges are opaque: through translucent ones the seams between neighbours would shine.
    edges = faces * (0.72, 0.72, 0.72, 1.0)
    width = min(0.35, 0.05 * points)
    add_cells(axes, layout, highest.lattice, highest.centres, facecolors=faces, edgecolors=edges, linewidths=width)


# ---------------------------------------------------------------------- the line of the robot


def draw_line(axes: Any, positions: NDArray[np.float64], width: float = 0.9) -> None:
    """Draw the path of the robot, ``width`` points wide: a ring where it starts, a disc where it ends."""
    if len(positions) == 0:
        return
    axes.plot(*positions.T, color="white", linewidth=width + 1.3, alpha=0.7, solid_capstyle="round", zorder=5)
    line = dict(color=PATH_COLOUR, linewidth=width, solid_capstyle="round", solid_joinstyle="round")
    axes.plot(*positions.T, **line, zorder=6)
    ends = positions[np.isfinite(positions).all(axis=1)]
    for position, face, size in ((ends[0], "white", 5.5), (ends[-1], PATH_COLOUR, 5.5)):
        mark = dict(marker="o", markersize=size, markerfacecolor=face, markeredgecolor=PATH_COLOUR, markeredgewidth=1.2)
        axes.plot(*position, **mark, zorder=7, clip_on=False)
