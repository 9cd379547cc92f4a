"""The logs of Wean Hall, CMU: one reading a line, as text, plain or gzip.

The lines that are read, in centimetres, radians and seconds::

    O x y theta t                              the robot in the odometry's frame
    L x y theta xl yl thetal r1..r180 t        the same, the laser in the odometry's frame, ranges

The 180 beams run counter-clockwise from -90 degrees, one a degree. A range of 8183 or more is the laser's maximum: the
beam returned nothing. What is handed on is in metres. How the laser is mounted, 25 cm ahead of the robot's middle,
follows from the two poses of the first sound L line.

All other lines are passed over. The order of the lines is the order of events.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hexmap.base.text import plural
from hexmap.io.logs.log import LogSettings
from hexmap.io.logs.text_log import BadLine, TextLog, floats, numbers, tag_of
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Event, Odometry, Scan

__all__ = ["WeanLog"]

_METRE = 100.0  # in the log's units
_BEAMS = 180
# Numbers of a line after its letter.
_SIZES = {b"O": 4, b"L": 6 + _BEAMS + 1}


class WeanLog(TextLog):
    """A log of Wean Hall; see :class:`hexmap.io.logs.Log`."""

    format = "wean"

    def __init__(self, path: Path, settings: LogSettings, compressed: bool) -> None:
        """Look ahead for how the laser is mounted.

        Raises:
            FileAccessError: the file cannot be read.
        """
        super().__init__(path, settings, compressed)
        self.mount = self._look_ahead()
        self._reset()

    def _look_ahead(self) -> Pose | None:
        """Return T_robot_laser of the first sound L line; None where there is none, or both poses are the same."""
        for _, line in self.lines():
            if tag_of(line) == b"L":
                try:
                    values = _values(line.split(), _SIZES[b"L"])
                except BadLine:
                    continue
                mount = _pose(values[:3]).inverse() @ _pose(values[3:6])
                # The log's poses are numbers of single precision, which tell a mount to a hundredth of a millimetre.
                mount = Pose.planar(round(mount.x, 5) + 0.0, round(mount.y, 5) + 0.0, round(mount.theta, 5) + 0.0)
                return None if mount.is_close(Pose.identity(2), 1e-5, 1e-5) else mount
        return None

    def _events(self) -> Iterator[Event]:
        last = -math.inf
        for number, line in self.lines():
            tag = tag_of(line)
            if tag not in _SIZES:
                continue
            try:
                values = _values(line.split(), _SIZES[tag])
                # A last line without its end may have lost the last digits of its stamp.
                if not self.whole_last_line and values[-1] < last:
                    raise BadLine("the line is cut off in its time stamp")
                event = self._scan(values, number) if tag == b"L" else Odometry(values[-1], _pose(values[:3]), number)
            except BadLine as bad:
                self._skipped.add(f"line {number}: {bad}")
                continue
            last = event.stamp
            if isinstance(event, Scan):
                self.scans += 1
            else:
                self.odometry += 1
            yield event

    def _scan(self, values: list[float], number: int) -> Scan:
        """Return the scan of an L line."""
        directions = self._beams.directions(_BEAMS, None, None)
        ranges = np.array(values[6:-1]) / _METRE
        points, rays, dropped = self._beams.split(ranges, directions, self.settings.no_return)
        if dropped:
            self._dropped.add(f"line {number}", dropped)
        return Scan(values[-1], points, rays, _pose(values[:3]), number)

    def _no_laser(self) -> str:
        return f"{self.path}: no laser reading (L) in {plural(self.lines_read, 'line')}"


def _values(tokens: list[bytes], size: int) -> list[float]:
    """Return the numbers of a line: poses and stamp, which must be finite, and ranges, which need not.

    Raises:
        BadLine: there are not ``size`` numbers, or one is not what it must be.
    """
    name, found = tokens[0].decode(), len(tokens) - 1
    if found != size:
        raise BadLine(f"{found} numbers after {name}, where {size} belong" + (
            f" (two poses, {_BEAMS} ranges and a time)" if name == "L" else " (a pose and a time)"
        ))  # fmt: skip
    head = 3 if name == "O" else 6
    return [
        *floats(tokens[1:4], "odometry"),
        *floats(tokens[4 : 1 + head], "laser pose"),
        *numbers(tokens[1 + head : -1]),
        *floats(tokens[-1:], "time stamp"),
    ]


def _pose(values: list[float]) -> Pose:
    """Return the pose of x, y in centimetres and theta in radians."""
    return Pose.planar(values[0] / _METRE, values[1] / _METRE, values[2])
