"""Maps of ours by their path, whether they are files or folders of tiles."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from hexmap.io.file_kinds import is_map_folder
from hexmap.io.map_file import load_map, read_metadata
from hexmap.io.map_folder import MapFolder
from hexmap.maps.map import Map

__all__ = ["map_metadata", "open_map"]


def open_map(path: str | os.PathLike[str], low: ArrayLike | None = None, high: ArrayLike | None = None) -> Map:
    """Read a map, a file or a folder of tiles, or the part of it in a box; of a folder only the tiles that it meets.

    Args:
        path: the Parquet file or the folder.
        low: corner (n,) of the box, metres; cells whose centre lies in the box are read, or all without one.
        high: the other corner.

    Raises:
        ArgumentError: the corners are not those of a box of the map's dimension.
        TooLargeError: of a folder, too many rows to read at once.
        FileAccessError, FormatError: as :func:`~hexmap.io.map_file.load_map`.
    """
    path = Path(path)
    if is_map_folder(path) or path.is_dir():
        return MapFolder.open(path).load(low, high)
    whole = load_map(path)
    return whole if low is None or high is None else whole.crop(low, high)


def map_metadata(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return what a map, a file or a folder of tiles, says about itself, without reading its rows.

    Raises:
        FileAccessError, FormatError: as :func:`~hexmap.io.map_file.read_metadata`.
    """
    path = Path(path)
    return MapFolder.open(path).header if is_map_folder(path) or path.is_dir() else read_metadata(path)
