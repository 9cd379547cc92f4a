"""Bags without their index: read record by record, up to the last whole one.

A recorder that was killed leaves a ROS 1 bag or an MCAP file whose records are sound but whose
index, which is written last, is missing. rosbags reads through the index only, so the records
are walked here; their messages are decoded by rosbags all the same.
"""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, Any

__all__ = ["UnindexedMcap", "UnindexedRosbag1"]

# A length beyond this comes of damaged bytes, not of a message; it must not be allocated.
_LONGEST_RECORD = 1 << 31


class _CutOff(Exception):
    """The file ends, or is damaged, within a record."""


def _exactly(handle: IO[bytes], size: int, or_less: bool = False) -> bytes:
    if not 0 <= size < _LONGEST_RECORD:
        raise _CutOff
    data = handle.read(size)
    if len(data) != size and not or_less:
        raise _CutOff
    return data


def _decompress(data: bytes, kind: str) -> bytes:
    """Decompress a chunk, or as much as there is of one that is cut off."""
    if kind in ("", "none"):
        return data
    try:
        if kind == "bz2":
            import bz2

            return bz2.BZ2Decompressor().decompress(data)
        if kind == "lz4":
            from lz4.frame import LZ4FrameDecompressor

            return bytes(LZ4FrameDecompressor().decompress(data))
        if kind == "zstd":
            try:
                from compression import zstd
            except ImportError:
                from backports import zstd
            return bytes(zstd.ZstdDecompressor().decompress(data))
    except Exception as error:  # each of these libraries has an error of its own
        raise _CutOff from error
    raise _CutOff


class _Unindexed(ABC):
    """What both formats share: topics by a first walk, messages by a second."""

    is2 = False

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: dict[str, str] = {}
        self.position = 0
        self._definitions: dict[str, str] = {}
        self._typestore: Any = None
        for _ in self._walk():
            pass

    @abstractmethod
    def _walk(self) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, nanoseconds, raw message) of the whole file, noting topics on the way."""

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, nanoseconds, raw message), in the order of the file."""
        return (message for message in self._walk() if message[0] in topics)

    def deserialize(self, raw: bytes, kind: str) -> Any:
        """Decode a message."""
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        if self._typestore is None:
            self._typestore = get_typestore(Stores.LATEST if self.is2 and not self._definitions else Stores.EMPTY)
            types: dict[str, Any] = {}
            for name, definition in self._definitions.items():
                types.update(get_types_from_msg(definition, name))
            self._typestore.register(types)
        return self._typestore.deserialize_cdr(raw, kind) if self.is2 else self._typestore.deserialize_ros1(raw, kind)

    def fraction(self, nanoseconds: int) -> float:
        """Return how much of the file has been read."""
        size = self.path.stat().st_size
        return self.position / size if size else 1.0

    def close(self) -> None:  # noqa: B027 - nothing to close but where there is
        """Nothing stays open."""


class UnindexedRosbag1(_Unindexed):
    """A ROS 1 bag (format 2.0) without its index."""

    def _walk(self) -> Iterator[tuple[str, int, bytes]]:
        connections: dict[int, str] = {}
        with open(self.path, "rb") as handle:
            handle.readline()
            try:
                while True:
                    header, data = _record1(handle)
                    self.position = handle.tell()
                    if header.get(b"op") == b"\x05":
                        kind = header.get(b"compression", b"none").decode("ascii", "replace")
                        chunk = BytesIO(_decompress(data, kind))
                        while chunk.tell() < len(chunk.getbuffer()):
                            yield from self._take(*_record1(chunk), connections)
                    else:
                        yield from self._take(header, data, connections)
            except _CutOff:
                return

    def _take(
        self, header: dict[bytes, bytes], data: bytes, connections: dict[int, str]
    ) -> Iterator[tuple[str, int, bytes]]:
        op = header.get(b"op")
        if op not in (b"\x02", b"\x07") or len(header.get(b"conn", b"")) != 4:
            return
        (number,) = struct.unpack("<I", header[b"conn"])
        if op == b"\x07":
            described = _fields1(data)
            topic = header.get(b"topic", b"").decode("utf-8", "replace")
            package, _, name = described.get(b"type", b"").decode("utf-8", "replace").rpartition("/")
            kind = f"{package.removesuffix('/msg')}/msg/{name}"
            connections[number] = topic
            self.topics[topic] = kind
            self._definitions[kind] = described.get(b"message_definition", b"").decode("utf-8", "replace")
        elif number in connections and len(header.get(b"time", b"")) == 8:
            seconds, nanoseconds = struct.unpack("<II", header[b"time"])
            yield connections[number], seconds * 10**9 + nanoseconds, data


def _record1(handle: IO[bytes]) -> tuple[dict[bytes, bytes], bytes]:
    (size,) = struct.unpack("<I", _exactly(handle, 4))
    header = _fields1(_exactly(handle, size))
    (size,) = struct.unpack("<I", _exactly(handle, 4))
    # The messages before the cut are still good where a chunk is cut off.
    return header, _exactly(handle, size, or_less=header.get(b"op") == b"\x05")


def _fields1(data: bytes) -> dict[bytes, bytes]:
    fields: dict[bytes, bytes] = {}
    place = 0
    while place + 4 <= len(data):
        (size,) = struct.unpack_from("<I", data, place)
        name, found, value = data[place + 4 : place + 4 + size].partition(b"=")
        if not found:
            raise _CutOff
        fields[name] = value
        place += 4 + size
    return fields


class UnindexedMcap(_Unindexed):
    """An MCAP file without its footer."""

    is2 = True

    def _walk(self) -> Iterator[tuple[str, int, bytes]]:
        schemas: dict[int, str] = {}
        channels: dict[int, str] = {}
        with open(self.path, "rb") as handle:
            handle.seek(8)
            try:
                while True:
                    op, data = _record2(handle)
                    self.position = handle.tell()
                    if op == 0x06:
                        (size,) = struct.unpack_from("<I", data, 28)
                        kind = data[32 : 32 + size].decode("ascii", "replace")
                        chunk = BytesIO(_decompress(data[40 + size :], kind))
                        while chunk.tell() < len(chunk.getbuffer()):
                            yield from self._take(*_record2(chunk), schemas, channels)
                    elif op == 0x0F:
                        return
                    else:
                        yield from self._take(op, data, schemas, channels)
            except (_CutOff, struct.error):
                return

    def _take(
        self, op: int, data: bytes, schemas: dict[int, str], channels: dict[int, str]
    ) -> Iterator[tuple[str, int, bytes]]:
        if op == 0x03:
            (number,) = struct.unpack_from("<H", data)
            name, place = _string2(data, 2)
            encoding, place = _string2(data, place)
            definition, _ = _string2(data, place)
            schemas[number] = name
            if encoding == "ros2msg":
                self._definitions[name] = definition
        elif op == 0x04:
            number, schema = struct.unpack_from("<HH", data)
            topic, _ = _string2(data, 4)
            channels[number] = topic
            self.topics[topic] = schemas.get(schema, "")
        elif op == 0x05:
            number, _, nanoseconds = struct.unpack_from("<HIQ", data)
            if number in channels:
                yield channels[number], nanoseconds, data[22:]


def _record2(handle: IO[bytes]) -> tuple[int, bytes]:
    op, size = struct.unpack("<BQ", _exactly(handle, 9))
    return op, _exactly(handle, size, or_less=op == 0x06)


def _string2(data: bytes, place: int) -> tuple[str, int]:
    (size,) = struct.unpack_from("<I", data, place)
    return data[place + 4 : place + 4 + size].decode("utf-8", "replace"), place + 4 + size
