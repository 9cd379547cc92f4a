"""Read the points of a file: its format is found by its content, then by its name."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError, FormatError
from hexmap.base.text import plural, shown
from hexmap.base.values import one_line
from hexmap.io import file_kinds
from hexmap.io.clouds.columns import Columns, Raw
from hexmap.io.clouds.ptx import begins_ptx, read_ptx
from hexmap.io.read_file import read_file

__all__ = ["FORMATS", "PointFile", "read_points"]

FORMATS = ("pcd", "ply", "text", "kitti", "npy", "ptx")

_ALIASES = {"xyz": "text", "txt": "text", "csv": "text", "asc": "text", "pts": "text", "bin": "kitti"}
_DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "blank": " ", "space": " "}
_FAR = 1e5  # metres: coordinates beyond are those of surveyors, not of a sensor
_FARTHEST = 1e9
_ROUND = 100.0  # metres: what an offset that is found is a multiple of
_UNITS = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
_KNOWN = "PCD, PLY, PTX, text (XYZ, CSV), a KITTI scan (.bin) and NPY are read"
_CARMEN = re.compile(rb"^(?:[FR]LASER|ROBOTLASER[12]|ODOM|PARAM)[ \t]", re.MULTILINE)
# How to make points of what holds points or surfaces in another format.
_CONVERSIONS = {
    file_kinds.LAS: "convert it to PLY or text first",
    file_kinds.E57: "convert it to PLY or text first",
    file_kinds.GLTF: "convert it to PLY first",
    file_kinds.STL: "convert it to PLY first",
}


@dataclass(frozen=True, eq=False)
class PointFile:
    """The points of a file.

    Attributes:
        points: (N, 2) or (N, 3) float64, contiguous, metres, all finite, N >= 1. Not read-only:
            kernels would compile again for such arrays.
        dropped: points of the file that were left out because a coordinate was not finite.
        path: the file.
        format: what it was read as, one of ``FORMATS``.
        warnings: what was not as it should be, one line each, each naming the file.
        offset: (n,) metres that were taken off the points: what is at 0 here is there in the file's coordinates.
        further: further columns (N,) float64 by their names, those that were asked for and are in the file.
    """

    points: NDArray[np.float64]
    dropped: int
    path: Path
    format: str
    warnings: tuple[str, ...] = ()
    offset: tuple[float, ...] = ()
    further: dict[str, NDArray[np.float64]] = field(default_factory=dict)

    __repr__ = one_line

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.points)

    @property
    def dim(self) -> int:
        """2 or 3."""
        return int(self.points.shape[1])


def read_points(
    path: str | os.PathLike[str],
    *,
    format: str | None = None,
    units: str | float = "m",
    axes: str = "xyz",
    columns: Sequence[str | int] | None = None,
    delimiter: str | None = None,
    offset: Sequence[float] | Literal["auto"] | None = None,
    further: Sequence[str] = (),
) -> PointFile:
    """Read the points of a file; its format is found by its content, then by its name.

    Read are PCD (ascii, binary, binary_compressed), PLY (ascii, binary of either endianness),
    text (XYZ, TXT, CSV: separator, header and comments are found), PTX, KITTI scans (.bin: float32
    x y z intensity, or with another number of columns) and NPY, each plain or inside gzip. Points
    come in the order of the file; those with a coordinate that is not finite are dropped and
    counted. The VIEWPOINT of a PCD file is not applied.

    Args:
        path: the file.
        format: "pcd", "ply", "text" (also "xyz", "txt", "csv", "asc", "pts"), "kitti" (also
            "bin") or "npy"; None: found.
        units: what the file's numbers count: "m", "cm", "mm", or metres as a number.
        axes: where x, y and z of the result come from, as a signed permutation: "x,-z,y" makes
            y of the file's -z and z of its y (a camera's frame to x forward is "z,-x,-y"). For
            points of the plane "xyz" is "xy".
        columns: two or three columns to take instead of x, y and z: names of fields, or numbers
            from 0 where columns have no names. Of a .bin also all names of a point's numbers, x, y and z among
            them, or how many there are ("5").
        delimiter: separator of a text file, a character or "comma", "semicolon", "tab",
            "blank"; None: found.
        offset: metres that are taken off the points, along the axes of the result: coordinates of surveyors, millions
            of metres large, fit no lattice's indices. "auto": the first point, to whole hundreds of metres, where a
            coordinate is beyond 100 km. None: nothing.
        further: names, in small letters, of columns to return beside the points where a PCD or PLY file has them, such
            as the time of each point.

    Raises:
        ArgumentError: an unknown format, unit, axes or delimiter, columns that are not two or three, or an offset that
            is not a finite number a coordinate.
        FileAccessError: the file is not there or cannot be read.
        FormatError: the file is empty, damaged, cut off or of another kind; the text names the
            file and, where there is one, the line or the byte.
    """
    path = Path(path)
    asked = _checked_format(format)
    scale = _checked_units(units)
    order = _checked_axes(axes)
    wanted = _checked_columns(columns)
    separator = _checked_delimiter(delimiter)
    shift = _checked_offset(offset)
    data = read_file(path)
    kind = asked or _find_format(path, data)
    if separator is not None and kind != "text":
        raise ArgumentError(f"{path}: a delimiter is for text, not for a file of format {kind}")
    if wanted is not None and len(wanted) not in (2, 3) and kind != "kitti":
        raise ArgumentError(f"columns of a file of format {kind} are two or three, not {columns!r}")
    # nuScenes' files have the ring as well.
    usual = 5 if asked is None and path.name.lower().removesuffix(".gz").endswith(".pcd.bin") else 4
    raw = _reader(kind, separator, usual, further)(path, data, wanted)
    values, kept, warnings = _in_metres(path, raw, order, axes, scale)
    coarse = _coarseness(raw.values, kind)
    if coarse:
        warnings.append(coarse)
    values, taken_off = _without_offset(path, values, shift, warnings)
    return PointFile(
        points=np.ascontiguousarray(values),
        dropped=len(kept) - int(np.count_nonzero(kept)),
        path=path,
        format=kind,
        warnings=tuple(f"{path.name}: {text}" for text in warnings),
        offset=taken_off,
        further={name: column[kept] for name, column in raw.further.items()},
    )


def _in_metres(
    path: Path, raw: Raw, order: list[tuple[int, float]], axes: str, scale: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.bool_], list[str]]:
    """Return the finite points in metres along the axes, which of all points these are, and warnings."""
    if len(raw.values) == 0:
        raise FormatError(f"{path}: no points in the file")
    values = _oriented(path, raw.values, order, axes)
    with np.errstate(over="ignore", invalid="ignore"):
        # A division, because 1/100 has no exact float64 and 7 cm would not be 0.07 m.
        values = values / scale[1] if scale[1] != 1.0 else values * scale[0]
    finite = np.asarray(np.isfinite(values).all(axis=1))
    dropped = len(values) - int(np.count_nonzero(finite))
    if dropped == len(values):
        raise FormatError(f"{path}: none of the {plural(dropped, 'point')} in the file is finite")
    warnings = list(raw.warnings)
    if dropped:
        warnings.append(f"{plural(dropped, 'point')} of {len(values)} dropped, not finite")
        values = values[finite]
    if _is_mirror(order[: values.shape[1]]):
        warnings.append(f"the axes {axes!r} mirror the points")
    return values, finite, warnings


def _checked_offset(offset: Sequence[float] | str | None) -> tuple[float, ...] | str:
    """Return the offset; empty where there is none."""
    if offset is None:
        return ()
    if isinstance(offset, str):
        if offset == "auto":
            return offset
        offset = ()
    try:
        found = tuple(float(v) for v in offset)
    except (TypeError, ValueError):
        found = ()
    if len(found) not in (2, 3) or not all(math.isfinite(v) for v in found):
        raise ArgumentError(f"an offset is two or three finite numbers of metres, or 'auto', not {offset!r}")
    return found


def _without_offset(
    path: Path, values: NDArray[np.float64], offset: tuple[float, ...] | str, warnings: list[str]
) -> tuple[NDArray[np.float64], tuple[float, ...]]:
    """Return the points less the offset, and the offset."""
    if isinstance(offset, str):
        if not (np.abs(values) > _FAR).any():
            return values, ()
        first = np.round(values[0] / _ROUND) * _ROUND
        # What is farther than anything on Earth is damage, not a survey.
        surveyed = (np.abs(first) > _FAR / 2) & (np.abs(first) < _FARTHEST)
        offset = tuple(float(v) for v in np.where(surveyed, first, 0.0))
        if not any(offset):
            return values, ()
        words = ",".join(f"{v:.10g}" for v in offset)
        warnings.append(f"coordinates beyond {_FAR:.0f} m; {words} m is taken off them (offset)")
    if not offset:
        return values, ()
    if len(offset) != values.shape[1]:
        raise ArgumentError(f"{path}: an offset of {len(offset)} numbers for points of dimension {values.shape[1]}")
    with np.errstate(over="ignore"):
        moved = values - np.array(offset)
    if not np.isfinite(moved).all():
        raise ArgumentError(f"{path}: less the offset {offset} the points are not finite")
    return moved, offset


def _coarseness(values: NDArray[np.float64], kind: str) -> str:
    """Return a warning where the file's single precision cannot tell points of a few centimetres apart."""
    with np.errstate(over="ignore", invalid="ignore"):
        most = float(np.abs(values[np.isfinite(values).all(axis=1)]).max(initial=0.0))
        if kind == "text" or most < _FAR or not np.array_equal(values.astype(np.float32), values, equal_nan=True):
            return ""
    step = float(np.spacing(np.float32(most)))
    return f"coordinates up to {most:.10g} in single precision: they stand in steps of {step:g} in the file"


def _reader(
    kind: str, separator: str | None, usual: int, further: Sequence[str]
) -> Callable[[Path, bytes, Columns | None], Raw]:
    if kind == "pcd":
        from hexmap.io.clouds.pcd import read_pcd

        return lambda path, data, columns: read_pcd(path, data, columns, further)
    if kind == "ply":
        from hexmap.io.clouds.ply import read_ply

        return lambda path, data, columns: read_ply(path, data, columns, further)
    if kind in ("kitti", "npy"):
        from hexmap.io.clouds.binary import read_kitti, read_npy

        if kind == "npy":
            return read_npy
        return lambda path, data, columns: read_kitti(path, data, columns, usual)
    if kind == "ptx":
        return read_ptx
    from hexmap.io.clouds.text import read_text

    return lambda path, data, columns: read_text(path, data, columns, separator)


def _find_format(path: Path, data: bytes) -> str:
    """Tell the format by the content, else by the name.

    Raises:
        FormatError: the file is of another kind.
    """
    head = data[:4096]
    for kind, name in ((file_kinds.NPY, "npy"), (file_kinds.PLY, "ply"), (file_kinds.PCD, "pcd")):
        if kind.begins(head):
            return name
    suffixes = [suffix.lower() for suffix in path.suffixes if suffix.lower() != ".gz"]
    if suffixes[-1:] == [".bin"]:
        # Before the foreign kinds: any bytes may begin a scan.
        return "kitti"
    foreign = file_kinds.find_kind(head)
    if foreign is not None:
        advice = foreign.advice or _CONVERSIONS.get(foreign, "")
        raise FormatError(f"{path}: this is {foreign.name}; {f'{advice}; ' if advice else ''}{_KNOWN}")
    if begins_ptx(head):
        return "ptx"
    if suffixes[-1:] in ([".pcd"], [".ply"], [".npy"], [".ptx"]):
        # The name promises a format whose mark is missing: its reader says best what is wrong.
        return suffixes[-1][1:]
    if re.match(rb"\s*<(?:!doctype|html|\?xml)", head, re.IGNORECASE):
        raise FormatError(f"{path}, line 1: this is HTML or XML, {shown(head.strip()[:16])!r}; {_KNOWN}")
    if _CARMEN.search(head):
        raise FormatError(f"{path}: this is a CARMEN log, not points; its points need its poses")
    if suffixes[-1:] == [".tum"]:
        # Its numbers would pass for points, the first of them being the time.
        raise FormatError(f"{path}: this is a trajectory by its name, not points; say format 'text' if it holds points")
    at = file_kinds.control_byte(head)
    if at is not None:
        raise FormatError(f"{path}, byte {at}: the file is binary ({head[at]:#04x}) and of no known kind; {_KNOWN}")
    return "text"


def _checked_format(format: str | None) -> str | None:
    if format is None:
        return None
    kind = str(format).lower().lstrip(".")
    kind = _ALIASES.get(kind, kind)
    if kind not in FORMATS:
        raise ArgumentError(f"format must be one of {', '.join((*FORMATS, *_ALIASES))}, not {format!r}")
    return kind


def _checked_units(units: str | float) -> tuple[float, float]:
    """Return what to multiply with and what to divide by; one of them is 1."""
    if isinstance(units, str) and units in _UNITS:
        return 1.0, _UNITS[units]
    try:
        metres = float(units)
    except (TypeError, ValueError):
        metres = math.nan
    if not (math.isfinite(metres) and metres > 0.0):
        raise ArgumentError(f"units must be m, cm, mm or a positive number of metres, not {units!r}")
    return metres, 1.0


def _checked_axes(axes: str) -> list[tuple[int, float]]:
    """Return column and sign of each axis of the result."""
    text = re.sub(r"[\s,]", "", str(axes).lower())
    found = re.findall(r"([+-]?)([xyz])", text)
    letters = "".join(letter for _, letter in found)
    if "".join(sign + letter for sign, letter in found) != text or sorted(letters) not in (["x", "y"], ["x", "y", "z"]):
        raise ArgumentError(f"axes must be a signed permutation of xyz such as 'x,-z,y' or 'xzy', not {axes!r}")
    return [("xyz".index(letter), -1.0 if sign == "-" else 1.0) for sign, letter in found]


def _checked_columns(columns: Sequence[str | int] | None) -> Columns | None:
    if columns is None:
        return None
    wanted = list(columns.split(",")) if isinstance(columns, str) else list(columns)
    good = all(isinstance(c, str) or (isinstance(c, (int, np.integer)) and c >= 0) for c in wanted)
    words = {str(column).strip().lower() for column in wanted}
    # What only a .bin can have: all names of a point's numbers, or how many there are.
    layout = (len(wanted) == 1 and str(wanted[0]).isdecimal()) or (3 < len(wanted) <= 64 and {"x", "y"} <= words)
    if not good or not (len(wanted) in (2, 3) or layout):
        raise ArgumentError(f"columns must be two or three names, or numbers from 0, not {columns!r}")
    return wanted


def _checked_delimiter(delimiter: str | None) -> str | None:
    if delimiter is None:
        return None
    sign = _DELIMITERS.get(delimiter, delimiter)
    # Anything a number or a quoted field may hold cannot separate them.
    if len(sign) != 1 or sign.isalnum() or sign in '+-."#\n\r':
        raise ArgumentError(f"delimiter must be one character or one of {', '.join(_DELIMITERS)}, not {delimiter!r}")
    return sign


def _oriented(
    path: Path, values: NDArray[np.float64], order: list[tuple[int, float]], axes: str
) -> NDArray[np.float64]:
    """Return the columns in the order of the axes, with their signs."""
    n = values.shape[1]
    if n == 2 and len(order) == 3 and order[2] == (2, 1.0):
        order = order[:2]
    if len(order) != n:
        raise ArgumentError(f"{path}: axes {axes!r} do not fit points of dimension {n}")
    columns = [column for column, _ in order]
    signs = np.array([sign for _, sign in order])
    if columns == list(range(n)) and (signs > 0).all():
        return values
    # Zeros keep no sign: -0.0 would be another point to whoever compares bytes.
    return values[:, columns] * signs + 0.0


def _is_mirror(order: list[tuple[int, float]]) -> bool:
    """Tell whether the axes turn a right-handed frame into a left-handed one."""
    matrix = np.zeros((len(order), len(order)))
    for row, (column, sign) in enumerate(order):
        matrix[row, column] = sign
    return bool(np.linalg.det(matrix) < 0.0)
