"""Where the map of a builder goes as its rows come, so that a large one is never whole in memory.

A store begins with the builder and ends with it. That of a file takes the rows at the end. That of a folder of tiles
takes them whenever they are more than a budget, as sorted parts in a hidden folder beside its own; at the end the parts
are merged. Counts add, so the map is the same as if it had been saved in one piece.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

import numpy as np

from hexmap.base.atomic_files import atomic_write
from hexmap.base.errors import FileAccessError
from hexmap.base.text import reason
from hexmap.io.map_file import describe, write_rows
from hexmap.io.map_folder import MapFolder
from hexmap.io.open_map import open_map
from hexmap.io.tile_merge import merge_parts
from hexmap.io.tile_writer import check_folder, check_tiles, locked
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import LevelRows, MapBuilder
from hexmap.maps.map import Map

__all__ = ["FileStore", "FolderStore", "MapStore", "StoredMap"]

# Bytes of counts that a build holds before they are spilled. At 0.05 m on three levels that is some 16,000 m2 in view,
# a large building: a robot that goes to and fro in one spills it once, and all else that a run needs takes twice as
# much.
_BUDGET = 64 << 20


@dataclass(frozen=True)
class StoredMap:
    """A map that has been written, of which nothing is in memory.

    Attributes:
        path: the file, or the folder of tiles.
        lattice: of the finest level.
        levels: how many there are.
        hit_cells: cells that were hit, on the finest level.
        tiles: how many tiles the folder has; None of a file.
    """

    path: Path
    lattice: Lattice
    levels: int
    hit_cells: int
    tiles: int | None = None

    def load(self) -> Map:
        """Read it.

        Raises:
            FileAccessError, FormatError, TooLargeError: as :func:`~hexmap.io.open_map.open_map`.
        """
        return open_map(self.path)


class MapStore(Protocol):
    """What takes the map of a builder.

    Attributes:
        seconds: that it has spent on writing so far.
    """

    seconds: float

    def begin(self, builder: MapBuilder) -> None:
        """See a builder before its first scan: what it holds may be taken from it from now on."""

    def finish(self, builder: MapBuilder, source: Mapping[str, Any]) -> StoredMap:
        """Write the map, and leave the builder empty; ``source`` is where the scans came from.

        Raises:
            FileAccessError: it cannot be written.
        """


class FileStore:
    """Writes the map as one file, with the same bytes as :func:`~hexmap.io.map_file.save_map`."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Say which file is made or replaced."""
        self.path = Path(path)
        self.seconds = 0.0

    def begin(self, builder: MapBuilder) -> None:
        """Take nothing before the end: the rows of a file are sorted."""

    def finish(self, builder: MapBuilder, source: Mapping[str, Any]) -> StoredMap:
        """Write the map."""
        begin = time.monotonic()
        empty = builder.empty_map(source=source)
        hit_cells = 0

        def counted() -> LevelRows:
            nonlocal hit_cells
            for level, rows in builder.take_rows():
                hit_cells += int(np.count_nonzero(rows[1])) if level == 0 else 0
                yield level, rows

        with atomic_write(self.path) as handle:
            write_rows(handle, describe(empty), empty.lattice.dim, counted())
        self.seconds += time.monotonic() - begin
        return StoredMap(self.path, empty.lattice, len(empty.levels), hit_cells)


class FolderStore:
    """Writes the map as a folder of tiles, as :func:`~hexmap.io.tile_merge.merge_maps` makes it of the saved file.

    It is entered before the work and left after it: then what it has spilled is removed, however the work ended. What a
    run that was killed has left beside the folder is removed by the next one.

    Args:
        path: the folder to make or to replace.
        tiles: metres that a tile is wide, about.
        budget: bytes of counts that a builder holds before they are spilled.

    Raises:
        ArgumentError: ``tiles`` is no positive number.
        FileAccessError: the folder holds something else, or cannot be made.
    """

    def __init__(self, path: str | os.PathLike[str], tiles: float, budget: int = _BUDGET) -> None:
        """Check the folder; nothing is written yet."""
        check_tiles(tiles)
        self.path, self._tiles, self._budget = Path(path), tiles, budget
        check_folder(self.path)
        self.seconds = 0.0
        self.parts: list[Path] = []
        self._stack = contextlib.ExitStack()
        self._scratch: Path | None = None
        self._empty: Map | None = None

    def __enter__(self) -> FolderStore:
        """Remove what earlier runs have left."""
        for left in self._hidden().parent.glob(f"{self._hidden().name}*"):
            # Another run that is still at work holds the lock of its own.
            with contextlib.suppress(FileAccessError, OSError), locked(left):
                shutil.rmtree(left, ignore_errors=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Remove what was spilled."""
        self._stack.close()
        self.parts, self._scratch = [], None

    def begin(self, builder: MapBuilder) -> None:
        """Take the rows of the builder whenever they are more than the budget."""
        self._empty = builder.empty_map()
        builder.spill(self._spill, self._budget)

    def finish(self, builder: MapBuilder, source: Mapping[str, Any]) -> StoredMap:
        """Write the tiles; the manifest comes last."""
        empty = self._empty = builder.empty_map(source=source)
        self._spill(builder.take_rows())
        begin = time.monotonic()
        merge_parts(self.parts, self.path, self._tiles, empty)
        folder = MapFolder.open(self.path)
        self.seconds += time.monotonic() - begin
        hit_cells = folder.totals()[0]["hit_cells"]
        return StoredMap(self.path, empty.lattice, len(empty.levels), hit_cells, len(folder.tiles))

    def _hidden(self) -> Path:
        """Return what the names of hidden folders begin with."""
        target = self.path.absolute()
        return target.with_name(f".{target.name[:100]}.parts-")

    def _spill(self, rows: LevelRows) -> None:
        """Write rows as the next part."""
        assert self._empty is not None
        begin = time.monotonic()
        try:
            if self._scratch is None:
                hidden = self._hidden()
                self._scratch = hidden.with_name(f"{hidden.name}{os.getpid()}-{os.urandom(4).hex()}")
                self._scratch.mkdir()
                self._stack.callback(shutil.rmtree, self._scratch, ignore_errors=True)
                self._stack.enter_context(locked(self._scratch))
            part = self._scratch / f"{len(self.parts)}.parquet"
            with open(part, "wb") as handle:
                write_rows(handle, describe(self._empty), self._empty.lattice.dim, rows)
        except OSError as error:
            if isinstance(error, FileAccessError):
                raise
            raise FileAccessError(f"{self.path}: cannot be written: {reason(error)}") from error
        self.parts.append(part)
        self.seconds += time.monotonic() - begin
