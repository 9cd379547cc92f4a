"""Chunks of bags out of their compression, none beyond what its size can account for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hexmap.base.errors import TooLargeError
from hexmap.io.read_file import inflation_limit

__all__ = ["bound_rosbags", "decompressor", "inflate"]


def inflate(data: bytes, kind: str, partly: bool = False) -> bytes:
    """Return a chunk inflated.

    Args:
        data: the chunk.
        kind: "bz2", "lz4" or "zstd"; "" and "none" give back the chunk.
        partly: a chunk that ends too early gives what it holds.

    Raises:
        TooLargeError: it would become larger than :func:`~hexmap.io.read_file.inflation_limit` allows.
        ValueError: no such compression, or a chunk that ends too early. Damage raises the error of its library.
    """
    if kind in ("", "none"):
        return data
    new = decompressor(kind)
    limit = inflation_limit(len(data))
    parts: list[bytes] = []
    size = 0
    rest = data
    while rest:
        machine = new()
        while True:
            part = bytes(machine.decompress(rest, limit + 1 - size))
            rest = b""
            parts.append(part)
            size += len(part)
            if size > limit:
                raise TooLargeError(
                    f"a chunk of {len(data)} bytes ({kind}) inflates to more than {limit}; "
                    "HEXMAP_MAX_INFLATION raises the limit"
                )
            if machine.eof or machine.needs_input or not part:
                break
        if not machine.eof:
            if partly:
                break
            raise ValueError(f"a chunk ({kind}) is cut off")
        # A chunk may be several streams in a row.
        rest = machine.unused_data or b""
    return b"".join(parts)


def decompressor(kind: str) -> Callable[[], Any]:
    """Return the class of what inflates a compression.

    Raises:
        ValueError: no such compression.
    """
    if kind == "bz2":
        from bz2 import BZ2Decompressor

        return BZ2Decompressor
    if kind == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        return LZ4FrameDecompressor  # type: ignore[no-any-return]
    if kind == "zstd":
        try:
            from compression import zstd
        except ImportError:
            from backports import zstd
        return zstd.ZstdDecompressor  # type: ignore[no-any-return]
    raise ValueError(f"the compression {kind!r} is not known")


def bound_rosbags() -> None:
    """Have rosbags inflate by :func:`inflate`: by itself it inflates a chunk to whatever size it has.

    It looks its functions up in two tables, one a format, which have no other place to state a limit.
    """
    from rosbags.rosbag1 import reader
    from rosbags.rosbag2 import storage_mcap

    for kind in ("bz2", "lz4"):
        reader.decompressors[kind] = lambda data, kind=kind: inflate(data, kind)  # type: ignore[misc]
    for kind in ("lz4", "zstd"):
        storage_mcap.DECOMPRESSORS[kind] = lambda data, size, kind=kind: inflate(data, kind)  # type: ignore[misc]
