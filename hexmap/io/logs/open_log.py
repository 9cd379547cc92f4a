"""Open a log: its format is found by its content, not by its name."""

from __future__ import annotations

import os
import stat
import zlib
from pathlib import Path

from hexmap.base.errors import FileAccessError, LogError
from hexmap.io.logs.log import Log, LogSettings

__all__ = ["open_log"]

_GZIP = b"\x1f\x8b"
_MCAP = b"\x89MCAP0\r\n"
_ROSBAG1 = b"#ROSBAG V"
_SQLITE = b"SQLite format 3\x00"
_KNOWN = "a CARMEN log (plain or gzip), a ROS 1 bag, a ROS 2 bag or an MCAP file"
# What other files that people hand over by mistake begin with; the rest is told by its bytes.
_FOREIGN = (
    (b"\x89PNG", "a PNG picture"),
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"PK\x03\x04", "a ZIP archive"),
    (b"PAR1", "a Parquet file"),
    (b"%PDF", "a PDF document"),
    (b"BZh", "a bzip2 file; decompress it first"),
    (b"\xfd7zXZ", "an xz file; decompress it first"),
    (b"\x28\xb5\x2f\xfd", "a zstd file; decompress it first"),
    (b"# .PCD", "a point cloud (PCD)"),
    (b"ply\n", "a point cloud (PLY)"),
    (b"P5\n", "a PGM picture"),
)


def open_log(path: str | os.PathLike[str], settings: LogSettings | None = None) -> Log:
    """Open a log; its format is found by its content, not by its name.

    Args:
        path: a CARMEN log (plain or gzip), a ROS 1 bag, a ROS 2 bag (folder or its single file)
            or an MCAP file.
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
        raise FileAccessError(f"{path}: cannot be read: {error.strerror or error}") from error
    if not head:
        raise LogError(f"{path}: the file is empty")
    if head.startswith(_ROSBAG1):
        return _open_bag(path, settings, "rosbag1")
    if head.startswith(_MCAP):
        return _open_bag(path, settings, "mcap")
    if head.startswith(_SQLITE):
        return _open_bag(path, settings, "rosbag2")
    compressed = head.startswith(_GZIP)
    text = _inflated(path, head) if compressed else head
    if text.startswith((_ROSBAG1, _MCAP, _SQLITE)):
        raise LogError(f"{path}: a bag inside gzip cannot be read; decompress it first")
    for magic, name in _FOREIGN:
        if text.startswith(magic):
            raise LogError(f"{path}: this is {name}; a log is {_KNOWN}")
    # Control characters other than tab, newline, form feed and return occur in no text.
    if any(byte < 9 or 13 < byte < 27 or 27 < byte < 32 for byte in text[:4096]):
        raise LogError(f"{path}: the file is binary and of no known kind; a log is {_KNOWN}")
    from hexmap.io.logs.carmen import CarmenLog

    return CarmenLog(path, settings, compressed)


def _inflated(path: Path, head: bytes) -> bytes:
    """Return the first bytes inside a gzip file."""
    try:
        text = zlib.decompressobj(wbits=31).decompress(head, 4096)
    except zlib.error as error:
        raise LogError(f"{path}: the gzip file is damaged at its start: {error}") from error
    if not text:
        raise LogError(f"{path}: the gzip file is empty or cut off at its start")
    return text


def _open_bag(path: Path, settings: LogSettings, kind: str) -> Log:
    from hexmap.io.logs.bags import BagLog

    return BagLog(path, settings, kind)


def _open_folder(path: Path, settings: LogSettings) -> Log:
    metadata = path / "metadata.yaml"
    if not metadata.is_file():
        storages = sorted(entry.name for entry in path.iterdir() if entry.suffix in (".db3", ".mcap", ".bag"))
        advice = f"; name the file in it ({storages[0]}) or run `ros2 bag reindex`" if storages else ""
        raise LogError(f"{path}: a folder without metadata.yaml is no ROS 2 bag{advice}")
    text = metadata.read_text(encoding="utf-8", errors="replace")
    return _open_bag(path, settings, "mcap" if "storage_identifier: mcap" in text else "rosbag2")
