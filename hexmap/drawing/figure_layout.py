"""The figure that a map is drawn in: how it is laid out, its colours, captions and legend."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError
from hexmap.base.values import one_line
from hexmap.lattice.lattice import Lattice
from hexmap.maps.outlines import silhouette
from hexmap.maps.state_rule import States
from hexmap.maps.voxel_list import VoxelList

__all__ = [
    "FAINT",
    "FRAME",
    "FREE_COLOUR",
    "HEIGHTS",
    "NEAR_COLOUR",
    "PATH_COLOUR",
    "SHADES",
    "UNKNOWN_COLOUR",
    "FigureLayout",
    "draw_captions",
    "draw_path_captions",
    "draw_slice_captions",
    "has_hits",
    "metres_text",
    "round_length",
    "thresholds",
]

UNKNOWN_COLOUR, FREE_COLOUR = "#dde3ea", "#ffffff"
SHADES = ("#8b9dc3", "#7085b0", "#566a98", "#3e5180", "#273861", "#121f40")  # few hits to many; one stands out, too
PATH_COLOUR = "#e4572e"
FAINT, FRAME = "#6b778c", "#b4bfcd"
NEAR_COLOUR = "#f6ead9"  # free, but too near to an obstacle for the robot
HEIGHTS = "viridis"
_TEXT = "#1f2a3d"

_LONG_SIDE = 8.0  # inches of the longer side of the map's own area
_MIN_WIDTH = 6.4  # inches that the captions need
_MARGIN, _FOOT, _HEAD = 0.14, 0.66, 0.38  # inches around, below and (with a title) above
_BESIDE, _BELOW = 0.5, 0.4  # inches for the coordinates to the left of the map and under it
_TICK, _LEGEND, _SMALL, _TITLE = 7.5, 8.5, 7.5, 11.0  # points
_ORIGIN = "#7a869a"
_MAX_PIXELS = 50_000_000


@dataclass(frozen=True)
class FigureLayout:
    """Where the map lies in its figure: inches, the box it shows in metres, and whole pixels.

    ``below`` and ``beside`` are room for coordinates and more under the map and to the left of it, inches; ``y_down``
    puts the low y at the top.
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    pixels: tuple[int, int]
    dpi: float
    titled: bool
    captions: float
    below: float = 0.0
    y_down: bool = False
    beside: float = 0.0

    __repr__ = one_line

    @classmethod
    def around(
        cls,
        positions: NDArray[np.float64],
        lattice: Lattice,
        dpi: float,
        titled: bool,
        y_down: bool = False,
        shrink: float = 1.0,
    ) -> FigureLayout:
        """Fit a figure around ``positions`` (N, 2), metres, with some room and not too far from a square.

        Args:
            positions: what must be seen.
            lattice: of the cells, whose size gives the room.
            dpi: pixels an inch.
            titled: whether there is a title above the map.
            y_down: whether low y is at the top.
            shrink: 1 makes the longer side of the map 8 inches.

        Raises:
            ArgumentError: the figure would have too many pixels.
        """
        if len(positions):
            low, high = positions.min(axis=0), positions.max(axis=0)
        else:
            low, high = np.full(2, -10.0) * lattice.resolution, np.full(2, 10.0) * lattice.resolution
        room = 2.0 * lattice.covering_radius + 0.02 * float((high - low).max())
        low, high = low - room, high + room
        size = high - low
        wanted = np.maximum(size, size.max() / 3.0)
        low, high = low - 0.5 * (wanted - size), high + 0.5 * (wanted - size)
        pixel = float(wanted.max()) / round(_LONG_SIDE * shrink * dpi)
        counts = np.maximum(np.ceil(wanted / pixel - 1e-9), 1.0)
        if counts.prod() > _MAX_PIXELS:
            raise ArgumentError(f"a picture of {counts[0]:.0f} x {counts[1]:.0f} pixels is too large; lower the dpi")
        high = low + counts * pixel
        captions = max(_MIN_WIDTH, counts[0] / dpi)
        pixels = int(counts[0]), int(counts[1])
        return cls(low, high, pixels, dpi, titled, captions, below=_BELOW, y_down=y_down, beside=_BESIDE)

    def _whole(self, inches: float) -> float:
        """Return a length that is a whole number of pixels, so that the map's pixels are the image's."""
        return round(inches * self.dpi) / self.dpi

    @property
    def metres_per_inch(self) -> float:
        """Metres of the map to an inch of paper."""
        return float((self.high[0] - self.low[0]) * self.dpi / self.pixels[0])

    @property
    def metres_per_pixel(self) -> float:
        """Metres of the map to a pixel."""
        return float((self.high[0] - self.low[0]) / self.pixels[0])

    @property
    def shows_origin(self) -> bool:
        """Whether the origin of the coordinates lies in the map's area."""
        return bool((self.low <= 0.0).all() and (self.high >= 0.0).all())

    def count_outside(self, centres: NDArray[np.float64]) -> int:
        """Return how many of the centres (N, 2), metres, are off the page."""
        return int(((centres < self.low) | (centres > self.high)).any(axis=1).sum())

    @property
    def left(self) -> float:
        """Inches from the left edge to the map, which is centred where the captions are wider."""
        return self._whole(_MARGIN + self.beside + 0.5 * (self.captions - self.pixels[0] / self.dpi))

    @property
    def bottom(self) -> float:
        """Inches from the lower edge to the map."""
        return self._whole(_FOOT + self.below)

    @property
    def width(self) -> float:
        """Inches of the whole figure."""
        return self._whole(self.captions + self.beside + 2.0 * _MARGIN)

    @property
    def height(self) -> float:
        """Inches of the whole figure."""
        return self._whole(_FOOT + self.below + (_HEAD if self.titled else _MARGIN)) + self.pixels[1] / self.dpi

    def add_axes(self, figure: Any) -> Any:
        """Add axes in metres that cover the map's own pixels, with coordinates, and the origin marked."""
        w, h = self.pixels[0] / self.dpi / self.width, self.pixels[1] / self.dpi / self.height
        axes = figure.add_axes((self.left / self.width, self.bottom / self.height, w, h))
        axes.set_xlim(self.low[0], self.high[0])
        axes.set_ylim(*((self.high[1], self.low[1]) if self.y_down else (self.low[1], self.high[1])))
        label_axes(axes, "x, m", "y, m")
        if self.shows_origin:
            for colour, width in (("white", 2.4), (_ORIGIN, 1.0)):
                axes.plot(0.0, 0.0, marker="+", markersize=9.0, markeredgecolor=colour, markeredgewidth=width, zorder=9)
        return axes


def label_axes(axes: Any, across: str, up: str) -> None:
    """Draw thin ticks with coordinates along the left and the lower side of axes that hide nothing."""
    from matplotlib.ticker import MaxNLocator

    axes.patch.set_visible(False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    inches = axes.figure.get_size_inches() * axes.get_position().size
    for axis, length in ((axes.xaxis, inches[0]), (axes.yaxis, inches[1])):
        # No number runs into the next one.
        axis.set_major_locator(MaxNLocator(nbins=max(2, min(9, int(length / 0.45))), steps=[1, 2, 5, 10]))
    axes.tick_params(labelsize=_TICK, length=2.5, width=0.5, color=FAINT, labelcolor=_TEXT, pad=2.0)
    axes.set_xlabel(across, fontsize=_TICK, labelpad=1.5, color=FAINT)
    axes.set_ylabel(up, fontsize=_TICK, labelpad=1.5, color=FAINT)


def has_hits(occupied: VoxelList) -> bool:
    """Tell whether any cell was hit more than once: in maps of others each counts 1."""
    return len(occupied) == 0 or int(occupied.counts.max()) > 1


def thresholds(occupied: VoxelList) -> NDArray[np.int64]:
    """Return the numbers of hits from which each shade but the first one holds."""
    # A few cells that a standing robot hit thousands of times should not make all walls pale.
    most = max(float(np.quantile(occupied.counts, 0.9)), 1.0) if len(occupied) else 1.0
    steps = np.arange(1, len(SHADES))
    # At least one more hit a shade, where hits are few.
    return np.maximum(np.ceil(most ** (steps / (len(SHADES) - 1.0))).astype(np.int64), steps + 1)


def draw_captions(
    figure: Any,
    layout: FigureLayout,
    states: States,
    heights: tuple[float, float] | None,
    with_path: bool,
    title: str | None,
    outside: int = 0,
) -> None:
    """Write the title, the scale bar, the legend and what the map is, ``outside`` cells off the page, and frame it."""
    lattice, known = states.occupied.lattice, f"{len(states.occupied):,} occupied"
    flat = lattice.dim == 2
    known += f", {len(states.free):,} free cells" if flat else " cells, seen from above"
    known += f"; {outside:,} cells not shown (--whole)" if outside else ""
    legend = _draw_sheet(figure, layout, title, f"{_lattice_words(lattice)}; {known}")
    if flat:
        legend.add_states(states)
    elif heights is not None:
        legend.add_heights(*heights)
    if with_path:
        legend.add_line("trajectory")


def draw_path_captions(
    figure: Any,
    layout: FigureLayout,
    lattice: Lattice,
    kinds: list[tuple[str, str]],
    title: str | None,
    words: str,
    goal_missed: bool,
) -> None:
    """Write what surrounds the picture of a path; ``kinds`` are the names and colours of its cells."""
    legend = _draw_sheet(figure, layout, title, "; ".join(filter(None, (_lattice_words(lattice), words))))
    legend.add_kinds(kinds, lattice)
    if goal_missed:
        legend.add_cross("goal, not reached")
    legend.add_line("path")


def draw_slice_captions(
    figure: Any,
    layout: FigureLayout,
    lattice: Lattice,
    kinds: list[tuple[str, str]],
    title: str | None,
    words: str,
    with_path: bool,
) -> None:
    """Write what a slice of a map in space shows; ``kinds`` are the names and colours of its cells."""
    legend = _draw_sheet(figure, layout, title, f"{_lattice_words(lattice)}; {words}")
    legend.add_kinds(kinds, lattice)
    if with_path:
        legend.add_line("trajectory")


def _lattice_words(lattice: Lattice) -> str:
    return f"{lattice.title} lattice, resolution {metres_text(lattice.resolution)}"


def _draw_sheet(figure: Any, layout: FigureLayout, title: str | None, words: str) -> _Legend:
    """Write the title, the scale bar and a line of small print, frame the map, and return its legend."""
    from matplotlib.patches import Rectangle

    sheet = figure.add_axes((0, 0, 1, 1))
    sheet.set_xlim(0, layout.width)
    sheet.set_ylim(0, layout.height)
    sheet.set_axis_off()
    w, h = (layout.high - layout.low) / layout.metres_per_inch
    sheet.add_patch(Rectangle((layout.left, layout.bottom), w, h, facecolor="none", edgecolor=FRAME, linewidth=0.6))
    left, right = _MARGIN, layout.width - _MARGIN
    if title is not None:
        sheet.text(left, layout.height - 0.5 * _HEAD, title, fontsize=_TITLE, color=_TEXT, va="center")
    row = 0.64 * _FOOT
    words += "; + marks the origin" if layout.shows_origin else ""
    metres = round_length(0.2 * (layout.high[0] - layout.low[0]))
    bar = metres / layout.metres_per_inch
    sheet.plot([left, left, left + bar, left + bar], [row + 0.05, row, row, row + 0.05], color=_TEXT, linewidth=1.1)
    sheet.text(left + bar + 0.07, row, metres_text(metres), fontsize=_LEGEND, color=_TEXT, va="center")
    sheet.text(left, 0.24 * _FOOT, words, fontsize=_SMALL, color=FAINT, va="center")
    return _Legend(sheet, right, row)


class _Legend:
    """Writes entries from the right to the left, in inches."""

    def __init__(self, sheet: Any, right: float, row: float) -> None:
        self._sheet, self._x, self._row = sheet, right, row

    def _text(self, text: str, gap: float = 0.0) -> None:
        words = self._sheet.text(self._x, self._row, text, fontsize=_LEGEND, color=_TEXT, ha="right", va="center")
        box = words.get_window_extent(self._sheet.figure.canvas.get_renderer())
        self._x -= box.width / self._sheet.figure.dpi + gap

    def _swatch(self, shape: NDArray[np.float64], colour: str, edge: str) -> None:
        from matplotlib.patches import Polygon

        width = float(np.ptp(shape[:, 0]))
        at = (self._x - 0.5 * width, self._row)
        self._sheet.add_patch(Polygon(shape + at, facecolor=colour, edgecolor=edge, linewidth=0.6))
        self._x -= width + 0.02

    def add_states(self, states: States) -> None:
        """Add the shades of occupied cells, free and unknown, as small cells of the lattice."""
        lattice = states.occupied.lattice
        shape = silhouette(lattice)
        shape = shape * (0.065 / np.abs(shape).max())
        if has_hits(states.occupied):
            self._text(f"{thresholds(states.occupied)[-1]:,}+ hits", 0.05)
            for colour in reversed(SHADES):
                self._swatch(shape, colour, colour)
            self._x -= 0.03
            self._text("occupied, 1", 0.16)
        else:
            self._text("occupied", 0.05)
            self._swatch(shape, SHADES[-2], SHADES[-2])
            self._x -= 0.12
        for name, colour in (("free", FREE_COLOUR), ("unknown", UNKNOWN_COLOUR)):
            self._text(name, 0.05)
            self._swatch(shape, colour, "#a3afbf")
            self._x -= 0.12

    def add_heights(self, low: float, high: float) -> None:
        """Add the colours of heights from ``low`` to ``high``, metres."""
        self._text(metres_text(high), 0.06)
        width = 1.1
        box = (self._x - width, self._x, self._row - 0.05, self._row + 0.05)
        ramp = np.linspace(0.0, 1.0, 128)[None]
        self._sheet.imshow(ramp, cmap=HEIGHTS, extent=box, aspect="auto", interpolation="nearest")
        self._sheet.set_xlim(0, self._sheet.figure.get_figwidth())
        self._sheet.set_ylim(0, self._sheet.figure.get_figheight())
        self._x -= width + 0.06
        self._text(f"height {metres_text(low)}", 0.18)

    def add_kinds(self, kinds: list[tuple[str, str]], lattice: Lattice) -> None:
        """Add kinds of cells by name and colour."""
        shape = silhouette(lattice)
        shape = shape * (0.065 / np.abs(shape).max())
        for name, colour in reversed(kinds):
            self._text(name, 0.05)
            self._swatch(shape, colour, "#a3afbf")
            self._x -= 0.12

    def add_cross(self, name: str) -> None:
        """Add the mark of a position that was not reached."""
        self._text(name, 0.1)
        self._sheet.plot([self._x], [self._row], marker="x", markersize=4.5, markeredgecolor=PATH_COLOUR)
        self._x -= 0.15

    def add_line(self, name: str) -> None:
        """Add the line of a path or a trajectory."""
        self._text(name, 0.1)
        ends = [self._x - 0.24, self._x]
        self._sheet.plot(ends, [self._row] * 2, color=PATH_COLOUR, linewidth=1.1)
        for x, face in zip(ends, ("white", PATH_COLOUR), strict=True):
            mark = dict(
                marker="o", markersize=3.6, markerfacecolor=face, markeredgecolor=PATH_COLOUR, markeredgewidth=0.9
            )
            self._sheet.plot([x], [self._row], **mark)


def round_length(metres: float) -> float:
    """Return the longest of 1, 2, 5, 10, ... times a power of ten that is no longer than ``metres``."""
    power = 10.0 ** math.floor(math.log10(metres))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= metres * (1 + 1e-9))


def metres_text(length: float) -> str:
    """Return a length as it is read: kilometres and centimetres only where metres would be clumsy."""
    rounded = float(f"{length:.3g}") + 0.0
    text = f"{rounded / 1000.0:g} km" if abs(rounded) >= 10_000 else f"{rounded:g} m"
    return text.replace("-", "\N{MINUS SIGN}")
