"""The pictures of ROS maps: PGM by hand, PNG and BMP by Pillow.

Pillow could read PGM, too. But it rounds greys to 8 or 16 bits where the maximum is another, clamps greys
beyond the maximum, and names neither the line nor the value where a file is wrong.
"""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import FormatError
from hexmap.base.text import quoted, reason
from hexmap.io import file_kinds
from hexmap.io.grids.grid_map import check_size

__all__ = ["read_picture"]

_TOKEN = re.compile(rb"(?:\s|#[^\r\n]*)*([^\s#]+)")


def read_picture(path: Path, data: bytes) -> tuple[NDArray[Any], int]:
    """Return the pixels of the picture in ``data``, the top row first, and the value that stands for white.

    Returns:
        Greys (H, W), or channels (H, W, 3) and with alpha (H, W, 4), all unsigned integers.

    Raises:
        FormatError: the picture is damaged, or of another kind than PGM, PNG and BMP.
        TooLargeError: it has more pixels than a dense array may have cells.
    """
    if file_kinds.PGM.begins(data):
        return _read_pgm(path, data)
    for kind, name in ((file_kinds.PNG, "PNG"), (file_kinds.BMP, "BMP")):
        if kind.begins(data):
            return _read_with_pillow(path, data, name), 255
    raise FormatError(f"{path}: the image is neither PGM nor PNG nor BMP (it begins with {quoted(data[:8])})")


def _read_with_pillow(path: Path, data: bytes, name: str) -> NDArray[np.uint8]:
    from PIL.BmpImagePlugin import BmpImageFile
    from PIL.PngImagePlugin import PngImageFile

    # Not by Image.open, which refuses pictures that are smaller than our own bound.
    kind = PngImageFile if name == "PNG" else BmpImageFile
    try:
        image = kind(io.BytesIO(data))
    except Exception as error:  # damaged headers surface as many kinds of errors
        raise FormatError(f"{path}: the {name} image cannot be read: {reason(error)}") from error
    check_size(path, image.size)
    try:
        if image.mode == "P":
            # A palette has an alpha only where the file says so.
            pixels = np.asarray(image.convert("RGBA" if "transparency" in image.info else "RGB"))
        elif image.mode == "LA":
            pixels = np.asarray(image.convert("RGBA"))
        elif image.mode in ("L", "RGB", "RGBA"):
            pixels = np.asarray(image)
        elif image.mode == "1":
            pixels = np.asarray(image.convert("L"))
        elif image.mode.startswith("I"):
            # Sixteen bits of grey, as eight: the nearest of them.
            pixels = np.rint(np.asarray(image, np.float64) * (255.0 / 65535.0)).astype(np.uint8)
        else:
            raise ValueError(f"pixels of the kind {image.mode}")
    except Exception as error:
        raise FormatError(f"{path}: the {name} image cannot be read: {reason(error)}") from error
    return pixels


def _read_pgm(path: Path, data: bytes) -> tuple[NDArray[Any], int]:
    """Return the greys (H, W) of a PGM image, plain or binary, and the grey that stands for white."""
    at = 2
    header: list[int] = []
    for name in ("width", "height", "maximum"):
        token = _TOKEN.match(data, at)
        if token is None or not re.fullmatch(rb"[0-9]{1,9}", token[1]):
            found = quoted(token[1]) if token else "the end of the file"
            line = data.count(b"\n", 0, at) + 1
            raise FormatError(f"{path}, line {line}: the {name} of the image must be an integer, not {found}")
        header.append(int(token[1]))
        at = token.end()
    width, height, most = header
    if width == 0 or height == 0:
        raise FormatError(f"{path}: the image is empty: {width} x {height} pixels")
    if not 1 <= most <= 65535:
        line = data.count(b"\n", 0, at) + 1
        raise FormatError(f"{path}, line {line}: the maximum of the image must be 1 to 65535, not {most}")
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
