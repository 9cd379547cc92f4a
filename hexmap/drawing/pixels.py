"""Exact images of cells: every sample of every pixel is looked up, and a pixel is the mean of its samples."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hexmap.drawing.figure_layout import FigureLayout
from hexmap.lattice.lattice import Lattice
from hexmap.maps.outlines import pixel_rows

__all__ = ["PointClasses", "draw_pixels", "put_image", "sample_image"]

_SUPERSAMPLING = 3


class PointClasses(Protocol):
    """What says of which class the points of a picture are: :class:`~hexmap.maps.outlines.ClassTable`, or a section."""

    lattice: Lattice

    def at(self, points: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Return the class (N,) of each of ``points`` (N, 2), metres."""
        ...


def draw_pixels(
    figure: Any,
    layout: FigureLayout,
    table: PointClasses,
    colours: tuple[str, ...],
    walls: NDArray[np.float64],
    classes: NDArray[np.uint8],
) -> None:
    """Put the exact image of cells onto the figure, the classes of ``table`` in their ``colours``.

    The ``walls`` (M, 2), metres, are the centres of cells of ``classes`` (M,) that must stay visible
    where they are smaller than a pixel.
    """
    from matplotlib.colors import to_rgb

    left, top = float(layout.low[0]), float((layout.low if layout.y_down else layout.high)[1])
    pixel = layout.metres_per_pixel
    step = pixel if layout.y_down else -pixel
    image = sample_image((left, top), (pixel, step), layout.pixels, table, colours)
    width, height = layout.pixels
    if table.lattice.resolution < 2.0 * pixel and len(walls):
        # A wall of one cell must not fade away on a small picture of a large map.
        at = (walls - (left, top)) / (pixel, step)
        on_page = ((at >= 0.0) & (at < (width, height))).all(axis=1)
        columns, lines = at[on_page].astype(np.int64).T
        ink = np.rint(255.0 * np.array([to_rgb(colour) for colour in colours]))[classes[on_page]].astype(np.uint8)
        np.minimum.at(image, (lines, columns), ink)
    put_image(figure, image, round(layout.left * layout.dpi), round(layout.bottom * layout.dpi))


def sample_image(
    corner: tuple[float, float],
    steps: tuple[float, float],
    pixels: tuple[int, int],
    table: PointClasses,
    colours: tuple[str, ...],
    samples: int = _SUPERSAMPLING,
) -> NDArray[np.uint8]:
    """Return the exact image (H, W, 3) of cells, the top row first.

    Args:
        corner: where the image's upper left corner is, metres.
        steps: from a pixel to the one on its right and to the one below it, metres.
        pixels: the width and the height.
        table: of which class points are.
        colours: of the classes.
        samples: a pixel, along each side.
    """
    from matplotlib.colors import to_rgb

    palette = 255.0 * np.array([to_rgb(colour) for colour in colours], np.float32)
    (width, height), n = pixels, samples
    xs = corner[0] + (np.arange(width * n, dtype=np.float64) + 0.5) * (steps[0] / n)
    ys = corner[1] + (np.arange(height * n, dtype=np.float64) + 0.5) * (steps[1] / n)
    image = np.empty((height, width, 3), np.uint8)
    for rows, points in pixel_rows(xs, ys, n):
        sampled = table.at(points).reshape(-1, n, width, n)
        # The samples of a pixel are added one after the other: far quicker than a mean over two axes.
        total = np.zeros((len(sampled), width, 3), np.float32)
        for i, j in np.ndindex(n, n):
            total += palette[sampled[:, i, :, j]]
        image[rows.start // n : rows.stop // n] = np.rint(total / (n * n))
    return image


def put_image(figure: Any, image: NDArray[np.uint8], x: int, y: int) -> None:
    """Put an image (H, W, 3), top row first, behind all else, its lower left corner at pixel (x, y).

    ``Figure.figimage`` would do, but resamples in floating point on the way, in some 250 MB.
    """
    from matplotlib.artist import Artist

    opaque = np.full((*image.shape[:2], 4), 255, np.uint8)
    opaque[:, :, :3] = image[::-1]

    class Pixels(Artist):
        def draw(self, renderer: Any) -> None:
            context = renderer.new_gc()
            renderer.draw_image(context, x, y, opaque)
            context.restore()

    pixels = Pixels()
    pixels.set_zorder(-1)
    figure.add_artist(pixels)
