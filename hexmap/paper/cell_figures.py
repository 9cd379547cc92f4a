"""The paper's Figs 2, 3 and 5: the occupied cells of the same points on every lattice, beside each other."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray
from hexmap.experiments.report.figures import COLOURS, figure_style
from hexmap.lattice.lattice import Lattice
from hexmap.maps.voxel_list import VoxelList
from hexmap.paper.cases import about_axis

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["close_up", "draw_cells", "new_figure", "planar_cells", "solid_cells"]

_CLOSE = 20.0  # resolutions, of the edge of the cube that is shown from close by: single cells are told apart


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure, inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def planar_cells(points: FloatArray, lattices: list[Lattice]) -> Figure:
    """Draw the same points (N, 2) on every lattice, side by side, as they are and rotated by 45 degrees.

    All axes have the same scale and extents of the same size.
    """
    turned = [(degrees, about_axis("z", degrees, 2).apply(points)) for degrees in (0.0, 45.0)]
    size = np.max([np.ptp(at, axis=0) for _, at in turned], axis=0) + 4.0 * max(x.covering_radius for x in lattices)
    width = 3.6
    with figure_style():
        # The height follows from the extent, so that no axes have empty bands.
        height = min(max(width * float(size[1] / size[0]), 1.6), 6.0) + 0.5
        figure = new_figure(width * len(lattices), 2.0 * height)
        for row, (degrees, at) in enumerate(turned):
            middle = 0.5 * (at.min(axis=0) + at.max(axis=0))
            for k, lattice in enumerate(lattices):
                cells = VoxelList.from_points(at, lattice)
                axes = figure.add_subplot(2, len(lattices), row * len(lattices) + k + 1)
                draw_cells(axes, cells, k, f"{lattice.name}, {degrees:g} degrees: {len(cells)} cells")
                axes.set_xlim(middle[0] - 0.5 * size[0], middle[0] + 0.5 * size[0])
                axes.set_ylim(middle[1] - 0.5 * size[1], middle[1] + 0.5 * size[1])
                axes.set_axis_on()
                axes.grid(False)
                axes.tick_params(labelsize=7, labelleft=k == 0)
    return figure


def draw_cells(axes: Any, cells: VoxelList, k: int, title: str) -> None:
    """Draw the true cells of a planar list in the colour of the k-th lattice."""
    from matplotlib.collections import PolyCollection

    outlines = cells.lattice.cell.vertices[None] + cells.centres()[:, None]
    colour = COLOURS[k % len(COLOURS)]
    axes.add_collection(PolyCollection(list(outlines), facecolors=colour, edgecolors="white", linewidths=0.3))
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_title(title, fontsize=9)
    axes.set_axis_off()


def solid_cells(points: FloatArray, lattices: list[Lattice]) -> Figure:
    """Draw points (N, 3) as shaded polyhedra: a row a lattice, the whole scan and a part of it from close by."""
    from matplotlib.image import imread

    from hexmap.drawing.solids.draw_solids import Cut, draw_solids

    near = close_up(points, lattices[0].resolution)
    with tempfile.TemporaryDirectory() as work, figure_style():
        figure = new_figure(9.0, 3.4 * len(lattices))
        for k, lattice in enumerate(lattices):
            for column, shown in enumerate((points, near)):
                cells = VoxelList.from_points(shown, lattice)
                path = Path(work) / f"{k}{column}.png"
                cut: Any = Cut() if column else "auto"
                draw_solids(cells, path, size=(1200, 900), cut=cut)
                axes = figure.add_subplot(len(lattices), 2, 2 * k + column + 1)
                axes.imshow(imread(path), interpolation="antialiased")
                edge = _CLOSE * lattices[0].resolution
                words = f"from close by, {edge:.3g} m wide" if column else f"{lattice.name} ({lattice.title})"
                axes.set_title(f"{words}, {len(cells):,} cells", fontsize=9)
                axes.set_axis_off()
    return figure


def close_up(points: FloatArray, resolution: float) -> NDArray[np.float64]:
    """Return the points (M, 3) of a cube, 20 resolutions wide, that holds most surface and has room in it.

    Of the cubes of a grid it is the one with most distinct cells of the resolution.
    """
    edge = _CLOSE * resolution
    cube = np.floor((points - points.min(axis=0)) / edge).astype(np.int64)
    cell = np.floor((points - points.min(axis=0)) / resolution).astype(np.int64)
    distinct = np.unique(np.column_stack([cube, cell]), axis=0)[:, :3]
    cubes, counts = np.unique(distinct, axis=0, return_counts=True)
    return np.asarray(points[(cube == cubes[counts.argmax()]).all(axis=1)])
