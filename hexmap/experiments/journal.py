"""Finished cases on disk, so that an interrupted run goes on where it stopped."""

from __future__ import annotations

import contextlib
import io
import json
import os
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hexmap.base.errors import FileAccessError, FormatError

_CHECKSUM = b',"crc32":'


class Journal:
    """Finished cases on disk, one JSON line each, after a first line that says what they are results of.

    A line is written by one call, so that a killed run can leave at most the last line torn; that one is cut
    off, and its case computed again.
    """

    def __init__(self, path: Path | None, file: io.FileIO | None) -> None:
        self._path, self._file = path, file
        self.finished: dict[str, dict[str, Any]] = {}

    @classmethod
    @contextlib.contextmanager
    def open(cls, folder: str | os.PathLike[str] | None, name: str, description: dict[str, Any]) -> Iterator[Journal]:
        """Open the journal ``name`` in ``folder`` and read it; without a folder nothing is kept."""
        if folder is None:
            yield cls(None, None)
            return
        path = Path(folder) / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = io.FileIO(path, "a+")
        except OSError as error:
            raise FileAccessError(f"{path}: cannot be written: {error.strerror or error}") from error
        journal = cls(path, file)
        with file:
            journal._lock()
            journal._read(description)
            yield journal
            # Power may fail; a killed process loses nothing even without this.
            with contextlib.suppress(OSError):
                os.fsync(file.fileno())

    def _lock(self) -> None:
        """Keep a second run off the same journal; the lock goes with the process, however it ends."""
        assert self._file is not None
        try:
            import fcntl
        except ImportError:  # another system than POSIX
            return
        try:
            fcntl.flock(self._file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise FileAccessError(f"{self._path}: another run is using this journal") from error
        except OSError:
            return  # file systems without locks

    def _read(self, description: dict[str, Any]) -> None:
        assert self._file is not None
        self._file.seek(0)
        content = self._file.readall()
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            self._file.truncate(whole)
        lines = content[:whole].splitlines()
        if not lines:
            self._write({"hexmap": "journal", "format": 1, "of": description})
            return
        head = _parse(lines[0])
        if head.get("hexmap") != "journal" or head.get("format") != 1 or head.get("of") != description:
            raise FormatError(f"{self._path}: is not the journal of this experiment; move it away to begin anew")
        for line in lines[1:]:
            entry = _parse(line)
            # A line that cannot be read, or is not as it was written, only costs its case a second time.
            key, result = entry.get("key"), entry.get("result")
            if isinstance(key, str) and isinstance(result, dict) and _is_whole(line):
                self.finished[key] = result

    def append(self, key: str, case: str, result: str) -> None:
        """Add a finished case; ``case`` and ``result`` are JSON already."""
        if self._file is not None:
            line = f'{{"key":"{key}","case":{case},"result":{result}'
            self._write_line(f"{line}{_CHECKSUM.decode()}{zlib.crc32(line.encode())}}}\n")

    def _write(self, value: object) -> None:
        self._write_line(json.dumps(value, separators=(",", ":")) + "\n")

    def _write_line(self, line: str) -> None:
        assert self._file is not None
        content = line.encode()
        try:
            while content:
                content = content[self._file.write(content) :]
        except OSError as error:
            raise FileAccessError(f"{self._path}: cannot be written: {error.strerror or error}") from error


def _is_whole(line: bytes) -> bool:
    """Tell whether a line has the checksum of what is before it."""
    before, found, checksum = line.rpartition(_CHECKSUM)
    return bool(found) and checksum == b"%d}" % zlib.crc32(before)


def _parse(line: bytes) -> dict[str, Any]:
    try:
        value = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return value if isinstance(value, dict) else {}
