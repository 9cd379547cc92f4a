"""Writing a map as a folder of tiles, rows as they come; the folder is the old map or the whole new one."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hexmap.base.atomic_files import atomic_write
from hexmap.base.errors import ArgumentError, FileAccessError
from hexmap.base.text import reason
from hexmap.io.file_kinds import MANIFEST
from hexmap.io.map_file import MapWriter, encode
from hexmap.io.map_folder import Tile, write_manifest
from hexmap.io.row_streams import Run
from hexmap.lattice.keys import layout, unpack
from hexmap.lattice.lattice import Lattice

__all__ = ["TileWriter", "check_folder", "check_tiles", "locked", "part_folder", "tile_cells", "tile_folder"]

# Rows of a row group. All tiles that one step along the first index meets are open at once, each with up to a group in
# memory: three megabytes.
_GROUP = 1 << 17
_NAME = re.compile(r"tile(_-?\d+){2,3}\.[0-9a-f]{16}\.parquet")
_SCRATCH = ".new-"
# Bytes of the provenance that a tile repeats. That of a thousand logs would be larger than a tile; the manifest has it.
_MOST_PROVENANCE = 1 << 16


def tile_cells(lattice: Lattice, levels: int, metres: float) -> tuple[int, ...]:
    """Return how many cells of the finest level a tile of about ``metres`` is wide along each index.

    They are multiples of the widest level's cell, so that a tile has whole cells of every level.

    Raises:
        ArgumentError: not a positive number of metres.
    """
    check_tiles(metres)
    step = 2 ** (levels - 1)
    wide = metres / (step * np.linalg.norm(lattice.basis, axis=0))
    most = 2 * lattice.limit // step + 1  # the whole range of indices
    return tuple(step * int(min(max(1.0, np.rint(w)), most)) for w in wide)


def check_tiles(metres: float) -> None:
    """Check how wide tiles are to be.

    Raises:
        ArgumentError: not a positive number of metres.
    """
    if not 0.0 < metres < float("inf"):
        raise ArgumentError(f"tiles are a positive number of metres wide, not {metres:g}")


def check_folder(path: Path) -> None:
    """Refuse a folder that holds anything but a map of tiles.

    Raises:
        FileAccessError: it does, is a file, or lies in no folder.
    """
    if path.exists() and not path.is_dir():
        raise FileAccessError(f"{path}: cannot be written: a map of tiles is a folder, and this is a file")
    if not path.exists() and not path.absolute().parent.is_dir():
        raise FileAccessError(f"{path}: cannot be written: there is no folder {path.absolute().parent}")
    for entry in sorted(os.listdir(path)) if path.exists() else []:
        if entry != MANIFEST and not _NAME.fullmatch(entry) and not entry.startswith((_SCRATCH, "._manifest.")):
            raise FileAccessError(f"{path}: cannot be written: the folder holds something else, {entry}")


@contextlib.contextmanager
def tile_folder(
    path: Path, header: dict[str, Any], lattice: Lattice, cells: tuple[int, ...]
) -> Iterator[TileWriter]:
    """Give what writes the tiles of a map, which become the folder ``path`` when the block ends well.

    Until then they lie in a hidden folder in it. Tiles are called by their content, so those of an older map stay
    beside them until the manifest, which is written last, names the new ones; what it does not name is removed then.

    Args:
        path: the folder to make or to replace.
        header: what :func:`~hexmap.io.map_file.describe` returns.
        lattice: of the finest level.
        cells: (n,) how many cells a tile is wide, see :func:`tile_cells`.

    Raises:
        FileAccessError: what :func:`check_folder` refuses, a full disk, or another run writes there.
    """
    check_folder(path)
    made = not path.exists()
    try:
        path.mkdir(exist_ok=True)
        with locked(path):
            scratch = path / f"{_SCRATCH}{os.getpid()}-{os.urandom(4).hex()}"
            scratch.mkdir()
            try:
                writer = TileWriter(scratch, header, lattice, cells)
                yield writer
                _commit(path, scratch, writer)
            finally:
                writer.abandon()
                shutil.rmtree(scratch, ignore_errors=True)
    except OSError as error:
        if isinstance(error, FileAccessError):
            raise
        raise FileAccessError(f"{path}: cannot be written: {reason(error)}") from error
    finally:
        if made:
            with contextlib.suppress(OSError):
                path.rmdir()  # where nothing has come of it


@contextlib.contextmanager
def part_folder(scratch: Path) -> Iterator[Path]:
    """Give a folder in ``scratch`` that no other process writes to, not even one that makes the same tiles."""
    own = scratch / f"part-{os.getpid()}-{os.urandom(4).hex()}"
    own.mkdir()
    try:
        yield own
    finally:
        shutil.rmtree(own, ignore_errors=True)


def _commit(path: Path, scratch: Path, writer: TileWriter) -> None:
    """Sync the tiles and move them into place, write the manifest, remove what it does not name."""
    for tile in writer.tiles:
        # Here, when the system has written most of them by itself.
        with open(scratch / tile.file, "rb") as handle:
            os.fsync(handle.fileno())
        os.replace(scratch / tile.file, path / tile.file)
    with atomic_write(path / MANIFEST) as manifest:  # which syncs the folder as well
        write_manifest(manifest, writer.header, writer.cells, writer.tiles)
    named = {tile.file for tile in writer.tiles}
    for entry in os.listdir(path):
        if entry.startswith(_SCRATCH) and entry != scratch.name:
            shutil.rmtree(path / entry, ignore_errors=True)
        elif entry.startswith("._manifest.") or (_NAME.fullmatch(entry) and entry not in named):
            (path / entry).unlink(missing_ok=True)


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Keep a second run off the folder; the lock goes with the process, however it ends.

    Raises:
        FileAccessError: another run has it.
    """
    try:
        import fcntl
    except ImportError:  # another system than POSIX
        yield
        return
    fd = os.open(path, os.O_RDONLY)
    try:
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise FileAccessError(f"{path}: another run is writing this map") from error
        except OSError:
            pass  # file systems without locks
        yield
    finally:
        os.close(fd)


class TileWriter:
    """Writes the rows of a map into tiles, step by step along the first index.

    Attributes:
        folder: where they are written.
        header: the metadata of the map.
        cells: (n,) how many cells a tile is wide.
        dim: of the lattice.
        tiles: those that are finished.
    """

    def __init__(self, folder: Path, header: dict[str, Any], lattice: Lattice, cells: tuple[int, ...]) -> None:
        """Write into ``folder``, which exists."""
        self.folder, self.header, self.cells, self.dim = folder, header, cells, lattice.dim
        self.tiles: list[Tile] = []
        large = len(encode({"provenance": header["provenance"]})) > _MOST_PROVENANCE
        self._tile_header = {**header, "provenance": []} if large else header
        self._lattices = [lattice.scaled(2.0**k) for k in range(header["levels"])]
        self._open: dict[tuple[int, ...], _OpenTile] = {}

    def add(self, step: int, level: int, run: Run) -> None:
        """Add rows of a level, whose first index is in the step; levels and keys must ascend within it."""
        from hexmap.io import _merge_kernels as kernels

        keys = run[0]
        bits, offset = layout(self.dim)
        cells = np.array(self.cells, np.int64) >> level
        tiles = np.empty((len(keys), 2), np.int64)
        low, high = kernels.tiles_of(keys, self.dim, bits, offset, cells, tiles)
        if (low == high).all():
            self._tile(step, low).add(level, run)
            return
        size = (high - low + 1).tolist()
        if size[0] * size[1] <= max(len(keys), _GROUP):
            number = (tiles[:, 0] - low[0]) * size[1] + tiles[:, 1] - low[1]
            places = np.indices(size).reshape(2, -1).T + low
        else:  # cells that lie far apart
            places, number = np.unique(tiles, axis=0, return_inverse=True)
            number = number.reshape(-1)
        ends = np.zeros(len(places) + 1, np.int64)
        keys, hits, passes = (np.empty(len(keys), np.int64) for _ in range(3))
        kernels.sort_by_tile(number, ends, run, (keys, hits, passes))
        for t in np.flatnonzero(np.diff(ends)).tolist():
            rows = slice(ends[t], ends[t + 1])
            # Copies: a view would keep all of the rows in memory.
            self._tile(step, places[t]).add(level, (keys[rows].copy(), hits[rows].copy(), passes[rows].copy()))

    def end_step(self) -> None:
        """Finish all tiles that have begun."""
        for tile in self._open.values():
            self.tiles.append(tile.finish())
        self._open.clear()

    def abandon(self) -> None:
        """Close what is open."""
        for tile in self._open.values():
            tile.close()

    def _tile(self, step: int, place: Any) -> _OpenTile:
        index = (step, *(int(p) for p in place[: self.dim - 1]))
        if index not in self._open:
            self._open[index] = _OpenTile(self.folder, index, self._tile_header, self._lattices)
        return self._open[index]


class _OpenTile:
    """A tile that is being written."""

    def __init__(self, folder: Path, index: tuple[int, ...], header: dict[str, Any], lattices: list[Lattice]) -> None:
        self._folder, self._index, self._header, self._lattices = folder, index, header, lattices
        self._dim = lattices[0].dim
        self._name = "tile_" + "_".join(map(str, index))
        self._waiting: list[tuple[int, Run]] = []
        self._count = 0
        self._handle: Any = None
        self._writer: MapWriter | None = None
        zero = dict.fromkeys(("rows", "hit_cells", "hits", "passed_cells"), 0)
        self._levels: list[dict[str, Any]] = [dict(zero) for _ in range(header["levels"])]

    def add(self, level: int, run: Run) -> None:
        """Add rows behind those that are there."""
        self._note(level, run)
        self._waiting.append((level, run))
        self._count += len(run[0])
        while self._count >= _GROUP:
            self._write(_GROUP)

    def _note(self, level: int, run: Run) -> None:
        """Count the rows, and widen the box of their centres."""
        keys, hits, passes = run
        note = self._levels[level]
        note["rows"] += len(keys)
        note["hit_cells"] += int(np.count_nonzero(hits))
        note["passed_cells"] += int(np.count_nonzero(passes))
        # In Python's integers, which do not wrap where the counts are huge.
        wide = hits.size and int(hits.max()) > 2**62 // hits.size
        note["hits"] += sum(hits.tolist()) if wide else int(hits.sum())
        centres = self._lattices[level].centres(unpack(keys, self._dim))
        # A column at a time: along the rows numpy would take ten times as long.
        low, high = (np.array([end(column) for column in centres.T]) for end in (np.min, np.max))
        note["low"] = np.minimum(low, note.get("low", low)).tolist()
        note["high"] = np.maximum(high, note.get("high", high)).tolist()

    def _write(self, rows: int) -> None:
        """Write a row group of so many of the rows that wait."""
        if self._writer is None:
            self._handle = open(self._folder / self._name, "wb")  # noqa: SIM115
            self._writer = MapWriter(self._handle, self._header, self._dim)
        group: list[list[Any]] = []
        left = rows
        while left:
            level, run = self._waiting.pop(0)
            cut = min(left, len(run[0]))
            if cut < len(run[0]):
                self._waiting.insert(0, (level, (run[0][cut:], run[1][cut:], run[2][cut:])))
            keys, hits, passes = (column[:cut] for column in run)
            group.append([np.full(cut, level, np.int32), *unpack(keys, self._dim).T, hits, passes])
            left -= cut
        self._count -= rows
        self._writer.write_columns([np.concatenate(column) for column in zip(*group, strict=True)])

    def finish(self) -> Tile:
        """Write what waits, and call the file by its content."""
        if self._count or self._writer is None:
            self._write(self._count)
        self.close()
        digest = hashlib.blake2b(digest_size=8)
        with open(self._folder / self._name, "rb") as handle:
            while piece := handle.read(1 << 20):
                digest.update(piece)
            size = handle.tell()
        name = f"{self._name}.{digest.hexdigest()}.parquet"
        os.replace(self._folder / self._name, self._folder / name)
        return Tile(name, self._index, size, tuple(self._levels))

    def close(self) -> None:
        """Close the file."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None
        if self._handle is not None:
            self._handle.close()
            self._handle = None
