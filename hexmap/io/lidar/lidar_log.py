"""What all logs of LiDARs share: settings, counts and the checks of every scan."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError, LogError
from hexmap.base.text import plural, shown
from hexmap.io.logs.log_account import LogAccount, Tally
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan

__all__ = ["LidarLog", "LidarLogSettings", "returned"]

# No range of a LiDAR is shorter: drivers write 0, 0, 0 where nothing came back.
_NOTHING = 1e-3


@dataclass(frozen=True)
class LidarLogSettings:
    """How to read a log of a LiDAR; plain JSON values.

    Attributes:
        topic: of the sensor_msgs/PointCloud2 in a bag; None: the only one.
        frame: of the scans to take; None: that of the first scan, and others are left out and counted.
        rate: scans a second of a folder whose file names are no stamps.
    """

    topic: str | None = None
    frame: str | None = None
    rate: float = 10.0

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ArgumentError: a rate that is not positive.
        """
        if not 0.0 < self.rate < float("inf"):
            raise ArgumentError(f"a folder holds a positive number of scans a second, not {self.rate:g}")


def returned(points: FloatArray) -> NDArray[np.bool_]:
    """Tell which points (N, 3) are something that a beam met: finite, and not at the sensor itself."""
    return np.asarray(np.isfinite(points).all(axis=1) & (np.abs(points) > _NOTHING).any(axis=1))


class LidarLog(LogAccount, ABC):
    """Scans of a LiDAR in the order of the log; iterate as often as needed, one scan is in memory at a time.

    Attributes:
        path: the file or folder.
        format: what it was read as.
        settings: how it is read.
        size: bytes of it.
        position: bytes read so far, about.
        scans: scans read so far.
        mount: T_robot_sensor, where the log says so: poses are those of the robot then, else those of the sensor.
        robot: the robot's frame, where the mount is known, else "".
        unused: what of a pose the log holds and nothing here uses, in words, or "".
        odometry: readings of another odometry: none are read.
    """

    format = ""
    odometry = 0
    _unit = "scan"

    def __init__(self, path: Path, settings: LidarLogSettings, size: int) -> None:
        """Begin; nothing is read yet."""
        self.settings = settings
        self.mount: Pose | None = None
        self.robot = self.unused = ""
        super().__init__(path, size)

    @property
    def poses_of(self) -> str:
        """Whose poses are found and taken, in words."""
        if self.mount is None:
            return "the sensor"
        return f"the robot ('{shown(self.robot)}')" if self.robot else "the robot"

    def _reset(self) -> None:
        super()._reset()
        self._empty, self._dropped, self._elsewhere = Tally(), Tally(), Tally()

    def _told(self) -> list[str]:
        texts = []
        if self._elsewhere.count:
            texts.append(
                f"{plural(self._elsewhere.count, 'scan')} of another frame left out, the first at "
                f"{self._elsewhere.first}; choose with --scan-frame"
            )
        if self._empty.count:
            count = plural(self._empty.count, "scan")
            texts.append(f"{count} without points left out, the first at {self._empty.first}")
        if self._dropped.count:
            texts.append(
                f"{plural(self._dropped.count, 'point')} dropped (not finite, or at the sensor itself), the first at "
                f"{self._dropped.first}"
            )
        return texts

    def __iter__(self) -> Iterator[Scan]:
        """Read the log from its start.

        Raises:
            LogError: there is no scan in the whole log (raised at its end).
            FileAccessError: a file cannot be read any more.
        """
        self._reset()
        for scan in self._read():
            self.scans += 1
            yield scan
        if self.scans == 0:
            # What happened to the scans says more than how the log was opened.
            notes = self.warnings[len(self._notes) :] or self.warnings
            raise LogError(self._no_scan() + (f" ({notes[0].partition(': ')[2]})" if notes else ""))
        self.position = self.size

    @abstractmethod
    def _read(self) -> Iterator[Scan]:
        """Yield the scans."""

    @abstractmethod
    def _no_scan(self) -> str:
        """Say that there was no scan."""

    def _clean(
        self, stamp: float, points: FloatArray, times: FloatArray | None, intensity: FloatArray | None, number: int,
        where: str,
    ) -> Scan | None:  # fmt: skip
        """Return a scan of its finite points that are not at the sensor itself; None, and counted, if there is none."""
        if not len(points):
            self._empty.add(where)
            return None
        good = returned(points)
        dropped = len(points) - int(np.count_nonzero(good))
        if dropped:
            self._dropped.add(where, dropped)
            points = points[good]
            times = None if times is None else times[good]
            intensity = None if intensity is None else intensity[good]
        if not len(points):
            self._empty.add(where)
            return None
        return Scan(stamp, points, line=number, times=times, intensity=intensity)
