"""Paths as tables: one row a corner of the path, as any spreadsheet and any robot reads them."""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hexmap.base.atomic_files import atomic_write
from hexmap.base.errors import FileAccessError, FormatError
from hexmap.base.values import one_line

if TYPE_CHECKING:
    from planners.path import Path

__all__ = ["PathTable", "read_path", "write_path"]

_POINT = {2: ("x", "y"), 3: ("x", "y", "z")}
_CELL = {2: ("a", "b"), 3: ("a", "b", "c")}


@dataclass(frozen=True, eq=False)
class PathTable:
    """What a file says of a path.

    Attributes:
        points: (M, n) float64, metres, in the frame of the map.
        cells: (M, n) int32 index of the cells.
        length: (M,) float64 metres from the start to each point along the path.
    """

    points: NDArray[np.float64]
    cells: NDArray[np.int32]
    length: NDArray[np.float64]

    __repr__ = one_line


def write_path(file: str | os.PathLike[str], path: Path) -> None:
    """Write the points of a path as CSV: ``x,y,a,b,length`` (``x,y,z,a,b,c,length`` in space) and a row a point.

    Metres, the cell's index in the lattice's basis, and the metres so far. Numbers are written with
    all their digits: :func:`read_path` gives the same ones.

    Raises:
        FileAccessError: the file cannot be written.
    """
    n = path.points.shape[1]
    legs = np.sqrt((np.diff(path.points, axis=0) ** 2).sum(axis=1))
    so_far = np.concatenate([[0.0], np.cumsum(legs)])
    rows = zip(path.points.tolist(), path.cells.tolist(), so_far.tolist(), strict=True)
    with atomic_write(file, "w") as handle:
        handle.write(",".join((*_POINT[n], *_CELL[n], "length")) + "\n")
        handle.writelines(",".join(map(repr, (*point, *cell, metres))) + "\n" for point, cell, metres in rows)


def read_path(file: str | os.PathLike[str]) -> PathTable:
    """Read what :func:`write_path` wrote.

    Raises:
        FileAccessError: the file cannot be read.
        FormatError: it is no such table; the text names file and line.
    """
    name = FilePath(file)
    try:
        lines = name.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise FileAccessError(f"{name}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise FormatError(f"{name}: not a path: not text") from error
    head = tuple(lines[0].split(",")) if lines else ()
    n = next((k for k in _POINT if head == (*_POINT[k], *_CELL[k], "length")), 0)
    if n == 0:
        raise FormatError(f"{name}, line 1: not a path: the columns must be x,y,a,b,length or x,y,z,a,b,c,length")
    values = []
    for number, row in enumerate(csv.reader(lines[1:]), start=2):
        try:
            point, cell, metres = [float(v) for v in row[:n]], [int(v) for v in row[n : 2 * n]], float(row[2 * n])
            if len(row) != 2 * n + 1 or not np.isfinite([*point, metres]).all() or max(map(abs, cell)) >= 2**31:
                raise ValueError
        except (ValueError, IndexError) as error:
            raise FormatError(
                f"{name}, line {number}: a point takes {2 * n + 1} numbers, not {','.join(row)!r}"
            ) from error
        values.append((point, cell, metres))
    if not values:
        raise FormatError(f"{name}: a path without a point")
    points, cells, length = zip(*values, strict=True)
    return PathTable(np.array(points, np.float64), np.array(cells, np.int32), np.array(length, np.float64))
