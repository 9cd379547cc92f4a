"""PTX, the scans of Leica's programs: a grid of points in the scanner's frame, and where the scanner stood."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import FormatError
from hexmap.base.text import plural, shown, whole_number
from hexmap.io.clouds.columns import Columns, Raw, choose_columns
from hexmap.io.clouds.text import parse_rows, plain_numbers

__all__ = ["begins_ptx", "read_ptx"]

_NUMBER = rb"[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?"
_MARK = re.compile(
    rb"\s*[0-9]+[ \t]*\r?\n\s*[0-9]+[ \t]*\r?\n(?:[ \t]*%(n)s(?:[ \t]+%(n)s){2}[ \t]*\r?\n){4}"
    rb"(?:[ \t]*%(n)s(?:[ \t]+%(n)s){3}[ \t]*\r?\n){4}" % {b"n": _NUMBER}
)
_HEADER = 10  # lines: columns, rows, position, three axes, four rows of a matrix


def begins_ptx(head: bytes) -> bool:
    """Tell whether a file begins as PTX does: two counts, four lines of three numbers, four of four."""
    return _MARK.match(head) is not None


def read_ptx(path: Path, data: bytes, columns: Columns | None = None) -> Raw:
    """Read the points of all scans of a PTX file held in ``data``, each in the frame that its matrix carries it to.

    A row vector (x, y, z, 1) times the matrix is the point there. What returned nothing is (0, 0, 0) and left out.

    Raises:
        FormatError: a scan that is cut off, or a line that is not numbers; the text names the line.
    """
    chosen = choose_columns(path, ["x", "y", "z", "intensity", "red", "green", "blue"], columns, "columns")
    lines = plain_numbers(data.decode("utf-8-sig", "replace")).replace("\r\n", "\n").replace("\r", "\n").split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    parts: list[FloatArray] = []
    unseen = at = 0
    while at < len(lines):
        counts = [whole_number(line.strip()) for line in lines[at : at + 2]]
        if len(counts) < 2 or None in counts:
            found = shown(lines[at].strip())
            raise FormatError(f"{path}, line {at + 1}: a scan begins with two numbers, columns and rows, not {found!r}")
        size = (counts[0] or 0) * (counts[1] or 0)
        begin = at + _HEADER
        if begin + size > len(lines):
            left = max(len(lines) - begin, 0)
            raise FormatError(f"{path}, line {at + 1}: cut off: {plural(size, 'point')} announced, {left} in the file")
        T = _rows(path, lines, at + 6, 4, 4)
        points = _rows(path, lines, begin, size, 3)
        seen = (points != 0.0).any(axis=1)
        unseen += size - int(np.count_nonzero(seen))
        with np.errstate(invalid="ignore", over="ignore"):  # what is not finite is dropped later
            moved = points @ T[:3, :3] + T[3, :3]
        if columns is None:
            parts.append(moved[seen])
        else:
            wide = np.column_stack([moved, _rows(path, lines, begin, size, max(chosen) + 1)[:, 3:]])
            parts.append(wide[seen][:, chosen])
        at = begin + size
    notes = [f"{plural(unseen, 'point')} without a return left out"] if unseen else []
    return Raw(np.concatenate(parts) if parts else np.empty((0, 3)), notes)


def _rows(path: Path, lines: list[str], at: int, count: int, columns: int) -> FloatArray:
    """Read so many lines of numbers."""
    text = "\n".join(lines[at : at + count]) + "\n"
    rows = parse_rows(path, text, at + 1, range(columns))
    if len(rows) != count:
        raise FormatError(f"{path}, line {at + 1}: {count} lines of numbers belong here, {len(rows)} are there")
    return rows
