"""Files into memory, out of gzip where they are in it, with the errors that all formats share."""

from __future__ import annotations

import contextlib
import io
import os
import re
import stat
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from hexmap.base.errors import ArgumentError, FileAccessError, FormatError, TooLargeError
from hexmap.base.text import quoted, reason, whole_number
from hexmap.io.file_kinds import GZIP

__all__ = [
    "CHUNK",
    "GzipError",
    "beginning",
    "cannot_read",
    "check_regular",
    "inflated",
    "inflation_limit",
    "read_file",
]

# Text that is one number over and over shrinks a hundredfold; logs and maps shrink four- to twentyfold.
_MOST_INFLATION = 200
_LEAST_LIMIT = 1 << 26  # bytes that anything may inflate to
CHUNK = 1 << 16  # bytes that are read and inflated at a time
_GZIP_WINDOW = 31  # tells zlib that a gzip header and checksum surround the data


class GzipError(ValueError):
    """A gzip file ends too early or is damaged; the text completes "the gzip file is"."""


def inflation_limit(size: int) -> int:
    """Return the most bytes that ``size`` compressed bytes may inflate to.

    That is 64 MiB, or 200 times the size where that is more; the environment's ``HEXMAP_MAX_INFLATION`` is another
    number of times.

    Raises:
        ArgumentError: ``HEXMAP_MAX_INFLATION`` is not a positive number.
    """
    named = os.environ.get("HEXMAP_MAX_INFLATION", "")
    times = whole_number(named) if named else _MOST_INFLATION
    if not times:
        raise ArgumentError(f"HEXMAP_MAX_INFLATION is a whole number of times, not {quoted(named)}")
    return max(_LEAST_LIMIT, times * size)


def check_regular(path: str | os.PathLike[str], mode: int) -> None:
    """Refuse what is no regular file: a device or a pipe has no end, or none that comes.

    Args:
        path: as it was named; ``/dev/stdin`` and the like are pipes that were asked for.
        mode: of :func:`os.stat`.

    Raises:
        FileAccessError: it is a device, a pipe or a socket.
    """
    if stat.S_ISREG(mode) or stat.S_ISDIR(mode):  # the system's words for a folder say it best
        return
    if stat.S_ISFIFO(mode) and re.fullmatch(r"/dev/stdin|/dev/fd/[0-9]+|/proc/self/fd/[0-9]+", os.fspath(path)):
        return
    kinds = {
        stat.S_IFCHR: "a device",
        stat.S_IFBLK: "a device",
        stat.S_IFIFO: "a pipe",
        stat.S_IFSOCK: "a socket",
    }
    raise FileAccessError(
        f"{path}: cannot be read: it is {kinds.get(stat.S_IFMT(mode), 'no file')}, not a regular file"
    )


def cannot_read(path: str | os.PathLike[str], error: BaseException) -> FileAccessError:
    """Return the error of a file that cannot be opened or read, for ``raise ... from error``."""
    return FileAccessError(f"{path}: cannot be read: {reason(error)}")


def read_file(path: Path, limit: int | None = None) -> bytes:
    """Return the bytes of a file, decompressed where it is gzip, whatever its name.

    Args:
        path: the file.
        limit: the most bytes that are read, as they are and decompressed; None: any number. What is inside gzip is
            bounded by :func:`inflation_limit` besides.

    Raises:
        FileAccessError: the file is not there, cannot be read or is no regular file.
        FormatError: it is empty, or its gzip is damaged or cut off.
        TooLargeError: there are more bytes than ``limit``.
    """
    try:
        # Before it is opened: opening a pipe that nobody writes to waits for ever.
        check_regular(path, os.stat(path).st_mode)
        with open(path, "rb") as handle:
            size = os.fstat(handle.fileno()).st_size
            if limit is not None and size > limit:
                raise TooLargeError(f"{path}: the file has {size} bytes; at most {limit} are read")
            data = handle.read() if limit is None else handle.read(limit + 1)
        if limit is not None and len(data) > limit:
            raise TooLargeError(f"{path}: more than {limit} bytes; at most so many are read")
    except FileNotFoundError:
        raise FileAccessError(f"{path}: no such file") from None
    except (FileAccessError, TooLargeError):
        raise
    except (OSError, ValueError) as error:  # a ValueError: a path with a null character
        raise cannot_read(path, error) from error
    if GZIP.begins(data):
        data = _decompressed(path, data, limit)
        if not data:
            raise FormatError(f"{path}: the file is empty (what is inside gzip is empty)")
    if not data:
        raise FormatError(f"{path}: the file is empty")
    return data


def beginning(path: Path) -> bytes:
    """Return how a file begins, decompressed where it is gzip; nothing where that cannot be read."""
    try:
        check_regular(path, os.stat(path).st_mode)
        if not path.is_file():
            return b""  # a pipe can be read only once
        with open(path, "rb") as handle:
            head = handle.read(CHUNK)
        return next(inflated([head]), b"") if GZIP.begins(head) else head
    except (OSError, ValueError):  # a GzipError is one, and a path with a null character
        return b""


def _decompressed(path: Path, data: bytes, limit: int | None) -> bytes:
    # A BytesIO hands its content over without a copy, and grows without holding all twice.
    out = io.BytesIO()
    most = inflation_limit(len(data))
    try:
        for text in inflated(data[at : at + CHUNK] for at in range(0, len(data), CHUNK)):
            out.write(text)
            if limit is not None and out.tell() > limit:
                raise TooLargeError(f"{path}: the file holds more than {limit} bytes once decompressed")
            if out.tell() > most:
                raise TooLargeError(
                    f"{path}: {len(data)} bytes of gzip hold more than {most}; HEXMAP_MAX_INFLATION raises the limit"
                )
    except GzipError as error:
        raise FormatError(f"{path}: the gzip file is {error} after {out.tell()} bytes of text") from error
    return out.getvalue()


def inflated(chunks: Iterable[bytes]) -> Iterator[bytes]:
    """Yield the text inside a gzip file that comes in chunks: everything that is sound, then the error.

    The gzip module gives up on a cut-off file before handing out all that it holds. No piece is larger
    than four chunks, because very regular text shrinks a thousandfold.

    Raises:
        GzipError: the file is damaged, or ends too early; raised after all that is sound.
    """
    inflate: Any = zlib.decompressobj(_GZIP_WINDOW)
    for chunk in chunks:
        rest = chunk
        while rest:
            if inflate.eof:
                # A gzip file may be several ones in a row, padded with zeros.
                rest = rest.lstrip(b"\0")
                if not rest:
                    break
                inflate = zlib.decompressobj(_GZIP_WINDOW)
            sound = inflate.copy()
            try:
                text = inflate.decompress(rest, 4 * CHUNK)
            except zlib.error as error:
                if before := _before_damage(sound, rest):
                    yield before
                raise GzipError(f"damaged ({reason(error)})") from error
            if text:
                yield text
            rest = inflate.unused_data if inflate.eof else inflate.unconsumed_tail
    if not inflate.eof:
        raise GzipError("cut off")


def _before_damage(inflate: Any, chunk: bytes) -> bytes:
    """Inflate in small steps what lies before a damaged place; zlib gives nothing of the step that fails."""
    text = b""
    with contextlib.suppress(zlib.error):
        for start in range(0, len(chunk), 32):
            text += inflate.decompress(chunk[start : start + 32])
    return text
