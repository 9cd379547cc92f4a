"""A folder of point files, one a scan: PCD and PLY, with a time a point where they have one, KITTI .bin, NPY, text."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import HexmapError, LogError
from hexmap.base.text import plural
from hexmap.io.clouds.read_points import PointFile, read_points
from hexmap.io.lidar.lidar_log import LidarLog, LidarLogSettings, returned
from hexmap.io.lidar.point_times import TIME_NAMES, PointTimes
from hexmap.io.logs.log_account import Tally
from hexmap.io.read_file import cannot_read
from hexmap.poses.scan import Scan

__all__ = ["LidarFolder", "scan_files"]

_SUFFIXES = (".pcd", ".ply", ".bin", ".npy", ".xyz", ".txt", ".csv", ".asc", ".pts")
# Names of files beside scans that are something else.
_NO_SCANS = re.compile(r"(times?|timestamps?|poses?|calib|readme|trajectory|groundtruth)\b", re.IGNORECASE)
_STAMP = re.compile(r"\d{9,11}(?:[._]\d+)?|\d{13}|\d{16}|\d{19}")
_TIMES = ("times.txt", "timestamps.txt")


def scan_files(folder: Path) -> list[Path]:
    """Return the scans of a folder: numbers in names count as numbers, so that 10 comes after 9.

    Raises:
        FileAccessError: the folder cannot be read.
    """
    try:
        entries = [e for e in folder.iterdir() if _suffix(e) in _SUFFIXES and e.is_file()]
    except OSError as error:
        raise cannot_read(folder, error) from error
    found = [e for e in entries if not e.name.startswith(".") and not _NO_SCANS.match(e.name)]
    return sorted(found, key=lambda e: [(int(t), "") if t.isdigit() else (-1, t) for t in re.split(r"(\d+)", e.name)])


def _suffix(path: Path) -> str:
    return Path(path.stem).suffix.lower() if path.suffix.lower() == ".gz" else path.suffix.lower()


class LidarFolder(LidarLog):
    """A folder of scans; see :class:`hexmap.io.lidar.LidarLog`.

    Stamps are the files' names where those are seconds, milliseconds, microseconds or nanoseconds since 1970, else the
    lines of ``times.txt`` or ``timestamps.txt`` in or beside the folder, else the order at ``settings.rate``.
    """

    _unit = "file"

    def __init__(self, path: Path, settings: LidarLogSettings) -> None:
        """List the scans and find their stamps.

        Raises:
            FileAccessError: the folder cannot be read.
            LogError: there is no scan in it.
        """
        self.files = scan_files(path)
        if not self.files:
            raise LogError(f"{path}: no scan in the folder; scans are {', '.join(_SUFFIXES)} files")
        self._sizes = [file.stat().st_size for file in self.files]
        super().__init__(path, settings, sum(self._sizes))
        kinds = sorted({_suffix(file) for file in self.files})
        self.format = "+".join(kind[1:] for kind in kinds)
        if len(kinds) > 1:
            self._notes.append(f"files of several kinds ({', '.join(kinds)}) taken as one run, by their names")
        self.stamps, how = self._find_stamps()
        if how:
            self._notes.append(how)

    def _find_stamps(self) -> tuple[list[float], str]:
        names = [Path(file.stem).stem if file.suffix == ".gz" else file.stem for file in self.files]
        if all(_STAMP.fullmatch(name) for name in names):
            return [_seconds(name) for name in names], ""
        for times in [folder / name for folder in (self.path, self.path.parent) for name in _TIMES]:
            if times.is_file():
                read = _read_times(times)
                if len(read) == len(self.files):
                    return read, ""
        return (
            np.round(np.arange(len(self.files)) / self.settings.rate, 9).tolist(),
            f"no stamps: neither the files' names nor times.txt; taken as {self.settings.rate:g} scans a second",
        )

    def _reset(self) -> None:
        super()._reset()
        self._untimed = Tally()

    def _told(self) -> list[str]:
        texts = super()._told()
        if self._untimed.count:
            count = plural(self._untimed.count, "scan")
            texts.append(f"{count} taken without the times of their points, the first {self._untimed.first}")
        return texts

    def _read(self) -> Iterator[Scan]:
        times = PointTimes()
        for number, (file, stamp, size) in enumerate(zip(self.files, self.stamps, self._sizes, strict=True)):
            self.position += size
            try:
                read = read_points(file, further=(*TIME_NAMES, "intensity"))
                if read.dim != 3:
                    raise LogError(f"{file}: points of the plane; a LiDAR's have x, y and z")
            except HexmapError as error:
                if "no points in the file" in str(error):
                    self._empty.add(file.name)
                else:
                    self._skipped.add(str(error))
                continue
            if read.dropped:
                self._dropped.add(file.name, read.dropped)
            scan = self._clean(
                stamp, read.points, self._times_of(read, stamp, times), read.further.get("intensity"), number, file.name
            )
            if scan is not None:
                yield scan

    def _times_of(self, read: PointFile, stamp: float, times: PointTimes) -> FloatArray | None:
        """Return seconds (N,) after the stamp of the points of a file; None, and counted, where they make no sweep."""
        try:
            return times.of(read.further.get, stamp, returned(read.points))
        except ValueError as error:
            self._untimed.add(f"{read.path.name}: {error}")
            return None

    def _no_scan(self) -> str:
        return f"{self.path}: none of the {len(self.files)} files can be used as a scan"


def _seconds(name: str) -> float:
    """Return the seconds that a file's name says."""
    digits = name.replace("_", ".")
    if "." in digits:
        return float(digits)
    return {13: 1e-3, 16: 1e-6, 19: 1e-9}.get(len(digits), 1.0) * int(digits)


def _read_times(path: Path) -> list[float]:
    """Return the stamps of a file: a number a line, or a date and a time as KITTI's raw data have."""
    from datetime import UTC, datetime

    out = []
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise cannot_read(path, error) from error
    for number, line in enumerate(lines, 1):
        text = line.strip()
        if not text:
            continue
        try:
            if ":" in text:
                whole, _, part = text.partition(".")
                moment = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC)
                out.append(moment.timestamp() + float(f"0.{part or 0}"))
            else:
                out.append(float(text.split()[0]))
        except ValueError as error:
            raise LogError(f"{path}: line {number}: not a time: {text[:40]!r}") from error
    return out
