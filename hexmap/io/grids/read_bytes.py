"""Whole files into memory, gzip or not, with the errors that all formats share."""

from __future__ import annotations

import gzip
import os
import re
import zlib
from pathlib import Path

from hexmap.base.errors import FileAccessError, FormatError, TooLargeError
from hexmap.io.grids.grid_map import MAX_CELLS

__all__ = ["check_size", "read_bytes", "shown", "whole"]

_GZIP = b"\x1f\x8b"
_MAX_BYTES = 4 * 2**30
_BLOCK = 1 << 24


def read_bytes(path: Path) -> bytes:
    """Return the bytes of a file, decompressed where it is gzip, whatever its name.

    Raises:
        FileAccessError: the file cannot be read.
        FormatError: it is empty, or its gzip is damaged or cut off.
        TooLargeError: more than 4 GiB.
    """
    try:
        with open(path, "rb") as handle:
            size = os.fstat(handle.fileno()).st_size
            if size > _MAX_BYTES:
                raise TooLargeError(f"{path}: the file has {size} bytes; at most {_MAX_BYTES} are read")
            data = handle.read()
    except FileNotFoundError:
        raise FileAccessError(f"{path}: no such file") from None
    except OSError as error:
        raise FileAccessError(f"{path}: cannot be read: {error.strerror or error}") from error
    if data.startswith(_GZIP):
        data = _inflated(path)
    if not data:
        raise FormatError(f"{path}: the file is empty")
    return data


def _inflated(path: Path) -> bytes:
    parts, total = [], 0
    try:
        with gzip.open(path, "rb") as handle:
            while part := handle.read(_BLOCK):
                parts.append(part)
                total += len(part)
                if total > _MAX_BYTES:
                    raise TooLargeError(f"{path}: the file holds more than {_MAX_BYTES} bytes once decompressed")
    except EOFError:
        raise FormatError(f"{path}: the gzip file is cut off after {total} bytes of text") from None
    except (zlib.error, gzip.BadGzipFile) as error:
        raise FormatError(f"{path}: the gzip file is damaged: {error}") from error
    except OSError as error:
        raise FileAccessError(f"{path}: cannot be read: {error.strerror or error}") from error
    return b"".join(parts)


def check_size(where: object, shape: tuple[int, ...]) -> None:
    """Refuse a dense array that is too large, before it is allocated.

    Raises:
        TooLargeError: naming the size.
    """
    cells = 1
    for s in shape:
        cells *= s
    if cells > MAX_CELLS:
        raise TooLargeError(
            f"{where}: {' x '.join(map(str, shape))} cells would take {cells / 2**30:.1f} GiB; "
            f"at most {MAX_CELLS} are read"
        )


def whole(word: bytes) -> int | None:
    """Return the integer of 0 or more that a word is, None for any other."""
    return int(word) if re.fullmatch(rb"[0-9]{1,18}", word) else None


def shown(word: bytes, most: int = 40) -> str:
    """Return what was read as it stands in a message: short, printable, quoted."""
    text = ascii(word.decode("latin-1"))
    return text if len(text) <= most else text[: most - 4] + "...'"
