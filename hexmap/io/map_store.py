"""Where the map of a builder goes as its rows come, so that a large one is never whole in memory.

A store begins with the builder and ends with it. It takes the rows whenever they are more than a budget, as sorted
parts in a hidden folder beside its own file or folder; at the end the parts are merged. Counts add, so the map is the
same as if it had been saved in one piece.
"""

from __future__ import annotations

import contextlib
import glob
import os
import shutil
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from hexmap.base.atomic_files import atomic_write
from hexmap.base.errors import FileAccessError
from hexmap.base.text import reason
from hexmap.io.map_file import describe, write_rows
from hexmap.io.map_folder import MapFolder
from hexmap.io.open_map import open_map
from hexmap.io.tile_merge import SIDE_BY_SIDE, merge_parts, merged_rows
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


class MapStore(ABC):
    """Takes the rows of a builder whenever they are more than a budget, as sorted parts in a hidden folder.

    It is entered before the work and left after it: then what it has spilled is removed, however the work ended. What a
    run that was killed has left is removed by the next one.

    Attributes:
        path: of the map.
        parts: what has been spilled.
        seconds: spent on writing so far.
    """

    def __init__(self, path: str | os.PathLike[str], budget: int) -> None:
        """Write nothing yet."""
        self.path, self._budget = Path(path), budget
        self.seconds = 0.0
        self.parts: list[Path] = []
        self._stack = contextlib.ExitStack()
        self._scratch: Path | None = None

    def __repr__(self) -> str:
        """Show where the map goes."""
        return f"<{type(self).__name__} of {self.path}>"

    def __enter__(self) -> Self:
        """Remove what earlier runs have left."""
        for left in self._hidden().parent.glob(f"{glob.escape(self._hidden().name)}*"):
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
        builder.spill(lambda rows: self._spill(rows, builder.empty_map()), self._budget)

    @abstractmethod
    def finish(self, builder: MapBuilder, source: Mapping[str, Any]) -> StoredMap:
        """Write the map, and leave the builder empty.

        Args:
            builder: of all scans.
            source: where they came from.

        Raises:
            FileAccessError: it cannot be written.
            BoundsError: a count would be more than 2^63 - 1.
        """

    def _hidden(self) -> Path:
        """Return what the names of hidden folders begin with."""
        target = self.path.absolute()
        return target.with_name(f".{target.name[:100]}.parts-")

    def _spill(self, rows: LevelRows, empty: Map, name: str | None = None) -> None:
        """Write rows as the next part; ``empty`` is their map without its cells."""
        begin = time.monotonic()
        try:
            if self._scratch is None:
                hidden = self._hidden()
                self._scratch = hidden.with_name(f"{hidden.name}{os.getpid()}-{os.urandom(4).hex()}")
                self._scratch.mkdir()
                self._stack.callback(shutil.rmtree, self._scratch, ignore_errors=True)
                self._stack.enter_context(locked(self._scratch))
            part = self._scratch / (name or f"{len(self.parts)}.parquet")
            with open(part, "wb") as handle:
                write_rows(handle, describe(empty), empty.lattice.dim, rows)
        except OSError as error:
            if isinstance(error, FileAccessError):
                raise
            raise FileAccessError(f"{self.path}: cannot be written: {reason(error)}") from error
        self.parts.append(part)
        self.seconds += time.monotonic() - begin


class FileStore(MapStore):
    """Writes the map as one file, with the same bytes as :func:`~hexmap.io.map_file.save_map`.

    Args:
        path: the file to make or to replace.
        budget: bytes of counts that a builder holds before they are spilled.
    """

    def __init__(self, path: str | os.PathLike[str], budget: int = _BUDGET) -> None:
        """Write nothing yet."""
        super().__init__(path, budget)

    def begin(self, builder: MapBuilder) -> None:
        """Take the rows of the builder whenever they are more than the budget; not beside a device."""
        if self.path.is_file() or not self.path.exists():
            super().begin(builder)

    def finish(self, builder: MapBuilder, source: Mapping[str, Any]) -> StoredMap:
        """Write the map."""
        empty = builder.empty_map(source=source)
        if self.parts:
            self._spill(builder.take_rows(), empty)
        while len(self.parts) > SIDE_BY_SIDE:
            groups = [self.parts[i : i + SIDE_BY_SIDE] for i in range(0, len(self.parts), SIDE_BY_SIDE)]
            self.parts = []
            for group in groups:
                self._spill(merged_rows(group), empty, f"of_{group[0].name}")
                for part in group:
                    part.unlink()
        begin = time.monotonic()
        rows = merged_rows(self.parts) if self.parts else builder.take_rows()
        hit_cells = 0

        def counted() -> LevelRows:
            nonlocal hit_cells
            for level, some in rows:
                hit_cells += int(np.count_nonzero(some[1])) if level == 0 else 0
                yield level, some

        with atomic_write(self.path) as handle:
            write_rows(handle, describe(empty), empty.lattice.dim, counted())
        self.seconds += time.monotonic() - begin
        return StoredMap(self.path, empty.lattice, len(empty.levels), hit_cells)


class FolderStore(MapStore):
    """Writes the map as a folder of tiles, as :func:`~hexmap.io.tile_merge.merge_maps` makes it of the saved file.

    Args:
        path: the folder to make or to replace.
        tiles: metres that a tile is wide, about.
        budget: bytes of counts that a builder holds before they are spilled.

    Raises:
        ArgumentError: ``tiles`` is no positive number.
        FileAccessError: the folder holds something else, or cannot be made.

    Examples:
        >>> import tempfile
        >>> from hexmap import MapBuilder, Pose, Scan
        >>> from hexmap.io import FolderStore
        >>> with tempfile.TemporaryDirectory() as here, FolderStore(f"{here}/map", tiles=2.0) as store:
        ...     builder = MapBuilder("A2", resolution=0.1)
        ...     store.begin(builder)
        ...     for x in range(10):
        ...         builder.fuse(Scan(stamp=0.0, points=[[2.0, 0.0]]), Pose.planar(x, 0.0, 0.0))
        ...     made = store.finish(builder, source={"log": "made up"})
        ...     made.tiles, made.hit_cells, len(made.load().levels[0].hits)
        (10, 10, 10)
    """

    def __init__(self, path: str | os.PathLike[str], tiles: float, budget: int = _BUDGET) -> None:
        """Check the folder; nothing is written yet."""
        super().__init__(path, budget)
        check_tiles(tiles)
        check_folder(self.path)
        self._tiles = tiles

    def finish(self, builder: MapBuilder, source: Mapping[str, Any]) -> StoredMap:
        """Write the tiles; the manifest comes last."""
        empty = builder.empty_map(source=source)
        self._spill(builder.take_rows(), empty)
        begin = time.monotonic()
        merge_parts(self.parts, self.path, self._tiles, empty)
        folder = MapFolder.open(self.path)
        self.seconds += time.monotonic() - begin
        hit_cells = folder.totals()[0]["hit_cells"]
        return StoredMap(self.path, empty.lattice, len(empty.levels), hit_cells, len(folder.tiles))
