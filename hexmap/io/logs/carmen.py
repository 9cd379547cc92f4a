"""CARMEN logs: one message a line, as text, plain or gzip.

The lines that are read, in metres and radians::

    FLASER n r1..rn x y theta odom_x odom_y odom_theta [ipc_time host logger_time]
    RLASER (the same, the rear laser)
    ROBOTLASER1 type start_angle field_of_view angular_resolution maximum_range accuracy
        remission_mode n r1..rn m s1..sm laser_x laser_y laser_theta robot_x robot_y robot_theta
        tv rv forward_safety side_safety turn_axis [ipc_time host logger_time]
    ROBOTLASER2 (the same, the rear laser)
    ODOM x y theta tv rv accel [ipc_time host logger_time]

All other lines and comments are passed over. Only one kind of laser line is used, because logs
often hold the same scan as ROBOTLASER1 and as FLASER: of a front laser ROBOTLASER1 before
FLASER. Which kinds a log has is judged by its first laser line and the 1,000 lines after it.

The order of the lines is the order of events. Stamps repeat, step back and may be too coarse to
tell anything; they are handed on and never used here.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hexmap.base.text import plural, shown
from hexmap.io.logs.log import LogSettings
from hexmap.io.logs.text_log import BadLine, TextLog, floats, not_a_number, numbers, tag_of
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Event, Odometry, Scan

__all__ = ["CarmenLog"]

_PREFERENCE: dict[str | None, tuple[bytes, ...]] = {
    None: (b"ROBOTLASER1", b"FLASER", b"ROBOTLASER2", b"RLASER"),
    "front": (b"ROBOTLASER1", b"FLASER"),
    "rear": (b"ROBOTLASER2", b"RLASER"),
}
_LASERS = frozenset((b"FLASER", b"RLASER", b"ROBOTLASER1", b"ROBOTLASER2"))
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
        self._laser = self._look_ahead()
        if self._laser == b"RLASER" and self.mount is None:
            self._notes.append("the log does not say how the rear laser (RLASER) is mounted; set the mount")
        self._reset()

    def _look_ahead(self) -> bytes | None:
        """Return the kind of laser line to read, or None where the log has none of those wanted."""
        setting = self.settings.laser
        wanted = _PREFERENCE.get(setting) or (str(setting).encode(),)
        best: int | None = None
        left = _LOOK_AHEAD
        for _, line in self.lines():
            tag = tag_of(line)
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

    def _events(self) -> Iterator[Event]:
        wanted = self._laser
        others = _LASERS if self.settings.laser is None else frozenset[bytes]()
        # A log with ROBOTLASER1 and FLASER holds the same scans twice: leaving one out needs no warning.
        if wanted in (b"ROBOTLASER1", b"FLASER"):
            others = frozenset((b"RLASER", b"ROBOTLASER2")) & others
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
        if tokens[0].startswith(b"ROBOT"):
            fields, ranges, tail = _robotlaser(tokens)
            odometry = tail[3:6]
            angle_min, angle_step = fields[1], fields[3]
            if not angle_step > 0.0:
                angle_step = fields[2] / max(len(ranges) - 1, 1)
            if fields[4] > 0.0:
                limit = min(limit, fields[4])
            time = _stamp(tokens, len(tokens) - 3) if len(tail) > 11 else None
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
        return time, Scan(stamp, points, rays, Pose.planar(*odometry), number)

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


def _robotlaser(tokens: list[bytes]) -> tuple[list[float], list[float], list[float]]:
    """Return the seven fields before the beams, the ranges, and the numbers after the remissions."""
    beams = _count(tokens, 8)
    if len(tokens) < 10 + beams:
        raise BadLine(f"{beams} beams announced, {max(len(tokens) - 9, 0)} found")
    fields = floats(tokens[1:8], "laser's description")
    ranges = numbers(tokens[9 : 9 + beams])
    after = tokens[9 + beams :]
    remissions = _count_remissions(after[0], beams)
    tail = after[1 + remissions :]
    if len(tail) not in (11, 14):
        raise BadLine(
            f"{beams} beams announced and {remissions} remissions, then {len(tail)} fields follow instead of 14"
        )
    poses = floats(tail[:11], "pose")
    if len(tail) == 14:
        poses.append(math.nan)  # marks that a stamp follows
    return fields, ranges, poses


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
        _, _, tail = _robotlaser(tokens)
    except BadLine:
        return None
    mount = Pose.planar(*tail[3:6]).inverse() @ Pose.planar(*tail[0:3])
    # The poses are printed with six digits, so a mount of less than that is none.
    return None if mount.is_close(Pose.identity(2), 1e-5, 1e-5) else mount
