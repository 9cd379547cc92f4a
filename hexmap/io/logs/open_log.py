"""Open a log: its format is found by its content, not by its name."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from hexmap.base.errors import FileAccessError, LogError
from hexmap.io import file_kinds
from hexmap.io.logs.bag_sources import are_parts, in_order
from hexmap.io.logs.log import Log, LogSettings
from hexmap.io.read_file import GzipError, beginning, cannot_read, inflated

__all__ = ["bag_kind", "is_log", "open_log"]

_KNOWN = "a CARMEN or Wean Hall log (plain or gzip), a ROS 1 bag, a ROS 2 bag or an MCAP file"
_BAGS = {
    file_kinds.ROSBAG1: "rosbag1",
    file_kinds.MCAP: "mcap",
    file_kinds.SQLITE: "rosbag2",
}


def open_log(path: str | os.PathLike[str], settings: LogSettings | None = None) -> Log:
    """Open a log; its format is found by its content, not by its name.

    Args:
        path: a CARMEN or Wean Hall log (plain or gzip), a ROS 1 bag, a ROS 2 bag (folder or its single
            file) or an MCAP file.
        settings: how to read it.

    Returns:
        The log, to be iterated over: :class:`~hexmap.poses.Scan` and
        :class:`~hexmap.poses.Odometry` in file order.

    Raises:
        FileAccessError: the file is not there or cannot be read.
        LogError: it is something else altogether, is empty, or has no laser in it.
    """
    settings = settings or LogSettings()
    path = Path(path)
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            return _open_folder(path, settings)
        if not stat.S_ISREG(mode):
            raise LogError(f"{path}: not a file that can be read twice; copy the log to a file first")
        with open(path, "rb") as handle:
            head = handle.read(65536)
    except FileNotFoundError:
        raise FileAccessError(f"{path}: no such file") from None
    except (FileAccessError, LogError):
        raise
    except OSError as error:
        raise cannot_read(path, error) from error
    if not head:
        raise LogError(f"{path}: the file is empty")
    bag = file_kinds.find_kind(head, _BAGS)
    if bag is not None:
        return _open_bag(path, settings, _BAGS[bag])
    compressed = file_kinds.GZIP.begins(head)
    text = _beginning(path, head) if compressed else head
    if file_kinds.find_kind(text, _BAGS) is not None:
        raise LogError(f"{path}: a bag inside gzip cannot be read; decompress it first")
    foreign = file_kinds.find_kind(text)
    if foreign is not None:
        advice = f"; {foreign.advice}" if foreign.advice else ""
        raise LogError(f"{path}: this is {foreign.name}{advice}; a log is {_KNOWN}")
    if file_kinds.control_byte(text[:4096]) is not None:
        raise LogError(f"{path}: the file is binary and of no known kind; a log is {_KNOWN}")
    if file_kinds.WEAN_LOG.begins(text):
        from hexmap.io.logs.wean import WeanLog

        return WeanLog(path, settings, compressed)
    from hexmap.io.logs.carmen import CarmenLog

    return CarmenLog(path, settings, compressed)


def is_log(path: Path) -> bool:
    """Tell whether a file or folder looks like a log that :func:`open_log` reads, by how it begins."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or bool(_storages(path))
    return file_kinds.find_kind(beginning(path), (*_BAGS, file_kinds.WEAN_LOG, file_kinds.CARMEN_LOG)) is not None


def bag_kind(path: Path) -> tuple[str, list[Path] | None] | None:
    """Return "rosbag1", "rosbag2" or "mcap" for a bag, by how it begins, and its files where they are the parts of one.

    None for anything else.

    Raises:
        LogError: a folder of bags that are not the parts of one recording.
    """
    if not path.is_dir():
        found = file_kinds.find_kind(beginning(path), _BAGS)
        return None if found is None else (_BAGS[found], None)
    metadata = path / "metadata.yaml"
    if metadata.is_file():
        with open(metadata, encoding="utf-8", errors="replace") as handle:
            text = handle.read(1 << 16)
        return "mcap" if "storage_identifier: mcap" in text else "rosbag2", None
    storages = _storages(path)
    if not storages:
        return None
    names = ", ".join(storage.name for storage in storages[:4]) + (", ..." if len(storages) > 4 else "")
    kinds = {_BAGS.get(kind) for storage in storages if (kind := file_kinds.find_kind(beginning(storage), _BAGS))}
    whole = all(file_kinds.find_kind(beginning(storage), _BAGS) for storage in storages)
    if not are_parts(storages) or len(kinds) != 1 or not whole:
        why = "not the parts of one recording" if len(storages) > 1 else "no bag"
        raise LogError(
            f"{path}: a folder without metadata.yaml is not a ROS 2 bag, and the files in it ({names}) are {why}; "
            "name the file to read, or run `ros2 bag reindex`"
        )
    return str(kinds.pop()), in_order(storages)


def _text_logs(folder: Path) -> list[Path]:
    """Return the files of a folder that begin as a CARMEN or Wean Hall log does, by name."""
    kinds = (file_kinds.WEAN_LOG, file_kinds.CARMEN_LOG)
    files = sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
    return [path for path in files if file_kinds.find_kind(beginning(path), kinds) is not None]


def _beginning(path: Path, head: bytes) -> bytes:
    """Return the first bytes inside a gzip file that begins with ``head``."""
    try:
        # What is cut off here is the head alone: the error for that would come after its text.
        return next(inflated([head]))
    except (StopIteration, GzipError) as error:
        state = "damaged" if str(error).startswith("damaged") else "empty or cut off"
        raise LogError(f"{path}: the gzip file is {state} at its start") from error


def _open_bag(path: Path, settings: LogSettings, kind: str) -> Log:
    from hexmap.io.logs.bags import BagLog

    return BagLog(path, settings, kind)


def _open_folder(path: Path, settings: LogSettings) -> Log:
    found = bag_kind(path)
    others = [] if (path / "metadata.yaml").is_file() else _text_logs(path)
    if others:
        names = ", ".join(other.name for other in others[:4]) + (", ..." if len(others) > 4 else "")
        beside = "" if found is None else " beside bags"
        raise LogError(f"{path}: a folder of {len(others)} logs ({names}){beside}; name the log to read, or several")
    if found is None:
        raise LogError(f"{path}: a folder without metadata.yaml is not a ROS 2 bag, and no bags are in it")
    from hexmap.io.logs.bags import BagLog

    return BagLog(path, settings, *found)


def _storages(path: Path) -> list[Path]:
    """Return the files in a folder that are bags by their names."""
    return sorted(entry for entry in path.iterdir() if entry.suffix in (".db3", ".mcap", ".bag") and entry.is_file())
