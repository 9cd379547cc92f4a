"""Map files read a batch of rows at a time, level by level, and merged as they come: nothing is ever held whole."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import BoundsError, FormatError
from hexmap.base.text import reason
from hexmap.io.map_file import check_columns, header_of, lattice_of, levels_of, open_regular, parquet_of
from hexmap.lattice.keys import layout, unpack

__all__ = ["MapRows", "RowStream", "Run", "merged_runs"]

Run: TypeAlias = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]  # keys, hits, passes

_NOTHING = np.empty(0, np.int32)
_NOTHING.setflags(write=False)  # as the columns that come from a file: the kernel is compiled once
_NO_KEYS = np.empty(0, np.int64)
_BEFORE_ALL = np.iinfo(np.int64).min
_WRONG = {  # what the kernel has found, by its code
    1: "has an index out of range, {limit}",
    2: "has a negative number of hits or passes",
    3: "repeats the cell of the row before",
    4: "is not sorted by level and index",
}


class MapRows:
    """An open map file, as streams of the rows of each of its levels.

    Attributes:
        path: the file.
        header: its metadata.
        rows: how many rows it has.

    Raises:
        FileAccessError, FormatError: as :func:`hexmap.io.map_file.load_map`.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._handle = open_regular(path)
        try:
            self.file = parquet_of(path, self._handle)
            self.header = header_of(path, self.file.schema_arrow.metadata)
            self.lattice = lattice_of(path, self.header)
            self.levels = levels_of(path, self.header)
            self.names = check_columns(path, self.file, self.lattice.dim)
        except BaseException:
            self.close()
            raise
        self.rows = int(self.file.metadata.num_rows)

    def close(self) -> None:
        """Close the file; its streams have ended."""
        self._handle.close()

    def groups(self) -> NDArray[np.int64]:
        """Return where each row group begins (G + 1,), and the last one ends."""
        data = self.file.metadata
        counts = [data.row_group(i).num_rows for i in range(data.num_row_groups)]
        return np.cumsum([0, *counts])

    def level_ends(self) -> NDArray[np.int64]:
        """Return at which row each level begins (L + 1,), and the last one ends.

        Raises:
            FormatError: a row is on a level that the map does not have, or levels are not sorted.
        """
        counts = np.zeros(self.levels, np.int64)
        last = 0
        for group in range(self.file.metadata.num_row_groups):
            size = self.file.metadata.row_group(group).num_rows
            span = self._range(group)
            # Nearly all groups are of one level, which their statistics say.
            level = np.full(min(size, 1), span[0]) if span and span[0] == span[1] else self._levels_of_rows(group)
            if (np.diff(level, prepend=last) < 0).any() and (level >= 0).all():
                raise FormatError(f"{self.path}: damaged map: row group {group} is not sorted by level and index")
            if len(level) and (level[0] < 0 or level[-1] >= self.levels):
                raise FormatError(
                    f"{self.path}: damaged map: row group {group} is on a level that is not among 0 to "
                    f"{self.levels - 1}"
                )
            counts += np.bincount(level, minlength=self.levels) if len(level) == size else 0
            if len(level) and len(level) != size:
                counts[level[0]] += size
            last = int(level[-1]) if len(level) else last
        return np.cumsum([0, *counts])

    def spans(self, width: int) -> list[tuple[int, int, int]]:
        """Return of each row group the first and last step that may have a row of it, and how many rows it has.

        A step is ``width`` cells of level 0 wide along the first index. Where the file has no statistics that are the
        first and the last step of all.
        """
        spans = []
        limit = self.lattice.limit
        for group in range(self.file.metadata.num_row_groups):
            rows = self.file.metadata.row_group(group).num_rows
            if rows == 0:
                continue
            levels, first = self._range(group), self._range(group, self.names[1])
            low, high = (-limit, limit) if first is None else (max(first[0], -limit), min(first[1], limit))
            widths = range(self.levels) if levels is None else range(max(0, levels[0]), min(levels[1] + 1, self.levels))
            # A level that the map does not have is found when the rows are read.
            at = [width >> k for k in widths] or [width]
            spans.append((min(low // w for w in at), max(high // w for w in at), rows))
        return spans

    def first_row(self, begin: int, end: int, low: int) -> int:
        """Return a row from which on all rows with a first index of ``low`` or more are.

        Row groups before it are passed over by their statistics.

        Args:
            begin: the first row of a level.
            end: the first row behind it.
            low: of the first index.
        """
        for group, (first, behind) in enumerate(itertools.pairwise(self.groups().tolist())):
            if behind <= begin or first >= end:
                continue
            span = self._range(group, self.names[1])
            if span is None or span[1] >= low:
                return max(begin, first)
        return end

    def _range(self, group: int, name: str = "level") -> tuple[int, int] | None:
        """Return the least and greatest value of a column in a row group, where its statistics say."""
        chunk = self.file.metadata.row_group(group).column(self.file.schema_arrow.names.index(name))
        statistics = chunk.statistics
        if statistics is None or not statistics.has_min_max:
            return None
        return int(statistics.min), int(statistics.max)

    def _levels_of_rows(self, group: int) -> NDArray[np.int64]:
        import pyarrow as pa

        try:
            table = self.file.read_row_group(group, columns=["level"], use_threads=False)
            return np.asarray(table.column("level").cast(pa.int64()).to_numpy(), dtype=np.int64)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise FormatError(f"{self.path}: damaged map: {reason(error)}") from error


class RowStream:
    """The rows of one level of a map file in ascending order, of which one batch at a time is in memory.

    Args:
        source: the open file.
        begin, end: the rows of the level, as :meth:`MapRows.level_ends` has them, or from a later one on.
        batch: rows at a time.
        low: keys below are passed over.

    Attributes:
        taken: how many rows have been taken.
    """

    def __init__(self, source: MapRows, begin: int, end: int, batch: int, low: int = _BEFORE_ALL) -> None:
        self._source = source
        self._begin, self._end, self._batch, self._low = begin, end, batch, low
        self.taken = 0
        self._batches: Iterator[Any] | None = None
        self._row = begin
        self._skip = 0
        self._last = _BEFORE_ALL
        self._at = 0
        self._run: Run = (_NO_KEYS, _NO_KEYS, _NO_KEYS)

    def head(self) -> int | None:
        """Return the key of the next row, None at the end."""
        while self._at == len(self._run[0]):
            if self._row >= self._end:
                return None
            self._fill()
        return int(self._run[0][self._at])

    def last(self) -> int:
        """Return the key up to which all rows are in memory."""
        return int(self._run[0][-1])

    def take(self, limit: int) -> Run:
        """Return the rows in memory whose keys are not beyond ``limit``, and go on behind them."""
        end = int(np.searchsorted(self._run[0], limit, side="right"))
        begin, self._at = self._at, max(self._at, end)
        self.taken += self._at - begin
        keys, hits, passes = self._run
        return keys[begin : self._at], hits[begin : self._at], passes[begin : self._at]

    def _fill(self) -> None:
        """Read the next batch."""
        import pyarrow as pa

        try:
            columns = self._next_columns()
        except (pa.ArrowException, OSError, ValueError) as error:
            if isinstance(error, FormatError):
                raise
            raise FormatError(f"{self._source.path}: damaged map: {reason(error)}") from error
        from hexmap.io import _merge_kernels as kernels

        source = self._source
        *axes, hits, passes = columns
        bits, offset = layout(source.lattice.dim)
        third = axes[2] if len(axes) == 3 else _NOTHING
        run = tuple(np.empty(len(hits), np.int64) for _ in range(3))
        kept, self._last, wrong, row = kernels.pack_rows(
            axes[0], axes[1], third, hits, passes, bits, offset, source.lattice.limit, self._last, run
        )
        if wrong:
            place = f"row {self._row + row}, index ({', '.join(str(axis[row]) for axis in axes)})"
            what = _WRONG[wrong].format(limit=source.lattice.limit)
            raise FormatError(f"{source.path}: damaged map: {place} {what}")
        self._row += len(hits)
        self._run = run[0][:kept], run[1][:kept], run[2][:kept]
        self._at = int(np.searchsorted(self._run[0], self._low))

    def _next_columns(self) -> list[NDArray[Any]]:
        """Return the columns of the next rows of this level but the level itself; at least one row."""
        import pyarrow as pa

        source = self._source
        if self._batches is None:
            starts = source.groups()
            groups = [g for g, (a, b) in enumerate(itertools.pairwise(starts)) if b > self._begin and a < self._end]
            # The first and the last group may have rows of other levels, too.
            self._skip = self._begin - int(starts[groups[0]])
            self._batches = source.file.iter_batches(
                batch_size=self._batch, row_groups=groups, columns=list(source.names[1:]), use_threads=False
            )
        while True:
            batch = next(self._batches, None)
            if batch is None:
                raise FormatError(f"{source.path}: damaged map: its numbers of rows do not agree")
            dropped = min(self._skip, len(batch))
            self._skip -= dropped
            batch = batch.slice(dropped, self._end - self._row)
            if len(batch):
                break
        columns = []
        for name in source.names[1:]:
            column = batch.column(name)
            if column.null_count:
                raise FormatError(f"{source.path}: damaged map: column {name!r} has empty values")
            kind = pa.int64() if name in ("hits", "passes") else pa.int32()
            columns.append(column.cast(kind).to_numpy())
        return columns


def merged_runs(streams: Sequence[RowStream], stop: int, dim: int) -> Iterator[Run]:
    """Yield the rows of all streams below the key ``stop``, in ascending order, the counts of equal keys added.

    Raises:
        BoundsError: the counts of a cell add up to more than 2^63 - 1.
    """
    while True:
        live = [s for s in streams if (head := s.head()) is not None and head < stop]
        if not live:
            return
        # What a stream has beyond the rows in memory lies behind the last of them: up to the least of those ends
        # nothing can come any more.
        limit = min(stop - 1, min(s.last() for s in live))
        runs = [run for run in (s.take(limit) for s in live) if len(run[0])]
        while len(runs) > 1:
            pairs = [_merged(a, b, dim) for a, b in zip(runs[::2], runs[1::2], strict=False)]
            runs = pairs + runs[len(runs) & ~1 :]
        if runs:
            yield runs[0]


def _merged(a: Run, b: Run, dim: int) -> Run:
    from hexmap.io import _merge_kernels as kernels

    keys, hits, passes = (np.empty(len(a[0]) + len(b[0]), np.int64) for _ in range(3))
    count, wrapped = kernels.merge_runs(a, b, (keys, hits, passes))
    if wrapped >= 0:
        cell = tuple(unpack(keys[wrapped : wrapped + 1], dim)[0].tolist())
        total = max(int(counts[wrapped]) % 2**64 for counts in (hits, passes))
        raise BoundsError(f"the counts of cell {cell} add up to {total}, beyond 2^63 - 1")
    return keys[:count], hits[:count], passes[:count]
