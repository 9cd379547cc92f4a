"""Bags read record by record: MCAP files, and ROS 1 bags whose index is missing.

A recorder that was killed leaves a ROS 1 bag or an MCAP file whose records are sound but whose index, which is written
last, is missing. rosbags reads ROS 1 bags through the index only, and of MCAP files only those of ROS 2 whose schemas
it knows, all of them; here the records are walked, up to the last whole one. Messages are decoded by rosbags all the
same.
"""

from __future__ import annotations

import heapq
import struct
import zlib
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, Any

from hexmap.base.errors import HexmapError
from hexmap.io.logs.bag_sources import Decoder, message_type
from hexmap.io.logs.inflate import inflate

__all__ = ["McapFile", "UnindexedRosbag1"]


class _CutOff(Exception):
    """The file ends, or is damaged, within a record."""


def _exactly(handle: IO[bytes], size: int, end: int, or_less: bool = False) -> bytes:
    """Read bytes that lie before ``end``: a damaged length is never allocated."""
    left = max(end - handle.tell(), 0)
    if size > left:
        if not or_less:
            raise _CutOff
        size = left
    return handle.read(size)


def _inflated(data: bytes, kind: str) -> bytes:
    """Inflate a chunk, or as much as there is of one that is cut off."""
    try:
        return inflate(data, kind, partly=True)
    except HexmapError:
        raise
    except Exception as error:  # each of the libraries has an error of its own
        raise _CutOff from error


class _Records(ABC):
    """What both formats share."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: dict[str, str] = {}
        self.trouble = ""
        self.size = path.stat().st_size
        self.position = 0
        self._decoder = Decoder()

    @abstractmethod
    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, nanoseconds, raw message)."""

    @abstractmethod
    def deserialize(self, raw: bytes, topic: str) -> Any:
        """Decode a message of a topic."""

    def fraction(self, nanoseconds: int) -> float:
        """Return how much of the file has been read."""
        return self.position / self.size if self.size else 1.0

    def close(self) -> None:  # noqa: B027 - nothing to close but where there is
        """Nothing stays open."""


class UnindexedRosbag1(_Records):
    """A ROS 1 bag (format 2.0) without its index."""

    def __init__(self, path: Path) -> None:
        """Walk through the file for its topics."""
        super().__init__(path)
        for _ in self._walk():
            pass

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, nanoseconds, raw message), in the order of the file."""
        return (message for message in self._walk() if message[0] in topics)

    def deserialize(self, raw: bytes, topic: str) -> Any:
        """Decode a message of a topic."""
        return self._decoder.decode(raw, self.topics[topic], True)

    def _walk(self) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, nanoseconds, raw message) of the whole file, noting topics on the way."""
        connections: dict[int, str] = {}
        with open(self.path, "rb") as handle:
            handle.readline(64)
            try:
                while True:
                    header, data = _record1(handle, self.size)
                    self.position = handle.tell()
                    if header.get(b"op") == b"\x05":
                        kind = header.get(b"compression", b"none").decode("ascii", "replace")
                        plain = _inflated(data, kind)
                        chunk = BytesIO(plain)
                        while chunk.tell() < len(plain):
                            yield from self._take(*_record1(chunk, len(plain)), connections)
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
            kind = message_type(described.get(b"type", b"").decode("utf-8", "replace"))
            connections[number] = topic
            self.topics[topic] = kind
            definition = described.get(b"message_definition", b"").decode("utf-8", "replace")
            self._decoder.define(kind, True, "msg", definition)
        elif number in connections and len(header.get(b"time", b"")) == 8:
            seconds, nanoseconds = struct.unpack("<II", header[b"time"])
            yield connections[number], seconds * 10**9 + nanoseconds, data


def _record1(handle: IO[bytes], end: int) -> tuple[dict[bytes, bytes], bytes]:
    (size,) = struct.unpack("<I", _exactly(handle, 4, end))
    header = _fields1(_exactly(handle, size, end))
    (size,) = struct.unpack("<I", _exactly(handle, 4, end))
    # The messages before the cut are still good where a chunk is cut off.
    return header, _exactly(handle, size, end, or_less=header.get(b"op") == b"\x05")


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


@dataclass(frozen=True)
class _Span:
    """A chunk of an MCAP file, or a message outside of any (``kind`` None): its times, and where its data lie."""

    start: int
    end: int
    at: int
    size: int
    kind: str | None
    plain: int = 0
    checksum: int = 0


_ENCODINGS = {"cdr": False, "ros1": True}
_LANGUAGES = {"ros1msg": "msg", "ros2msg": "msg", "ros2idl": "idl", "omgidl": "idl"}
# How a time stands in the file, and the header of a chunk before the name of its compression.
_CHUNK_HEADER = struct.Struct("<QQQII")
_MESSAGE_HEADER = struct.Struct("<HIQQ")


class McapFile(_Records):
    """An MCAP file of ROS 1 or ROS 2 messages, with its index or without.

    Chunks are read by their times and a chunk's messages by theirs, so that a file that was written topic by topic
    is read as the robot saw it.

    Attributes:
        foreign: topic -> why its messages cannot be decoded: their encoding is of another kind.
    """

    def __init__(self, path: Path) -> None:
        """Walk through the records for topics and chunks.

        Raises:
            TooLargeError: a chunk inflates to more than may be.
        """
        super().__init__(path)
        self.foreign: dict[str, str] = {}
        self._schemas: dict[int, tuple[str, str, str]] = {}
        self._channels: dict[int, str] = {}
        self._ros1: dict[str, bool] = {}
        self._spans: list[_Span] = []
        self._handle: IO[bytes] | None = None
        try:
            whole = self._scan()
        except _CutOff:
            whole = False
        if not whole:
            self.trouble = "its last records are missing"
        # Channels stand in the chunks, too; an index repeats them after all chunks, but need not.
        if not self._channels or self.trouble:
            try:
                for span in self._spans:
                    for _ in self._whole(span):
                        pass
            except ValueError as error:
                self.trouble = str(error)

    def deserialize(self, raw: bytes, topic: str) -> Any:
        """Decode a message of a topic."""
        return self._decoder.decode(raw, self.topics[topic], self._ros1.get(topic, False))

    def close(self) -> None:
        """Close the file."""
        if self._handle is not None:
            self._handle.close()
            self._handle = None

    def _scan(self) -> bool:
        """Note chunks, and what stands outside of them; returns whether the file is whole."""
        with open(self.path, "rb") as handle:
            handle.seek(8)
            while True:
                head = handle.read(9)
                if len(head) < 9:
                    return False
                op, size = struct.unpack("<BQ", head)
                at = handle.tell()
                if op == 0x02:
                    return True
                if op == 0x06:
                    self._note_chunk(handle, at, size)
                elif op in (0x03, 0x04, 0x05):
                    if at + size > self.size:
                        return False
                    if op == 0x05:
                        fields = handle.read(_MESSAGE_HEADER.size)
                        if size < len(fields) or len(fields) < _MESSAGE_HEADER.size:
                            return False
                        time = _MESSAGE_HEADER.unpack(fields)[2]
                        self._spans.append(_Span(time, time, at - 9, size + 9, None))
                    else:
                        self._describe(op, handle.read(size))
                if at + size > self.size:
                    return False
                handle.seek(at + size)

    def _note_chunk(self, handle: IO[bytes], at: int, size: int) -> None:
        head = handle.read(_CHUNK_HEADER.size)
        if len(head) < _CHUNK_HEADER.size:
            return
        start, end, plain, checksum, letters = _CHUNK_HEADER.unpack(head)
        kind = handle.read(min(letters, 16)).decode("ascii", "replace")
        begin = at + _CHUNK_HEADER.size + letters + 8
        left = min(at + size, self.size) - begin
        if left > 0:
            self._spans.append(_Span(start, end, begin, left, kind, plain, checksum))

    def _describe(self, op: int, data: bytes) -> None:
        """Take a schema or a channel."""
        try:
            if op == 0x03:
                (number,) = struct.unpack_from("<H", data)
                name, place = _string2(data, 2)
                language, place = _string2(data, place)
                definition, _ = _string2(data, place)
                self._schemas[number] = (name, language, definition)
                return
            number, schema = struct.unpack_from("<HH", data)
            topic, place = _string2(data, 4)
            encoding, _ = _string2(data, place)
        except struct.error as error:
            raise _CutOff from error
        name, language, definition = self._schemas.get(schema, ("", "", ""))
        self._channels[number] = topic
        kind = message_type(name)
        self.topics.setdefault(topic, kind)
        ros1 = _ENCODINGS.get(encoding, language == "ros1msg" if not encoding else None)
        if ros1 is None:
            self.foreign.setdefault(topic, encoding)
            return
        self._ros1.setdefault(topic, ros1)
        self._decoder.define(kind, ros1, _LANGUAGES.get(language, ""), definition)

    def _records(self, span: _Span, partly: bool) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, nanoseconds, raw message) of a chunk, noting schemas and channels on the way."""
        if self._handle is None:
            self._handle = open(self.path, "rb")  # noqa: SIM115 - close() closes it
        self._handle.seek(span.at)
        data = self._handle.read(span.size)
        self.position = max(self.position, span.at + span.size)
        if span.kind is not None:
            data = _inflated(data, span.kind)
            if not partly and (len(data) != span.plain or (span.checksum and zlib.crc32(data) != span.checksum)):
                raise ValueError(f"the chunk at byte {span.at} is damaged")
        chunk = BytesIO(data)
        while chunk.tell() < len(data):
            try:
                op, size = struct.unpack("<BQ", _exactly(chunk, 9, len(data)))
                record = _exactly(chunk, size, len(data))
                if op in (0x03, 0x04):
                    self._describe(op, record)
                elif op == 0x05:
                    number, _, nanoseconds, _ = _MESSAGE_HEADER.unpack_from(record)
                    if number in self._channels:
                        yield self._channels[number], nanoseconds, record[_MESSAGE_HEADER.size :]
            except (_CutOff, struct.error) as error:
                if partly:
                    return
                raise ValueError(f"the chunk at byte {span.at} is damaged") from error

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, nanoseconds, raw message), by time."""
        self.position = 0
        spans = sorted(self._spans, key=lambda span: span.start)
        # What is open: the time of its next message, a number that keeps the order of the file, the message, the rest.
        opened: list[tuple[int, int, tuple[str, int, bytes], Iterator[tuple[str, int, bytes]]]] = []
        number = 0
        while opened or number < len(spans):
            while number < len(spans) and (not opened or spans[number].start <= opened[0][0]):
                chosen = [m for m in self._whole(spans[number]) if m[0] in topics]
                rest = iter(sorted(chosen, key=lambda message: message[1]))
                if (first := next(rest, None)) is not None:
                    heapq.heappush(opened, (first[1], number, first, rest))
                number += 1
            if opened:
                _, place, message, rest = opened[0]
                following = next(rest, None)
                if following is None:
                    heapq.heappop(opened)
                else:
                    heapq.heapreplace(opened, (following[1], place, following, rest))
                yield message

    def _whole(self, span: _Span) -> Iterator[tuple[str, int, bytes]]:
        """Yield the messages of a chunk; without its index the file may end within it."""
        try:
            yield from self._records(span, self.trouble != "")
        except _CutOff as error:
            if not self.trouble:
                raise ValueError(f"the chunk at byte {span.at} is damaged") from error


def _string2(data: bytes, place: int) -> tuple[str, int]:
    (size,) = struct.unpack_from("<I", data, place)
    return data[place + 4 : place + 4 + size].decode("utf-8", "replace"), place + 4 + size
