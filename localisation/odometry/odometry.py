"""What an odometry is: something that gives each scan a pose as it comes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeAlias

from hexmap.base.values import one_line
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from localisation.matching.match import Match

__all__ = ["Odometry", "Reading", "RegisteredScan"]

Reading: TypeAlias = tuple[float, Pose]
"""Stamp, in seconds, and T_map_robot of an odometry reading."""


@dataclass(frozen=True, eq=False)
class RegisteredScan:
    """A scan with its pose.

    Attributes:
        scan: the scan.
        T_map_robot: where the robot was.
        T_map_scan: where its sensor was.
        readings: the odometry readings since the scan before, whose poses are final with this one.
        matched: whether there was something to match the scan against.
        match: what was found; None where nothing coincided, or nothing was looked for.
        predicted: T_map_robot before it was matched; None where nothing said so.
    """

    scan: Scan
    T_map_robot: Pose
    T_map_scan: Pose
    readings: tuple[Reading, ...] = ()
    matched: bool = False
    match: Match | None = None
    predicted: Pose | None = None

    __repr__ = one_line


class Odometry(Protocol):
    """Registers scans one after the other; whether they go into a map is for the caller to say."""

    def register(self, scan: Scan) -> RegisteredScan:
        """Return the next scan with its pose."""
        ...
