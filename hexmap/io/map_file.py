"""Map files: Parquet tables that any Parquet reader can use, with the lattice as numbers beside them.

One row is one cell that was hit or passed: ``level, a, b(, c), hits, passes``, sorted by level,
then index, each cell once. What the rows mean lies in the file's metadata under ``hexmap``, as JSON.
Rows may be cut, or concatenated and summed by cell, with any tool; as long as they stay sorted and
the metadata goes with them the result is a map file again.

The same map always gives the same bytes (there is no time of writing in the file), so two maps can
be compared by their checksums. Pages carry checksums, which reading verifies.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import platform
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.atomic_files import atomic_write
from hexmap.base.errors import FileAccessError, FormatError, HexmapError, TooLargeError
from hexmap.base.text import quoted, reason
from hexmap.base.values import read_only
from hexmap.io.file_kinds import PARQUET
from hexmap.io.read_file import cannot_read, check_regular, inflation_limit
from hexmap.lattice.keys import KeyArray, pack, unpack
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import LevelRows
from hexmap.maps.map import Level, Map
from hexmap.maps.voxel_list import VoxelList

__all__ = [
    "FORMAT_VERSION",
    "MapWriter",
    "check_columns",
    "describe",
    "encode",
    "header_of",
    "lattice_of",
    "levels_of",
    "load_map",
    "open_regular",
    "parquet_of",
    "read_metadata",
    "save_map",
    "texts_of",
    "write_rows",
]

FORMAT_VERSION = 1
_KEY = b"hexmap"
_AXES = ("a", "b", "c")
_MAX_LEVELS = 16
# Rows of a row group, pyarrow's default; other readers see no difference, but files stay the same byte for byte.
_GROUP = 1 << 20


def save_map(path: str | os.PathLike[str], map: Map) -> None:
    """Write a map; an older file of that name stays until the new one is whole.

    Args:
        path: the Parquet file to make or to replace.
        map: the map, which may be empty.

    Raises:
        FileAccessError: the folder is missing or not writable, or the disk is full.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from hexmap import Lattice, Map, VoxelList, load_map, save_map
        >>> from hexmap.maps import Level
        >>> hexagons = Lattice.named("A2", resolution=0.1)
        >>> hits = VoxelList.from_points([[0.02, 0.31]], hexagons)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     save_map(Path(folder) / "one.parquet", Map([Level(hits, VoxelList.empty(hexagons))]))
        ...     load_map(Path(folder) / "one.parquet").levels[0].hits.rows().tolist()
        [[0, 3, 1]]
    """
    with atomic_write(path) as handle:
        write_rows(handle, describe(map), map.lattice.dim, _rows(map))


class MapWriter:
    """Writes a map file row group by row group; that the rows are sorted, each cell once, is the caller's care.

    Args:
        handle: the file to write to.
        header: what :func:`describe` returns.
        dim: of the lattice.
    """

    def __init__(self, handle: Any, header: dict[str, Any], dim: int) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        axes = _AXES[:dim]
        types = {"level": np.int32, **dict.fromkeys(axes, np.int32), "hits": np.int64, "passes": np.int64}
        fields = [pa.field(name, pa.from_numpy_dtype(dtype), nullable=False) for name, dtype in types.items()]
        metadata = {_KEY: encode({**header, "crc32": zlib.crc32(encode(header))})}
        self._schema = pa.schema(fields, metadata=metadata)
        self._writer = pq.ParquetWriter(
            handle,
            self._schema,
            compression="zstd",
            # Sorted indices differ by small steps, which delta coding stores in a few bits; counts repeat.
            use_dictionary=["level", "hits", "passes"],
            column_encoding=dict.fromkeys(axes, "DELTA_BINARY_PACKED"),
            write_page_checksum=True,
        )

    def write_columns(self, columns: list[NDArray[Any]]) -> None:
        """Write a row group: level, indices, hits and passes, each (M,)."""
        import pyarrow as pa

        self._writer.write_table(pa.table(columns, schema=self._schema))

    def close(self) -> None:
        """End the file."""
        self._writer.close()

    def __enter__(self) -> MapWriter:
        """Write rows in a block."""
        return self

    def __exit__(self, *error: object) -> None:
        """End the file."""
        self.close()


def write_rows(handle: Any, header: dict[str, Any], dim: int, rows: LevelRows) -> None:
    """Write a map file, so many rows at a time: a large map would take three times its memory at once.

    Args:
        handle: the file to write to.
        header: what :func:`describe` returns.
        dim: of the lattice.
        rows: of all levels.
    """
    columns: list[NDArray[Any]] = [np.empty(_GROUP, np.int32) for _ in range(1 + dim)]
    columns += [np.empty(_GROUP, np.int64) for _ in range(2)]
    count = groups = 0
    with MapWriter(handle, header, dim) as writer:
        for level, (keys, hits, passes) in rows:
            at = 0
            while at < len(keys):
                some, room = slice(at, at + _GROUP - count), slice(count, count + len(keys) - at)
                index = unpack(keys[some], dim)
                for column, values in zip(columns, [level, *index.T, hits[some], passes[some]], strict=True):
                    column[room] = values
                at += len(index)
                count += len(index)
                if count == _GROUP:
                    writer.write_columns(columns)
                    count, groups = 0, groups + 1
        # A map without a cell has one group of no rows.
        if count or not groups:
            writer.write_columns([column[:count] for column in columns])


def _rows(map: Map) -> LevelRows:
    for k, level in enumerate(map.levels):
        for part in _parts(level):
            yield k, part.columns()


def _parts(level: Level) -> Iterator[Level]:
    """Yield a level in parts of neighbouring cells, of about a quarter of a row group."""
    longer = level.passes.keys if len(level.passes) > len(level.hits) else level.hits.keys
    starts = longer[_GROUP // 4 :: _GROUP // 4]

    def cut(cells: VoxelList) -> Iterator[VoxelList]:
        ends = [0, *np.searchsorted(cells.keys, starts).tolist(), len(cells)]
        for begin, end in itertools.pairwise(ends):
            yield VoxelList(cells.lattice, cells.keys[begin:end], cells.counts[begin:end])

    yield from (Level(h, p) for h, p in zip(cut(level.hits), cut(level.passes), strict=True))


def load_map(path: str | os.PathLike[str]) -> Map:
    """Read a map that :func:`save_map` wrote, or that was made of such files row by row.

    Args:
        path: the Parquet file.

    Returns:
        The map; rows with neither hits nor passes are left out.

    Raises:
        FileAccessError: the file cannot be opened.
        FormatError: not Parquet, cut off, damaged, not a hexmap map, of a newer version, or with rows
            that are not those of a map; the text names the file and what is wrong.
    """
    path = Path(path)
    with open_regular(path) as handle:
        file = parquet_of(path, handle)
        header = header_of(path, file.schema_arrow.metadata)
        lattice = lattice_of(path, header)
        names = check_columns(path, file, lattice.dim)
        rows = _Rows(path, lattice, levels_of(path, header))
        for columns in _read(path, file, names):
            rows.add(columns)
    return Map(rows.levels(), header["frame"], texts_of(header))


def read_metadata(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return what a map file says about itself, without reading its rows.

    Returns:
        ``format``, ``kind``, ``lattice`` (``name`` and ``basis``), ``levels``, ``resolution`` (metres),
        ``frame``, ``provenance`` (one entry a log) and ``versions`` of the software that wrote it.

    Raises:
        FileAccessError: the file cannot be opened.
        FormatError: not a map file, or one of a newer version.
    """
    path = Path(path)
    with open_regular(path) as handle:
        header = header_of(path, parquet_of(path, handle).schema_arrow.metadata)
    lattice_of(path, header)
    levels_of(path, header)
    return header


# ---------------------------------------------------------------------- metadata


def describe(map: Map) -> dict[str, Any]:
    """Return the metadata of a map's file; nothing in it depends on when or where it is written."""
    return {
        "format": FORMAT_VERSION,
        "kind": "map",
        "lattice": map.lattice.to_dict(),
        "levels": len(map.levels),
        "resolution": map.lattice.resolution,
        "frame": map.frame,
        "provenance": [_to_entry(text) for text in map.provenance],
        "versions": _versions(),
    }


def encode(header: dict[str, Any]) -> bytes:
    """Return metadata as JSON: one text for one content."""
    return json.dumps(header, sort_keys=True, allow_nan=False).encode("ascii")


def _to_entry(text: str) -> Any:
    """Return a text of the provenance as an object where it comes back letter by letter, else as it is.

    Objects can be read by others without decoding JSON within JSON. Infinity is not JSON: such a
    text stays a text.
    """
    try:
        value = json.loads(text)
        if isinstance(value, dict) and json.dumps(value, sort_keys=True, allow_nan=False) == text:
            return value
    except ValueError:
        pass
    return text


def _versions() -> dict[str, str]:
    import pyarrow as pa

    from hexmap.base.version import __version__

    return {
        "hexmap": __version__,
        "numpy": np.__version__,
        "pyarrow": pa.__version__,
        "python": platform.python_version(),
    }


def header_of(path: Path, metadata: dict[bytes, bytes] | None) -> dict[str, Any]:
    """Decode the metadata and check everything in it but the lattice and the levels."""
    text = (metadata or {}).get(_KEY)
    if text is None:
        raise FormatError(f"{path}: a Parquet file, but not a hexmap map: it has no metadata 'hexmap'")
    try:
        header = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path}: damaged map: its metadata is not JSON: {reason(error)}") from error
    if not isinstance(header, dict) or "format" not in header:
        raise FormatError(f"{path}: damaged map: its metadata names no format version")
    version = header["format"]
    if not isinstance(version, int) or isinstance(version, bool) or version < 1:
        raise FormatError(f"{path}: damaged map: its format version is {quoted(version)}")
    if version > FORMAT_VERSION:
        raise FormatError(
            f"{path}: written by a newer hexmap: format version {version}, this one reads up to {FORMAT_VERSION}"
        )
    # Parquet has checksums for its pages but not for its metadata, which holds the basis. Metadata that was
    # edited by hand comes without the checksum.
    stated = header.pop("crc32", None)
    if stated is not None and stated != zlib.crc32(_recode(path, header)):
        raise FormatError(f"{path}: damaged map: its metadata does not fit its checksum 'crc32'")
    if header.get("kind") != "map":
        raise FormatError(f"{path}: not a map: its metadata says {quoted(header.get('kind'))}")
    if not isinstance(header.get("frame"), str):
        raise FormatError(f"{path}: damaged map: its frame is {quoted(header.get('frame'))}, not a name")
    provenance = header.get("provenance")
    if not isinstance(provenance, list) or not all(isinstance(entry, (str, dict)) for entry in provenance):
        raise FormatError(f"{path}: damaged map: its provenance is not a list of texts or objects")
    return header


def _recode(path: Path, header: dict[str, Any]) -> bytes:
    try:
        return encode(header)
    except ValueError as error:
        raise FormatError(f"{path}: damaged map: its metadata holds a number that is not finite") from error


def lattice_of(path: Path, header: dict[str, Any]) -> Lattice:
    """Return the lattice of the finest level."""
    try:
        lattice = Lattice.from_dict(header.get("lattice", {}))
    except HexmapError as error:
        raise FormatError(f"{path}: damaged map: {error}") from error
    stated = header.get("resolution")
    try:
        fits = isinstance(stated, (int, float)) and math.isclose(stated, lattice.resolution, rel_tol=1e-6)
    except OverflowError:  # a whole number of more digits than any float64
        fits = False
    if not fits:
        raise FormatError(
            f"{path}: damaged map: it states a resolution of {quoted(stated)}, "
            f"its lattice's basis gives {lattice.resolution:g} m"
        )
    return lattice


def levels_of(path: Path, header: dict[str, Any]) -> int:
    """Return how many levels the map has."""
    levels = header.get("levels")
    if not isinstance(levels, int) or isinstance(levels, bool) or not 1 <= levels <= _MAX_LEVELS:
        raise FormatError(f"{path}: damaged map: it has {quoted(levels)} levels, not 1 to {_MAX_LEVELS}")
    return levels


# ---------------------------------------------------------------------- rows


def check_columns(path: Path, file: Any, dim: int) -> tuple[str, ...]:
    """Return the names of a map's columns, each of which an opened file has once, and of integers.

    Raises:
        FormatError: it does not.
    """
    import pyarrow as pa

    schema = file.schema_arrow
    names = ("level", *_AXES[:dim], "hits", "passes")
    for name in names:
        count = schema.names.count(name)
        if count != 1:
            raise FormatError(f"{path}: damaged map: it has {count or 'no'} columns {name!r}, and needs one")
        if not pa.types.is_integer(schema.field(name).type):
            raise FormatError(
                f"{path}: damaged map: column {name!r} holds {schema.field(name).type}, and should hold integers"
            )
    return names


def open_regular(path: Path) -> IO[bytes]:
    """Open a file that is no device.

    Raises:
        FileAccessError: it cannot be opened.
    """
    try:
        check_regular(path, os.stat(path).st_mode)
        return open(path, "rb")
    except FileAccessError:
        raise
    except (OSError, ValueError) as error:  # a ValueError: a path with a null character
        raise cannot_read(path, error) from error


def parquet_of(path: Path, handle: IO[bytes]) -> Any:
    """Return the opened pyarrow ParquetFile."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        head = handle.read(4)
        size = handle.seek(0, os.SEEK_END)
        handle.seek(max(0, size - 4))
        tail = handle.read(4)
        handle.seek(0)
    except OSError as error:
        raise cannot_read(path, error) from error
    if size == 0:
        raise FormatError(f"{path}: not a map: the file is empty")
    if not PARQUET.begins(head):
        from hexmap.io.grids.open_grid import is_grid

        if is_grid(path):
            raise FormatError(f"{path}: not a map of hexmap: a map of another program, which hexmap.open_grid reads")
        raise FormatError(f"{path}: not a map: not a Parquet file (it begins with {quoted(head)})")
    if not PARQUET.begins(tail):
        raise FormatError(f"{path}: damaged map: the file is cut off at {size} bytes")
    try:
        # Read a row group at a time: in a buffer ahead of them all row groups would stay until the last is read.
        file = pq.ParquetFile(handle, page_checksum_verification=True, pre_buffer=False)
        groups = [file.metadata.row_group(i) for i in range(file.metadata.num_row_groups)]
        counts = {group.num_rows == group.column(j).num_values for group in groups for j in range(group.num_columns)}
        total = sum(group.num_rows for group in groups)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise FormatError(f"{path}: damaged map: {reason(error)}") from error
    # pyarrow reads as many rows as it is told, and has no checksum for where it is told so.
    if total != file.metadata.num_rows or not counts <= {True}:
        raise FormatError(f"{path}: damaged map: its numbers of rows do not agree")
    # Equal rows take no room in the file, and eight bytes a number in memory; no two cells of a map are equal.
    unpacked, most = 8 * total * file.metadata.num_columns, inflation_limit(size)
    if unpacked > most:
        raise TooLargeError(
            f"{path}: {size} bytes say {total:,} rows, {unpacked} bytes in memory and more than {most}; "
            "HEXMAP_MAX_INFLATION raises the limit"
        )
    return file


def _read(path: Path, file: Any, names: tuple[str, ...]) -> Iterator[list[NDArray[np.int64]]]:
    """Yield the columns ``names``, each (M,) int64, so many rows at a time."""
    import pyarrow as pa

    try:
        for batch in file.iter_batches(_GROUP, columns=list(names), use_threads=False):
            for name in names:
                if batch.column(name).null_count:
                    raise FormatError(f"{path}: damaged map: column {name!r} has empty values")
            yield [np.asarray(batch.column(name).cast(pa.int64()).to_numpy(), dtype=np.int64) for name in names]
    except FormatError:
        raise
    except (pa.ArrowException, OSError, ValueError) as error:
        raise FormatError(f"{path}: damaged map: {reason(error)}") from error


class _Rows:
    """Checks rows as they are read, and makes the levels of them."""

    def __init__(self, path: Path, lattice: Lattice, count: int) -> None:
        self._path, self._lattice, self._count = path, lattice, count
        # Of each level the keys and counts that are not 0, of hits and of passes.
        self._pieces: list[list[list[tuple[KeyArray, NDArray[np.int64]]]]] = [[[], []] for _ in range(count)]
        self._row = 0
        self._last = np.full(2, -1, np.int64)  # level and key of the row before

    def add(self, columns: list[NDArray[np.int64]]) -> None:
        """Take the next rows: level, indices, hits and passes.

        Raises:
            FormatError: they are not those of a map.
        """
        level, *axes, hits, passes = columns
        if not len(level):
            return
        limit = self._lattice.limit

        def refuse(bad: NDArray[np.bool_], what: str) -> None:
            if bad.any():
                row = int(np.argmax(bad))
                place = "level {}, index ({})".format(level[row], ", ".join(str(axis[row]) for axis in axes))
                raise FormatError(f"{self._path}: damaged map: row {self._row + row} ({place}) {what}")

        refuse((level < 0) | (level >= self._count), f"is on a level that is not among 0 to {self._count - 1}")
        for axis in axes:
            refuse((axis >= limit) | (axis <= -limit), f"has an index out of range, {limit}")
        for name, counts in (("hits", hits), ("passes", passes)):
            refuse(counts < 0, f"has a negative number of {name}")
        keys = pack(np.stack(axes, axis=1).astype(np.int32))
        before, key_before = self._last
        step = np.diff(level, prepend=before)
        same = step == 0
        follows = np.append(key_before, keys[:-1])
        refuse(same & (keys == follows), "repeats the cell of the row before")
        refuse((step < 0) | (same & (keys < follows)), "is not sorted by level and index")
        ends = np.searchsorted(level, np.arange(self._count + 1))
        for pieces, (begin, end) in zip(self._pieces, itertools.pairwise(ends.tolist()), strict=True):
            for kind, counts in zip(pieces, (hits[begin:end], passes[begin:end]), strict=True):
                some = counts > 0
                kind.append((keys[begin:end][some], counts[some]))
        self._row += len(level)
        self._last = np.array([level[-1], keys[-1]])

    def levels(self) -> list[Level]:
        """Return the levels; what was read is given back one by one, so that a large map is not in memory twice."""
        out = []
        for k, pieces in enumerate(self._pieces):
            on, lists = self._lattice.scaled(2.0**k), []
            for kind in pieces:
                columns = [read_only(np.concatenate([p[c] for p in kind] or [np.empty(0, np.int64)])) for c in (0, 1)]
                kind.clear()
                lists.append(VoxelList(on, *columns))
            out.append(Level(*lists))
        return out


def texts_of(header: dict[str, Any]) -> list[str]:
    """Return the provenance that metadata holds as the texts that a map has."""
    return [e if isinstance(e, str) else json.dumps(e, sort_keys=True) for e in header["provenance"]]
