"""CARMEN logs: one message a line, as text, plain or gzip.

The lines that are read, in metres and radians::

    FLASER n r1..rn x y theta odom_x odom_y odom_theta [ipc_time host logger_time]
    RLASER (the same, the rear laser)
    ROBOTLASER1 type start_angle field_of_view angular_resolution maximum_range accuracy
        remission_mode n r1..rn m s1..sm laser_x laser_y laser_theta robot_x robot_y robot_theta
        tv rv forward_safety side_safety turn_axis [ipc_time host logger_time]
    ROBOTLASER2 (the same, the rear laser)
    RAWLASER1 type start_angle field_of_view angular_resolution maximum_range accuracy
        remission_mode n r1..rn m s1..sm [ipc_time host logger_time]
    RAWLASER2 (the same, the rear laser)
    ODOM x y theta tv rv accel [ipc_time host logger_time]
    PARAM robot_frontlaser_offset metres ...

All other lines and comments are passed over. Only one kind of laser line is used, because logs
often hold the same scan as ROBOTLASER1, as FLASER and as RAWLASER1: of a front laser in this order.
Which kinds a log has is judged by its first laser line and the 1,000 lines after it.

How a laser is mounted say the poses of a ROBOTLASER line; else PARAM lines ``robot_frontlaser_offset`` (metres
forward), ``..._side_offset`` (metres to the left) and ``..._angular_offset`` (radians), or ``robot_rearlaser_...``,
where the offset is forward as well, so mostly negative, and the laser looks back unless an angle is given.

The order of the lines is the order of events. Stamps repeat, step back and may be too coarse to
tell anything; they are handed on and used here only for RAWLASER lines, which have no odometry of
their own: they get that of the ODOM lines around them, by time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hexmap.base.text import plural, shown
from hexmap.io.logs.log import LogSettings
from hexmap.io.logs.text_log import BadLine, TextLog, floats, not_a_number, numbers, tag_of
from hexmap.io.logs.waiting import Waiting
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Event, Odometry, Scan

__all__ = ["CarmenLog"]

_FRONT = (b"ROBOTLASER1", b"FLASER", b"RAWLASER1")
_REAR = (b"ROBOTLASER2", b"RLASER", b"RAWLASER2")
_PREFERENCE: dict[str | None, tuple[bytes, ...]] = {None: _FRONT + _REAR, "front": _FRONT, "rear": _REAR}
# Lines that describe their laser: how many numbers stand between the remissions and the stamp.
_DESCRIBED = {b"ROBOTLASER1": 11, b"ROBOTLASER2": 11, b"RAWLASER1": 0, b"RAWLASER2": 0}
# Of a PARAM line after robot_frontlaser or robot_rearlaser.
_OFFSETS = (b"_offset", b"_side_offset", b"_angular_offset")
_FARTHEST_OFFSET = 1000.0  # metres or radians
_WIDEST = 1000.0  # radians: no fan of beams, not even one in degrees
_LOOK_AHEAD = 1000


class CarmenLog(TextLog):
    """A CARMEN log; see :class:`hexmap.io.logs.Log`."""

    format = "carmen"

    def __init__(self, path: Path, settings: LogSettings, compressed: bool) -> None:
        """Look ahead for the kind of laser and, with ROBOTLASER lines, how it is mounted.

        Raises:
            FileAccessError: the file cannot be read.
        """
        super().__init__(path, settings, compressed)
        self._offsets: dict[bytes, float] = {}
        self._laser = self._look_ahead()
        if self._laser is not None and not self._laser.startswith(b"ROBOT"):
            self.mount = self._offset_mount(self._laser)
        if self._laser in (b"RLASER", b"RAWLASER2") and self.mount is None:
            self._notes.append(
                f"the log does not say how the rear laser ({self._laser.decode()}) is mounted; set the mount"
            )
        self._reset()

    def _look_ahead(self) -> bytes | None:
        """Return the kind of laser line to read, or None where the log has none of those wanted."""
        setting = self.settings.laser
        wanted = _PREFERENCE.get(setting) or (str(setting).encode(),)
        best: int | None = None
        left = _LOOK_AHEAD
        for _, line in self.lines():
            tag = tag_of(line)
            if tag == b"PARAM":
                self._take_offset(line.split(None, 3))
            if tag in wanted:
                rank = wanted.index(tag)
                if best is None or rank < best:
                    best, self.mount = rank, None
                if rank == best and self.mount is None and tag.startswith(b"ROBOT"):
                    self.mount = _mount(line.split())
            if best is not None:
                left -= 1
                if left < 0 or (best == 0 and not wanted[0].startswith(b"ROBOT")) or self.mount is not None:
                    break
        return None if best is None else wanted[best]

    def _take_offset(self, words: list[bytes]) -> None:
        """Take a PARAM line, if it says where a laser is; the last one of a name counts."""
        if len(words) < 3 or not words[1].startswith((b"robot_frontlaser_", b"robot_rearlaser_")):
            return
        name = words[1].removeprefix(b"robot_")
        if any(name in (b"frontlaser" + offset, b"rearlaser" + offset) for offset in _OFFSETS):
            try:
                value = floats([words[2]], name.decode())[0]
                if abs(value) > _FARTHEST_OFFSET:
                    raise BadLine(f"{value:g} is no place on a robot")
                self._offsets[name] = value
            except BadLine as bad:
                self._notes.append(f"PARAM {shown(words[1])} ignored: {bad}")

    def _offset_mount(self, laser: bytes) -> Pose | None:
        """Return T_robot_laser of the PARAM lines; None where there are none, or the laser is where the robot is."""
        side = b"frontlaser" if laser in _FRONT else b"rearlaser"
        x, y, theta = (self._offsets.get(side + offset) for offset in _OFFSETS)
        if x is None and y is None and theta is None:
            return None
        if theta is None:
            theta = 0.0 if laser in _FRONT else math.pi
        mount = Pose.planar(x or 0.0, y or 0.0, theta)
        return None if mount.is_close(Pose.identity(2)) else mount

    def _events(self) -> Iterator[Event]:
        if self._laser is None or not self._laser.startswith(b"RAW"):
            yield from self._lines()
            return
        yield from Waiting(True, None).events(self._lines())

    def _lines(self) -> Iterator[Event]:
        """Yield what the lines say."""
        wanted = self._laser
        # A log may hold the same scans in several kinds of lines: leaving these out needs no warning.
        others = (_REAR if wanted in _FRONT else _FRONT) if self.settings.laser is None else ()
        stamp = 0.0
        unstamped = 0
        for number, line in self.lines():
            tag = tag_of(line)
            event: Event
            try:
                if tag == b"ODOM":
                    tokens = line.split()
                    # A last line without its end may have lost part of its last number.
                    if len(tokens) < 4 or (not self.whole_last_line and len(tokens) < 10):
                        raise BadLine(f"{len(tokens) - 1} fields of an ODOM line, which has 9")
                    values = floats(tokens[1:4], "odometry")
                    time = _stamp(tokens, 7)
                    unstamped += time is None
                    stamp = stamp if time is None else time
                    event = Odometry(stamp, Pose.planar(*values), number)
                    self.odometry += 1
                elif tag == wanted:
                    time, event = self._scan(line.split(), number, stamp)
                    unstamped += time is None
                    stamp = event.stamp
                    self.scans += 1
                else:
                    if tag in others:
                        self._other_laser.add(f"line {number} ({tag.decode()})")
                    continue
            except BadLine as bad:
                self._skipped.add(f"line {number}: {bad}")
                continue
            yield event
        if unstamped:
            self._late_notes.append(f"{plural(unstamped, 'line')} without a time stamp took the one before")

    def _scan(self, tokens: list[bytes], number: int, last_stamp: float) -> tuple[float | None, Scan]:
        """Read a laser line; returns its own stamp (or None) and the scan."""
        angle_min = angle_step = None
        limit = self.settings.no_return
        odometry: list[float] | None = None
        if tokens[0] in _DESCRIBED:
            fields, ranges, tail = _described(tokens)
            odometry = tail[3:6] or None
            angle_min, angle_step = fields[1], fields[3]
            if not angle_step > 0.0:
                angle_step = fields[2] / max(len(ranges) - 1, 1)
            if not abs(angle_min) + abs(angle_step) * len(ranges) < _WIDEST:
                raise BadLine(f"beams from {angle_min:g} by {angle_step:g} rad")
            if fields[4] > 0.0:
                limit = min(limit, fields[4])
            time = _stamp(tokens, len(tokens) - 3) if tail[-1:] == [math.inf] else None
        else:
            beams = _count(tokens, 1)
            tail_length = len(tokens) - 2 - beams
            # Six fields are a whole line without a stamp, unless a host's name says that beams are missing.
            short = tail_length == 6 and (not self.whole_last_line or not_a_number(tokens[-2:-1]))
            if short or tail_length not in (6, 9):
                raise BadLine(_wrong_number(tokens, beams, tail_length))
            ranges = numbers(tokens[2 : 2 + beams])
            # After x y theta of the laser, which in many logs is a corrected pose, comes the odometry.
            odometry = floats(tokens[5 + beams : 8 + beams], "odometry")
            floats(tokens[2 + beams : 5 + beams], "laser pose")
            time = _stamp(tokens, 8 + beams)
        if not len(ranges):
            raise BadLine("0 beams")
        directions = self._beams.directions(len(ranges), angle_min, angle_step)
        points, rays, dropped = self._beams.split(np.array(ranges), directions, limit)
        if dropped:
            self._dropped.add(f"line {number}", dropped)
        stamp = last_stamp if time is None else time
        return time, Scan(stamp, points, rays, None if odometry is None else Pose.planar(*odometry), number)

    def _no_laser(self) -> str:
        names = ", ".join(tag.decode() for tag in _PREFERENCE.get(self.settings.laser, ()))
        names = names or str(self.settings.laser)
        return f"{self.path}: no laser reading ({names}) in {plural(self.lines_read, 'line')}"


def _stamp(tokens: list[bytes], index: int) -> float | None:
    return floats(tokens[index : index + 1], "time stamp")[0] if index < len(tokens) else None


def _count(tokens: list[bytes], index: int) -> int:
    try:
        count = int(tokens[index])
    except (ValueError, IndexError):
        text = shown(tokens[index]) if index < len(tokens) else ""
        raise BadLine(f"the number of beams is '{text}'") from None
    if count < 0:
        raise BadLine(f"the number of beams is '{count}'")
    return count


def _wrong_number(tokens: list[bytes], beams: int, tail: int) -> str:
    """Say how many beams a line has instead; a host's name near its end tells a whole line."""
    whole = len(tokens) > 4 and not_a_number(tokens[-2:-1]) != b""
    if not whole and 0 <= tail < 9:
        return f"the line is cut off, {tail} of 9 fields after the {beams} beams"
    found = max(beams + tail - 9, 0) if whole else max(beams + min(tail, 0), 0) if tail < 0 else beams + tail - 6
    return f"{beams} beams announced, {found} found"


def _described(tokens: list[bytes]) -> tuple[list[float], list[float], list[float]]:
    """Return the seven fields before the beams, the ranges, and the numbers of the poses after the remissions.

    The last of these is infinite where a stamp follows; RAWLASER lines have no others.
    """
    beams = _count(tokens, 8)
    if len(tokens) < 10 + beams:
        raise BadLine(f"{beams} beams announced, {max(len(tokens) - 9, 0)} found")
    fields = floats(tokens[1:8], "laser's description")
    ranges = numbers(tokens[9 : 9 + beams])
    after = tokens[9 + beams :]
    remissions = _count_remissions(after[0], beams)
    tail = after[1 + remissions :]
    poses = _DESCRIBED[tokens[0]]
    if len(tail) not in (poses, poses + 3):
        raise BadLine(
            f"{beams} beams announced and {remissions} remissions, "
            f"then {len(tail)} fields follow instead of {poses + 3}"
        )
    found = floats(tail[:poses], "pose")
    return fields, ranges, [*found, math.inf] if len(tail) > poses else found


def _count_remissions(token: bytes, beams: int) -> int:
    try:
        count = int(token)
    except ValueError:
        # Where a beam is missing or one too many, this is a range or a pose.
        raise BadLine(f"{beams} beams announced, then '{shown(token)}' instead of a number of remissions") from None
    if count < 0:
        raise BadLine(f"the number of remissions is '{count}'")
    return count


def _mount(tokens: list[bytes]) -> Pose | None:
    """Return T_robot_laser of a ROBOTLASER line, or None where both poses are the same or unreadable."""
    try:
        _, _, tail = _described(tokens)
    except BadLine:
        return None
    if math.hypot(tail[0] - tail[3], tail[1] - tail[4]) > _FARTHEST_OFFSET:
        return None
    mount = Pose.planar(*tail[3:6]).inverse() @ Pose.planar(*tail[0:3])
    # The poses are printed with six digits, so a mount of less than that is none.
    return None if mount.is_close(Pose.identity(2), 1e-5, 1e-5) else mount
