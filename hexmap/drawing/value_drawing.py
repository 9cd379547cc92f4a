"""Maps, lists of cells, lines and fields on axes of matplotlib that somebody else owns, and small ones for notebooks.

Cells of the plane are drawn as the shapes that they are where each is some pixels wide, and else as an image in which
no wall fades away. Cells in space are seen from above, the highest of each column in the colour of its height, or cut
by a horizontal plane. Everything is in metres; axes keep what they showed before.
"""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError
from hexmap.drawing.figure_layout import FREE_COLOUR, HEIGHTS, PATH_COLOUR, SHADES, UNKNOWN_COLOUR, thresholds
from hexmap.drawing.map_drawing import area_patch, highest_cells
from hexmap.lattice.lattice import Lattice
from hexmap.maps.map import Map
from hexmap.maps.outlines import ClassTable, outline, pixel_rows, silhouette
from hexmap.maps.state_rule import StateRule
from hexmap.maps.voxel_list import VoxelList

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from hexmap.graph.lattice_graph import LatticeGraph

__all__ = ["inline_picture", "plot_cells", "plot_graph", "plot_line", "plot_map", "plot_values"]

_SHAPED_WIDTH, _SHAPED_CELLS = 1.5, 50_000  # pixels of a cell, and cells, that are drawn as shapes
_SAMPLES = 2  # to each side of a pixel
_MOST_PIXELS = 2000  # of the longer side of an image
_INLINE_INCHES, _INLINE_DPI = (4.2, 3.2), 180
_INLINE_SCALE = 2  # pixels of the image to one of the page: sharp on fine screens
_INLINE_BYTES = 150_000  # of an image; a larger one, which is all noise, is made with half the pixels
_INLINE_CELLS = 300_000  # of a level in a notebook; a coarser one looks the same at that size
_STRAYS, _ROOM = 0.005, 0.1  # of the cells on each side, and of the width of the others around these
_INLINE_POINTS = 20_000  # of a line; more are no finer at that size
_BLOCKED = "#7f7f7f"  # no colour of a cost
_AT_ONCE = 1 << 20  # cells

Box = tuple[FloatArray, FloatArray]


# ---------------------------------------------------------------------- what values call


def plot_map(
    map: Map, ax: Axes | None = None, *, level: int = 0, rule: StateRule | None = None, height: float | None = None
) -> Axes:
    """Draw a level of a map: see :meth:`hexmap.Map.plot`."""
    states = map.state(rule, level)
    _check_height(map.lattice, height)
    ax = _axes(ax)
    if map.lattice.dim == 3 and height is None:
        return _plot_highest(states.occupied, ax)
    ax.set_facecolor(UNKNOWN_COLOUR)
    shades = _shades(states.occupied)
    if height is not None:
        shades = np.full(len(states.occupied), len(SHADES) - 2)
    layers = [(states.free, np.zeros(len(states.free), np.int64)), (states.occupied, shades + 1)]
    return _plot_classes(ax, layers, (FREE_COLOUR, *SHADES), height)


def plot_cells(
    cells: VoxelList,
    ax: Axes | None = None,
    *,
    height: float | None = None,
    colour: Any = None,
    alpha: float | None = None,
    colorbar: bool = True,
) -> Axes:
    """Draw a list of cells: see :meth:`hexmap.VoxelList.plot`."""
    _check_height(cells.lattice, height)
    ax = _axes(ax)
    if cells.lattice.dim == 3 and height is None:
        return _plot_highest(cells, ax, colour, alpha, colorbar)
    if colour is not None:
        return _plot_classes(ax, [(cells, np.zeros(len(cells), np.int64))], (colour,), height, alpha)
    return _plot_classes(ax, [(cells, _shades(cells))], SHADES, height, alpha)


def plot_line(points: ArrayLike, ax: Axes | None = None, **style: Any) -> Axes:
    """Draw a line through points (N, 2) or (N, 3), metres: a ring at the first one, a disc at the last.

    ``style`` is that of the line, as :meth:`matplotlib.axes.Axes.plot` takes it. Returns the axes.
    """
    from matplotlib.cbook import normalize_kwargs
    from matplotlib.lines import Line2D

    ax = _axes(ax)
    at = np.asarray(points, dtype=np.float64)
    columns = 3 if ax.name == "3d" else 2
    at = np.column_stack([at, np.zeros((len(at), max(0, columns - at.shape[1])))])[:, :columns]
    if len(at):
        usual = {"color": PATH_COLOUR, "linewidth": 1.4, "solid_joinstyle": "round", "zorder": 6}
        (line,) = ax.plot(*at.T, **{**usual, **normalize_kwargs(style, Line2D)})
        for end, face in ((at[:1], "white"), (at[-1:], line.get_color())):
            ax.plot(
                *end.T, linestyle="none", marker="o", markersize=5.0, markerfacecolor=face,
                markeredgecolor=line.get_color(), markeredgewidth=1.2, zorder=line.get_zorder() + 1,
            )  # fmt: skip
    return _labelled(ax)


def plot_values(
    graph: LatticeGraph,
    values: NDArray[np.float64],
    ax: Axes | None = None,
    *,
    marks: NDArray[np.float64] | None = None,
    height: float | None = None,
    colorbar: bool = True,
) -> Axes:
    """Draw a number a cell of a graph: see :meth:`planners.DistanceField.plot`.

    Args:
        graph: the cells; those that are not free are grey.
        values: (size,) by flat position; cells with a value that is not finite are left blank.
        ax: axes to draw on; new ones where none are given.
        marks: (M, n) points to mark with rings, metres.
        height: of the horizontal cut through cells in space, metres.
        colorbar: whether the colours are explained beside it.

    Returns:
        The axes.

    Raises:
        ArgumentError: the height is not finite, or the graph one of the plane.
    """
    import matplotlib

    _check_height(graph.lattice, height)
    ax = _axes(ax)
    box = _free_box(graph)

    def at(points: FloatArray) -> FloatArray:
        flat = graph.index_to_flat(graph.lattice.quantise(_in_space(points, height)))
        found = np.where(graph.free[flat] != 0, values[flat], -1.0)  # no cost is negative: these are blocked
        found[~np.isfinite(found) | (flat < 0)] = np.nan
        return found

    sampled = _sampled(ax, box, at, 1)[:, :, 0, 0]
    none = np.ma.masked_array(sampled, ~(sampled >= 0.0))
    plain = np.zeros((*sampled.shape, 4))
    plain[sampled == -1.0] = matplotlib.colors.to_rgba(_BLOCKED)
    _add_image(ax, plain, box)
    image = _add_image(ax, none, box, cmap=HEIGHTS)
    if marks is not None and len(marks) <= 1000:  # of so many none would be seen for the others
        ax.plot(
            *marks[:, :2].T, linestyle="none", marker="o", markersize=5.0, markerfacecolor="white",
            markeredgecolor=PATH_COLOUR, markeredgewidth=1.2, zorder=7,
        )  # fmt: skip
    if colorbar and not none.mask.all():
        ax.figure.colorbar(image, ax=ax, label="least cost, m")
    return _labelled(ax)


def plot_graph(graph: LatticeGraph, ax: Axes | None = None, *, height: float | None = None) -> Axes:
    """Draw which cells of a graph are free: see :meth:`hexmap.LatticeGraph.plot`."""
    from matplotlib.colors import to_rgba

    _check_height(graph.lattice, height)
    if height is None and graph.lattice.dim == 3:
        corners = np.array([graph.first, graph.first + graph.inner_shape - 1])
        height = float(graph.lattice.centres(corners)[:, 2].mean())
    ax = _axes(ax)
    box = _free_box(graph)
    colours = np.array([(0.0, 0.0, 0.0, 0.0), to_rgba(FREE_COLOUR), to_rgba(_BLOCKED)])

    def at(points: FloatArray) -> NDArray[np.int64]:
        flat = graph.index_to_flat(graph.lattice.quantise(_in_space(points, height)))
        return np.where(flat < 0, 0, np.where(graph.free[flat] != 0, 1, 2))

    ax.set_facecolor(UNKNOWN_COLOUR)
    _add_image(ax, colours[_sampled(ax, box, at, 1)[:, :, 0, 0]], box)
    return _labelled(ax)


def inline_picture(value: Any) -> str:
    """Return a small picture of anything that has a ``plot``, as an image of HTML that holds its PNG."""
    import matplotlib
    from matplotlib import style
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    settings: dict[Any, Any] = {"font.size": 7.5, "font.family": ["DejaVu Sans"], "axes.linewidth": 0.6}
    with style.context("default", after_reset=True), matplotlib.rc_context(settings):
        figure = Figure(figsize=_INLINE_INCHES, dpi=_INLINE_DPI)
        FigureCanvasAgg(figure)
        ax = figure.add_subplot()
        line = getattr(value, "positions", getattr(value, "points", ()))  # of a trajectory, of a path
        if len(line) > _INLINE_POINTS:
            plot_line(line[np.linspace(0, len(line) - 1, _INLINE_POINTS).astype(np.int64)], ax)
        elif isinstance(value, Map):
            level = _level_for_a_glance(value)
            near = _without_strays(value.levels[level].hits)
            (value if near is None else value.crop(*near)).plot(ax, level=level)
        elif isinstance(value, VoxelList) and (near := _without_strays(value)) is not None:
            inside = (value.centres() >= near[0]) & (value.centres() <= near[1])
            value.select(np.asarray(inside.all(axis=1))).plot(ax)
        else:
            value.plot(ax)
        scale, data = _INLINE_SCALE, _png(figure, _INLINE_DPI)
        if len(data) > _INLINE_BYTES:
            scale, data = 1, _png(figure, _INLINE_DPI // _INLINE_SCALE)
    width = int.from_bytes(data[16:20], "big") // scale  # of the header of a PNG
    text = base64.b64encode(data).decode("ascii")
    return f'<img alt="{type(value).__name__}" width="{width}" src="data:image/png;base64,{text}">'


def _png(figure: Any, dpi: int) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, bbox_inches="tight", metadata={"Software": None})
    return buffer.getvalue()


def _without_strays(cells: VoxelList) -> Box | None:
    """Return the corners (n,), metres, of the box around all cells but the few that lie far off; None where none do.

    They would make all others too small to be seen in a small picture.
    """
    if len(cells) == 0:
        return None
    centres = cells.centres()
    least, most = centres.min(axis=0), centres.max(axis=0)
    low, high = np.quantile(centres, (_STRAYS, 1.0 - _STRAYS), axis=0)
    room = _ROOM * (high - low) + 2.0 * cells.lattice.covering_radius
    if (least >= low - room).all() and (most <= high + room).all():
        return None
    return low - room, high + room


def _level_for_a_glance(map: Map) -> int:
    """Return the finest level that a small picture of does not take long."""
    sizes = [len(level.hits) + len(level.passes) for level in map.levels]
    return next((k for k, size in enumerate(sizes) if size <= _INLINE_CELLS), len(sizes) - 1)


# ---------------------------------------------------------------------- axes


def _axes(ax: Axes | None) -> Any:
    """Return the axes to draw on."""
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    return plt.subplots()[1]


def _labelled(ax: Any, box: Box | None = None) -> Axes:
    """Return axes on which a metre is as long along x as along y, wide enough for a box, metres."""
    if box is not None:
        ax.update_datalim(np.array(box))
        ax.autoscale_view()
    ax.set_aspect("equal")
    for axis in ("x", "y", "z") if ax.name == "3d" else ("x", "y"):
        if not getattr(ax, f"get_{axis}label")():
            getattr(ax, f"set_{axis}label")(f"{axis}, m")
    labelled: Axes = ax
    return labelled


def _box_of(lattice: Lattice, index: NDArray[np.integer[Any]]) -> Box:
    """Return the corners (2,), metres, of the box around cells (M, n); where there is none, around the origin."""
    if len(index) == 0:
        return np.full(2, -5.0 * lattice.resolution), np.full(2, 5.0 * lattice.resolution)
    centres = lattice.centres(index)[:, :2]
    return centres.min(axis=0) - lattice.covering_radius, centres.max(axis=0) + lattice.covering_radius


def _free_box(graph: LatticeGraph) -> Box:
    """Return the corners (2,), metres, of the box around the free cells of a graph and some of those around them."""
    nodes = np.flatnonzero(graph.free)
    if len(nodes) == 0:
        nodes = graph.index_to_flat(np.array([graph.first, graph.first + graph.inner_shape - 1]))
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for k in range(0, len(nodes), _AT_ONCE):
        centres = graph.centres(nodes[k : k + _AT_ONCE])[:, :2]
        low, high = np.minimum(low, centres.min(axis=0)), np.maximum(high, centres.max(axis=0))
    room = 3.0 * graph.lattice.covering_radius
    return low - room, high + room


def _pixel(ax: Any, box: Box) -> float:
    """Return how many metres a pixel of the axes is wide once they show a box."""
    extent = ax.get_window_extent()
    shown = np.maximum((box[1] - box[0]) / np.maximum((extent.width, extent.height), 1.0), 1e-12)
    return float(shown.max())


def _check_height(lattice: Lattice, height: float | None) -> None:
    if height is not None and not (lattice.dim == 3 and math.isfinite(height)):
        why = "the cells are of the plane" if lattice.dim == 2 else f"not {height!r}"
        raise ArgumentError(f"a cut through cells in space is at a finite height, {why}")


# ---------------------------------------------------------------------- cells


def _shades(cells: VoxelList) -> NDArray[np.int64]:
    """Return the shade (M,) of each cell by its count, 0 for the palest."""
    if len(cells) == 0:
        return np.empty(0, np.int64)
    return np.searchsorted(thresholds(cells), cells.counts, side="right")


def _plot_classes(
    ax: Any,
    layers: list[tuple[VoxelList, NDArray[np.int64]]],
    colours: tuple[Any, ...],
    height: float | None,
    alpha: float | None = None,
) -> Axes:
    """Draw disjoint cells of the plane, or where a plane cuts cells in space, in the colours of their classes (M,)."""
    lattice = layers[0][0].lattice
    if height is not None:
        top = float(lattice.cell.vertices[:, 2].max()) * (1.0 + 1e-9)
        layers = [_select(layer, np.abs(layer[0].centres()[:, 2] - height) <= top) for layer in layers]
    box = _box_of(lattice, np.concatenate([cells.index for cells, _ in layers]))
    count = sum(len(cells) for cells, _ in layers)
    if count == 0:
        ax.text(0.5, 0.5, "no cells", transform=ax.transAxes, ha="center", va="center", fontsize="small")
    elif height is None and count <= _SHAPED_CELLS and lattice.resolution >= _SHAPED_WIDTH * _pixel(ax, box):
        _add_shapes(ax, layers, colours, alpha)
    else:
        _add_image(ax, _image_of_classes(ax, box, layers, colours, height), box, alpha=alpha)
    return _labelled(ax, box)


def _select(
    layer: tuple[VoxelList, NDArray[np.int64]], chosen: NDArray[np.bool_]
) -> tuple[VoxelList, NDArray[np.int64]]:
    cells, classes = layer
    return cells.select(chosen), classes[chosen]


def _add_shapes(
    ax: Any, layers: list[tuple[VoxelList, NDArray[np.int64]]], colours: tuple[Any, ...], alpha: float | None
) -> None:
    """Add the cells as areas without a seam between two of one colour."""
    for k, colour in enumerate(colours):
        # Each area holds those above it, so that no seam shows; what shines through must not lie on itself.
        area = VoxelList.empty(layers[0][0].lattice)
        for layer in layers:
            area = area.merge(_select(layer, layer[1] == k if alpha is not None else layer[1] >= k)[0])
        rings = outline(area)
        if len(rings.ends):
            patch = area_patch(rings, colour)
            patch.set_alpha(alpha)
            # Not add_patch, which walks through the curve in Python to find limits that are known.
            ax.add_artist(patch)


def _image_of_classes(
    ax: Any,
    box: Box,
    layers: list[tuple[VoxelList, NDArray[np.int64]]],
    colours: tuple[Any, ...],
    height: float | None,
) -> NDArray[np.float64]:
    """Return an image (H, W, 4), lowest row first; the darkest cell that falls into a pixel is seen in it."""
    from matplotlib.colors import to_rgba

    lattice = layers[0][0].lattice
    table = ClassTable(lattice, [(cells, (classes + 1).astype(np.uint8)) for cells, classes in layers])
    palette = np.array([(0.0, 0.0, 0.0, 0.0), *(to_rgba(colour) for colour in colours)])
    samples = _sampled(ax, box, lambda points: table.at(_in_space(points, height)), _SAMPLES)
    found = palette[samples].reshape(*samples.shape[:2], -1, 4)
    image = np.empty((*samples.shape[:2], 4))
    image[:, :, 3] = found[:, :, :, 3].mean(axis=2)
    weight = np.maximum(found[:, :, :, 3:].sum(axis=2), 1e-9)
    image[:, :, :3] = (found[:, :, :, :3] * found[:, :, :, 3:]).sum(axis=2) / weight
    if height is None:
        pixel = (box[1] - box[0]) / (image.shape[1], image.shape[0])
        for cells, classes in layers[-1:]:
            if lattice.resolution < 2.0 * float(pixel.max()):  # a wall of one cell must not fade away
                at = np.minimum((cells.centres() - box[0]) / pixel, (image.shape[1] - 1, image.shape[0] - 1))
                order = np.argsort(classes, kind="stable")  # of several in one pixel the last one stays
                columns, rows = at.astype(np.int64)[order].T
                image[rows, columns] = palette[classes[order] + 1]
    return image


def _plot_highest(
    cells: VoxelList, ax: Any, colour: Any = None, alpha: float | None = None, colorbar: bool = False
) -> Axes:
    """Draw cells in space from above, the highest of each column in the colour of its height."""
    import matplotlib
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgba

    lattice = cells.lattice
    highest = highest_cells(cells)
    box = _box_of(lattice, cells.index)
    ax.set_facecolor(UNKNOWN_COLOUR)
    if highest.heights is None:
        ax.text(0.5, 0.5, "no cells", transform=ax.transAxes, ha="center", va="center", fontsize="small")
        return _labelled(ax, box)
    low, high = highest.heights
    colours = matplotlib.colormaps[HEIGHTS]((highest.centres[:, 2] - low) / ((high - low) or 1.0))
    if colour is not None:
        colours[:] = to_rgba(colour)
    elif colorbar:
        heights = matplotlib.cm.ScalarMappable(matplotlib.colors.Normalize(low, high), HEIGHTS)
        ax.figure.colorbar(heights, ax=ax, label="z, m")
    if len(highest.centres) <= _SHAPED_CELLS and lattice.resolution >= _SHAPED_WIDTH * _pixel(ax, box):
        shapes = highest.centres[:, None, :2] + silhouette(lattice)
        # Edges of their own colour: seams between neighbours would shine.
        ax.add_collection(
            PolyCollection(list(shapes), facecolors=colours, edgecolors=colours, linewidths=0.3, alpha=alpha),
            autolim=False,
        )
    else:
        # Pixels no smaller than a cell, or there would be holes between its centres.
        pixel = max(_pixel(ax, box), lattice.resolution, float((box[1] - box[0]).max()) / _MOST_PIXELS)
        shape = np.ceil((box[1] - box[0]) / pixel).astype(np.int64)
        image = np.zeros((shape[1], shape[0], 4))
        columns, rows = np.minimum((highest.centres[:, :2] - box[0]) / pixel, shape - 1).astype(np.int64).T
        image[rows, columns] = colours  # from the lowest to the highest: of several the last one stays
        _add_image(ax, image, (box[0], box[0] + shape * pixel), alpha=alpha)
    return _labelled(ax, box)


# ---------------------------------------------------------------------- images


def _in_space(points: FloatArray, height: float | None) -> FloatArray:
    """Return points (N, 2) of a horizontal plane as they lie in space; of the plane as they are."""
    return points if height is None else np.column_stack([points, np.full(len(points), height)])


def _sampled(ax: Any, box: Box, at: Callable[[FloatArray], NDArray[Any]], each: int) -> NDArray[Any]:
    """Return what is in a box (H, W, ``each``, ``each``), sampled in pixels as wide as those of the axes, lowest first.

    ``at`` answers points (N, 2), metres, with a value (N,) each.
    """
    pixel = max(_pixel(ax, box), float((box[1] - box[0]).max()) / _MOST_PIXELS)
    width, tall = np.maximum(np.ceil((box[1] - box[0]) / pixel), 1.0).astype(np.int64)
    xs = box[0][0] + (np.arange(width * each) + 0.5) * ((box[1][0] - box[0][0]) / (width * each))
    ys = box[0][1] + (np.arange(tall * each) + 0.5) * ((box[1][1] - box[0][1]) / (tall * each))
    rows = [at(points).reshape(-1, each, width, each) for _, points in pixel_rows(xs, ys, each)]
    return np.concatenate(rows).transpose(0, 2, 1, 3)


def _add_image(ax: Any, image: NDArray[Any], box: Box, **style: Any) -> Any:
    """Add an image, lowest row first, that covers a box, metres, below all lines, and leave the limits wide enough."""
    from matplotlib.image import AxesImage

    extent = (box[0][0], box[1][0], box[0][1], box[1][1])
    # Colours may be mixed where pixels do not meet those of the axes; numbers may not.
    smooth = "antialiased" if image.ndim == 3 else "nearest"
    artist = AxesImage(ax, extent=extent, origin="lower", interpolation=smooth, **style)
    artist.set_data(image)
    artist.set_clip_path(ax.patch)
    ax.add_image(artist)
    _labelled(ax, box)
    return artist
