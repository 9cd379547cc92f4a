"""Maps in the formats of others: ROS map_server images, tables of cells (CSV) and points (PLY).

Each function writes one level of a map, whole files only. What is occupied and free is the map's
own rule, :meth:`hexmap.maps.Map.state`.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hexmap._shapes import ClassTable, pixel_rows
from hexmap.atomic import atomic_write
from hexmap.cells import unpack
from hexmap.errors import ArgumentError
from hexmap.maps import FREE, OCCUPIED, Map, StateRule, States

__all__ = ["export", "export_csv", "export_ply", "export_ros"]

_PathLike = str | os.PathLike[str]

# map_server's values: black is occupied, 254 is free, 205 lies between its default thresholds.
_OCCUPIED_PIXEL, _FREE_PIXEL, _UNKNOWN_PIXEL = 0, 254, 205
_MAX_PIXELS = 10**9
_STATE_NAMES = ("unknown", "free", "occupied")


def export(map: Map, path: _PathLike, level: int = 0, rule: StateRule | None = None) -> list[Path]:
    """Write a level of a map in the format that the suffix of ``path`` names.

    Args:
        map: the map.
        path: ``.yaml`` or ``.yml`` for ROS map_server (with a ``.pgm`` beside it), ``.csv`` for a table
            of cells, ``.ply`` for the occupied centres as points.
        level: which level, 0 is the finest.
        rule: what makes a cell occupied or free; the default rule where none is given.

    Returns:
        The files written.

    Raises:
        ArgumentError: a suffix that is not known, a level that the map has not, or a map in space
            for ROS.
        FileAccessError: a file cannot be written.
    """
    formats: dict[str, Callable[[Map, _PathLike, int, StateRule | None], list[Path]]] = {
        ".yaml": export_ros,
        ".yml": export_ros,
        ".csv": export_csv,
        ".ply": export_ply,
    }
    suffix = Path(path).suffix.lower()
    if suffix not in formats:
        raise ArgumentError(
            f"{path}: cannot export to {suffix or 'a file without a suffix'}; known are {', '.join(formats)}"
        )
    return formats[suffix](map, path, level, rule)


def export_ros(map: Map, path: _PathLike, level: int = 0, rule: StateRule | None = None) -> list[Path]:
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
        raise ArgumentError(f"{path}: a ROS map is flat and this map is in space; export it to .ply or .csv")
    states = map.state(rule, level)
    image_path = path.with_suffix(".pgm")
    resolution, origin, image = _ros_image(path, states)
    name = image_path.name
    lines = [
        f"image: {name if re.fullmatch(r'[A-Za-z_][A-Za-z0-9_.-]*', name) else json.dumps(name, ensure_ascii=False)}",
        f"resolution: {resolution!r}",
        f"origin: [{origin[0]!r}, {origin[1]!r}, 0.0]",
        "negate: 0",
        "occupied_thresh: 0.65",
        "free_thresh: 0.196",
        "mode: trinary",
    ]
    # The YAML file comes last: where it is, its image is too.
    with atomic_write(image_path) as handle:
        handle.write(b"P5\n%d %d\n255\n" % (image.shape[1], image.shape[0]))
        handle.write(np.ascontiguousarray(image[::-1]).data)
    with atomic_write(path, "w") as handle:
        handle.write("\n".join(lines) + "\n")
    return [path, image_path]


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
        raise ArgumentError(
            f"{path}: the image would have {span[0] + 1:.0f} x {span[1] + 1:.0f} pixels, more than {_MAX_PIXELS}; "
            f"export a coarser level, or crop the map"
        )
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


def export_csv(map: Map, path: _PathLike, level: int = 0, rule: StateRule | None = None) -> list[Path]:
    """Write the cells of a level as a table, one line a cell that was hit or passed.

    Columns: ``level,a,b(,c),x,y(,z),hits,passes,state``; x, y, z is the cell's centre in metres, with
    all digits, and state is ``occupied``, ``free`` or ``unknown``.

    Args:
        map: the map.
        path: the file.
        level: which level, 0 is the finest.
        rule: what makes a cell occupied or free.

    Returns:
        The file written.

    Raises:
        ArgumentError: there is no such level.
        FileAccessError: the file cannot be written.
    """
    path = Path(path)
    states = map.state(rule, level)
    keys, hits, passes = map.level(level).columns()
    lattice = map.level(level).lattice
    index = unpack(keys, lattice.dim)
    # The lists of occupied and free cells are sorted as the keys are: no need to look each cell up.
    state = np.zeros(len(keys), np.int64)
    state[np.searchsorted(keys, states.free.keys)] = FREE
    state[np.searchsorted(keys, states.occupied.keys)] = OCCUPIED
    columns: list[list[object]] = [*index.T.tolist(), *lattice.centres(index).T.tolist()]
    columns += [hits.tolist(), passes.tolist(), [_STATE_NAMES[s] for s in state.tolist()]]
    line = f"{level}," + ",".join(["%s"] * len(columns)) + "\n"
    axes, places = ("a", "b", "c")[: lattice.dim], ("x", "y", "z")[: lattice.dim]
    with atomic_write(path, "w") as handle:
        handle.write(",".join(("level", *axes, *places, "hits", "passes", "state")) + "\n")
        handle.writelines(line % row for row in zip(*columns, strict=True))
    return [path]


def export_ply(map: Map, path: _PathLike, level: int = 0, rule: StateRule | None = None) -> list[Path]:
    """Write the centres of the occupied cells of a level as points: binary little-endian PLY.

    Each vertex has ``double x y z`` in metres (z is 0 for a map in the plane) and ``uint hits``, which
    stays at 2^32 - 1 where a cell was hit more often than that.

    Args:
        map: the map.
        path: the file.
        level: which level, 0 is the finest.
        rule: what makes a cell occupied.

    Returns:
        The file written.

    Raises:
        ArgumentError: there is no such level.
        FileAccessError: the file cannot be written.
    """
    path = Path(path)
    occupied = map.state(rule, level).occupied
    vertices = np.zeros(len(occupied), np.dtype([("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("hits", "<u4")]))
    for axis, column in zip("xyz", occupied.centres().T, strict=False):
        vertices[axis] = column
    vertices["hits"] = np.minimum(occupied.counts, 2**32 - 1)
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
        "property double x\nproperty double y\nproperty double z\nproperty uint hits\nend_header\n"
    )
    with atomic_write(path) as handle:
        handle.write(header.encode("ascii"))
        handle.write(vertices.tobytes())
    return [path]
