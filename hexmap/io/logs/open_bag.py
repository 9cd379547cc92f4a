"""Open a bag of any kind: one file, or the files of a folder in order."""

from __future__ import annotations

import contextlib
from pathlib import Path

from hexmap.base.errors import ArgumentError, FileAccessError, LogError, MissingDependencyError, TooLargeError
from hexmap.base.text import reason, shown
from hexmap.io.logs.bag_sources import BagSource, IndexedBag, SplitBag, folder_files
from hexmap.io.read_file import cannot_read

__all__ = ["ADVICE", "open_bag", "open_sound_bag", "topic_list", "topic_name"]

ADVICE = {
    "rosbag1": "`rosbag reindex` may repair it",
    "mcap": "`mcap recover` or `ros2 bag reindex` may repair it",
    "rosbag2": "`ros2 bag reindex` may repair it",
}
"""What may repair a bag, by its kind."""


def open_sound_bag(path: Path, kind: str, parts: list[Path] | None) -> BagSource:
    """Open a bag; the arguments are those of :func:`open_bag`.

    Raises:
        FileAccessError: the file cannot be read.
        LogError: the bag is damaged beyond reading.
        TooLargeError: a chunk inflates to more than may be.
        MissingDependencyError: rosbags is not installed.
    """
    try:
        return open_bag(path, kind, parts)
    except ModuleNotFoundError as error:
        raise MissingDependencyError(f"{path}: reading bags takes the package rosbags: {error}") from error
    except PermissionError as error:
        raise cannot_read(path, error) from error
    except TooLargeError as error:
        raise TooLargeError(f"{path}: {error}") from error
    except (ArgumentError, FileAccessError):
        raise
    except Exception as error:  # a damaged bag surfaces as any error of the parsers below
        raise LogError(f"{path}: the bag cannot be read: {reason(error)}; {ADVICE[kind]}") from error


def open_bag(path: Path, kind: str, parts: list[Path] | None) -> BagSource:
    """Open a bag.

    Args:
        path: the file or the folder.
        kind: "rosbag1", "rosbag2" or "mcap".
        parts: the files of a folder without metadata, in order.

    Raises:
        FileAccessError: a part of the recording is missing.
        TooLargeError: a chunk inflates to more than may be.
        Exception: of many kinds, where it is damaged beyond reading.
    """
    if parts is not None:
        return _open_parts(path, kind, parts)
    if path.is_dir() and kind == "mcap":
        files, packed = folder_files(path)
        if not packed:
            return _open_parts(path, kind, files)
    return _open_file(path, kind)


def _open_parts(path: Path, kind: str, files: list[Path]) -> BagSource:
    with contextlib.ExitStack() as stack:
        parts: list[BagSource] = []
        for file in files:
            try:
                parts.append(_open_file(file, kind))
            except FileNotFoundError:
                # The name is that of the metadata: it may hold anything.
                name = shown(str(file), 4096)
                raise FileAccessError(f"{name}: no such file, a part of the recording {path}") from None
            except TooLargeError:
                raise
            except Exception as error:
                raise ValueError(f"{shown(file.name, 200)}: {reason(error)}") from error
            stack.callback(parts[-1].close)
        # Nothing failed: they stay open.
        stack.pop_all()
    return SplitBag(parts, [file.stat().st_size for file in files])


def _open_file(path: Path, kind: str) -> BagSource:
    from hexmap.io.logs.bag_recovery import McapFile, UnindexedRosbag1

    if kind == "mcap" and not path.is_dir():
        mcap = McapFile(path)
        if mcap.trouble and not mcap.topics:
            raise ValueError(mcap.trouble)
        return mcap
    try:
        return IndexedBag(path, kind)
    except (ModuleNotFoundError, PermissionError, FileNotFoundError, TooLargeError):
        raise
    except Exception as error:
        if kind != "rosbag1":
            raise
        why = reason(error)
        source = UnindexedRosbag1(path)
        if not source.topics:
            raise
        source.trouble = why
        return source


def topic_list(topics: dict[str, str]) -> str:
    """Return topics and their types in one line."""
    if not topics:
        return "none"
    named = sorted(topics.items())
    return ", ".join(f"{topic_name(topic)} ({topic_name(kind.replace('/msg/', '/'))})" for topic, kind in named)


def topic_name(name: str) -> str:
    """Return the name of a topic or a type as it can stand in a message."""
    return shown(name, 120)
