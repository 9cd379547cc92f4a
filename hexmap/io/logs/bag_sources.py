"""Bags as streams of messages, whatever their format: one file, or the parts of a recording in order."""

from __future__ import annotations

import contextlib
import re
import tempfile
from collections.abc import Collection, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

from hexmap.base.errors import TooLargeError
from hexmap.io.logs.inflate import bound_rosbags, decompressor, inflate
from hexmap.io.read_file import CHUNK, inflation_limit

__all__ = ["BagSource", "Decoder", "IndexedBag", "SplitBag", "are_parts", "folder_files", "in_order", "message_type"]

# The YAML file of a ROS 2 bag lists topics and files, some hundred bytes each.
_MOST_METADATA = 1 << 22


class BagSource(Protocol):
    """A bag; times are in nanoseconds.

    Attributes:
        topics: topic -> message type, as ROS 2 writes it (``sensor_msgs/msg/LaserScan``).
        trouble: why the file is read without its index, if it is.
    """

    topics: dict[str, str]
    trouble: str

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, nanoseconds, raw message)."""

    def deserialize(self, raw: bytes, topic: str) -> Any:
        """Decode a message of a topic."""

    def fraction(self, nanoseconds: int) -> float:
        """Return how much of the bag lies before a time."""

    def close(self) -> None:
        """Close the files."""


def message_type(name: str) -> str:
    """Return the name of a message type as ROS 2 writes it: ROS 1 leaves out the ``msg`` in its middle.

    Examples:
        >>> from hexmap.io.logs.bag_sources import message_type
        >>> message_type("sensor_msgs/LaserScan"), message_type("sensor_msgs/msg/LaserScan")
        ('sensor_msgs/msg/LaserScan', 'sensor_msgs/msg/LaserScan')
    """
    package, slash, last = name.rpartition("/")
    return f"{package.removesuffix('/msg')}/msg/{last}" if slash else name


class Decoder:
    """Decodes messages by the definitions that their bag holds.

    Each type is parsed by itself and when it is met, so that a definition of no interest, or two that differ, are of
    no consequence.
    """

    def __init__(self) -> None:
        """Begin without definitions."""
        self._definitions: dict[tuple[str, bool], tuple[str, str]] = {}

    def define(self, kind: str, ros1: bool, language: str, definition: str) -> None:
        """Take the definition of a type.

        Args:
            kind: the type, as ROS 2 writes it.
            ros1: whether its messages are in the encoding of ROS 1.
            language: "msg", "idl", or "" where there is none.
            definition: its text.
        """
        if language and definition.strip():
            self._definitions.setdefault((kind, ros1), (language, definition))

    def decode(self, raw: bytes, kind: str, ros1: bool) -> Any:
        """Return a message.

        Raises:
            Exception: of many kinds, where message and definition do not go together.
        """
        store = _type_store(kind, ros1, *self._definitions.get((kind, ros1), ("", "")))
        return store.deserialize_ros1(raw, kind) if ros1 else store.deserialize_cdr(raw, kind)


# A store compiles the reading of its types, which takes longer than reading a small bag.
@lru_cache(maxsize=64)
def _type_store(kind: str, ros1: bool, language: str, definition: str) -> Any:
    """Return what decodes a type by its definition, or by the usual one where that is missing or no such text."""
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    if language:
        with contextlib.suppress(Exception):
            types = get_types_from_idl(definition) if language == "idl" else get_types_from_msg(definition, kind)
            store = get_typestore(Stores.EMPTY)
            store.register(types)
            if kind in store.types:
                return store
    # Old ROS 2 bags do not say what their messages look like; laser, odometry and tf never changed.
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.LATEST)
    if ros1 and "tf2_msgs/msg/TFMessage" not in store.types:
        for tf in ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"):
            store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", tf))
    return store


class IndexedBag:
    """A ROS 1 bag, or a ROS 2 bag of sqlite3 files, through rosbags and the bag's index."""

    def __init__(self, path: Path, kind: str) -> None:
        """Open the bag.

        Args:
            path: a file, or the folder of a ROS 2 bag.
            kind: "rosbag1", "rosbag2" or "mcap".

        Raises:
            Exception: of many kinds, where it is damaged.
        """
        bound_rosbags()
        self.trouble = ""
        self._decoder = Decoder()
        self._ros1 = kind == "rosbag1"
        self._packed = False
        self._stack = contextlib.ExitStack()
        try:
            self._reader = self._open(path, kind)
            self._stack.callback(self._reader.close)
        except BaseException:
            self._stack.close()
            raise
        self.topics: dict[str, str] = {}
        for connection in self._reader.connections:
            kind = message_type(connection.msgtype)
            self.topics.setdefault(connection.topic, kind)
            language = {1: "msg", 2: "idl"}.get(connection.msgdef.format.value, "")
            self._decoder.define(kind, self._ros1, language, connection.msgdef.data)

    def _open(self, path: Path, kind: str) -> Any:
        if kind == "rosbag1":
            from rosbags.rosbag1 import Reader as Reader1

            reader1 = Reader1(path)
            reader1.open()
            return reader1
        from rosbags.rosbag2.reader import DirectoryReader, Reader

        if not path.is_dir():
            reader = Reader(self._well_named(path, kind))
            reader.open()
            return reader
        _check_folder(path)
        folder = DirectoryReader(path)
        folder.open()
        # Messages that are compressed one by one are inflated here, within bounds.
        if folder.metadata.compression_mode == "message":
            self._packed = True
            folder.metadata = folder.metadata._replace(compression_mode=None)
        return folder

    def _well_named(self, path: Path, kind: str) -> Path:
        """Return a path with the suffix by which rosbags tells the formats, a link if need be."""
        suffix = {"rosbag2": ".db3", "mcap": ".mcap"}[kind]
        if path.suffix == suffix:
            return path
        folder = self._stack.enter_context(tempfile.TemporaryDirectory())
        link = Path(folder) / f"log{suffix}"
        link.symlink_to(path.resolve())
        return link

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, nanoseconds, raw message), by time."""
        chosen = [c for c in self._reader.connections if c.topic in topics]
        if not chosen:
            return  # rosbags takes none for all
        for connection, nanoseconds, raw in self._reader.messages(connections=chosen):
            yield connection.topic, nanoseconds, inflate(raw, "zstd") if self._packed else raw

    def deserialize(self, raw: bytes, topic: str) -> Any:
        """Decode a message of a topic."""
        return self._decoder.decode(raw, self.topics[topic], self._ros1)

    def _span(self) -> tuple[int, int]:
        about = getattr(self._reader, "metadata", None) or self._reader
        return int(about.start_time), int(about.duration)

    def fraction(self, nanoseconds: int) -> float:
        """Return how much of the bag lies before a time."""
        start, duration = self._span()
        return (nanoseconds - start) / duration if duration > 0 else 1.0

    def close(self) -> None:
        """Close the files."""
        self._stack.close()


def folder_files(path: Path) -> tuple[list[Path], bool]:
    """Return the files that the metadata of a ROS 2 bag lists, and whether they, or their messages, are compressed.

    Raises:
        Exception: of many kinds, where the metadata are no such YAML.
    """
    from ruamel.yaml import YAML

    metadata = path / "metadata.yaml"
    if metadata.stat().st_size > _MOST_METADATA:
        raise TooLargeError(f"{metadata}: {metadata.stat().st_size} bytes; at most {_MOST_METADATA} are read")
    about = YAML(typ="safe").load(metadata.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
    files = [path / Path(str(name)).name for name in about["relative_file_paths"]]
    return files, str(about.get("compression_mode") or "none").lower() not in ("none", "")


def _check_folder(path: Path) -> None:
    """Refuse a ROS 2 bag whose compressed files would fill the disk."""
    files, packed = folder_files(path)
    if not packed:
        return
    for file in files:
        if file.suffix == ".zstd" and file.is_file():
            machine, size, limit = decompressor("zstd")(), 0, inflation_limit(file.stat().st_size)
            with file.open("rb") as handle:
                while size <= limit and not machine.eof and (data := handle.read(CHUNK)):
                    size += len(machine.decompress(data, limit + 1))
            if size > limit:
                raise TooLargeError(
                    f"{file.name} inflates to more than {limit} bytes; HEXMAP_MAX_INFLATION raises the limit"
                )


class SplitBag:
    """The parts of one recording, one after the other."""

    def __init__(self, parts: list[BagSource], sizes: list[int]) -> None:
        """Take the parts in order, and how large each file is."""
        self._parts = parts
        self._sizes = [max(size, 1) for size in sizes]
        self._at = 0
        self.topics: dict[str, str] = {}
        for part in parts:
            for topic, kind in part.topics.items():
                self.topics.setdefault(topic, kind)
        self.trouble = next((part.trouble for part in parts if part.trouble), "")

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, nanoseconds, raw message) of each part."""
        for at, part in enumerate(self._parts):
            self._at = at
            yield from part.messages(topics)

    def deserialize(self, raw: bytes, topic: str) -> Any:
        """Decode a message of a topic, by the definitions of the part that is being read."""
        return self._parts[self._at].deserialize(raw, topic)

    def fraction(self, nanoseconds: int) -> float:
        """Return how much of all parts lies before a time in the one that is being read."""
        within = min(max(self._parts[self._at].fraction(nanoseconds), 0.0), 1.0)
        return (sum(self._sizes[: self._at]) + within * self._sizes[self._at]) / sum(self._sizes)

    def close(self) -> None:
        """Close all parts."""
        for part in self._parts:
            part.close()


def in_order(paths: list[Path]) -> list[Path]:
    """Return the files of a recording in the order of the numbers in their names."""

    def key(path: Path) -> list[tuple[int, str]]:
        return [(int(word), "") if word.isdigit() else (-1, word) for word in re.split(r"([0-9]+)", path.name) if word]

    return sorted(paths, key=key)


def are_parts(paths: list[Path]) -> bool:
    """Tell whether files are the parts of one recording: their names differ in digits only."""
    return len({re.sub(r"[0-9]+", "0", path.name) for path in paths}) == 1
