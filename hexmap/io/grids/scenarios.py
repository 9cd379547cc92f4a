"""Benchmark problems with their published lengths: MovingAI ``.scen`` and Warframe ``.3dscen``."""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import FormatError
from hexmap.base.text import quoted, whole_number
from hexmap.base.values import one_line
from hexmap.io.grids.grid_map import MAX_BYTES, GridMap
from hexmap.io.read_file import read_file
from hexmap.maps.cell_state import CellState

__all__ = ["Scenario", "read_scenario"]

_NUMBER = re.compile(rb"[0-9]+(\.[0-9]*)?([eE][-+]?[0-9]+)?")


@dataclass(frozen=True, eq=False)
class Scenario:
    """Queries on one map, in the order of the file; arrays are read-only.

    Published lengths are in cells. Those of MovingAI are octile (diagonal steps sqrt 2 long), those of
    Warframe go to 26 neighbours; in both a diagonal step needs every cell of its square or cube free.

    Attributes:
        starts: (Q, n) int64 source cells, x, y(, z).
        goals: (Q, n) int64 source cells.
        lengths: (Q,) float64 published lengths, cells.
        texts: the lengths as published, Q of them: "2.82843", "6".
        lines: (Q,) int64 line of the file that each query stands in.
        buckets: (Q,) int64 group of similar lengths, -1 in a ``.3dscen``.
        size: (width, height) of the map that the file was made for, None in a ``.3dscen``.
        map_name: the map as the file names it.
        path: the file.
    """

    starts: NDArray[np.int64] = field(repr=False)
    goals: NDArray[np.int64] = field(repr=False)
    lengths: NDArray[np.float64] = field(repr=False)
    texts: tuple[str, ...] = field(repr=False)
    lines: NDArray[np.int64] = field(repr=False)
    buckets: NDArray[np.int64] = field(repr=False)
    size: tuple[int, int] | None
    map_name: str
    path: str = ""

    __repr__ = one_line

    def __len__(self) -> int:
        """Return the number of queries."""
        return len(self.lengths)

    @property
    def dim(self) -> int:
        """2 or 3."""
        return int(self.starts.shape[1])

    @property
    def decimals(self) -> NDArray[np.int64]:
        """(Q,) digits after the point of each published length; the last ones may be zeros left out."""
        return np.array([len(text.partition(".")[2]) for text in self.texts], np.int64)

    def check(self, grid: GridMap) -> None:
        """Make sure that the queries are queries of this map: its size is theirs, and all their ends are free.

        Raises:
            FormatError: naming the first line that does not fit.
        """
        shape = grid.states.shape
        named = f"the map {grid.path or 'given'}"
        size = " x ".join(map(str, shape))
        if self.dim != grid.dim:
            raise FormatError(f"{self.path}: its cells have {self.dim} coordinates, {named} has {grid.dim} dimensions")
        if self.size is not None and self.size != shape:
            raise FormatError(
                f"{self.path}: made for a map of {self.size[0]} x {self.size[1]} cells, {named} has {size}"
            )
        for what, cells in (("start", self.starts), ("goal", self.goals)):
            inside = np.asarray((cells < np.array(shape)).all(axis=1))
            fits: NDArray[np.bool_] = inside.copy()
            fits[inside] = grid.states[tuple(cells[inside].T)] == CellState.FREE
            if not fits.all():
                row = int(np.argmin(fits))
                why = f"free in {named}" if inside[row] else f"in {named} of {size}"
                cell = tuple(cells[row].tolist())
                raise FormatError(f"{self.path}, line {self.lines[row]}: the {what} {cell} is not {why}")


def read_scenario(path: str | os.PathLike[str]) -> Scenario:
    """Read the queries of a ``.scen`` (MovingAI, version 1) or a ``.3dscen`` (Warframe), plain or gzip.

    Which of the two it is shows in the second line: the map's name alone, or a query.

    Raises:
        FileAccessError: the file is not there or cannot be read.
        FormatError: a line is wrong (it is named), or the file has no query.
    """
    path = Path(path)
    lines = read_file(path, MAX_BYTES).split(b"\n")
    solid = _is_solid(path, lines)
    queries: list[_Query] = []
    for number, line in enumerate(lines[1 + solid :], start=2 + solid):
        content = line.strip()
        if content and solid:
            queries.append(_solid_query(f"{path}, line {number}", number, content))
        elif content:
            queries.append(_flat_query(f"{path}, line {number}", number, content, queries[0] if queries else None))
    if not queries:
        raise FormatError(f"{path}: no query in the file")
    name = lines[1].strip() if solid else queries[0].map_name
    ends = np.array([query.ends for query in queries], np.int64)
    dim = ends.shape[1] // 2
    arrays = (
        np.ascontiguousarray(ends[:, :dim]),
        np.ascontiguousarray(ends[:, dim:]),
        np.array([query.length for query in queries]),
        np.array([query.line for query in queries], np.int64),
        np.array([query.bucket for query in queries], np.int64),
    )
    for array in arrays:
        array.setflags(write=False)
    starts, goals, lengths, numbers, buckets = arrays
    texts = tuple(query.text for query in queries)
    return Scenario(
        starts, goals, lengths, texts, numbers, buckets, queries[0].size, name.decode("utf-8", "replace"), str(path)
    )


class _Query(NamedTuple):
    """A line of a scenario: start and goal in one row, the length as a number and as it was published."""

    line: int
    ends: list[int]
    length: float
    text: str
    bucket: int = -1
    map_name: bytes = b""
    size: tuple[int, int] | None = None


def _is_solid(path: Path, lines: list[bytes]) -> bool:
    """Tell whether the file is a ``.3dscen``, by its name or by the name of a map alone in its second line."""
    head = lines[0].split()
    if head[:1] != [b"version"] or len(head) != 2:
        raise FormatError(f"{path}, line 1: a scenario begins with 'version 1', not with {quoted(lines[0])}")
    if head[1] not in (b"1", b"1.0"):
        raise FormatError(f"{path}, line 1: only scenarios of version 1 are read, not of {quoted(head[1])}")
    second = lines[1].strip() if len(lines) > 1 else b""
    words = len(second.split())
    solid = words == 1 or any(suffix.lower() == ".3dscen" for suffix in path.suffixes[-2:])
    if solid and words != 1:
        raise FormatError(f"{path}, line 2: the name of the map belongs here, not {quoted(second)}")
    return solid


def _solid_query(where: str, number: int, content: bytes) -> _Query:
    words = _words(where, content, "sx sy sz gx gy gz length ratio")
    if _length(words[7]) is None:
        raise FormatError(f"{where}: the ratio must be a number of 0 or more, not {quoted(words[7])}")
    ends = [_integer(where, "a coordinate", word) for word in words[:6]]
    return _Query(number, ends, _published(where, words[6]), words[6].decode("ascii"))


def _flat_query(where: str, number: int, content: bytes, first: _Query | None) -> _Query:
    """Read a line of a ``.scen``, whose map must be that of the ``first`` line, if there was one."""
    words = _words(where, content, "bucket map width height sx sy gx gy length")
    bucket = _integer(where, "the bucket", words[0])
    size = _integer(where, "the width", words[2]), _integer(where, "the height", words[3])
    if first is not None and first.size is not None and first.size != size:
        raise FormatError(
            f"{where}: a map of {size[0]} x {size[1]} cells, "
            f"and one of {first.size[0]} x {first.size[1]} in the lines before"
        )
    if first is not None and first.map_name != words[1]:
        raise FormatError(f"{where}: the map is {quoted(words[1])}, and {quoted(first.map_name)} in the lines before")
    ends = [_integer(where, "a coordinate", word) for word in words[4:8]]
    for value, side in zip(ends, size * 2, strict=True):
        if value >= side:
            raise FormatError(
                f"{where}: the query {' '.join(map(str, ends))} leaves its map of {size[0]} x {size[1]} cells"
            )
    return _Query(number, ends, _published(where, words[8]), words[8].decode("ascii"), bucket, words[1], size)


def _words(where: str, content: bytes, fields: str) -> list[bytes]:
    """Split a query into as many words as there are names in ``fields``."""
    # Names of maps may hold spaces where the fields are parted by tabs.
    words = [word.strip() for word in content.split(b"\t")] if b"\t" in content else content.split()
    if len(words) != fields.count(" ") + 1:
        raise FormatError(f"{where}: {len(words)} fields, and a query has '{fields}'")
    return words


def _published(where: str, word: bytes) -> float:
    length = _length(word)
    if length is None:
        raise FormatError(f"{where}: the length must be a number of 0 or more, not {quoted(word)}")
    return length


def _integer(where: str, what: str, word: bytes) -> int:
    value = whole_number(word)
    if value is None:
        raise FormatError(f"{where}: {what} must be an integer of 0 or more, not {quoted(word)}")
    return value


def _length(word: bytes) -> float | None:
    if not _NUMBER.fullmatch(word):
        return None
    value = float(word)
    return value if math.isfinite(value) else None
