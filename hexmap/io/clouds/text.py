"""Points as text, one a line: XYZ, TXT, ASC, PTS and CSV."""

from __future__ import annotations

import csv
import io
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import FormatError
from hexmap.base.text import plural, reason, shown, whole_number
from hexmap.io.clouds.columns import Columns, Raw, choose_columns

__all__ = ["parse_rows", "plain_numbers", "read_text"]

# (separator, decimal comma): tried in this order until the first line of data makes sense.
_GUESSES: tuple[tuple[str | None, bool], ...] = (
    (";", False), (",", False), ("\t", False), (None, False), (";", True), ("\t", True), (None, True),
)  # fmt: skip
# Visual C++ writes numbers that are none as 1.#IND, 1.#QNAN00 and 1.#INF, and newer ones as nan(ind).
_MICROSOFT = re.compile(r"([-+]?)1\.#(INF|IND|QNAN|SNAN|J|R)0*|[-+]?nan\([a-z0-9_]*\)", re.IGNORECASE)
# Lines that are looked at for a header, below titles, and for the first line of data.
_HEAD_LINES = 12
# What stands before the letter of a coordinate, where all three have it: "Points:0", "pos_x", "Position.Y".
_LETTERS = ({"x": "x", "y": "y", "z": "z"}, {"0": "x", "1": "y", "2": "z"})
_PREFIXED = re.compile(r"(.*[ _:.\-])([xyz012])")
_SUFFIXED = re.compile(r"([xyz])[ _.\-]?(?:m|coord|coordinate|pos|position)")
_SURVEYED = {"easting": "x", "northing": "y", "elevation": "z", "height": "z", "altitude": "z"}
_UNITS = re.compile(r"\[[^\]]*\]|\([^)]*\)")


@dataclass
class _Line:
    """A line that is neither blank nor a comment: its number (from 1), where it begins, and its text."""

    number: int
    offset: int
    text: str


@dataclass
class _Layout:
    """How the lines of a file are to be read."""

    delimiter: str | None
    decimal_comma: bool
    columns: list[int]
    first: _Line
    announced: int | None = None
    warnings: list[str] = field(default_factory=list)


def read_text(path: Path, data: bytes, columns: Columns | None = None, delimiter: str | None = None) -> Raw:
    """Read points of a text file held in ``data``, one a line.

    The separator (semicolon, comma, tab or blanks) is found by the first line of data, and with
    it whether numbers have a decimal comma. Text after ``#`` is a comment. One header line is
    allowed, below titles; it, or a last comment before the data with as many names, says which
    columns are x, y and z ("Points:0", "pos_x" and "easting" are understood). Without names the
    first three columns are taken, or both of two. A first line that
    holds only a number is the number of points (PTS).

    Args:
        path: the file, for messages.
        data: its content, UTF-8.
        columns: names or numbers (from 0) of the columns to take.
        delimiter: the separator, a single character or " " for blanks; None: found.

    Raises:
        FormatError: a line that is not numbers; the text names the line and the value.
    """
    text = data.decode("utf-8-sig", "replace")
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    text = plain_numbers(text)
    comment, head = _head(text)
    if not head:
        raise FormatError(f"{path}: no points in the file")
    layout = _find_layout(path, comment, head, columns, delimiter)
    values = parse_rows(
        path,
        text[layout.first.offset :],
        layout.first.number,
        layout.columns,
        delimiter=layout.delimiter,
        decimal_comma=layout.decimal_comma,
        comments="#",
    )
    if layout.announced is not None and layout.announced != len(values):
        if len(values) < layout.announced:
            raise FormatError(f"{path}: cut off: {layout.announced} points announced, {len(values)} in the file")
        layout.warnings.append(f"{layout.announced} points announced, {len(values)} in the file")
    return Raw(values, layout.warnings)


def plain_numbers(text: str) -> str:
    """Return a text with what Visual C++ writes for infinite and no numbers as others write it."""
    if "1.#" not in text and "an(" not in text and "AN(" not in text:
        return text
    return _MICROSOFT.sub(lambda found: f"{found[1]}inf" if (found[2] or "").upper() == "INF" else "nan", text)


def parse_rows(
    path: Path,
    text: str,
    line: int,
    columns: Sequence[int],
    *,
    delimiter: str | None = None,
    decimal_comma: bool = False,
    comments: str | None = None,
    rows: int | None = None,
) -> FloatArray:
    """Read columns of numbers; blank lines are skipped.

    Args:
        path: the file, for messages.
        text: the lines; they end with a newline character.
        line: number of the first of them in the file.
        columns: places of the columns to take, from 0.
        delimiter: the separator; None: blanks and tabs.
        decimal_comma: commas in the numbers are decimal points.
        comments: the character that begins a comment.
        rows: read at most so many rows.

    Returns:
        (N, len(columns)) float64; N may be less than ``rows``.

    Raises:
        FormatError: a line with too few columns or something else than a number.
    """
    if not text or text.isspace():
        return np.empty((0, len(columns)))
    text = plain_numbers(text)
    if rows is not None:
        # numpy allocates so many before it reads: no more than there are lines.
        rows = min(rows, text.count("\n") + 1)
    prepared = text.replace(",", ".") if decimal_comma else text
    try:
        with warnings.catch_warnings():
            # numpy warns of blank lines beside max_rows, whose meaning it changed once.
            warnings.simplefilter("ignore", UserWarning)
            return np.loadtxt(
                io.StringIO(prepared),
                dtype=np.float64,
                comments=comments,
                delimiter=delimiter,
                usecols=list(columns),
                ndmin=2,
                max_rows=rows,
                quotechar='"',
            )
    except ValueError as error:
        # numpy counts rows, not lines: go through the lines again to name the one at fault.
        for number, content in enumerate(text.splitlines(), line):
            trouble = _complaint(content, columns, delimiter, decimal_comma, comments)
            if trouble:
                raise FormatError(f"{path}, line {number}: {trouble}") from None
        raise FormatError(f"{path}: cannot be read as numbers: {reason(error)}") from error


def _complaint(
    content: str, columns: Sequence[int], delimiter: str | None, decimal_comma: bool, comments: str | None
) -> str:
    """Return what is wrong with a line, or an empty text."""
    if comments:
        content = content.partition(comments)[0]
    if not content.strip():
        return ""
    fields = _fields(content, delimiter)
    for place in columns:
        if place >= len(fields):
            return f"{plural(len(fields), 'column')}, expected at least {max(columns) + 1}"
        if not _is_number(fields[place], decimal_comma):
            return f"{shown(fields[place])!r} is not a number"
    return ""


def _fields(content: str, delimiter: str | None) -> list[str]:
    """Split a line; empty fields at its end are a separator too many and left out."""
    if delimiter is None:
        return [token.strip('"') for token in content.split()]
    try:
        fields = [token.strip() for token in next(csv.reader([content], delimiter=delimiter))]
    except (csv.Error, StopIteration):
        fields = [token.strip() for token in content.split(delimiter)]
    while fields and not fields[-1]:
        fields.pop()
    return fields


def _is_number(token: str, decimal_comma: bool) -> bool:
    if "_" in token or not token.isascii():
        return False
    try:
        float(token.replace(",", ".") if decimal_comma else token)
    except ValueError:
        return False
    return True


def _head(text: str) -> tuple[str, list[_Line]]:
    """Return the last comment before the data, and the first lines that are no comments."""
    comment = ""
    lines: list[_Line] = []
    at = number = 0
    while at < len(text) and len(lines) < _HEAD_LINES:
        end = text.find("\n", at)
        end = len(text) if end < 0 else end
        number += 1
        content = text[at:end].strip()
        # CloudCompare begins its header with two slashes.
        if content.startswith(("#", "//")):
            if not lines:
                comment = content.lstrip("#/ \t")
        elif content:
            lines.append(_Line(number, at, content.partition("#")[0]))
        at = end + 1
    return comment, lines


def _find_layout(
    path: Path, comment: str, head: list[_Line], columns: Columns | None, delimiter: str | None
) -> _Layout:
    guesses: tuple[tuple[str | None, bool], ...] = _GUESSES
    if delimiter is not None:
        sign = None if delimiter == " " else delimiter
        guesses = ((sign, False),) if sign == "," else ((sign, False), (sign, True))
    errors: list[tuple[int, FormatError]] = []
    for sign, comma in guesses:
        try:
            layout = _layout(path, comment, head, columns, sign, comma)
        except FormatError as error:
            errors.append((min(len(_fields(line.text, sign)) for line in head[:2]), error))
            continue
        # Excel writes decimal commas beside semicolons, but the first line may hold whole numbers.
        if sign == ";" and "," in head[-1].text:
            layout.decimal_comma = True
        if layout.decimal_comma:
            layout.warnings.append("commas in the numbers are read as decimal points")
        return layout
    # The first guess that found several columns knows best what is wrong.
    raise next((error for fields, error in errors if fields > 1), errors[-1][1])


def _layout(
    path: Path, comment: str, head: list[_Line], columns: Columns | None, delimiter: str | None, decimal_comma: bool
) -> _Layout:
    """Return how to read the file with this separator.

    Raises:
        FormatError: it makes no sense of the first line of data.
    """
    notes: list[str] = []
    head = _without_titles(head, delimiter, decimal_comma)[:2]
    first = head[0]
    fields = _fields(first.text, delimiter)
    names: list[str] | None = None
    announced = None
    if not any(_is_number(token, decimal_comma) for token in fields):
        if len(head) < 2:
            raise FormatError(f"{path}, line {first.number}: {shown(fields[0] if fields else '')!r} is not a number")
        names = _names(first.text, delimiter)
        first = head[1]
    elif len(fields) == 1 and len(head) == 2 and len(_fields(head[1].text, delimiter)) > 1:
        announced = whole_number(fields[0])
        first = head[1] if announced is not None else first
    fields = _fields(first.text, delimiter)
    if names is None and comment:
        noted = _names(comment, delimiter)
        names = noted if len(noted) == len(fields) and {"x", "y"} <= set(noted) else None
    elif names is not None and len(names) != len(fields):
        notes.append(f"the header names {plural(len(names), 'column')}, but there are {len(fields)}")
        names = None
    if columns is None and names is not None:
        names = _coordinates(names)
    if columns is None and not (names and {"x", "y"} <= set(names)):
        if len(fields) < 2:
            raise FormatError(
                f"{path}, line {first.number}: {shown(first.text.strip())!r} is one column, a point takes two or three"
            )
        if first is not head[0] and announced is None:
            notes.append(f"the header names no x and y; the first {min(len(fields), 3)} columns are used")
        chosen = list(range(min(len(fields), 3)))
    else:
        chosen = choose_columns(path, names or [str(k) for k in range(len(fields))], columns, "columns")
    trouble = _complaint(first.text, chosen, delimiter, decimal_comma, None)
    if trouble:
        raise FormatError(f"{path}, line {first.number}: {trouble}")
    return _Layout(delimiter, decimal_comma, chosen, first, announced, notes)


def _without_titles(head: list[_Line], delimiter: str | None, decimal_comma: bool) -> list[_Line]:
    """Return the lines from the header on, where titles stand above it, else all of them."""

    def numbers_of(line: _Line) -> tuple[int, int]:
        fields = _fields(line.text, delimiter)
        return sum(_is_number(token, decimal_comma) for token in fields), len(fields)

    for k, line in enumerate(head[:-1]):
        found, fields = numbers_of(line)
        after, there = numbers_of(head[k + 1])
        # Names above as many fields of data, with numbers among them: the header. What is above it are titles.
        if found == 0 and fields > 1 and after > 1 and there == fields:
            return head[k:]
        if fields > 1 and found == fields:
            break  # data
    return head


def _coordinates(names: list[str]) -> list[str]:
    """Return the names of a header with x, y and z for the one set of columns that are coordinates by other names."""
    if {"x", "y"} <= set(names):
        return names
    for letters in _LETTERS:
        groups: dict[str, dict[str, int]] = {}
        for place, name in enumerate(names):
            found = _PREFIXED.fullmatch(name)
            if found and found[2] in letters and not re.search("norm|vel|rot|col|acc|rgb", found[1]):
                groups.setdefault(found[1], {})[letters[found[2]]] = place
        whole = [group for group in groups.values() if {"x", "y"} <= set(group)]
        if len(whole) == 1:
            return _renamed(names, whole[0])
    for by in (lambda name: (_SUFFIXED.fullmatch(name) or [None, None])[1], _SURVEYED.get):
        places: dict[str, int] = {}
        for place, name in enumerate(names):
            letter = by(name)
            if letter is not None:
                places.setdefault(letter, place)
        if {"x", "y"} <= set(places):
            return _renamed(names, places)
    return names


def _renamed(names: list[str], places: dict[str, int]) -> list[str]:
    out = list(names)
    for letter, place in places.items():
        out[place] = letter
    return out


def _names(content: str, delimiter: str | None) -> list[str]:
    """Return the names of a header in lower case, without quotes and units in brackets."""
    return [token.strip(' "/').lower() for token in _fields(_UNITS.sub("", content.lstrip("/")), delimiter)]
