"""PCD, the point cloud files of PCL: ascii, binary and binary_compressed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import FormatError
from hexmap.base.text import plural, shown, whole_number
from hexmap.io.clouds.columns import Columns, Raw, choose_columns, further_columns, gather
from hexmap.io.clouds.lzf import LzfError, inflate

__all__ = ["read_pcd"]

_KEYS = ("VERSION", "FIELDS", "COLUMNS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
_KINDS = ("ascii", "binary", "binary_compressed")
_SIZES = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}
_LETTERS = {"F": "f", "I": "i", "U": "u"}
# No LZF instruction makes more of its bytes: 3 bytes become 264.
_LZF_RATIO = 88
_LONGEST_HEADER = 1 << 20
_MOST_VALUES = 1 << 20


@dataclass
class _Header:
    """The header of a PCD file: its entries, the lines they stand on, and where the data begin."""

    path: Path
    entries: dict[str, list[str]] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)
    start: int = 0
    start_line: int = 0
    names: list[str] = field(default_factory=list)
    sizes: list[int] = field(default_factory=list)
    types: list[str] = field(default_factory=list)
    counts: list[int] = field(default_factory=list)
    points: int = 0
    kind: str = ""

    def error(self, key: str, text: str) -> FormatError:
        """Return an error that names the line of ``key``, where the header has one."""
        where = f", line {self.lines[key]}" if key in self.lines else ""
        return FormatError(f"{self.path}{where}: {text}")

    def numbers(self, key: str, count: int, default: int | None = None) -> list[int]:
        """Return ``count`` whole numbers of an entry."""
        if key not in self.entries:
            if default is None:
                raise FormatError(f"{self.path}: the PCD header has no {key}")
            return [default] * count
        tokens = self.entries[key]
        if len(tokens) != count:
            raise self.error(key, f"{key} has {plural(len(tokens), 'value')}, expected {count}")
        values = []
        for token in tokens:
            value = whole_number(token)
            if value is None:
                raise self.error(key, f"{key} {shown(token)!r} is not a whole number")
            values.append(value)
        return values


def read_pcd(path: Path, data: bytes, columns: Columns | None = None, further: Sequence[str] = ()) -> Raw:
    """Read x, y (and z) of a PCD file held in ``data``.

    Fields of any type and size, and others beside the coordinates, are understood. VIEWPOINT,
    the pose that the cloud was taken from, is not applied: points are as they are stored.

    Args:
        path: the file, for messages.
        data: its content.
        columns: names of the fields to take instead of x, y, z.
        further: names of fields to take beside them, where the file has them.

    Raises:
        FormatError: the file is damaged, cut off or has no such fields.
    """
    header = _read_header(path, data)
    warnings = []
    view = header.entries.get("VIEWPOINT", [])
    if view and _floats(view) != [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]:
        warnings.append(f"VIEWPOINT {shown(' '.join(view), 60)} is not applied")
    chosen = choose_columns(path, header.names, columns, "fields")
    for place in chosen:
        if header.counts[place] != 1:
            raise header.error(
                "COUNT", f"field {header.names[place]!r} has {header.counts[place]} values a point, expected 1"
            )
    beside = further_columns(header.names, [count == 1 for count in header.counts], further)
    chosen += beside.values()
    if header.points == 0:
        values = np.empty((0, len(chosen)))
    elif header.kind == "ascii":
        values = _read_ascii(header, data, chosen)
    elif header.kind == "binary":
        values = _read_binary(header, data, chosen)
    else:
        values = _read_compressed(header, data, chosen)
    return Raw.of(values, list(beside), warnings)


def _floats(tokens: list[str]) -> list[float] | None:
    try:
        return [float(token) for token in tokens]
    except ValueError:
        return None


def _read_header(path: Path, data: bytes) -> _Header:
    header = _Header(path)
    at = number = 0
    while "DATA" not in header.entries:
        if at >= min(len(data), _LONGEST_HEADER):
            raise FormatError(f"{path}: the PCD header has no DATA line; the file is cut off or no PCD file")
        number += 1
        end = data.find(b"\n", at)
        end = len(data) if end < 0 else end
        line, at = data[at : min(end, at + _LONGEST_HEADER)], end + 1
        tokens = line.decode("utf-8", "replace").split()
        if not tokens or tokens[0].startswith("#"):
            continue
        if tokens[0].upper() not in _KEYS:
            if end == len(data) and number > 1:
                continue  # half a line: the file ends in the header
            raise FormatError(f"{path}, line {number}: {shown(tokens[0])!r} is not an entry of a PCD header")
        key = tokens[0].upper()
        key = "FIELDS" if key == "COLUMNS" else key
        header.entries[key], header.lines[key] = tokens[1:], number
    header.start, header.start_line = min(at, len(data)), number + 1

    kind = " ".join(header.entries["DATA"]).lower()
    if kind not in _KINDS:
        raise header.error("DATA", f"DATA {shown(kind)!r} is not one of {', '.join(_KINDS)}")
    header.kind = kind
    header.names = header.entries.get("FIELDS", [])
    if not header.names:
        raise header.error("FIELDS", "the PCD header names no FIELDS")
    n = len(header.names)
    header.sizes, header.counts = header.numbers("SIZE", n), header.numbers("COUNT", n, 1)
    if sum(header.counts) > _MOST_VALUES:
        raise header.error("COUNT", f"{sum(header.counts)} values a point are more than {_MOST_VALUES}")
    header.types = [letter.upper() for letter in header.entries.get("TYPE", [])]
    if len(header.types) != n:
        raise header.error("TYPE", f"TYPE has {plural(len(header.types), 'value')}, expected {n}")
    for size, letter in zip(header.sizes, header.types, strict=True):
        if size not in _SIZES.get(letter, ()):
            raise header.error("TYPE", f"a field of TYPE {shown(letter)!r} and SIZE {size} is unknown")
    area = None
    if "WIDTH" in header.entries or "POINTS" not in header.entries:
        area = header.numbers("WIDTH", 1)[0] * header.numbers("HEIGHT", 1, 1)[0]
    header.points = header.numbers("POINTS", 1, area)[0]
    if area is not None and area != header.points:
        raise header.error("POINTS", f"POINTS {header.points} is not WIDTH times HEIGHT, {area}")
    return header


def _read_ascii(header: _Header, data: bytes, chosen: list[int]) -> FloatArray:
    from hexmap.io.clouds.text import parse_rows

    firsts = np.cumsum([0, *header.counts])
    text = data[header.start :].decode("utf-8", "replace")
    columns = [int(firsts[place]) for place in chosen]
    values = parse_rows(header.path, text, header.start_line, columns, rows=header.points)
    if len(values) < header.points:
        raise FormatError(f"{header.path}: cut off: {header.points} points announced, {len(values)} in the file")
    return values


def _record(header: _Header) -> tuple[list[str], int]:
    """Return the fields' numpy types and the bytes of a point."""
    formats = [f"<{_LETTERS[letter]}{size}" for letter, size in zip(header.types, header.sizes, strict=True)]
    return formats, sum(size * count for size, count in zip(header.sizes, header.counts, strict=True))


def _read_binary(header: _Header, data: bytes, chosen: list[int]) -> FloatArray:
    formats, width = _record(header)
    have = len(data) - header.start
    if have < header.points * width:
        raise FormatError(
            f"{header.path}, byte {len(data)}: cut off: {header.points} points of {width} bytes announced, "
            f"{have // width} in the file"
        )
    firsts = np.cumsum([0] + [s * c for s, c in zip(header.sizes, header.counts, strict=True)])
    names = [f"c{k}" for k in range(len(chosen))]
    record = np.dtype(
        {
            "names": names,
            "formats": [formats[place] for place in chosen],
            "offsets": [int(firsts[place]) for place in chosen],
            "itemsize": width,
        }
    )
    return gather(np.frombuffer(data, dtype=record, count=header.points, offset=header.start), names)


def _read_compressed(header: _Header, data: bytes, chosen: list[int]) -> FloatArray:
    path, start = header.path, header.start
    formats, width = _record(header)
    if len(data) < start + 8:
        raise FormatError(f"{path}, byte {len(data)}: cut off before the sizes of the compressed data")
    packed, size = (int(v) for v in np.frombuffer(data, dtype="<u4", count=2, offset=start))
    if size != header.points * width:
        raise FormatError(
            f"{path}, byte {start + 4}: {size} bytes of data announced, "
            f"but {header.points} points of {width} bytes are {header.points * width}"
        )
    if len(data) < start + 8 + packed:
        raise FormatError(
            f"{path}, byte {len(data)}: cut off: {packed} compressed bytes announced, "
            f"{len(data) - start - 8} in the file"
        )
    if size > packed * _LZF_RATIO:
        raise FormatError(f"{path}, byte {start}: {packed} compressed bytes cannot hold {size} bytes")
    try:
        plain = np.frombuffer(inflate(data[start + 8 : start + 8 + packed], size), dtype=np.uint8)
    except LzfError as error:
        raise FormatError(f"{path}, byte {start + 8 + error.at}: the compressed data are damaged") from error
    # Field after field, each for all points: the order in which coordinates compress well.
    firsts = np.cumsum([0] + [s * c * header.points for s, c in zip(header.sizes, header.counts, strict=True)])
    values = np.empty((header.points, len(chosen)), dtype=np.float64)
    with np.errstate(invalid="ignore"):
        for k, place in enumerate(chosen):
            begin = int(firsts[place])
            values[:, k] = plain[begin : begin + header.sizes[place] * header.points].view(formats[place])
    return values
