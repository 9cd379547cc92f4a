"""The pictures of ROS maps: PGM and PPM by hand, PNG and BMP by Pillow.

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

# Bytes that a byte of deflate, PNG's compression, becomes at most.
_MOST_PACKED = 1032
_TOKEN = re.compile(rb"(?:\s|#[^\r\n]*)*([^\s#]+)")


def read_picture(path: Path, data: bytes) -> tuple[NDArray[Any], int]:
    """Return the pixels of the picture in ``data``, the top row first, and the value that stands for white.

    Returns:
        Greys (H, W) of integers, or channels (H, W, 3), with alpha (H, W, 4), of 0 to 255.

    Raises:
        FormatError: the picture is damaged, or of another kind than PGM, PPM, PNG and BMP.
        TooLargeError: it has more pixels than a dense array may have cells.
    """
    if file_kinds.PGM.begins(data):
        return _read_pgm(path, data)
    for kind, name in ((file_kinds.PNG, "PNG"), (file_kinds.BMP, "BMP")):
        if kind.begins(data):
            return _read_with_pillow(path, data, name), 255
    # Without what it begins with: a YAML file may name any file of the machine.
    raise FormatError(f"{path}: the image is neither PGM nor PPM nor PNG nor BMP")


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
    # Before anything is allocated: the least that a picture of that many pixels takes, at one bit a pixel.
    if image.size[0] * image.size[1] / 8 > _MOST_PACKED * len(data):
        raise FormatError(
            f"{path}: the {name} image is cut off: {len(data)} bytes cannot hold "
            f"{image.size[0]} x {image.size[1]} pixels"
        )
    try:
        if image.mode == "P":
            # A palette has an alpha only where the file says so, of pixels that are not opaque.
            pixels = np.asarray(image.convert("RGBA" if "transparency" in image.info else "RGB"))
            if pixels.shape[2] == 4 and bool((pixels[:, :, 3] == 255).all()):
                pixels = pixels[:, :, :3]
        elif image.mode == "LA":
            pixels = np.asarray(image.convert("RGBA"))
        elif image.mode in ("L", "RGB", "RGBA"):
            pixels = np.asarray(image)
        elif image.mode == "1":
            pixels = np.asarray(image.convert("L"))
        elif image.mode.startswith("I"):
            # Of sixteen bits of grey map_server takes the upper eight.
            pixels = (np.asarray(image).astype(np.int64) >> 8).astype(np.uint8)
        else:
            raise ValueError(f"pixels of the kind {image.mode}")
    except Exception as error:
        raise FormatError(f"{path}: the {name} image cannot be read: {reason(error)}") from error
    return pixels


def _read_pgm(path: Path, data: bytes) -> tuple[NDArray[Any], int]:
    """Return the pixels of a PGM or PPM image, plain or binary, and the value that stands for white."""
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
    channels = 3 if data[:2] in (b"P3", b"P6") else 1
    count = width * height * channels
    grey: NDArray[Any]
    if data[:2] in (b"P5", b"P6"):
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
    if channels == 1:
        return grey.reshape(height, width), most
    return grey.reshape(height, width, channels) * (255.0 / most), 255
