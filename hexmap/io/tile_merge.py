"""Merging map files that together are larger than memory into a map of tiles.

The rows of a map are sorted, so nothing needs to be grouped: all maps are read side by side, a batch at a time, and
their least rows are the next ones of the result (:mod:`hexmap.io.merge_part`). The range of the first index is divided
among worker processes, each of which reads only the row groups that its part of the tiles needs.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, Executor, Future, wait
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np

from hexmap.base.errors import ArgumentError, HexmapError, LatticeError
from hexmap.base.local_workers import LocalWorkers, WorkerError
from hexmap.base.text import reason
from hexmap.io.file_kinds import is_map_folder
from hexmap.io.map_file import describe, lattice_of, levels_of, texts_of
from hexmap.io.map_folder import MapFolder, Tile
from hexmap.io.merge_part import Input, Part, merge_part, merge_part_apart, rows_merged
from hexmap.io.open_map import map_metadata
from hexmap.io.row_streams import MapRows, RowStream, merged_runs
from hexmap.io.tile_writer import check_folder, tile_cells, tile_folder
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
# Parts of a merge for each worker, so that one that is slow or killed holds up little; and how many times the rows that
# it reads in common with its neighbour a part has at least.
_PARTS_A_WORKER, _LEAST_PART = 4, 4
_CLUSTER = 8  # workers that an executor is taken to have
_REPORT_SECONDS = 0.1


Progress: TypeAlias = Callable[[int, int], None]


@dataclass(frozen=True)
class _Team:
    """Who merges: workers of our own, those of another executor, or where there are neither this process."""

    own: LocalWorkers | None = None
    other: Executor | None = None
    workers: int = 1


def merge_maps(
    paths: Sequence[str | os.PathLike[str]],
    output: str | os.PathLike[str],
    tiles: float,
    *,
    same_frame: bool = False,
    again: bool = False,
    workers: int = 1,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> MapFolder:
    """Merge maps cell by cell into a folder of tiles; the result has the same cells and counts as :meth:`Map.merge`.

    Args:
        paths: map files or maps of tiles, on the same lattice and in the same frame; one is cut into tiles.
        output: the folder to make or to replace; it may be one of ``paths``.
        tiles: metres that a tile is wide, about.
        same_frame: take maps of different frames to be in that of the first.
        again: count a log again that is in several of the maps.
        workers: processes of this machine, each of which merges a part of the tiles; one merges in this process. The
            files are the same for any number.
        executor: merges instead of ``workers``: any whose workers see the maps and ``output`` under the same paths.
        progress: called as ``progress(rows, total)`` with the rows that have been merged, and all.

    Returns:
        The map written, of which nothing but the manifest is in memory.

    Raises:
        ArgumentError: frames differ, a log would count twice, ``tiles`` is no positive number, or ``workers`` is out of
            range.
        LatticeError: the lattices or the numbers of levels differ.
        BoundsError: a count would be more than 2^63 - 1.
        FileAccessError, FormatError: a map cannot be read, or the folder cannot be written.
        WorkerError: three workers that merged the same tiles died, or another executor has lost them.
    """
    sources, target = [Path(p) for p in paths], Path(output)
    if not sources:
        raise ArgumentError("merging takes a map or more")
    if isinstance(workers, bool) or workers < 1:
        raise ArgumentError(f"the number of workers must be 1 or larger, not {workers!r}")
    check_folder(target)
    merged = _merged_empty(sources, same_frame, again)
    merge_parts(sources, target, tiles, merged, progress, workers=workers, executor=executor)
    return MapFolder.open(target)


def merge_parts(
    sources: Sequence[Path],
    target: Path,
    tiles: float,
    merged: Map,
    progress: Progress | None = None,
    *,
    workers: int = 1,
    executor: Executor | None = None,
) -> None:
    """Merge maps that are known to go together into a folder of tiles: arguments and errors as of :func:`merge_maps`.

    ``merged`` is the map that they make, without its cells.
    """
    cells = tile_cells(merged.lattice, len(merged.levels), tiles)
    with contextlib.ExitStack() as stack:
        if executor is not None:
            team = _Team(other=executor, workers=_CLUSTER)
            # Its workers may have begun in another folder.
            sources, target = [path.absolute() for path in sources], target.absolute()
        else:
            team = _Team(stack.enter_context(LocalWorkers(workers)), workers=workers) if workers > 1 else _Team()
        if len(sources) > SIDE_BY_SIDE:
            # Beside the output: the folder of the system may be a small one, in memory.
            beside = tempfile.TemporaryDirectory(
                prefix=".merge-", dir=target.absolute().parent, ignore_cleanup_errors=True
            )
            sources = _merge_groups(sources, Path(stack.enter_context(beside)), merged, cells, team)
        _merge_side_by_side(sources, target, merged, cells, team, progress)


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


def _merge_groups(
    paths: Sequence[Path], scratch: Path, merged: Map, cells: tuple[int, ...], team: _Team
) -> list[Path]:
    """Merge maps in groups until so few are left that they can be read side by side."""
    numbers, paths = itertools.count(), list(paths)
    while len(paths) > SIDE_BY_SIDE:
        groups = [paths[i : i + SIDE_BY_SIDE] for i in range(0, len(paths), SIDE_BY_SIDE)]
        paths = [
            _merge_side_by_side(group, scratch / str(next(numbers)), merged, cells, team, None) for group in groups
        ]
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
    paths: Sequence[Path], output: Path, merged: Map, cells: tuple[int, ...], team: _Team, progress: Progress | None
) -> Path:
    """Merge maps that are known to go together into a folder of tiles."""
    inputs, spans = _inputs(paths, cells[0])
    total = sum(rows for _, _, rows in spans)
    batch = min(_BATCH, max(_LEAST_BATCH, _ALL_BATCHES // (len(paths) * len(merged.levels) * team.workers)))
    header = describe(merged)

    def report(rows: int) -> None:
        if progress is not None:
            progress(rows, total)

    with tile_folder(output, header, merged.lattice, cells) as writer:
        cuts = _cuts(spans, _number_of_parts(spans, total, len(inputs), team))
        parts = [
            Part(tuple(i for i in inputs if i.first < stop and i.last >= first), header, cells, first, stop, batch)
            for first, stop in itertools.pairwise(cuts)
        ]
        if team.workers == 1 or len(parts) < 2:
            for part in parts:
                merge_part(part, writer, report)
        else:
            writer.tiles += _merge_by(team, parts, writer.folder, report)
        report(total)  # with those that have neither hits nor passes
    return output


def _merge_by(team: _Team, parts: Sequence[Part], scratch: Path, report: Callable[[int], None]) -> list[Tile]:
    """Merge the parts on workers that see the folder ``scratch``, and return all tiles."""
    executor = team.own or team.other
    assert executor is not None
    futures: list[Future[list[Tile]]] = []
    try:
        for number, part in enumerate(parts):
            futures.append(executor.submit(merge_part_apart, part, str(scratch), number))
        while True:
            done, left = wait(futures, timeout=_REPORT_SECONDS, return_when=FIRST_EXCEPTION)
            report(rows_merged(scratch))
            if not left or any(future.exception() is not None for future in done):
                # In the order of the parts: of several that failed, the first.
                return [tile for future in futures if future.done() for tile in future.result()]
    except BaseException as error:
        for future in futures:
            future.cancel()
        if team.own is not None:
            team.own.stop()  # before the folder that they write to is removed
        elif isinstance(error, Exception) and not isinstance(error, HexmapError):
            raise WorkerError(f"the executor lost a part: {type(error).__name__}: {reason(error)}") from error
        raise


def _number_of_parts(spans: Sequence[tuple[int, int, int]], total: int, files: int, team: _Team) -> int:
    """Return into how many parts a merge is divided: several a worker, unless they would read too much in common."""
    if team.workers == 1 or not spans:
        return 1
    # At each cut a row group of every file is read twice, and its first rows are only passed over the second time.
    common = files * total / len(spans)
    return max(team.workers, min(_PARTS_A_WORKER * team.workers, int(total / (_LEAST_PART * common))))


def _cuts(spans: Sequence[tuple[int, int, int]], count: int) -> list[int]:
    """Return at which steps ``count`` parts of about equally many rows begin, and the last one ends."""
    if not spans:
        return []
    first, last, rows = (np.array(column, np.float64) for column in zip(*spans, strict=True))
    # The rows of a group lie anywhere in its steps: taken as spread evenly.
    density = rows / (last + 1 - first)
    ends, place = np.unique(np.concatenate([first, last + 1]), return_inverse=True)
    slope = np.cumsum(np.bincount(place, np.concatenate([density, -density])))
    share = np.concatenate([[0.0], np.cumsum(slope[:-1] * np.diff(ends))])
    inner = np.rint(np.interp(np.arange(1, count) / count * share[-1], share, ends)).astype(np.int64)
    begin, end = int(first.min()), int(last.max()) + 1
    return [begin, *sorted({int(c) for c in inner if begin < c < end}), end]


def _inputs(paths: Sequence[Path], width: int) -> tuple[list[Input], list[tuple[int, int, int]]]:
    """Return all files to read that have rows, of a map of tiles a file a tile, and where their row groups lie."""
    inputs: list[Input] = []
    spans: list[tuple[int, int, int]] = []
    for path in paths:
        if is_map_folder(path):
            folder = MapFolder.open(path)
            for t in folder.tiles:
                begin = t.index[0] * folder.cells[0]
                inputs.append(Input(path / t.file, begin // width, (begin + folder.cells[0] - 1) // width))
                spans.append((inputs[-1].first, inputs[-1].last, t.rows))
            continue
        rows = MapRows(path)
        try:
            found = rows.spans(width)
        finally:
            rows.close()
        if found:
            inputs.append(Input(path, min(span[0] for span in found), max(span[1] for span in found)))
            spans += found
    return inputs, spans
