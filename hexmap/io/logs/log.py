"""What all logs share: the settings, the tallies behind the warnings, and the beams' geometry."""

from __future__ import annotations

import math
import os
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError, LogError
from hexmap.base.text import plural
from hexmap.io.logs.log_account import LogAccount, Tally
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Event

LASERS = ("front", "rear", "FLASER", "RLASER", "ROBOTLASER1", "ROBOTLASER2", "RAWLASER1", "RAWLASER2")

# Lasers whose number of beams tells their field of view: (first beam, step), radians.
# 180 and 360 beams stop one step short of +90 degrees; 181, 361 and 721 include it.
_HALF_TURN = (180, 181, 360, 361, 720, 721)
_THREE_QUARTERS = (541, 1081)


@dataclass(frozen=True)
class LogSettings:
    """How to read a log; every field has a default that suits most logs, and is plain JSON.

    Attributes:
        angle_min: direction of the first beam in the laser's frame, radians, counter-clockwise
            from x. None: what the log says, else by the number of beams (see ``beam_fan``).
        angle_step: from one beam to the next, radians; negative for a laser that turns clockwise.
            None: as for ``angle_min``.
        no_return: metres; a range at or above it is a beam that returned nothing. A smaller
            maximum range in the log itself (ROBOTLASER1, LaserScan) is used instead.
        laser: which laser of a CARMEN log: "front" (ROBOTLASER1, else FLASER, else RAWLASER1), "rear"
            (ROBOTLASER2, else RLASER, else RAWLASER2), or one of the six by name. None: front, or
            rear where the log has no front laser.
        scan_topic: topic of the sensor_msgs/LaserScan in a bag. None: the only one, or of
            several the only one whose last name is ``scan``; sensor_msgs/MultiEchoLaserScan where there is none.
        scan_frame: frame of the scans in a bag, where one topic has scans of several lasers. None: the first scan's.
        odometry_topic: topic of the nav_msgs/Odometry in a bag. None: the only one, or of
            several the only one whose last name is ``odom``; without any, tf.
    """

    angle_min: float | None = None
    angle_step: float | None = None
    no_return: float = 80.0
    laser: str | None = None
    scan_topic: str | None = None
    odometry_topic: str | None = None
    scan_frame: str | None = None

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ArgumentError: an angle that is not finite, a step of zero, a no-return range that is
                not positive, or an unknown laser.
        """
        if self.angle_min is not None and not math.isfinite(self.angle_min):
            raise ArgumentError(f"angle_min must be finite, not {self.angle_min}")
        if self.angle_step is not None and (not math.isfinite(self.angle_step) or self.angle_step == 0.0):
            raise ArgumentError(f"angle_step must be finite and not zero, not {self.angle_step}")
        if not self.no_return > 0.0:
            raise ArgumentError(f"no_return must be a positive range in metres, not {self.no_return}")
        if self.laser is not None and self.laser not in LASERS:
            raise ArgumentError(f"laser must be one of {', '.join(LASERS)}, not {self.laser!r}")


def beam_fan(beams: int) -> tuple[float, float, bool]:
    """Return first angle and step (radians) of a laser by its number of beams, and whether that is known.

    541 and 1081 beams span 270 degrees, centred. All others span 180 degrees from -90: an even
    number excludes the last direction (180 beams: step 1 degree), an odd one includes it (181
    beams: step 1 degree). Known numbers are 180, 181, 360, 361, 720, 721, 541 and 1081; for
    others the same rule is a guess.
    """
    if beams in _THREE_QUARTERS:
        return -0.75 * math.pi, 1.5 * math.pi / (beams - 1), True
    steps = beams if beams % 2 == 0 else max(beams - 1, 1)
    return -0.5 * math.pi, math.pi / steps, beams in _HALF_TURN


class Beams:
    """Turns ranges into points and rays; keeps the directions of the last geometry seen."""

    def __init__(self, settings: LogSettings) -> None:
        self.settings = settings
        self.guessed: int | None = None
        self._key: tuple[int, float | None, float | None, bool] | None = None
        self._directions: FloatArray = np.empty((0, 2))

    def directions(
        self, beams: int, angle_min: float | None, angle_step: float | None, mirrored: bool = False
    ) -> FloatArray:
        """Return unit directions (beams, 2); the settings come first, then the log, then the rule."""
        key = (beams, angle_min, angle_step, mirrored)
        if key != self._key:
            first = self.settings.angle_min if self.settings.angle_min is not None else angle_min
            step = self.settings.angle_step if self.settings.angle_step is not None else angle_step
            if first is None or step is None:
                fan_first, fan_step, known = beam_fan(beams)
                first = fan_first if first is None else first
                step = fan_step if step is None else step
                if not known:
                    self.guessed = beams
            angles = first + step * np.arange(beams)
            sign = -1.0 if mirrored else 1.0
            self._directions = np.stack([np.cos(angles), sign * np.sin(angles)], axis=1)
            self._key = key
        return self._directions

    def split(
        self, ranges: FloatArray, directions: FloatArray, limit: float, minimum: float = 0.0
    ) -> tuple[FloatArray, FloatArray, int]:
        """Return end points, rays without return, and how many beams were dropped.

        Dropped are ranges that are NaN, zero, negative or below ``minimum``; a range at or above
        ``limit`` (infinity included) is a ray without return. All in metres.
        """
        far = ranges >= limit
        # NaN compares false with everything, so it is in neither of the two.
        hit = (ranges > 0.0) & (ranges >= minimum) & ~far
        returned, rays = int(np.count_nonzero(hit)), int(np.count_nonzero(far))
        return ranges[hit, None] * directions[hit], directions[far], len(ranges) - returned - rays


class Log(LogAccount, ABC):
    """A log as a stream of scans and odometry readings, in the order of the file.

    Iterating reads the file from its start, as often as one likes, and holds no more of it than
    a few events. The counts, the warnings and the progress are those of the latest iteration.

    Attributes:
        path: the file or folder.
        settings: how it is read.
        format: "carmen", "wean", "rosbag1", "rosbag2" (sqlite3) or "mcap".
        size: bytes of the file, compressed as it is.
        position: bytes read so far, about.
        scans: scans yielded so far.
        odometry: odometry readings yielded so far.
        skipped: lines or messages that could not be used so far.
        mount: T_robot_laser where the log itself says how the laser sits on the robot, else None.
    """

    format: str = ""

    def __init__(self, path: Path, settings: LogSettings, size: int) -> None:
        self.settings = settings
        self.mount: Pose | None = None
        super().__init__(path, size)

    def _reset(self) -> None:
        super()._reset()
        self.odometry = 0
        self._dropped = Tally()
        self._other_laser = Tally()
        self._beams = Beams(self.settings)

    def _told(self) -> list[str]:
        texts = []
        if self._dropped.count:
            texts.append(
                f"{plural(self._dropped.count, 'beam')} dropped (NaN, negative, zero or below the minimum range), "
                f"the first at {self._dropped.first}"
            )
        if self._beams.guessed is not None:
            texts.append(
                f"{self._beams.guessed} beams: that they span 180 degrees from -90 is a guess; "
                "set angle_min and angle_step"
            )
        if self._other_laser.count:
            texts.append(
                f"{plural(self._other_laser.count, 'scan')} of another laser left out, "
                f"the first at {self._other_laser.first}; choose with the setting laser"
            )
        return texts

    def __iter__(self) -> Iterator[Event]:
        """Read the log from its start.

        Raises:
            LogError: no laser reading in the whole log (raised at its end).
            FileAccessError: the file cannot be read any more.
        """
        self._reset()
        yield from self._events()
        if self.scans == 0:
            notes = self.warnings
            raise LogError(self._no_laser() + (f" ({notes[0].partition(': ')[2]})" if notes else ""))
        self.position = self.size

    @abstractmethod
    def _events(self) -> Iterator[Event]:
        """Yield the events; counts scans, odometry and troubles on the way."""

    @abstractmethod
    def _no_laser(self) -> str:
        """Say that there was no laser reading."""


def file_size(path: Path) -> int:
    """Return the bytes of a file, or of all files in a folder."""
    if path.is_dir():
        return sum(entry.stat().st_size for entry in os.scandir(path) if entry.is_file())
    return path.stat().st_size
