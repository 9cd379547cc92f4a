"""Write a map in the plane, or a band of heights of one in space, for ROS map_server: a YAML file and a PGM image."""

from __future__ import annotations

import math
import re
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hexmap.base.atomic_files import PathLike, atomic_write
from hexmap.base.errors import ArgumentError, FileAccessError
from hexmap.maps.cubes import cubes_of
from hexmap.maps.map import Map
from hexmap.maps.outlines import ClassTable, pixel_rows
from hexmap.maps.state_rule import StateRule, States


def export_ros(map: Map, path: PathLike, level: int = 0, rule: StateRule | None = None) -> list[Path]:
    """Write a level of a map in the plane for ROS map_server: a YAML file and a PGM image beside it.

    Pixels are as wide as the lattice's resolution, so they have the area of a cell. A pixel is
    occupied where the centre of an occupied cell lies in it, and nowhere else; free where the centre of a
    free cell lies in it or its own centre lies in a free cell; unknown otherwise. A point (x, y) lies in
    column ``floor((x - origin_x) / resolution)`` and in the row, counted from the *bottom*,
    ``floor((y - origin_y) / resolution)``, with the numbers of the YAML file.

    Args:
        map: a map in the plane.
        path: the YAML file; the image has its name and the suffix ``.pgm``.
        level: which level, 0 is the finest.
        rule: what makes a cell occupied or free.

    Returns:
        The YAML file and the image.

    Raises:
        ArgumentError: the map is in space, there is no such level, or the image would have more than
            10^9 pixels.
        FileAccessError: a file cannot be written.
    """
    path = Path(path)
    if map.lattice.dim != 2:
        raise ArgumentError(
            f"{path}: a ROS map is flat and this map is in space; export it to .bt, .ply, .pcd or .csv, "
            "or say which heights a flat one shall show (--height LOW HIGH)"
        )
    return _write(path, *_ros_image(path, map.state(rule, level)))


def export_ros_band(states: States, path: PathLike, heights: tuple[float, float]) -> tuple[list[Path], str]:
    """Write the cells of a map in space between two heights for ROS map_server, seen from above.

    The cells whose centre lies in the band become cubes as large as a cell (:func:`hexmap.maps.cubes.cubes_of`). A
    pixel is occupied where any cube above it is, free where none is and one is free, unknown otherwise.

    Args:
        states: the occupied and free cells.
        path: the YAML file; the image has its name and the suffix ``.pgm``.
        heights: the lowest and the highest, metres, both included.

    Returns:
        The YAML file and the image, and a line that says what was done.

    Raises:
        ArgumentError: the map is in the plane, the heights are no band, no known cell lies in it, or the image would
            have more than 10^9 pixels.
        FileAccessError: a file cannot be written.
    """
    path = Path(path)
    low, high = heights
    if states.occupied.lattice.dim != 3:
        raise ArgumentError(f"{path}: a band of heights is cut out of a map in space, and this one is in the plane")
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise ArgumentError(f"{path}: a band of heights is from a lower one to a higher one, not {low:g} to {high:g} m")
    within = [
        cells.select((cells.centres()[:, 2] >= low) & (cells.centres()[:, 2] <= high))
        for cells in (states.occupied, states.free)
    ]
    if len(within[0]) + len(within[1]) == 0:
        raise ArgumentError(f"{path}: no known cell lies between {low:g} and {high:g} m")
    cubes = cubes_of(States(*within))
    known = np.concatenate([cubes.free[:, :2], cubes.occupied[:, :2]])
    first = known.min(axis=0)
    width, height = (known.max(axis=0) - first + 1).tolist()
    if width * height > _MAX_PIXELS:
        raise _too_large(path, width, height)
    image = np.full((height, width), _UNKNOWN_PIXEL, np.uint8)
    for kind, value in ((cubes.free, _FREE_PIXEL), (cubes.occupied, _OCCUPIED_PIXEL)):
        image[kind[:, 1] - first[1], kind[:, 0] - first[0]] = value
    counts = [int(np.count_nonzero(image == value)) for value in (_OCCUPIED_PIXEL, _FREE_PIXEL, _UNKNOWN_PIXEL)]
    words = (
        f"heights from {low:g} to {high:g} m: {len(within[0]):,} occupied and {len(within[1]):,} free cells became "
        f"{counts[0]:,} occupied pixels (a cell in the band is), {counts[1]:,} free (none is, one is free) and "
        f"{counts[2]:,} unknown, of {cubes.edge:g} m"
    )
    x, y = (float(v) for v in np.round(first * cubes.edge, 9) + 0.0)
    return _write(path, cubes.edge, (x, y), image), words


def _write(path: Path, resolution: float, origin: tuple[float, float], image: NDArray[np.uint8]) -> list[Path]:
    """Write the YAML file ``path`` and the image (H, W), the bottom row first, beside it; return both paths."""
    image_path = path.with_suffix(".pgm")
    lines = [
        f"image: {_yaml_text(path, image_path.name)}",
        f"resolution: {resolution!r}",
        f"origin: [{origin[0]!r}, {origin[1]!r}, 0.0]",
        "negate: 0",
        "occupied_thresh: 0.65",
        "free_thresh: 0.196",
        "mode: trinary",
    ]
    # Both are whole before either takes its name, and the YAML file comes last: where it is, its image is too.
    with ExitStack() as last, atomic_write(image_path) as handle:
        handle.write(b"P5\n%d %d\n255\n" % (image.shape[1], image.shape[0]))
        handle.write(np.ascontiguousarray(image[::-1]).data)
        text = last.enter_context(atomic_write(path, "w"))
        text.write("\n".join(lines) + "\n")
        text.flush()
    return [path, image_path]


def _yaml_text(path: Path, name: str) -> str:
    """Return a file's name as YAML: plain where it can be, else quoted, with what is not printable escaped.

    Raises:
        FileAccessError: the name is not UTF-8, which no YAML file can say.
    """
    if re.fullmatch(r"[A-Za-z_][A-Za-z0-9_.-]*", name):
        return name
    if any("\ud800" <= c <= "\udfff" for c in name):
        raise FileAccessError(f"{path}: cannot be written: the name is not UTF-8, and a YAML file names its image")
    escaped = (c if c.isprintable() and c not in '"\\' else f"\\U{ord(c):08x}" for c in name)
    return '"' + "".join(escaped) + '"'


def _ros_image(path: Path, states: States) -> tuple[float, tuple[float, float], NDArray[np.uint8]]:
    """Return the pixel's side, the origin and the image (H, W), the bottom row first."""
    lattice = states.occupied.lattice
    # Twelve digits are what the file says, so they are also what the pixels are computed with.
    side = float(f"{lattice.resolution:.12g}")
    occupied, free = states.occupied.centres(), states.free.centres()
    centres = np.concatenate([occupied, free])
    if len(centres) == 0:
        return side, (-0.5 * side, -0.5 * side), np.full((1, 1), _UNKNOWN_PIXEL, np.uint8)
    # Half a pixel of room puts the centres of squares in the middle of their pixels.
    digits = max(9, 6 - math.floor(math.log10(side)))
    corner = np.round(centres.min(axis=0) - 0.5 * side, digits) + 0.0
    span = np.floor((centres.max(axis=0) - corner) / side)
    if float((span + 1.0).prod()) > _MAX_PIXELS:
        raise _too_large(path, span[0] + 1, span[1] + 1)
    width, height = int(span[0]) + 1, int(span[1]) + 1
    image = np.empty((height, width), np.uint8)
    table = ClassTable(lattice, [(states.free, np.ones(len(states.free), np.uint8))])
    xs = corner[0] + (np.arange(width) + 0.5) * side
    ys = corner[1] + (np.arange(height) + 0.5) * side
    for rows, points in pixel_rows(xs, ys):
        image[rows] = np.where(table.at(points) > 0, _FREE_PIXEL, _UNKNOWN_PIXEL).reshape(-1, width)
    for points, value in ((free, _FREE_PIXEL), (occupied, _OCCUPIED_PIXEL)):
        pixel = np.floor((points - corner) / side).astype(np.int64)
        image[pixel[:, 1], pixel[:, 0]] = value
    return side, (float(corner[0]), float(corner[1])), image


def _too_large(path: Path, width: float, height: float) -> ArgumentError:
    return ArgumentError(
        f"{path}: the image would have {width:.0f} x {height:.0f} pixels, more than {_MAX_PIXELS}; "
        f"export a coarser level, or crop the map"
    )


# map_server's values: black is occupied, 254 is free, 205 lies between its default thresholds.
_OCCUPIED_PIXEL, _FREE_PIXEL, _UNKNOWN_PIXEL = 0, 254, 205


_MAX_PIXELS = 10**9
