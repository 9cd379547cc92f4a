"""A horizontal slice through a map in space: which cells a plane cuts, and what they are.

Every sample of every pixel is quantised at the height of the slice, so what is drawn is the true cross-section of the
cells: squares of cubes, hexagons and triangles of other polyhedra, as the plane happens to cut them.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError
from hexmap.drawing.extent import FIT
from hexmap.drawing.figure_layout import (
    FREE_COLOUR,
    SHADES,
    UNKNOWN_COLOUR,
    FigureLayout,
    draw_slice_captions,
    metres_text,
)
from hexmap.drawing.map_drawing import draw_line, save_figure
from hexmap.drawing.pixels import draw_pixels
from hexmap.drawing.solids.lines import positions_in_space
from hexmap.maps.outlines import ClassTable
from hexmap.maps.state_rule import States
from hexmap.maps.voxel_list import VoxelList

if TYPE_CHECKING:
    from hexmap.poses.trajectory import Trajectory

__all__ = ["draw_slice"]

_COLOURS = (UNKNOWN_COLOUR, FREE_COLOUR, SHADES[-2])
_KINDS = [("occupied", SHADES[-2]), ("free", FREE_COLOUR), ("unknown", UNKNOWN_COLOUR)]
_OCCUPIED = 2  # the place of its colour
_STRAYING = 0.08  # of the width of the bulk of the cells: what is farther off is a stray


def draw_slice(
    states: States,
    height: float,
    path: str | os.PathLike[str],
    *,
    trajectory: Trajectory | ArrayLike | None = None,
    offset: ArrayLike = (0.0, 0.0, 0.0),
    fit: float = FIT,
    title: str | None = None,
    dpi: float = 200.0,
) -> Path:
    """Draw where a horizontal plane meets occupied, free and unknown cells.

    Args:
        states: the occupied and free cells of a map in space.
        height: of the plane, metres.
        path: a ``.png``.
        trajectory: where the sensor went, seen from above: a trajectory or positions (N, 3), metres.
        offset: (3,) metres, where the cell 0 of the lattice has its centre in the map's frame, for grids of others.
        fit: the fraction of the occupied cells of the slice that the picture is made for on each side; strays farther
            off are left out, and the caption tells how many. 1 shows all.
        title: a line above the picture, if any.
        dpi: pixels an inch; the longer side of the slice is 8 inches.

    Returns:
        The path of the file.

    Raises:
        ArgumentError: the map is in the plane, the height is not finite or no known cell reaches it, another suffix,
            or numbers out of range.
        FileAccessError: the file cannot be written.
    """
    path = Path(path)
    lattice = states.occupied.lattice
    if lattice.dim != 3:
        raise ArgumentError(f"only a map in space is cut into slices; {lattice.name} is a lattice of the plane")
    if path.suffix.lower() != ".png":
        raise ArgumentError(f"{path}: a slice is drawn as .png, not as {path.suffix or 'a file without a suffix'}")
    if not math.isfinite(height):
        raise ArgumentError(f"a slice is at a finite height, not at {height}")
    if not 0.5 <= fit <= 1.0:
        raise ArgumentError(f"at least half of the cells and at most all must fit the page, not a fraction of {fit:g}")
    if not 10.0 <= dpi <= 5000.0:
        raise ArgumentError(f"a picture has 10 to 5000 pixels an inch, not {dpi:g}")
    shift = np.asarray(offset, dtype=np.float64)
    line = positions_in_space(trajectory)
    z = height - float(shift[2])
    occupied, free = _reaching(states.occupied, z), _reaching(states.free, z)
    if len(occupied) + len(free) == 0:
        raise ArgumentError(f"no known cell is at the height of {height:g} m{_extent(states, float(shift[2]))}")
    low, high = _box(occupied if len(occupied) else free, fit)
    finite = line[np.isfinite(line).all(axis=1), :2]
    layout = FigureLayout.around(
        np.vstack([low + shift[:2], high + shift[:2], finite]), lattice, dpi, title is not None
    )
    section = _Section(occupied, free, shift, z)
    centres = occupied.centres()[:, :2] + shift[:2]
    cut = centres[section.at(centres) == _OCCUPIED]
    outside = int(((centres < layout.low) | (centres > layout.high)).any(axis=1).sum())

    def draw(figure: Any, axes: Any) -> None:
        draw_pixels(figure, layout, section, _COLOURS, cut, np.full(len(cut), _OCCUPIED, np.uint8))
        draw_line(axes, line[:, :2])
        words = f"slice at z = {metres_text(height)}"
        words += f", {outside:,} occupied cells off the page" if outside else ""
        draw_slice_captions(figure, layout, lattice, _KINDS, title, words, len(line) > 0)

    save_figure(layout, path, draw)
    return path


class _Section:
    """Cells in space, looked up by points of a horizontal plane: occupied, free or unknown."""

    def __init__(self, occupied: VoxelList, free: VoxelList, shift: NDArray[np.float64], height: float) -> None:
        kinds = [(cells, np.full(len(cells), kind, np.uint8)) for cells, kind in ((free, 1), (occupied, _OCCUPIED))]
        self._table, self._shift, self._height = ClassTable(occupied.lattice, kinds), shift[:2], height
        self.lattice = occupied.lattice

    def at(self, points: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Return the class (N,) of the cell that each of ``points`` (N, 2), metres, lies in at this height."""
        return self._table.at(np.column_stack([points - self._shift, np.full(len(points), self._height)]))


def _reaching(cells: VoxelList, height: float) -> VoxelList:
    """Return the cells that may reach a height: their centres are no farther from it than a cell's top."""
    top = float(cells.lattice.cell.vertices[:, 2].max()) * (1.0 + 1e-9)
    return cells.select(np.abs(cells.centres()[:, 2] - height) <= top)


def _extent(states: States, rise: float) -> str:
    """Say between which heights there are known cells."""
    heights = np.concatenate([states.occupied.centres()[:, 2], states.free.centres()[:, 2]])
    if len(heights) == 0:
        return ": the map is empty"
    return f"; those known are between {heights.min() + rise:.2f} and {heights.max() + rise:.2f} m"


def _box(cells: VoxelList, fit: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners (2,) of the box around the cells, without those that stray far from the others."""
    flat = cells.centres()[:, :2]
    low, high = np.quantile(flat, (1.0 - fit, fit), axis=0)
    room = _STRAYING * (high - low)
    return np.maximum(flat.min(axis=0), low - room), np.minimum(flat.max(axis=0), high + room)
