"""Checkpoints of a long mapping run, from which a killed one goes on to the same bits.

A checkpoint holds all that a run knows after so many readings of its log. It is a pickle, so that it is read with a
reader that makes objects of this project and of numpy only: a file from elsewhere cannot run anything.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import pickle
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hexmap.base.atomic_files import atomic_path
from hexmap.base.errors import FileAccessError, FormatError
from hexmap.base.version import __version__
from hexmap.io.lidar.lidar_log import LidarLog
from hexmap.io.logs.log import Log
from localisation.lidar_settings import LidarSettings
from localisation.settings import MappingSettings
from localisation.slam.settings import LoopSettings

__all__ = ["Checkpoint", "Checkpoints", "checkpoints_of", "forget"]

_NAME = "mapping.checkpoint"
_MAGIC = b"hexmap checkpoint\n"
_PACKAGES = ("hexmap.", "localisation.")
_OTHERS = {
    ("builtins", name) for name in ("set", "frozenset", "complex", "slice", "range", "bytearray")
} | {
    ("collections", "OrderedDict"), ("collections", "deque"), ("pathlib", "PosixPath"), ("pathlib", "WindowsPath"),
    ("numpy", "ndarray"), ("numpy", "dtype"),
}  # fmt: skip
_NUMPY = {"_reconstruct", "scalar", "_frombuffer"}
_READ = 1 << 20


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """A run that was begun.

    Attributes:
        readings: of the log that were taken, laser and odometry.
        state: what the run knew then.
    """

    readings: int
    state: Any


class Checkpoints:
    """Keeps the last checkpoint of one run in a folder.

    Args:
        folder: made where it is missing.
        every: seconds between two checkpoints.

    Raises:
        FileAccessError: the folder cannot be made.
    """

    def __init__(self, folder: str | os.PathLike[str], every: float = 30.0) -> None:
        """Make the folder."""
        self.path = Path(folder) / _NAME
        self.every = every
        self._last = time.monotonic()
        self._described: tuple[Path, dict[str, Any]] | None = None
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FileAccessError(f"{folder}: cannot be made a folder for checkpoints: {error.strerror}") from error

    def find(
        self, log: Log | LidarLog, settings: MappingSettings | LidarSettings, loops: LoopSettings
    ) -> Checkpoint | None:
        """Return the checkpoint of a run on this log with these settings; None where there is none.

        Raises:
            FormatError: what is there is of another run, of another version, or damaged.
        """
        if not self.path.exists():
            return None
        with open(self.path, "rb") as handle:
            if handle.readline() != _MAGIC:
                raise FormatError(f"{self.path}: not a checkpoint of hexmap")
            try:
                run = json.loads(handle.readline())
                digest = handle.readline().strip().decode("ascii", "replace")
            except ValueError as error:
                raise FormatError(f"{self.path}: damaged, its heading cannot be read; delete it") from error
            body = handle.read()
        wanted = _describe(log, settings, loops)
        for name, value in wanted.items():
            if not isinstance(run, dict) or run.get(name) != value:
                raise FormatError(
                    f"{self.path}: belongs to another run ({name} differs); delete it or choose another folder"
                )
        if hashlib.sha256(body).hexdigest() != digest:
            raise FormatError(f"{self.path}: damaged, its content does not go with its sum; delete it")
        try:
            readings, state = _Reader(io.BytesIO(body)).load()
        except FormatError:
            raise
        except Exception as error:
            raise FormatError(f"{self.path}: damaged ({error}); delete it") from error
        return Checkpoint(readings, state)

    def keep(
        self,
        log: Log | LidarLog,
        settings: MappingSettings | LidarSettings,
        loops: LoopSettings,
        readings: int,
        state: Any,
    ) -> None:
        """Write a checkpoint if the last one is old enough: the old one is there until the new one is whole.

        Raises:
            FileAccessError: the folder is not writable.
        """
        if time.monotonic() - self._last < self.every:
            return
        body = pickle.dumps((readings, state), protocol=4)
        with atomic_path(self.path) as temporary, open(temporary, "wb") as handle:
            handle.write(_MAGIC)
            # The sum over a log takes a while, and a run has one log.
            if self._described is None or self._described[0] != log.path:
                self._described = log.path, _describe(log, settings, loops)
            run = {**self._described[1], "readings": readings}
            handle.write(json.dumps(run, sort_keys=True).encode() + b"\n")
            handle.write(hashlib.sha256(body).hexdigest().encode() + b"\n")
            handle.write(body)
        self._last = time.monotonic()

    def readings(self) -> int | None:
        """Return how many readings of the log the checkpoint holds, as it says; None where there is none that does."""
        try:
            with open(self.path, "rb") as handle:
                count = json.loads(handle.readline())["readings"] if handle.readline() == _MAGIC else None
        except (OSError, ValueError, LookupError, TypeError):
            return None
        return count if isinstance(count, int) else None

    def forget(self) -> None:
        """Remove the checkpoint: the run is done."""
        self.path.unlink(missing_ok=True)


def checkpoints_of(folder: Path | None, count: int) -> list[Checkpoints | None]:
    """Return where each of some runs keeps its checkpoints below a folder; None for each where there is none.

    Raises:
        FileAccessError: a folder cannot be made.
    """
    return [None if folder is None else Checkpoints(folder / str(k)) for k in range(count)]


def forget(folder: Path, count: int) -> None:
    """Remove the checkpoints of runs that are done, and the folders if they are empty."""
    for k in range(count):
        Checkpoints(folder / str(k)).forget()
    for path in [*(folder / str(k) for k in range(count)), folder]:
        with contextlib.suppress(OSError):
            path.rmdir()


def _describe(
    log: Log | LidarLog, settings: MappingSettings | LidarSettings, loops: LoopSettings
) -> dict[str, Any]:
    """Return what must be the same for a run to go on."""
    sha = hashlib.sha256()
    folder = log.path.is_dir()
    for path in sorted(p for p in log.path.iterdir() if p.is_file()) if folder else [log.path]:
        if folder:
            sha.update(path.name.encode("utf-8", "surrogateescape") + b"\0")
        with open(path, "rb") as handle:
            while block := handle.read(_READ):
                sha.update(block)
    return {
        "version": __version__,
        "log": sha.hexdigest(),
        "settings": json.loads(json.dumps(settings.to_dict())),
        "loops": json.loads(json.dumps(loops.__dict__)),
    }


class _Reader(pickle.Unpickler):
    """Reads objects of this project and of numpy, and refuses everything else."""

    def find_class(self, module: str, name: str) -> Any:
        """Return a class by its module and name."""
        ours = module.startswith(_PACKAGES) and "." not in name
        numpy = module.split(".")[0] == "numpy" and name in _NUMPY
        if ours or numpy or (module, name) in _OTHERS:
            found = super().find_class(module, name)
            # Of our own modules only classes: a function might do something.
            if not ours or isinstance(found, type):
                return found
        raise FormatError(f"it asks for {module}.{name}, which no checkpoint holds")
