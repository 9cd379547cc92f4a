"""Read the points of a file: its format is found by its content, then by its name."""

from __future__ import annotations

import gzip
import math
import os
import re
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError, FileAccessError, FormatError
from hexmap.io.clouds.columns import Columns, Raw, plural, shown

__all__ = ["FORMATS", "PointFile", "read_points"]

FORMATS = ("pcd", "ply", "text", "kitti", "npy")

_ALIASES = {"xyz": "text", "txt": "text", "csv": "text", "asc": "text", "pts": "text", "bin": "kitti"}
_DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "blank": " ", "space": " "}
_UNITS = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
_GZIP = b"\x1f\x8b"
_NPY = b"\x93NUMPY"
_PLY = re.compile(rb"ply[ \t]*[\r\n]")
_PCD = re.compile(rb"(?:[ \t]*(?:#[^\n]*)?\r?\n)*(?:# \.PCD|VERSION[ \t]+\.?[0-9]|(?:FIELDS|COLUMNS)[ \t]+[A-Za-z_])")
_CARMEN = re.compile(rb"^(?:[FR]LASER|ROBOTLASER[12]|ODOM|PARAM)[ \t]", re.MULTILINE)
_KNOWN = "PCD, PLY, text (XYZ, CSV), a KITTI scan (.bin) and NPY are read"
# What people hand over by mistake begins with; the rest is told by its bytes.
_FOREIGN = (
    (b"PK\x03\x04", "a ZIP or NPZ archive; unpack it first"),
    (b"LASF", "a LAS file; convert it to PLY or text first"),
    (b"ASTM-E57", "an E57 file; convert it to PLY or text first"),
    (b"# Octomap OcTree", "an OctoMap, not points"),
    (b"glTF", "a glTF mesh; convert it to PLY first"),
    (b"solid ", "an STL mesh; convert it to PLY first"),
    (b"PAR1", "a Parquet file"),
    (b"#ROSBAG", "a ROS 1 bag, a log and not points"),
    (b"\x89MCAP0", "an MCAP file, a log and not points"),
    (b"SQLite format 3", "a SQLite file"),
    (b"\x89PNG", "a PNG picture"),
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"P5\n", "a PGM picture"),
    (b"%PDF", "a PDF document"),
    (b"BZh", "a bzip2 file; decompress it first"),
    (b"\xfd7zXZ", "an xz file; decompress it first"),
    (b"\x28\xb5\x2f\xfd", "a zstd file; decompress it first"),
    (b"version https://git-lfs", "a Git LFS pointer; fetch the file itself"),
    (b"\xff\xfe", "text in UTF-16; save it as UTF-8"),
    (b"\xfe\xff", "text in UTF-16; save it as UTF-8"),
)


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
    """

    points: NDArray[np.float64]
    dropped: int
    path: Path
    format: str
    warnings: tuple[str, ...] = ()

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
) -> PointFile:
    """Read the points of a file; its format is found by its content, then by its name.

    Read are PCD (ascii, binary, binary_compressed), PLY (ascii, binary of either endianness),
    text (XYZ, TXT, CSV: separator, header and comments are found), KITTI scans (.bin: float32
    x y z intensity) and NPY, each plain or inside gzip. Points come in the order of the file;
    those with a coordinate that is not finite are dropped and counted. The VIEWPOINT of a PCD
    file is not applied.

    Args:
        path: the file.
        format: "pcd", "ply", "text" (also "xyz", "txt", "csv", "asc", "pts"), "kitti" (also
            "bin") or "npy"; None: found.
        units: what the file's numbers count: "m", "cm", "mm", or metres as a number.
        axes: where x, y and z of the result come from, as a signed permutation: "x,-z,y" makes
            y of the file's -z and z of its y (a camera's frame to x forward is "z,-x,-y"). For
            points of the plane "xyz" is "xy".
        columns: two or three columns to take instead of x, y and z: names of fields, or numbers
            from 0 where columns have no names.
        delimiter: separator of a text file, a character or "comma", "semicolon", "tab",
            "blank"; None: found.

    Raises:
        ArgumentError: an unknown format, unit, axes or delimiter, or columns that are not two or three.
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
    data = _read_bytes(path)
    kind = asked or _find_format(path, data)
    if separator is not None and kind != "text":
        raise ArgumentError(f"{path}: a delimiter is for text, not for a file of format {kind}")
    raw = _reader(kind, separator)(path, data, wanted)
    if len(raw.values) == 0:
        raise FormatError(f"{path}: no points in the file")
    values = _oriented(path, raw.values, order, axes)
    with np.errstate(over="ignore", invalid="ignore"):
        # A division, because 1/100 has no exact float64 and 7 cm would not be 0.07 m.
        values = values / scale[1] if scale[1] != 1.0 else values * scale[0]
    finite = np.isfinite(values).all(axis=1)
    dropped = len(values) - int(np.count_nonzero(finite))
    if dropped == len(values):
        raise FormatError(f"{path}: none of the {plural(dropped, 'point')} in the file is finite")
    warnings = list(raw.warnings)
    if dropped:
        warnings.append(f"{plural(dropped, 'point')} of {len(values)} dropped, not finite")
        values = values[finite]
    if _is_mirror(order[: values.shape[1]]):
        warnings.append(f"the axes {axes!r} mirror the points")
    return PointFile(
        points=np.ascontiguousarray(values),
        dropped=dropped,
        path=path,
        format=kind,
        warnings=tuple(f"{path.name}: {text}" for text in warnings),
    )


def _reader(kind: str, separator: str | None) -> Callable[[Path, bytes, Columns | None], Raw]:
    if kind == "pcd":
        from hexmap.io.clouds.pcd import read_pcd

        return read_pcd
    if kind == "ply":
        from hexmap.io.clouds.ply import read_ply

        return read_ply
    if kind in ("kitti", "npy"):
        from hexmap.io.clouds.binary import read_kitti, read_npy

        return read_kitti if kind == "kitti" else read_npy
    from hexmap.io.clouds.text import read_text

    return lambda path, data, columns: read_text(path, data, columns, separator)


def _read_bytes(path: Path) -> bytes:
    """Return the content of a file, out of gzip where it is inside."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise FileAccessError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        raise FileAccessError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if data.startswith(_GZIP):
        try:
            data = gzip.decompress(data)
        except (OSError, EOFError, zlib.error) as error:
            state = "cut off" if isinstance(error, EOFError) else f"damaged: {error}"
            raise FormatError(f"{path}: the gzip file is {state}") from error
        if not data:
            raise FormatError(f"{path}: the file inside gzip is empty")
    if not data:
        raise FormatError(f"{path}: the file is empty")
    return data


def _find_format(path: Path, data: bytes) -> str:
    """Tell the format by the content, else by the name.

    Raises:
        FormatError: the file is of another kind.
    """
    head = data[:4096]
    if head.startswith(_NPY):
        return "npy"
    if _PLY.match(head):
        return "ply"
    if _PCD.match(head):
        return "pcd"
    suffixes = [suffix.lower() for suffix in path.suffixes if suffix.lower() != ".gz"]
    if suffixes[-1:] == [".bin"]:
        if suffixes[-2:] == [".pcd", ".bin"]:
            raise FormatError(
                f"{path}: .pcd.bin is nuScenes' format of five numbers a point, which is not read; "
                "say format 'kitti' if it holds four"
            )
        # Before the foreign kinds: any bytes may begin a scan.
        return "kitti"
    for magic, name in _FOREIGN:
        if head.startswith(magic):
            raise FormatError(f"{path}: this is {name}; {_KNOWN}")
    for suffix, kind in ((".pcd", "pcd"), (".ply", "ply"), (".npy", "npy")):
        # The name promises a format whose mark is missing: its reader says best what is wrong.
        if suffixes[-1:] == [suffix]:
            return kind
    if re.match(rb"\s*<(?:!doctype|html|\?xml)", head, re.IGNORECASE):
        raise FormatError(f"{path}, line 1: this is HTML or XML, {shown(head.strip()[:16])!r}; {_KNOWN}")
    if _CARMEN.search(head):
        raise FormatError(f"{path}: this is a CARMEN log, not points; its points need its poses")
    if suffixes[-1:] == [".tum"]:
        # Its numbers would pass for points, the first of them being the time.
        raise FormatError(f"{path}: this is a trajectory by its name, not points; say format 'text' if it holds points")
    # Control characters other than tab, newline, form feed and return occur in no text.
    for at, byte in enumerate(head):
        if byte < 9 or 13 < byte < 27 or 27 < byte < 32:
            raise FormatError(f"{path}, byte {at}: the file is binary ({byte:#04x}) and of no known kind; {_KNOWN}")
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
    if len(wanted) not in (2, 3) or not good:
        raise ArgumentError(f"columns must be two or three names, or numbers from 0, not {columns!r}")
    return wanted


def _checked_delimiter(delimiter: str | None) -> str | None:
    if delimiter is None:
        return None
    sign = _DELIMITERS.get(delimiter, delimiter)
    # Anything a number or a quoted field may hold cannot separate them.
    if len(sign) != 1 or sign.isalnum() or sign in '+-."#\n\r':
        raise ArgumentError(
            f"delimiter must be one character or one of {', '.join(_DELIMITERS)}, not {delimiter!r}"
        )
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
