"""Open a map of someone else: its format is found by its content."""

from __future__ import annotations

import math
import os
from pathlib import Path

from hexmap.base.errors import ArgumentError, FormatError
from hexmap.base.text import quoted
from hexmap.io import file_kinds
from hexmap.io.grids.grid_map import MAX_BYTES, GridMap
from hexmap.io.read_file import beginning, read_file

__all__ = ["is_grid", "open_grid"]

_KNOWN = "a MovingAI .map, a Warframe .3dmap, the .yaml of a ROS map, an OctoMap .bt or a BeeSoft .dat (Wean Hall)"
_PICTURES = (file_kinds.PNG, file_kinds.PGM, file_kinds.BMP)
_KINDS = {
    file_kinds.MOVINGAI: "movingai",
    file_kinds.WARFRAME: "warframe",
    file_kinds.OCTOMAP: "octomap",
    file_kinds.WEAN_MAP: "wean",
}


def open_grid(path: str | os.PathLike[str], *, cell: float | None = None) -> GridMap:
    """Read a published map; its format is found by its content, and by its name where that leaves it open.

    Args:
        path: a ``.map`` or ``.3dmap`` (plain or gzip), the ``.yaml`` of a ROS map_server map with its
            image beside it, a ``.bt``, or the map of Wean Hall (``.dat``, plain or gzip).
        cell: metres an edge of a cell, for MovingAI and Warframe, which name none; 1 where none is given.

    Returns:
        The map. The cell (x, y(, z)) of a MovingAI or Warframe map has its *centre* at that index times ``cell``.

    Raises:
        ArgumentError: ``cell`` is not positive, or the format has its own.
        FileAccessError: a file is not there or cannot be read.
        FormatError: a file is damaged or of a foreign kind; the text names the line where there is one.
        TooLargeError: the map has more cells than a dense array may have.
    """
    path = Path(path)
    if cell is not None and not (isinstance(cell, (int, float)) and math.isfinite(cell) and cell > 0.0):
        raise ArgumentError(f"the edge of a cell must be a positive number of metres, not {cell!r}")
    data = read_file(path, MAX_BYTES)
    kind = _kind(path, data)
    if kind != "octomap":
        data = data.removeprefix(file_kinds.BOM)
    if kind in ("ros", "octomap", "wean") and cell is not None:
        raise ArgumentError(f"{path}: the file says how large its cells are; a cell of {cell:g} m cannot change that")
    # Each format's module is imported when it is needed.
    if kind == "movingai":
        from hexmap.io.grids import movingai

        return movingai.parse(path, data, 1.0 if cell is None else float(cell))
    if kind == "warframe":
        from hexmap.io.grids import warframe

        return warframe.parse(path, data, 1.0 if cell is None else float(cell))
    if kind == "octomap":
        from hexmap.io.grids import octomap

        return octomap.parse(path, data)
    if kind == "wean":
        from hexmap.io.grids import wean

        return wean.parse(path, data)
    from hexmap.io.grids import ros

    return ros.parse(path, data)


def is_grid(path: Path) -> bool:
    """Tell whether a file is a map that :func:`open_grid` reads, by how it begins and by the name of a ROS map's."""
    if _suffix(path) in (".yaml", ".yml"):
        return path.is_file()
    return file_kinds.find_kind(beginning(path), _KINDS) is not None


def _suffix(path: Path) -> str:
    """Return the last suffix, that of gzip left out."""
    suffixes = [suffix.lower() for suffix in path.suffixes if suffix.lower() != ".gz"]
    return suffixes[-1] if suffixes else ""


def _kind(path: Path, data: bytes) -> str:
    """Return what a file is, by how it begins, then by its suffix."""
    if file_kinds.find_kind(data, _PICTURES) is not None:
        raise FormatError(
            f"{path}: a picture alone does not say where its map lies; "
            f"name the .yaml of map_server ({path.with_suffix('.yaml').name})"
        )
    if file_kinds.FULL_OCTOMAP.begins(data):
        raise FormatError(f"{path}: this is a full OctoMap (.ot); write it as binary first (convert_octree)")
    if file_kinds.SCENARIO.begins(data):
        raise FormatError(f"{path}: this is a scenario, the queries of a map; name the map itself")
    found = file_kinds.find_kind(data, _KINDS)
    if found is not None:
        return _KINDS[found]
    names = {".map": "movingai", ".3dmap": "warframe", ".yaml": "ros", ".yml": "ros", ".bt": "octomap"}
    kind = names.get(_suffix(path), "")
    if not kind:
        raise FormatError(f"{path}: of no known kind (it begins with {quoted(data[:40])}); a map is {_KNOWN}")
    return kind
