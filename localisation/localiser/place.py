"""A place where the robot may be, carried on while it is not clear which of several is true."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.values import one_line
from hexmap.poses.pose import Pose
from localisation.localiser.evidence import Evidence
from localisation.matching.match import Match

__all__ = ["UNSEEN", "Place", "View", "mean_of", "see"]

View: TypeAlias = tuple[float, int, float]
UNSEEN: View = (0.0, 0, 0.0)


def see(view: View, said: float, driven: float, view_metres: float) -> tuple[float, View]:
    """Add to a view what a scan said; return what is settled by it, if the view is over, and the view that goes on.

    Scans of one view show the same walls and the same people: together they say what they say on average. It is over
    when the robot has driven ``view_metres``.
    """
    view = view[0] + said, view[1] + 1, view[2] + driven
    return (mean_of(view), UNSEEN) if view[2] >= view_metres else (0.0, view)


def mean_of(view: View) -> float:
    """Return what a view has said so far."""
    return view[0] / max(1, view[1])


@dataclass(eq=False)
class Place:
    """A pose that is carried on.

    Attributes:
        pose: T_map_sensor after the last scan.
        covariance: of ``pose``.
        anchor: pose and covariance at the last scan that was new evidence: what odometry is counted from.
        motion: of the sensor between the last two scans.
        settled: log-likelihood of the views that are over, relative to other places.
        view: of this view, the sum of what its scans said that were new evidence, their number, and the metres driven
            since it began.
        latest: of the last scan, which the next one replaces if the robot has not moved.
        way: motion of the sensor since the anchor by odometry: matches jump about in a corridor.
        driven: metres and radians of the path since the anchor.
        judged: what the scans said of this place, one for each that was new evidence.
        match: of the last scan, if anything coincided.
        fits: whether the last scans agree with the map here. Where they do not it competes on for a while: the map may
            be wrong about the true place, and what is left when that is dropped is not the truth for being alone.
        track: of the sensor, T_map_sensor at each scan that was new evidence.
        tracked: whether it was answered before; then beams through walls alone do not rule it out, but to be
            answered again it must fit as well as any other.
    """

    pose: Pose
    covariance: FloatArray
    anchor: tuple[Pose, FloatArray]
    way: Pose
    motion: Pose
    driven: tuple[float, float] = (0.0, 0.0)
    settled: float = 0.0
    view: View = UNSEEN
    latest: float = 0.0
    judged: list[Evidence] = field(default_factory=list)
    match: Match | None = None
    fits: bool = True
    track: list[Pose] = field(default_factory=list)
    tracked: bool = False

    __repr__ = one_line

    @classmethod
    def at(cls, pose: Pose, covariance: FloatArray, *, settled: float = 0.0, tracked: bool = False) -> Place:
        """Return a place that begins here."""
        still = Pose.identity(pose.dim)
        return cls(
            pose, covariance, (pose, covariance), still, still, settled=settled, track=[pose], tracked=tracked
        )

    def begin_anew(self) -> None:
        """Count odometry from here on."""
        self.track.append(self.pose)
        self.anchor, self.way, self.driven = (self.pose, self.covariance), Pose.identity(self.pose.dim), (0.0, 0.0)

    def move(self, step: Pose) -> None:
        """Add a motion of the sensor to what was driven since the anchor."""
        self.way = self.way @ step
        metres, radians = self.driven
        self.driven = metres + float(np.linalg.norm(step.translation)), radians + step.angle

    @property
    def metres_on(self) -> float:
        """How far the sensor is from the anchor by odometry, metres."""
        return float(np.linalg.norm(self.way.translation))

    @property
    def so_far(self) -> float:
        """The likelihood of before the last scan."""
        return self.settled + mean_of(self.view)

    @property
    def likelihood(self) -> float:
        """Logarithm of how likely this place is, but for a constant."""
        said, scans, _ = self.view
        return self.settled + (said + self.latest) / (scans + 1)

    def settle(self, view_metres: float) -> None:
        """Take what the last scan said as said; the view is over when the robot has driven so many metres."""
        over, self.view = see(self.view, self.latest, self.driven[0], view_metres)
        self.settled += over
        self.latest = 0.0
