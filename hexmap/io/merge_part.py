"""Merging a part of the tiles of maps: all maps side by side, a batch at a time, the least rows of all next.

The work goes in steps along the first index, as wide as a tile, and level by level within a step; so of each map and
level one batch is in memory, and of the result the tiles of one step. A part is a range of steps. Its tiles depend on
the maps alone, not on where the part begins or ends.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hexmap.base.errors import BoundsError
from hexmap.io.map_file import lattice_of
from hexmap.io.map_folder import Tile
from hexmap.io.row_streams import MapRows, RowStream, merged_runs
from hexmap.io.tile_writer import TileWriter, part_folder
from hexmap.lattice.keys import layout

__all__ = ["Input", "Part", "merge_part", "merge_part_apart", "rows_merged"]

_BYTES = 8  # of the number that a part notes of its progress


@dataclass(frozen=True)
class Input:
    """A map file, or a tile of a map, and the first and last step along the first index in which it may have a cell."""

    path: Path
    first: int
    last: int


@dataclass(frozen=True)
class Part:
    """A part of a merge.

    Attributes:
        inputs: the files that may have cells in it.
        header: the metadata of the merged map.
        cells: (n,) how many cells of the finest level a tile is wide.
        first, stop: the steps from the first to the one before ``stop``.
        batch: rows of a level of an input that are in memory.
    """

    inputs: tuple[Input, ...]
    header: dict[str, Any]
    cells: tuple[int, ...]
    first: int
    stop: int
    batch: int


def merge_part(part: Part, writer: TileWriter, report: Callable[[int], None]) -> None:
    """Merge a part into the tiles that ``writer`` writes.

    Args:
        part: what to merge.
        writer: of the merged map.
        report: called with the rows that have been merged.

    Raises:
        BoundsError: a count would be more than 2^63 - 1.
        FileAccessError, FormatError: a map cannot be read.
    """
    width, levels = part.cells[0], int(part.header["levels"])
    inputs, open_maps = list(part.inputs), list[_Streams]()
    done = 0
    try:
        while inputs or open_maps:
            step = min([m.step(width) for m in open_maps] + [max(part.first, i.first) for i in inputs])
            if step >= part.stop:
                break
            open_maps += [_Streams(i.path, part, writer.dim) for i in inputs if i.first <= step]
            inputs = [i for i in inputs if i.first > step]
            for level in range(levels):
                _merge_level(open_maps, level, step, width >> level, writer)
                report(done + sum(m.taken() for m in open_maps))
            writer.end_step()
            done += sum(m.taken() for m in open_maps if m.ended())
            for m in open_maps:
                if m.ended():
                    m.close()
            open_maps = [m for m in open_maps if not m.ended()]
    finally:
        for m in open_maps:
            m.close()


def merge_part_apart(part: Part, scratch: str, number: int) -> list[Tile]:
    """Merge a part in a process of its own, which may be killed and the part begun again.

    Args:
        part: what to merge.
        scratch: the folder for the tiles, and the file that :func:`rows_merged` reads.
        number: of the part.

    Returns:
        The tiles.
    """
    folder = Path(scratch)
    progress = os.open(_progress_file(folder), os.O_RDWR | os.O_CREAT, 0o666)
    try:
        with part_folder(folder) as own:
            writer = TileWriter(own, part.header, lattice_of(own, part.header), part.cells)
            try:
                merge_part(part, writer, lambda rows: _note(progress, number, rows))
            finally:
                writer.abandon()
            for tile in writer.tiles:
                os.replace(own / tile.file, folder / tile.file)
        return writer.tiles
    finally:
        os.close(progress)


def _note(progress: int, number: int, rows: int) -> None:
    os.lseek(progress, _BYTES * number, os.SEEK_SET)
    os.write(progress, rows.to_bytes(_BYTES, "little"))


def rows_merged(scratch: Path) -> int:
    """Return how many rows all parts have merged so far."""
    try:
        content = _progress_file(scratch).read_bytes()
    except FileNotFoundError:
        return 0
    return sum(int.from_bytes(content[k : k + _BYTES], "little") for k in range(0, len(content), _BYTES))


def _progress_file(scratch: Path) -> Path:
    return scratch / "rows"


def _merge_level(maps: list[_Streams], level: int, step: int, width: int, writer: TileWriter) -> None:
    """Merge what the maps have of a level in a step that is ``width`` cells of the level wide."""
    stop = _first_key(step + 1, width, writer.dim)
    try:
        for run in merged_runs([m.streams[level] for m in maps], stop, writer.dim):
            writer.add(step, level, run)
    except BoundsError as error:
        raise BoundsError(f"level {level} of {', '.join(str(m.path) for m in maps)}: {error}") from error


def _first_key(step: int, width: int, dim: int) -> int:
    """Return the key below which all keys before a step are, which is ``width`` cells wide."""
    bits, offset = layout(dim)
    return (step * width + int(offset[0])) << bits * (dim - 1)


class _Streams:
    """The rows of all levels of an open map file from the first step of a part on."""

    def __init__(self, path: Path, part: Part, dim: int) -> None:
        self.path = path
        self._dim = dim
        self._rows = MapRows(path)
        try:
            self.streams = []
            for level, (begin, end) in enumerate(itertools.pairwise(self._rows.level_ends().tolist())):
                width = part.cells[0] >> level
                first = self._rows.first_row(begin, end, part.first * width)
                low = _first_key(part.first, width, dim)
                self.streams.append(RowStream(self._rows, first, end, part.batch, low))
        except BaseException:
            self.close()
            raise

    def step(self, width: int) -> int:
        """Return the first step, ``width`` cells of level 0 wide, in which there is a row left."""
        bits, offset = layout(self._dim)
        shift = bits * (self._dim - 1)
        heads = [(stream.head(), width >> level) for level, stream in enumerate(self.streams)]
        return min(((head >> shift) - int(offset[0])) // w for head, w in heads if head is not None)

    def ended(self) -> bool:
        """Tell whether no row is left."""
        return all(stream.head() is None for stream in self.streams)

    def taken(self) -> int:
        """Return how many rows have been merged."""
        return sum(stream.taken for stream in self.streams)

    def close(self) -> None:
        self._rows.close()
