"""PLY, the Stanford polygon files: ascii, binary little endian and binary big endian."""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import FormatError
from hexmap.base.text import plural, shown, whole_number
from hexmap.io.clouds.columns import Columns, Raw, choose_columns, further_columns, gather

__all__ = ["read_ply"]

_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES = {
    "char": "b", "int8": "b", "uchar": "B", "uint8": "B",
    "short": "h", "int16": "h", "ushort": "H", "uint16": "H",
    "int": "i", "int32": "i", "uint": "I", "uint32": "I", "int64": "q", "uint64": "Q",
    "float": "f", "float32": "f", "double": "d", "float64": "d",
}  # fmt: skip
_LONGEST_HEADER = 1 << 20


@dataclass(frozen=True)
class _Property:
    """One property: its ``struct`` letter, and that of the length before it where it is a list."""

    name: str
    letter: str
    length: str | None = None


@dataclass
class _Element:
    """One element: a table of ``count`` rows."""

    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)

    @property
    def has_lists(self) -> bool:
        """Whether rows differ in size."""
        return any(p.length is not None for p in self.properties)

    def width(self) -> int:
        """Return the bytes of a row without lists."""
        return sum(struct.calcsize("<" + p.letter) for p in self.properties)


def read_ply(path: Path, data: bytes, columns: Columns | None = None, further: Sequence[str] = ()) -> Raw:
    """Read x, y (and z) of the element ``vertex`` of a PLY file held in ``data``.

    Properties of any numeric type, list properties, and other elements before and after the
    vertices are understood; faces are ignored.

    Args:
        path: the file, for messages.
        data: its content.
        columns: names of the properties to take instead of x, y, z.
        further: names of properties to take beside them, where the file has them.

    Raises:
        FormatError: the file is damaged, cut off or has no such properties.
    """
    order, elements, start, line = _read_header(path, data)
    before: list[_Element] = []
    for element in elements:
        if element.name == "vertex":
            break
        before.append(element)
    else:
        have = " ".join(shown(element.name) for element in elements)
        raise FormatError(f"{path}: no element 'vertex' in the file, only: {have or 'none'}")
    chosen = choose_columns(path, [p.name for p in element.properties], columns, "properties of 'vertex'")
    for place in chosen:
        if element.properties[place].length is not None:
            raise FormatError(f"{path}: the property {shown(element.properties[place].name)!r} is a list, not a number")
    is_number = [p.length is None for p in element.properties]
    beside = further_columns([p.name for p in element.properties], is_number, further)
    chosen += beside.values()
    if element.count == 0:
        values = np.empty((0, len(chosen)))
    elif not order:
        values = _read_ascii(path, data, start, line, before, element, chosen)
    else:
        for other in before:
            start = _walk(path, data, start, other, order, [])[1]
        if element.has_lists:
            values = _walk(path, data, start, element, order, chosen)[0]
        else:
            values = _read_binary(path, data, start, element, order, chosen)
    return Raw.of(values, list(beside))


def _read_header(path: Path, data: bytes) -> tuple[str, list[_Element], int, int]:
    """Return the byte order ("" for ascii), the elements, and the byte and line where the data begin."""
    begin = re.match(rb"ply[ \t]*(\r\n|\n|\r)", data)
    if begin is None:
        raise FormatError(f"{path}, line 1: {shown(data[:8])!r} is not the 'ply' that a PLY file begins with")
    # The first line tells how lines end: after a lone CR, a byte 10 belongs to the data already.
    newline = begin.group(1)
    order: str | None = None
    elements: list[_Element] = []
    at, number = begin.end(), 1
    while True:
        number += 1
        end = data.find(newline, at, at + _LONGEST_HEADER)
        if end < 0 or at > _LONGEST_HEADER:
            raise FormatError(f"{path}: the PLY header has no end_header; the file is cut off or no PLY file")
        tokens = data[at:end].decode("utf-8", "replace").split()
        at = end + len(newline)
        if not tokens or tokens[0] in ("comment", "obj_info"):
            continue
        if tokens[0] == "end_header":
            break
        if tokens[0] == "format" and len(tokens) >= 2:
            if tokens[1] not in _ORDERS:
                known = ", ".join(_ORDERS)
                raise FormatError(f"{path}, line {number}: format {shown(tokens[1])!r} is not one of {known}")
            order = _ORDERS[tokens[1]]
        elif tokens[0] == "element" and len(tokens) == 3:
            count = whole_number(tokens[2])
            if count is None:
                raise FormatError(f"{path}, line {number}: {shown(tokens[2])!r} is not a number of elements")
            elements.append(_Element(tokens[1], count))
        elif tokens[0] == "property" and elements:
            elements[-1].properties.append(_property(path, number, tokens))
        else:
            raise FormatError(f"{path}, line {number}: {shown(' '.join(tokens), 40)!r} is not a line of a PLY header")
    if order is None:
        raise FormatError(f"{path}: the PLY header has no format line")
    return order, elements, at, number + 1


def _property(path: Path, number: int, tokens: list[str]) -> _Property:
    is_list = len(tokens) == 5 and tokens[1] == "list"
    kinds = tokens[2:4] if is_list else tokens[1:2]
    if not is_list and len(tokens) != 3:
        raise FormatError(f"{path}, line {number}: {shown(' '.join(tokens), 40)!r} is not a property")
    for kind in kinds:
        if kind not in _TYPES:
            raise FormatError(f"{path}, line {number}: the type {shown(kind)!r} is unknown")
    if is_list and _TYPES[kinds[0]] in "fd":
        raise FormatError(f"{path}, line {number}: the length of a list cannot be of type {shown(kinds[0])!r}")
    return _Property(tokens[-1], _TYPES[kinds[-1]], _TYPES[kinds[0]] if is_list else None)


def _cut_off(path: Path, at: int, element: _Element, row: int) -> FormatError:
    return FormatError(
        f"{path}, byte {at}: cut off: {element.count} of {shown(element.name)!r} announced, {row} in the file"
    )


def _read_binary(path: Path, data: bytes, start: int, element: _Element, order: str, chosen: list[int]) -> FloatArray:
    """Read an element without lists."""
    width = element.width()
    have = (len(data) - start) // width
    if have < element.count:
        raise _cut_off(path, len(data), element, have)
    names = [f"c{k}" for k in range(len(chosen))]
    sizes = [struct.calcsize("<" + p.letter) for p in element.properties]
    record = np.dtype(
        {
            "names": names,
            "formats": [np.dtype(order + element.properties[place].letter) for place in chosen],
            "offsets": [sum(sizes[:place]) for place in chosen],
            "itemsize": width,
        }
    )
    return gather(np.frombuffer(data, dtype=record, count=element.count, offset=start), names)


def _walk(path: Path, data: bytes, at: int, element: _Element, order: str, chosen: list[int]) -> tuple[FloatArray, int]:
    """Go through an element row by row where its lists make rows differ; returns values and where it ends."""
    if not element.has_lists:
        width = element.width()
        if at + width * element.count > len(data):
            raise _cut_off(path, len(data), element, (len(data) - at) // width)
        return np.empty((0, 0)), at + width * element.count
    steps = []
    for place, p in enumerate(element.properties):
        size = struct.calcsize("<" + p.letter)
        column = chosen.index(place) if place in chosen else -1
        # A column asked for twice is filled from its first place below.
        steps.append((struct.Struct(order + (p.length or p.letter)), size, p.length is not None, column))
    rows: list[list[float]] = []
    for row in range(element.count):
        values = [0.0] * len(chosen)
        try:
            for reader, size, is_list, column in steps:
                if is_list:
                    length = reader.unpack_from(data, at)[0]
                    if length < 0:
                        raise FormatError(f"{path}, byte {at}: a list of length {length}")
                    at += reader.size + length * size
                else:
                    if column >= 0:
                        values[column] = float(reader.unpack_from(data, at)[0])
                    at += size
        except struct.error:
            raise _cut_off(path, len(data), element, row) from None
        if at > len(data):
            raise _cut_off(path, len(data), element, row)
        if chosen:
            rows.append([values[chosen.index(place)] for place in chosen])
    return np.array(rows, dtype=np.float64).reshape(len(rows), len(chosen)), at


def _read_ascii(
    path: Path, data: bytes, at: int, line: int, before: list[_Element], element: _Element, chosen: list[int]
) -> FloatArray:
    from hexmap.io.clouds.text import parse_rows, plain_numbers

    text = plain_numbers(data[at:].decode("utf-8", "replace").replace("\r\n", "\n").replace("\r", "\n"))
    place = 0
    for other in before:
        for row in range(other.count if other.properties else 0):
            found = False
            while not found:
                end = text.find("\n", place)
                if end < 0:
                    raise FormatError(
                        f"{path}: cut off: {other.count} of {shown(other.name)!r} announced, {row} in the file"
                    )
                # A blank line is no row.
                found = not text[place:end].isspace() and end > place
                place, line = end + 1, line + 1
    text = text[place:]
    if element.has_lists:
        values = _walk_ascii(path, text, line, element, chosen)
    else:
        values = parse_rows(path, text, line, chosen, rows=element.count)
    if len(values) < element.count:
        raise FormatError(f"{path}: cut off: {element.count} of 'vertex' announced, {len(values)} in the file")
    return values


def _walk_ascii(path: Path, text: str, line: int, element: _Element, chosen: list[int]) -> FloatArray:
    """Read rows of text whose lists make them differ in length."""
    rows: list[list[float]] = []
    for number, content in enumerate(text.splitlines(), line):
        tokens = content.split()
        if not tokens:
            continue
        if len(rows) == element.count:
            break
        at, values, token = 0, [], ""
        try:
            for p in element.properties:
                token = tokens[at]
                if p.length is None:
                    values.append(float(token))
                    at += 1
                else:
                    length = int(token)
                    if length < 0:
                        raise ValueError
                    values.append(0.0)
                    at += 1 + length
        except IndexError:
            raise FormatError(f"{path}, line {number}: {plural(len(tokens), 'number')}, more expected") from None
        except ValueError:
            raise FormatError(f"{path}, line {number}: {shown(token)!r} is not a number that can stand there") from None
        rows.append([values[place] for place in chosen])
    return np.array(rows, dtype=np.float64).reshape(len(rows), len(chosen))
