"""Maps in space as solids: the true polyhedra as a mesh, as a picture and in a viewer.

The picture is drawn in software: no display and no graphics card is needed, and the same arguments
give the same bytes. Surfaces hidden by others are removed sample by sample (a z-buffer, 3 x 3
samples a pixel), the view is a true perspective, and shadows are computed.

Examples:
    >>> import tempfile
    >>> from pathlib import Path
    >>> from hexmap import Lattice, VoxelList
    >>> from hexmap.drawing.solids import draw_solids
    >>> ball = Lattice.named("D3", resolution=0.1).disk([0, 0, 0], 3)
    >>> cells = VoxelList.from_cells(ball, Lattice.named("D3", resolution=0.1))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = draw_solids(cells, Path(folder) / "ball.png", size=(320, 240))
    ...     path.stat().st_size > 1000
    True
"""

from __future__ import annotations

import io
import math
import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.atomic_files import atomic_write
from hexmap.base.errors import ArgumentError, MissingDependencyError
from hexmap.drawing.extent import FIT
from hexmap.drawing.figure_layout import FAINT, metres_text, round_length
from hexmap.drawing.solids.lines import SeenLine, add_line_legend, positions_in_space
from hexmap.drawing.solids.mesh import Mesh, check_spatial, exposed_faces, height_colours, height_range, mesh_of_cells
from hexmap.drawing.solids.mesh_files import MESH_SUFFIXES, save_mesh
from hexmap.drawing.solids.renderer import Camera, directions, render
from hexmap.lattice.window import IndexBox
from hexmap.maps.voxel_list import VoxelList

if TYPE_CHECKING:
    from hexmap.poses.trajectory import Trajectory

__all__ = ["MESH_SUFFIXES", "Cut", "Mesh", "draw_solids", "find_cut", "mesh_of_cells", "save_mesh", "view_solids"]

_PAPER = (255, 255, 255)
_TEXT = "#1f2a3d"
_MARGIN, _FOOT, _HEAD = 0.16, 0.62, 0.40  # inches around, below and (with a title) above the solids
_METADATA: dict[str, Any] = {"Software": None}
_SIDES, _MAX_PIXELS = (64, 20_000), 40_000_000
_CEILING = 0.2  # a layer that covers this fraction of the ground plan is a floor or a ceiling


@dataclass(frozen=True)
class Cut:
    """What to take away so that the inside is seen.

    Attributes:
        above: cells whose centre is higher than this, metres.
        near: the cells nearest to the viewer, as a fraction (0 to 1) of the scene's depth along the
            view's horizontal direction: 0.3 takes away the front third, as in a doll's house.
    """

    above: float | None = None
    near: float | None = None

    def __post_init__(self) -> None:
        """Check the numbers."""
        if self.above is not None and not math.isfinite(self.above):
            raise ArgumentError(f"a cut is at a finite height, not at {self.above}")
        if self.near is not None and not 0.0 <= self.near < 1.0:
            raise ArgumentError(f"a cut takes away a fraction from 0 to below 1 of the near side, not {self.near}")

    def keep(self, cells: VoxelList, azimuth: float) -> NDArray[np.bool_]:
        """Tell which cells (M,) of a list stay, seen from ``azimuth``, degrees."""
        centres = cells.centres()
        kept = np.ones(len(cells), np.bool_)
        if len(cells) and self.above is not None:
            kept &= centres[:, 2] <= self.above
        if len(cells) and self.near is not None:
            towards = centres @ directions(azimuth, 0.0).level
            # Strays in front of the wall would otherwise be all that is cut.
            low, high = np.quantile(towards, (0.01, 0.99))
            if high - low > cells.lattice.resolution:
                kept &= towards <= high - self.near * (high - low)
        return kept


def find_cut(cells: VoxelList) -> Cut:
    """Return the cut that takes the ceiling off a scanned room, or one that takes nothing where there is none.

    A ceiling is a layer, two resolutions thick, in the upper half of the heights that covers a
    fifth or more of the ground plan, with walls or air below it; the lowest one counts, and what
    is above it goes with it. Solid bodies, and outdoor scans as a rule, have none.
    """
    if len(cells) == 0:
        return Cut()
    check_spatial(cells.lattice)
    centres = cells.centres()
    step = 2.0 * cells.lattice.resolution
    blocks = np.floor(centres / step + 1e-9).astype(np.int64)
    plan = IndexBox.of_cells(blocks[:, :2])
    column, layer_of = plan.flat(blocks[:, :2]), blocks[:, 2] - blocks[:, 2].min()
    layers = int(layer_of.max()) + 1
    filled = np.unique(layer_of * plan.size + column) // plan.size
    cover = np.bincount(filled, minlength=layers) / len(np.unique(column))
    low, high = np.searchsorted(np.cumsum(cover) / cover.sum(), (0.01, 0.99))
    middle = (int(low) + int(high) + 1) // 2
    # In a solid body the layer below is as full as the ceiling would be.
    for layer in range(middle + 1, layers):
        below = cover[max(layer - 3, 0) : layer - 1]
        if cover[layer] >= _CEILING and len(below) and below.max() < 0.5 * cover[layer]:
            bottom = math.floor(float(centres[:, 2].min()) / step + 1e-9) + layer - 1
            return Cut(above=bottom * step)
    return Cut()


def draw_solids(
    cells: VoxelList,
    path: str | os.PathLike[str],
    *,
    view: tuple[float, float] = (-120.0, 35.0),
    cut: Cut | Literal["auto"] | None = "auto",
    fit: float = FIT,
    title: str | None = None,
    size: tuple[int, int] = (1600, 1200),
    dpi: float = 200.0,
    trajectory: Trajectory | ArrayLike | None = None,
    offset: ArrayLike = (0.0, 0.0, 0.0),
) -> Path:
    """Draw cells in space as shaded solids, in perspective, coloured by height.

    Args:
        cells: of any lattice in space; an empty list gives an empty page that says so.
        path: a ``.png``.
        view: where the viewer stands, degrees: azimuth counter-clockwise from x, elevation above
            the horizon. By default behind and to the right of a robot that looks along x.
        cut: what to take away; ``"auto"`` takes off a ceiling, if :func:`find_cut` sees one, and
            None draws all cells. The caption tells where it was cut.
        fit: the fraction of the cells that the picture is made for on each side; beyond it, those that
            stray far from the others may be outside, and the caption tells how many are.
            1 shows all cells, however far some of them are.
        title: a line above the picture, if any.
        size: width and height of the picture, pixels.
        dpi: pixels an inch, which sets the size of the text.
        trajectory: where the sensor went: a trajectory or positions (N, 3), metres; a row that is not finite
            interrupts the line. What cells hide of it is drawn dotted.
        offset: (3,) metres, where the cell 0 of the lattice has its centre in the map's frame, for grids of others,
            whose cells have their corners there.

    Returns:
        The path of the file.

    Raises:
        ArgumentError: a lattice of the plane, another suffix, positions of another shape, or numbers out of range.
        FileAccessError: the file cannot be written.
    """
    path = Path(path)
    check_spatial(cells.lattice)
    _check_options(path, view, fit, size, dpi)
    shift = np.asarray(offset, dtype=np.float64)
    line = positions_in_space(trajectory) - shift
    cut = _cut_in(cells, cut, shift)
    drawn = cells.select(cut.keep(cells, view[0]))
    heights = drawn.centres()[:, 2]
    ends = height_range(heights)
    scene = None
    pixels = np.full((size[1], size[0], 3), _PAPER, np.uint8)
    outside = 0
    if len(drawn):
        exposed = exposed_faces(drawn)
        looking = directions(*view)
        camera = Camera.fitted(
            looking, drawn.centres(), drawn.lattice.cell.vertices, _frame(size, dpi, title is not None), fit
        )
        rendering = render(drawn, exposed, height_colours(heights, *ends), camera, looking, size, _PAPER)
        pixels = rendering.image
        seen = [SeenLine.of(line, camera, rendering.nearness, drawn.lattice.resolution)] if len(line) else []
        scene = _Scene(camera, drawn, (ends[0] + float(shift[2]), ends[1] + float(shift[2])), seen)
        positions = camera.project(drawn.centres())
        outside = int(((positions < 0) | (positions > size)).any(axis=1).sum())
    words = _caption(cells, drawn, cut, outside, float(shift[2]))
    pixels = _lettered(pixels, scene, words, title, dpi)

    from matplotlib.image import imsave

    buffer = io.BytesIO()
    # Dates and versions would make the same picture differ from day to day and from machine to machine.
    imsave(buffer, pixels, format="png", dpi=dpi, metadata=_METADATA)
    with atomic_write(path) as handle:
        handle.write(buffer.getvalue())
    return path


def _check_options(path: Path, view: tuple[float, float], fit: float, size: tuple[int, int], dpi: float) -> None:
    """Check the options of a picture.

    Raises:
        ArgumentError: a suffix that is not known, or a number out of its range.
    """
    if path.suffix.lower() != ".png":
        raise ArgumentError(f"{path}: solids are drawn as .png, not as {path.suffix or 'a file without a suffix'}")
    if not (len(view) == 2 and math.isfinite(view[0]) and -90.0 <= view[1] <= 90.0):
        raise ArgumentError(f"a view is an azimuth and an elevation from -90 to 90 degrees, not {view}")
    if not 0.5 <= fit <= 1.0:
        raise ArgumentError(f"at least half of the cells and at most all must fit the page, not a fraction of {fit:g}")
    if not 10.0 <= dpi <= 5000.0:
        raise ArgumentError(f"a picture has 10 to 5000 pixels an inch, not {dpi:g}")
    if len(size) != 2 or not all(_SIDES[0] <= s <= _SIDES[1] for s in size) or size[0] * size[1] > _MAX_PIXELS:
        raise ArgumentError(
            f"a picture has {_SIDES[0]} to {_SIDES[1]:,} pixels a side and {_MAX_PIXELS:,} at most, not {size}"
        )


def _frame(size: tuple[int, int], dpi: float, titled: bool) -> tuple[float, float, float, float]:
    """Return left, top, right and bottom of the area of the page for the solids, pixels."""
    # On a page smaller than its margins the solids still get the middle.
    side = min(_MARGIN * dpi, 0.2 * size[0])
    top = min((_HEAD if titled else _MARGIN) * dpi, 0.2 * size[1])
    return side, top, size[0] - side, size[1] - min(_FOOT * dpi, 0.3 * size[1])


@dataclass(frozen=True, eq=False)
class _Scene:
    """What the words and lines on a picture are about.

    Attributes:
        camera: where it is seen from.
        drawn: the cells.
        ends: the heights, metres, between which colours change.
        lines: the trajectory, if there is one.
    """

    camera: Camera
    drawn: VoxelList
    ends: tuple[float, float]
    lines: list[SeenLine]


def _cut_in(cells: VoxelList, cut: Cut | Literal["auto"] | None, shift: NDArray[np.float64]) -> Cut:
    """Return the cut in the frame of the lattice, which ``shift`` (3,), metres, carries into the map's."""
    if cut == "auto":
        return find_cut(cells)
    if cut is None or cut.above is None:
        return cut or Cut()
    return replace(cut, above=cut.above - float(shift[2]))


def _caption(cells: VoxelList, drawn: VoxelList, cut: Cut, outside: int, rise: float) -> str:
    """Say in a line what is drawn; the map's heights are ``rise``, metres, above those of the lattice."""
    lattice = cells.lattice
    words = f"{lattice.title} lattice, resolution {metres_text(lattice.resolution)}; {len(drawn):,} cells"
    if len(drawn) < len(cells):
        parts = [f"above {metres_text(cut.above + rise)}"] if cut.above is not None else []
        parts += [f"in the nearest {100.0 * cut.near:.3g} % of the depth"] if cut.near else []
        words += f", {len(cells) - len(drawn):,} {' and '.join(parts)} cut away"
    return words + (f", {outside:,} off the page" if outside else "")


def _lettered(
    pixels: NDArray[np.uint8], scene: _Scene | None, words: str, title: str | None, dpi: float
) -> NDArray[np.uint8]:
    """Return the picture with title, caption, scale, the colours of heights and the trajectory."""
    height, width = pixels.shape[:2]
    ink = _ink(height, width, scene, words, title, dpi)
    if ink.shape[:2] != pixels.shape[:2]:
        # The figure's inches can round to a pixel less or more.
        whole = np.zeros((height, width, 4), np.float32)
        rows, columns = min(height, ink.shape[0]), min(width, ink.shape[1])
        whole[:rows, :columns] = ink[:rows, :columns]
        ink = whole
    marked = ink[:, :, 3].any(axis=1)
    out = _faded(pixels, dpi, title is not None)
    opacity = ink[marked, :, 3:] / 255.0
    out[marked] = np.rint(out[marked] * (1.0 - opacity) + ink[marked, :, :3] * opacity)
    return out


def _ink(
    height: int, width: int, scene: _Scene | None, words: str, title: str | None, dpi: float
) -> NDArray[np.float32]:
    """Return all that is written and drawn on the picture on a transparent sheet (H, W, 4), 0 to 255."""
    import matplotlib
    from matplotlib import style
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    w, h = width / dpi, height / dpi
    # The user's own style must not leak in.
    with style.context("default", after_reset=True), matplotlib.rc_context({"font.family": ["DejaVu Sans"]}):
        figure = Figure(figsize=(w, h), dpi=dpi, facecolor="none")
        canvas = FigureCanvasAgg(figure)
        sheet = figure.add_axes((0, 0, 1, 1))
        sheet.set_xlim(0, w)
        sheet.set_ylim(0, h)
        sheet.set_axis_off()
        if title is not None:
            sheet.text(_MARGIN, h - 0.5 * _HEAD, title, fontsize=10.5, color=_TEXT, va="center")
        sheet.text(_MARGIN, 0.24 * _FOOT, words, fontsize=7, color=FAINT, va="center")
        if scene is None:
            empty = "no cell is left to draw" if "cut" in words else "empty map: no cell is occupied"
            sheet.text(0.5 * w, 0.5 * h, empty, ha="center", va="center", color=FAINT, fontsize=11)
        else:
            _add_scale(sheet, scene.camera, scene.drawn, w, dpi)
            left = _add_heights(sheet, w - _MARGIN, scene.ends)
            for line in scene.lines:
                line.draw(sheet, h, dpi)
                add_line_legend(sheet, left - 0.2, 0.62 * _FOOT)
            sheet.set_xlim(0, w)
            sheet.set_ylim(0, h)
        canvas.draw()
        return np.asarray(canvas.buffer_rgba()).astype(np.float32)


def _faded(pixels: NDArray[np.uint8], dpi: float, titled: bool) -> NDArray[np.uint8]:
    """Return the picture with little left of it where the words are, so that they stay legible over strays."""
    height, width = pixels.shape[:2]
    _, top, _, bottom = _frame((width, height), dpi, titled)
    rows = np.arange(height)
    depth = (rows - bottom) / (height - bottom)
    if titled:
        depth = np.maximum(depth, (top - rows) / top)
    faint = 0.88 * np.clip(4.0 * depth - 0.6, 0.0, 1.0)[:, None, None]
    return np.rint(pixels * (1.0 - faint) + np.array(_PAPER) * faint).astype(np.uint8)


def _add_scale(sheet: Any, camera: Camera, drawn: VoxelList, width: float, dpi: float) -> None:
    """Add a bar as long as some round length is in the middle of the scene; nearer things are larger."""
    middle = np.median(drawn.centres(), axis=0)
    far = float((camera.rotation @ (middle - camera.eye))[2])
    metres = round_length(0.16 * width * dpi / camera.focal * far)
    bar = metres * camera.focal / far / dpi
    left, row = _MARGIN, 0.62 * _FOOT
    sheet.plot([left, left, left + bar, left + bar], [row + 0.05, row, row, row + 0.05], color=_TEXT, linewidth=1.1)
    sheet.text(left + bar + 0.07, row, f"{metres_text(metres)} in mid-scene", fontsize=7.5, color=_TEXT, va="center")


def _add_heights(sheet: Any, right: float, ends: tuple[float, float]) -> float:
    """Add the colours of the heights between the ends, metres, left of ``right``; return where that begins, inches."""
    row = 0.62 * _FOOT
    # To a hundredth of the range: more digits would only be noise.
    digits = 2 - math.floor(math.log10(max(ends[1] - ends[0], 1e-3)))
    low, high = (metres_text(round(end, digits)) for end in ends)
    text = sheet.text(right, row, high, fontsize=7.5, color=_TEXT, ha="right", va="center")
    figure = sheet.figure
    x = right - text.get_window_extent(figure.canvas.get_renderer()).width / figure.dpi - 0.06
    ramp = height_colours(np.linspace(0.0, 1.0, 256), 0.0, 1.0)[None]
    sheet.imshow(ramp, extent=(x - 1.1, x, row - 0.05, row + 0.05), aspect="auto", interpolation="nearest")
    text = sheet.text(x - 1.16, row, f"height {low}", fontsize=7.5, color=_TEXT, ha="right", va="center")
    return float(x - 1.16 - text.get_window_extent(figure.canvas.get_renderer()).width / figure.dpi)


# ---------------------------------------------------------------------- the viewer


def view_solids(mesh: Mesh, title: str = "hexmap") -> None:
    """Show a mesh in a window until the user closes it; takes the optional package Open3D.

    Args:
        mesh: the surface, as :func:`mesh_of_cells` makes it.
        title: of the window.

    Raises:
        ArgumentError: the mesh is empty.
        MissingDependencyError: Open3D, a library of the system it needs or a display is missing.
    """
    import contextlib

    if len(mesh.triangles) == 0:
        raise ArgumentError("the mesh is empty, there is nothing to show")
    o3d = _open3d()
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise MissingDependencyError(_NO_DISPLAY)
    corners, triangles, of = mesh.split()
    origin = np.round(mesh.vertices.mean(axis=0))
    surface = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices[corners] - origin), o3d.utility.Vector3iVector(triangles)
    )
    surface.vertex_normals = o3d.utility.Vector3dVector(mesh.normals[of].astype(np.float64))
    surface.vertex_colors = o3d.utility.Vector3dVector(mesh.colours[of] / 255.0)
    window = o3d.visualization.Visualizer()
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        opened = window.create_window(window_name=title, width=1280, height=900)
    # Without a display Open3D draws where nobody sees it, and would wait for ever for the window to be closed.
    if not opened or "offscreen" in said.getvalue().lower():
        window.destroy_window()
        raise MissingDependencyError(_NO_DISPLAY)
    try:
        window.add_geometry(surface)
        options = window.get_render_option()
        options.background_color = np.ones(3)
        options.light_on = True
        control = window.get_view_control()
        control.set_front(-directions(-120.0, 35.0).rotation[2])
        control.set_up([0.0, 0.0, 1.0])
        control.set_lookat(surface.get_axis_aligned_bounding_box().get_center())
        control.set_zoom(0.6)
        window.run()
    finally:
        window.destroy_window()


_NO_DISPLAY = "there is no display to open a window on; draw a picture or save a mesh instead"


def _open3d() -> Any:
    """Import Open3D, or say what is missing for it."""
    try:
        import open3d
    except ModuleNotFoundError as error:
        if error.name != "open3d":
            raise MissingDependencyError(f"the viewer's package open3d lacks the package {error.name}") from error
        raise MissingDependencyError("the viewer takes the package open3d: pip install 'hexmap[open3d]'") from error
    except (ImportError, OSError) as error:
        what = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise MissingDependencyError(
            f"the viewer's package open3d cannot be loaded ({what}); install the system libraries it needs, "
            "on Debian and Ubuntu: apt install libusb-1.0-0 libgl1 libgomp1 libx11-6"
        ) from error
    return open3d
