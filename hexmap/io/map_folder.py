"""Maps that are folders: a Parquet file for each coarse tile, and a manifest that says what the tiles are.

A tile is a box of lattice indices, as many cells wide along each index as make about the metres asked for; on a lattice
whose basis leans, so do its tiles. A cell of level k belongs to the tile of the cell of level 0 with 2^k times its
index. Each tile is a map file (:mod:`hexmap.io.map_file`) that any Parquet reader can use; no row is in two of them, so
that all of them together are a table of the whole map.

The manifest, ``_manifest.json`` (a name that readers of data sets pass over), is written last, and a folder without
one is no map. It names every tile with the number of its rows and the box of its centres on each level, so that only
the tiles of a window need to be read.
"""

from __future__ import annotations

import json
import math
import os
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import FileAccessError, FormatError, TooLargeError
from hexmap.base.text import quoted, reason
from hexmap.base.values import read_only
from hexmap.io.file_kinds import MANIFEST, MANIFEST_MARK
from hexmap.io.map_file import encode, header_of, lattice_of, levels_of, load_map, texts_of
from hexmap.lattice.lattice import Lattice
from hexmap.maps.map import Level, Map
from hexmap.maps.voxel_list import VoxelList

__all__ = ["FOLDER_FORMAT", "MOST_ROWS", "MapFolder", "Tile", "write_manifest"]

FOLDER_FORMAT = 1
# Rows read at once: reading takes up to a hundred bytes a row, so this many take ten gigabytes.
MOST_ROWS = 100_000_000
_NUMBERS = ("rows", "hit_cells", "hits", "passed_cells")


@dataclass(frozen=True)
class Tile:
    """One tile of a map.

    Attributes:
        file: its name in the folder.
        index: (n,) its place among the tiles.
        size: of the file, bytes.
        levels: what it holds of each level: ``rows``, ``hit_cells``, ``hits``, ``passed_cells``, and where it holds
            anything the corners of the box of the cells' centres, ``low`` and ``high``, metres.
    """

    file: str
    index: tuple[int, ...]
    size: int
    levels: tuple[dict[str, Any], ...]

    @property
    def rows(self) -> int:
        """How many rows it has."""
        return sum(int(level["rows"]) for level in self.levels)

    def meets(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> bool:
        """Tell whether any of its levels may have a centre in the box from ``low`` to ``high`` (n,), metres."""
        return any(
            all(a <= h and b >= lo for a, b, lo, h in zip(level["low"], level["high"], low, high, strict=True))
            for level in self.levels
            if level["rows"]
        )


@dataclass(frozen=True, eq=False)
class MapFolder:
    """A map of tiles, of which nothing but the manifest has been read.

    Attributes:
        path: the folder.
        header: the metadata of the map, as those of a map file.
        lattice: of the finest level.
        cells: (n,) how many cells of the finest level a tile is wide along each index.
        tiles: sorted by index.
    """

    path: Path
    header: dict[str, Any]
    lattice: Lattice
    cells: tuple[int, ...]
    tiles: tuple[Tile, ...]

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> MapFolder:
        """Read the manifest of a folder.

        Raises:
            FileAccessError: it cannot be read.
            FormatError: the folder has none, or it is damaged or of a newer version.
        """
        path = Path(path)
        file = path / MANIFEST
        value = _read_manifest(path, file)
        header = dict(value["map"])
        header = header_of(file, {b"hexmap": json.dumps(header).encode()})
        lattice, levels = lattice_of(file, header), levels_of(file, header)
        try:
            cells = tuple(int(c) for c in value["tile_cells"])
            tiles = tuple(_tile(entry, lattice.dim, levels) for entry in value["tiles"])
        except (KeyError, TypeError, ValueError) as error:
            raise FormatError(f"{file}: damaged map: its list of tiles is not one: {reason(error)}") from error
        if len(cells) != lattice.dim or min(cells) < 1:
            raise FormatError(f"{file}: damaged map: its tiles are {quoted(value['tile_cells'])} cells wide")
        return cls(path, header, lattice, cells, tiles)

    @property
    def rows(self) -> int:
        """How many rows all tiles have."""
        return sum(tile.rows for tile in self.tiles)

    def sources(self) -> list[dict[str, Any]]:
        """Return where the map came from, as :meth:`hexmap.maps.map.Map.sources`."""
        return Map([self._nothing(0)], self.header["frame"], texts_of(self.header)).sources()

    def _nothing(self, level: int) -> Level:
        cells = VoxelList.empty(self.lattice.scaled(2.0**level))
        return Level(cells, cells)

    def totals(self) -> list[dict[str, int]]:
        """Return ``rows``, ``hit_cells``, ``hits`` and ``passed_cells`` of each level, from the manifest."""
        return [
            {name: sum(int(tile.levels[k][name]) for tile in self.tiles) for name in _NUMBERS}
            for k in range(int(self.header["levels"]))
        ]

    def bounds(self, level: int = 0) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Return the corners (n,), metres, of the box of all cell centres, from the manifest; None for no cell."""
        boxes = [tile.levels[level] for tile in self.tiles if tile.levels[level]["rows"]]
        if not boxes:
            return None
        return np.min([box["low"] for box in boxes], axis=0), np.max([box["high"] for box in boxes], axis=0)

    def within(self, low: ArrayLike | None = None, high: ArrayLike | None = None) -> list[Tile]:
        """Return the tiles that may have a centre in the box from ``low`` to ``high`` (n,), metres; all without one."""
        if low is None or high is None:
            return list(self.tiles)
        lo, hi = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
        return [tile for tile in self.tiles if tile.meets(lo, hi)]

    def maps(self, tiles: list[Tile]) -> Iterator[Map]:
        """Yield the map of each tile.

        Raises:
            FileAccessError, FormatError: as :func:`~hexmap.io.map_file.load_map`, and for a tile that is not the one
                that the manifest names.
        """
        for tile in tiles:
            file = self.path / tile.file
            try:
                size = os.stat(file).st_size
            except OSError as error:
                raise FileAccessError(f"{file}: a tile of the map cannot be read: {reason(error)}") from error
            if size != tile.size:
                raise FormatError(f"{file}: damaged map: a tile of {size} bytes, and its manifest says {tile.size}")
            part = load_map(file)
            if part.lattice != self.lattice or len(part.levels) != self.header["levels"]:
                raise FormatError(f"{file}: damaged map: a tile on another lattice than its manifest says")
            yield part

    def load(self, low: ArrayLike | None = None, high: ArrayLike | None = None) -> Map:
        """Return the cells whose centre lies in the box from ``low`` to ``high`` (n,), metres; all without one.

        Raises:
            TooLargeError: the tiles to read have more rows than memory holds.
            FileAccessError, FormatError: as :meth:`maps`.
        """
        tiles = self.within(low, high)
        rows = sum(tile.rows for tile in tiles)
        if rows > MOST_ROWS:
            raise TooLargeError(
                f"{self.path}: {rows:,} rows in {len(tiles):,} tiles are more than the {MOST_ROWS:,} that are read at "
                "once; --crop takes a part"
            )
        parts = [part if low is None or high is None else part.crop(low, high) for part in self.maps(tiles)]
        levels = [
            Level(
                _joined([part.levels[k].hits for part in parts], self.lattice.scaled(2.0**k)),
                _joined([part.levels[k].passes for part in parts], self.lattice.scaled(2.0**k)),
            )
            for k in range(int(self.header["levels"]))
        ]
        return Map(levels, self.header["frame"], texts_of(self.header))


def _joined(lists: list[VoxelList], lattice: Lattice) -> VoxelList:
    """Return one list of lists that have no cell in common."""
    if not lists:
        return VoxelList.empty(lattice)
    keys = np.concatenate([cells.keys for cells in lists])
    # Each is sorted: a stable sort only has to merge.
    order = np.argsort(keys, kind="stable")
    counts = np.concatenate([cells.counts for cells in lists])
    return VoxelList(lattice, read_only(keys[order]), read_only(counts[order]))


def write_manifest(handle: Any, header: dict[str, Any], cells: tuple[int, ...], tiles: list[Tile]) -> None:
    """Write a manifest; ``header`` is what :func:`~hexmap.io.map_file.describe` returns, the rest as MapFolder has it.

    The same map always gives the same bytes.
    """
    entries = [
        {"file": t.file, "index": list(t.index), "bytes": t.size, "levels": list(t.levels)}
        for t in sorted(tiles, key=lambda tile: tile.index)
    ]
    value = {"format": FOLDER_FORMAT, "map": header, "tile_cells": list(cells), "tiles": entries}
    # The mark comes first, so that the first bytes tell what the file is.
    text = json.dumps({"crc32": zlib.crc32(encode(value)), **value}, sort_keys=True, allow_nan=False)
    handle.write(MANIFEST_MARK + b", " + text.encode("ascii")[1:])


def _read_manifest(path: Path, file: Path) -> dict[str, Any]:
    """Return what a manifest says, with its checksum checked."""
    try:
        content = file.read_bytes()
    except FileNotFoundError as error:
        what = f"a folder, but not a map: it has no {MANIFEST}" if path.is_dir() else "there is no such folder"
        raise (FormatError if path.is_dir() else FileAccessError)(f"{path}: {what}") from error
    except OSError as error:
        raise FileAccessError(f"{file}: cannot be read: {reason(error)}") from error
    if not content.startswith(MANIFEST_MARK):
        raise FormatError(f"{file}: not the manifest of a map of hexmap")
    try:
        value = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{file}: damaged map: its manifest is not JSON: {reason(error)}") from error
    version = value.get("format")
    if not isinstance(version, int) or version < 1:
        raise FormatError(f"{file}: damaged map: its format version is {quoted(version)}")
    if version > FOLDER_FORMAT:
        raise FormatError(
            f"{file}: written by a newer hexmap: format version {version}, this one reads up to {FOLDER_FORMAT}"
        )
    stated = value.pop("crc32", None)
    body = {key: v for key, v in value.items() if key != "hexmap"}
    try:
        sound = stated is None or stated == zlib.crc32(encode(body))
    except ValueError:  # a number that is not finite
        sound = False
    if not sound or not isinstance(value.get("map"), dict):
        raise FormatError(f"{file}: damaged map: its manifest does not fit its checksum 'crc32'")
    return body


def _tile(entry: dict[str, Any], dim: int, levels: int) -> Tile:
    """Return a tile of the manifest, checked.

    Raises:
        KeyError, TypeError, ValueError: it is none.
    """
    name, found = entry["file"], tuple(entry["levels"])
    index = tuple(int(i) for i in entry["index"])
    if not isinstance(name, str) or "/" in name or "\\" in name or name.startswith("."):
        raise ValueError(f"a tile is called {quoted(name)}")
    if len(index) != dim or len(found) != levels:
        raise ValueError(f"tile {quoted(name)} has {len(index)} indices and {len(found)} levels")
    for level in found:
        if any(not isinstance(level[number], int) or level[number] < 0 for number in _NUMBERS):
            raise ValueError(f"tile {quoted(name)} has a number that is none")
        corners = [*level["low"], *level["high"]] if level["rows"] else []
        if level["rows"] and (len(corners) != 2 * dim or not all(math.isfinite(v) for v in corners)):
            raise ValueError(f"tile {quoted(name)} has a box that is none")
    return Tile(name, index, int(entry["bytes"]), found)
