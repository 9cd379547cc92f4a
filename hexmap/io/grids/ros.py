"""Maps of ROS map_server: a YAML file that says where an image lies and what its greys mean.

The states are those of map_server's ``image_loader.cpp`` (ROS 1; Nav2's ``map_io.cpp`` agrees on
opaque pictures). PyYAML is not needed: the few lines are ``key: value``.
"""

from __future__ import annotations

import io
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import FileAccessError, FormatError
from hexmap.base.text import quoted
from hexmap.io.grids.grid_map import MAX_BYTES, GridMap, check_size
from hexmap.io.read_file import read_file
from hexmap.maps.cell_state import CellState

__all__ = ["image_of", "parse"]

_NEEDED = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
_MODES = ("trinary", "scale", "raw")
_PNG = b"\x89PNG"
_TOKEN = re.compile(rb"(?:\s|#[^\r\n]*)*([^\s#]+)")
_KEY = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)\s*:(?:\s+(.*))?$")
_NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")
_BOOLEANS = {"0": False, "1": True, "false": False, "true": True, "no": False, "yes": True}


@dataclass(frozen=True)
class _Entry:
    """A value of the YAML file, as text or a list of texts, and the line that it stands in."""

    line: int
    value: str | list[str]


def image_of(path: Path) -> Path:
    """Return the image that a map_server YAML file names, whether it is there or not.

    Raises:
        FileAccessError: the YAML file cannot be read.
        FormatError: it names no image.
    """
    return _image(path, _entries(path, read_file(path, MAX_BYTES)))


def _image(path: Path, entries: dict[str, _Entry]) -> Path:
    if "image" not in entries:
        raise FormatError(f"{path}: no 'image' in the file; a ROS map has {', '.join(_NEEDED)}")
    image = entries["image"]
    if not isinstance(image.value, str) or not image.value or "\0" in image.value:
        raise FormatError(f"{path}, line {image.line}: the image must be the name of a file, not {image.value!r}")
    return path.parent / image.value


def parse(path: Path, data: bytes) -> GridMap:
    """Make a world of the text of a map_server YAML file and of the image that it names.

    With p = (255 - grey) / 255, or grey / 255 where ``negate`` is set, a pixel is blocked where
    p > ``occupied_thresh``, free where p < ``free_thresh``, unknown between. That holds in the modes trinary
    and scale (whose values between the thresholds are neither free nor occupied). In the mode raw the grey is the
    probability in percent, beyond 100 unknown. As in map_server a pixel's grey is the mean of its
    channels, alpha among them in the mode trinary alone.

    Raises:
        FileAccessError: the image cannot be read; the line that names it is said.
        FormatError: naming the line of the YAML file, or what is wrong with the image.
        TooLargeError: the image has more pixels than a dense array may have cells.
    """
    entries = _entries(path, data)
    for key in _NEEDED:
        if key not in entries:
            raise FormatError(f"{path}: no {key!r} in the file; a ROS map has {', '.join(_NEEDED)}")
    resolution = _number(path, "resolution", entries["resolution"])
    if resolution <= 0.0:
        raise FormatError(
            f"{path}, line {entries['resolution'].line}: the resolution must be positive, not {resolution:g}"
        )
    x, y, yaw = _origin(path, entries["origin"])
    occupied = _number(path, "occupied_thresh", entries["occupied_thresh"])
    free = _number(path, "free_thresh", entries["free_thresh"])
    if not 0.0 <= free <= occupied <= 1.0:
        line = max(entries[k].line for k in ("occupied_thresh", "free_thresh"))
        raise FormatError(
            f"{path}, line {line}: thresholds must be 0 <= free_thresh <= occupied_thresh <= 1, "
            f"not {free:g} and {occupied:g}"
        )
    negate = _boolean(path, "negate", entries["negate"])
    mode_entry = entries.get("mode", _Entry(0, "trinary"))
    mode = mode_entry.value if isinstance(mode_entry.value, str) else ""
    if mode.lower() not in _MODES:
        raise FormatError(f"{path}, line {mode_entry.line}: the mode is one of {', '.join(_MODES)}, not {mode!r}")
    image_path = _image(path, entries)
    try:
        image = read_file(image_path, MAX_BYTES)
    except FileAccessError as error:
        raise FileAccessError(f"{path}, line {entries['image'].line}: the image {error}") from error
    states = _states(image_path, image, mode.lower(), negate, occupied, free)
    # The image's first row is the top one, that of the largest y.
    turned = np.ascontiguousarray(states[::-1].T)
    turned.setflags(write=False)
    return GridMap(turned, resolution, np.array([x, y]), yaw=yaw, path=str(path), kind="ros")


# ---------------------------------------------------------------------- the YAML file


def _entries(path: Path, data: bytes) -> dict[str, _Entry]:
    """Return the entries of a flat YAML file: ``key: value``, ``[a, b]`` and lists of ``- a`` lines."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        at = data.count(b"\n", 0, error.start) + 1
        raise FormatError(f"{path}, line {at}: not text (byte {data[error.start]:#04x})") from None
    found: dict[str, _Entry] = {}
    last = ""
    for number, raw in enumerate(text.splitlines(), start=1):
        where = f"{path}, line {number}"
        line = _uncommented(raw).rstrip()
        if not line.strip() or line in ("---", "...") or line.startswith("%"):
            continue
        item = re.match(r"\s*-\s+(.*)$", line)
        before = found[last].value if last else "none"
        if item and (before == "" or isinstance(before, list)):
            found[last] = _Entry(found[last].line, [*before, _unquoted(where, item[1])])
            continue
        match = _KEY.match(line)
        if match is None:
            raise FormatError(f"{where}: not 'key: value': {quoted(raw.encode())}")
        last = match[1]
        if last in found:
            raise FormatError(f"{where}: {last!r} stands in line {found[last].line} already")
        value = (match[2] or "").strip()
        if value.startswith("["):
            if not value.endswith("]"):
                raise FormatError(f"{where}: the list {quoted(value.encode())} does not end in this line")
            inside = value[1:-1].strip()
            parts = inside.rstrip(",").split(",") if inside else []
            found[last] = _Entry(number, [_unquoted(where, part.strip()) for part in parts])
        else:
            found[last] = _Entry(number, _unquoted(where, value))
    return found


def _uncommented(line: str) -> str:
    """Cut a comment off: a # at the beginning or after a space, and not in quotes."""
    quote = ""
    for k, c in enumerate(line):
        if quote:
            # A backslash hides a quote only between double ones.
            if c == quote and not (c == '"' and line[k - 1] == "\\"):
                quote = ""
        elif c in "'\"" and (k == 0 or line[k - 1] in " \t[,"):
            quote = c
        elif c == "#" and (k == 0 or line[k - 1] in " \t"):
            return line[:k]
    return line


def _unquoted(where: str, value: str) -> str:
    if value[:1] not in ("'", '"'):
        return value
    if len(value) < 2 or value[-1] != value[0]:
        raise FormatError(f"{where}: the quotes of {quoted(value.encode())} do not match")
    inside = value[1:-1]
    if value[0] == "'":
        return inside.replace("''", "'")
    return re.sub(r'\\(["\\/])', r"\1", inside)


def _number(path: Path, key: str, entry: _Entry) -> float:
    value = entry.value if isinstance(entry.value, str) else ""
    out = float(value) if _NUMBER.fullmatch(value) else math.nan
    if not math.isfinite(out):
        raise FormatError(f"{path}, line {entry.line}: {key!r} must be a finite number, not {_text(entry)}")
    return out


def _boolean(path: Path, key: str, entry: _Entry) -> bool:
    value = entry.value.lower() if isinstance(entry.value, str) else ""
    if value not in _BOOLEANS:
        raise FormatError(f"{path}, line {entry.line}: {key!r} must be 0 or 1, not {_text(entry)}")
    return _BOOLEANS[value]


def _origin(path: Path, entry: _Entry) -> list[float]:
    values = entry.value if isinstance(entry.value, list) else []
    if len(values) != 3 or not all(_NUMBER.fullmatch(v) and math.isfinite(float(v)) for v in values):
        raise FormatError(f"{path}, line {entry.line}: 'origin' must be [x, y, yaw], not {_text(entry)}")
    return [float(v) for v in values]


def _text(entry: _Entry) -> str:
    return quoted((entry.value if isinstance(entry.value, str) else f"[{', '.join(entry.value)}]").encode())


# ---------------------------------------------------------------------- the image


def _states(path: Path, data: bytes, mode: str, negate: bool, occupied: float, free: float) -> NDArray[np.uint8]:
    """Return the states (H, W) of the pixels of an image of the bytes ``data``, the top row first."""
    if data[:2] in (b"P2", b"P5"):
        grey, most = _pgm(path, data)
        if most == 255:
            return _classes(np.arange(256.0), mode, negate, occupied, free)[grey]
        scaled = np.arange(most + 1, dtype=np.float64) * (255.0 / most)
        return _classes(scaled, mode, negate, occupied, free)[grey]
    if data.startswith(_PNG):
        pixels = _png(path, data)
        if mode != "trinary" and pixels.shape[2] in (2, 4):
            pixels = pixels[:, :, :-1]
        return _classes(np.asarray(pixels.mean(axis=2)), mode, negate, occupied, free)
    raise FormatError(f"{path}: the image is neither PGM nor PNG (it begins with {quoted(data[:8])})")


def _classes(grey: NDArray[np.float64], mode: str, negate: bool, occupied: float, free: float) -> NDArray[np.uint8]:
    """Return the state of greys from 0 to 255."""
    grey = 255.0 - grey if negate else grey
    if mode == "raw":
        percent = np.floor(grey)
        p, known = percent / 100.0, percent <= 100.0
    else:
        p, known = (255.0 - grey) / 255.0, np.ones(grey.shape, np.bool_)
    out = np.full(grey.shape, CellState.UNKNOWN, np.uint8)
    out[known & (p < free)] = CellState.FREE
    out[known & (p > occupied)] = CellState.OCCUPIED
    return out


def _pgm(path: Path, data: bytes) -> tuple[NDArray[Any], int]:
    """Return the greys (H, W) of a PGM image, plain or binary, and the grey that stands for white."""
    at = 2
    header: list[int] = []
    for name in ("width", "height", "maximum"):
        token = _TOKEN.match(data, at)
        if token is None or not re.fullmatch(rb"[0-9]{1,9}", token[1]):
            found = quoted(token[1]) if token else "the end of the file"
            raise FormatError(
                f"{path}, line {_line(data, at)}: the {name} of the image must be an integer, not {found}"
            )
        header.append(int(token[1]))
        at = token.end()
    width, height, most = header
    if width == 0 or height == 0:
        raise FormatError(f"{path}: the image is empty: {width} x {height} pixels")
    if not 1 <= most <= 65535:
        raise FormatError(f"{path}, line {_line(data, at)}: the maximum of the image must be 1 to 65535, not {most}")
    check_size(path, (width, height))
    count = width * height
    grey: NDArray[Any]
    if data[:2] == b"P5":
        # One byte of space ends the header.
        at += 1
        kind = np.dtype(np.uint8) if most < 256 else np.dtype(">u2")
        have = max(0, len(data) - at)
        if have < count * kind.itemsize:
            raise FormatError(
                f"{path}: the image is cut off: {have} bytes of pixels, {width} x {height} need {count * kind.itemsize}"
            )
        grey = np.frombuffer(data, kind, count, at)
    else:
        words = re.sub(rb"#[^\r\n]*", b"", data[at:]).split()
        if len(words) != count:
            raise FormatError(f"{path}: the image has {len(words)} values, and {width} x {height} pixels")
        wrong = next((word for word in words if not re.fullmatch(rb"[0-9]{1,9}", word)), None)
        if wrong is not None:
            raise FormatError(f"{path}: a value of the image is {quoted(wrong)}, which is no integer")
        grey = np.array(words, dtype="S9").astype(np.int64)
    if int(grey.max()) > most:
        raise FormatError(f"{path}: a pixel is {int(grey.max())}, and the image's maximum is {most}")
    return grey.reshape(height, width), most


def _line(data: bytes, at: int) -> int:
    return data.count(b"\n", 0, at) + 1


def _png(path: Path, data: bytes) -> NDArray[np.float64]:
    """Return the channels (H, W, C) of a PNG image, 0 to 255."""
    from matplotlib.image import imread

    if len(data) < 24 or data[12:16] != b"IHDR":
        raise FormatError(f"{path}: the PNG image is cut off or damaged")
    check_size(path, (int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")))
    try:
        pixels = np.asarray(imread(io.BytesIO(data), format="png"), dtype=np.float64)
    except (OSError, ValueError, SyntaxError) as error:
        raise FormatError(f"{path}: the PNG image cannot be read: {str(error).splitlines()[0][:160]}") from error
    # Eight bits a channel come back as they were.
    return np.rint((pixels if pixels.ndim == 3 else pixels[:, :, None]) * 255.0)
