"""What a localiser answers for a scan."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from hexmap.base.arrays import FloatArray
from hexmap.base.values import one_line
from hexmap.poses.pose import Pose

__all__ = ["Estimate", "Hypothesis", "TrackState"]


class TrackState(StrEnum):
    """How much is known of where the robot is."""

    lost = "lost"
    ambiguous = "ambiguous"
    tracking = "tracking"


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A place where the robot may be.

    Attributes:
        pose: T_map_robot.
        score: of the last scan.
        weight: how likely it is among all that are carried on, 0 to 1.
    """

    pose: Pose
    score: int
    weight: float


@dataclass(frozen=True, eq=False)
class Estimate:
    """What is known after a scan.

    Attributes:
        stamp: of the scan, seconds.
        line: of the log, where the scan has one.
        state: lost, ambiguous or tracking.
        pose: T_map_robot where it is answered, that is while tracking; else None.
        covariance: (3, 3) or (6, 6) of ``pose``: translation in the map's frame, metres, then the rotation vector
            in the map's frame about the robot, radians; None without a pose.
        hypotheses: the most likely first; the pose alone while tracking, none where lost.
        score: of the scan at the most likely pose.
        total: the score if every point met the map.
        overlap: share of the points, 0 to 1, that meet the map there.
        contradicted: share of the beams, 0 to 1, that end beyond a wall of the map there.
        complete: whether the hypotheses are all that fit.
    """

    stamp: float
    line: int | None
    state: TrackState
    pose: Pose | None = None
    covariance: FloatArray | None = None
    hypotheses: list[Hypothesis] = field(default_factory=list)
    score: int = 0
    total: int = 0
    overlap: float = 0.0
    contradicted: float = 0.0
    complete: bool = True

    __repr__ = one_line
