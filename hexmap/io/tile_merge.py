"""Merging map files that together are larger than memory into a map of tiles.

The rows of a map are sorted, so nothing needs to be grouped: all maps are read side by side, a batch at a time, and
their least rows are the next ones of the result. The work goes in steps along the first index, as wide as a tile, and
level by level within a step; so of each map and level one batch is in memory, and of the result the tiles of one step.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from hexmap.base.errors import ArgumentError, BoundsError, LatticeError
from hexmap.io.file_kinds import is_map_folder
from hexmap.io.map_file import describe, lattice_of, levels_of, texts_of
from hexmap.io.map_folder import MapFolder
from hexmap.io.open_map import map_metadata
from hexmap.io.row_streams import MapRows, RowStream, merged_runs
from hexmap.io.tile_writer import TileWriter, check_folder, tile_cells, tile_folder
from hexmap.lattice.keys import layout
from hexmap.maps.builder import LevelRows
from hexmap.maps.map import Level, Map
from hexmap.maps.origin import common_logs, logs_in_words
from hexmap.maps.voxel_list import VoxelList

__all__ = ["SIDE_BY_SIDE", "merge_maps", "merge_parts", "merged_rows"]

# Maps read side by side; more are merged in groups of as many first. Each has a batch of every level in memory.
SIDE_BY_SIDE = 64
_BATCH, _LEAST_BATCH = 1 << 17, 1 << 13  # rows, of 24 bytes
_ALL_BATCHES = 1 << 23
# Rows of all files that are merged into one: the rows of one level wait at a time.
_MOST_WAITING = 1 << 20


@dataclass(frozen=True)
class _Input:
    """A map file, or a tile of a map, and the first step along the first index in which it may have a cell."""

    path: Path
    first: int


def merge_maps(
    paths: Sequence[str | os.PathLike[str]],
    output: str | os.PathLike[str],
    tiles: float,
    *,
    same_frame: bool = False,
    again: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> MapFolder:
    """Merge maps cell by cell into a folder of tiles; the result has the same cells and counts as :meth:`Map.merge`.

    Args:
        paths: map files or maps of tiles, on the same lattice and in the same frame; one is cut into tiles.
        output: the folder to make or to replace; it may be one of ``paths``.
        tiles: metres that a tile is wide, about.
        same_frame: take maps of different frames to be in that of the first.
        again: count a log again that is in several of the maps.
        progress: called as ``progress(rows, total)`` with the rows that have been read, and all.

    Returns:
        The map written, of which nothing but the manifest is in memory.

    Raises:
        ArgumentError: frames differ, a log would count twice, or ``tiles`` is no positive number.
        LatticeError: the lattices or the numbers of levels differ.
        BoundsError: a count would be more than 2^63 - 1.
        FileAccessError, FormatError: a map cannot be read, or the folder cannot be written.
    """
    sources, target = [Path(p) for p in paths], Path(output)
    if not sources:
        raise ArgumentError("merging takes a map or more")
    check_folder(target)
    merge_parts(sources, target, tiles, _merged_empty(sources, same_frame, again), progress)
    return MapFolder.open(target)


def merge_parts(
    sources: Sequence[Path],
    target: Path,
    tiles: float,
    merged: Map,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Merge maps that are known to go together into a folder of tiles: arguments and errors as of :func:`merge_maps`.

    ``merged`` is the map that they make, without its cells.
    """
    cells = tile_cells(merged.lattice, len(merged.levels), tiles)
    with contextlib.ExitStack() as stack:
        if len(sources) > SIDE_BY_SIDE:
            # Beside the output: the folder of the system may be a small one, in memory.
            beside = tempfile.TemporaryDirectory(
                prefix=".merge-", dir=target.absolute().parent, ignore_cleanup_errors=True
            )
            sources = _merge_groups(sources, Path(stack.enter_context(beside)), merged, cells)
        _merge_side_by_side(sources, target, merged, cells, progress)


def merged_rows(parts: Sequence[Path]) -> LevelRows:
    """Yield the rows of map files that are known to go together, the counts of equal cells added.

    Raises:
        BoundsError: a count would be more than 2^63 - 1.
        FileAccessError, FormatError: a file cannot be read.
    """
    with contextlib.ExitStack() as stack:
        maps = [stack.enter_context(contextlib.closing(MapRows(path))) for path in parts]
        batch = min(_BATCH, max(_LEAST_BATCH, _MOST_WAITING // len(maps)))
        ends = [rows.level_ends().tolist() for rows in maps]
        for level in range(maps[0].levels):
            streams = [RowStream(m, e[level], e[level + 1], batch) for m, e in zip(maps, ends, strict=True)]
            for run in merged_runs(streams, 2**63 - 1, maps[0].lattice.dim):
                yield level, run


def _merge_groups(paths: Sequence[Path], scratch: Path, merged: Map, cells: tuple[int, ...]) -> list[Path]:
    """Merge maps in groups until so few are left that they can be read side by side."""
    numbers, paths = itertools.count(), list(paths)
    while len(paths) > SIDE_BY_SIDE:
        groups = [paths[i : i + SIDE_BY_SIDE] for i in range(0, len(paths), SIDE_BY_SIDE)]
        paths = [_merge_side_by_side(group, scratch / str(next(numbers)), merged, cells, None) for group in groups]
    return paths


def _merged_empty(paths: Sequence[Path], same_frame: bool, again: bool) -> Map:
    """Return the merged map without its cells, having checked that the maps go together."""
    merged: Map | None = None
    for path in paths:
        header = map_metadata(path)
        lattice = lattice_of(path, header)
        nothing = [VoxelList.empty(lattice.scaled(2.0**k)) for k in range(levels_of(path, header))]
        other = Map([Level(cells, cells) for cells in nothing], header["frame"], texts_of(header))
        if merged is None:
            merged = other
            continue
        twice = common_logs(merged.sources(), other.sources())
        if twice and not again:
            raise ArgumentError(
                f"{path}: {logs_in_words(twice)} is in the other maps, too, and would count twice; --again does that"
            )
        try:
            merged = merged.merge(other, same_frame=same_frame)
        except (LatticeError, ArgumentError) as error:
            ways = "; --same-frame says that they are one" if "different frames" in str(error) else ""
            raise type(error)(f"{path}: cannot be merged with {paths[0]}: {error}{ways}") from error
    assert merged is not None
    return merged


def _merge_side_by_side(
    paths: Sequence[Path],
    output: Path,
    merged: Map,
    cells: tuple[int, ...],
    progress: Callable[[int, int], None] | None,
) -> Path:
    """Merge maps that are known to go together into a folder of tiles."""
    inputs, total = _inputs(paths, cells[0])
    batch = min(_BATCH, max(_LEAST_BATCH, _ALL_BATCHES // (len(paths) * len(merged.levels))))
    with tile_folder(output, describe(merged), merged.lattice, cells) as writer:
        open_maps: list[_Streams] = []
        done = 0
        try:
            while inputs or open_maps:
                step = min([m.step(cells[0]) for m in open_maps] + [i.first for i in inputs])
                open_maps += [_Streams(i.path, batch) for i in inputs if i.first <= step]
                inputs = [i for i in inputs if i.first > step]
                for level in range(len(merged.levels)):
                    _merge_level(open_maps, level, step, cells[0] >> level, merged, writer)
                    if progress is not None:
                        progress(done + sum(m.read() for m in open_maps), total)
                writer.end_step()
                done += sum(m.read() for m in open_maps if m.ended())
                for m in open_maps:
                    if m.ended():
                        m.close()
                open_maps = [m for m in open_maps if not m.ended()]
        finally:
            for m in open_maps:
                m.close()
    return output


def _merge_level(
    maps: list[_Streams], level: int, step: int, width: int, merged: Map, writer: TileWriter
) -> None:
    """Merge what the maps have of a level in a step that is ``width`` cells of the level wide."""
    bits, offset = layout(merged.lattice.dim)
    stop = ((step + 1) * width + int(offset[0])) << bits * (merged.lattice.dim - 1)
    try:
        for run in merged_runs([m.streams[level] for m in maps], stop, merged.lattice.dim):
            writer.add(step, level, run)
    except BoundsError as error:
        raise BoundsError(f"level {level} of {', '.join(str(m.path) for m in maps)}: {error}") from error


class _Streams:
    """The rows of all levels of an open map file."""

    def __init__(self, path: Path, batch: int) -> None:
        self.path = path
        self._rows = MapRows(path)
        try:
            ends = self._rows.level_ends().tolist()
            self.streams = [RowStream(self._rows, a, b, batch) for a, b in itertools.pairwise(ends)]
        except BaseException:
            self.close()
            raise

    def step(self, width: int) -> int:
        """Return the first step, ``width`` cells of level 0 wide, in which there is a row left."""
        bits, offset = layout(self._rows.lattice.dim)
        shift = bits * (self._rows.lattice.dim - 1)
        heads = [(stream.head(), width >> level) for level, stream in enumerate(self.streams)]
        return min(((head >> shift) - int(offset[0])) // w for head, w in heads if head is not None)

    def ended(self) -> bool:
        """Tell whether no row is left."""
        return all(stream.head() is None for stream in self.streams)

    def read(self) -> int:
        """Return how many rows have been read."""
        return sum(stream.read for stream in self.streams)

    def close(self) -> None:
        self._rows.close()


def _inputs(paths: Sequence[Path], width: int) -> tuple[list[_Input], int]:
    """Return all files to read, and how many rows they have; of a map of tiles a file a tile."""
    inputs: list[_Input] = []
    total = 0
    for path in paths:
        if is_map_folder(path):
            folder = MapFolder.open(path)
            inputs += [_Input(path / t.file, t.index[0] * folder.cells[0] // width) for t in folder.tiles]
            total += folder.rows
            continue
        rows = MapRows(path)
        try:
            total += rows.rows
            first = rows.first_step(width)
        finally:
            rows.close()
        if first is not None:
            inputs.append(_Input(path, first))
    return inputs, total
