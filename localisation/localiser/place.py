"""A pose that a localiser carries on, and what speaks for it."""

from __future__ import annotations

from dataclasses import dataclass, field

from hexmap.poses.pose import Pose
from localisation.localiser.evidence import Evidence
from localisation.matching.match import Match

__all__ = ["Place"]


@dataclass(eq=False)
class Place:
    """A pose that is carried on.

    Attributes:
        pose: T_map_sensor after the last scan.
        motion: of the sensor between the last two scans.
        settled: log-likelihood of the scans that were new evidence, relative to other places.
        latest: of the last scan, which the next one replaces if the robot has not moved.
        way: motion of the sensor since ``settled`` last grew, as predicted: matches jump about in a corridor.
        judged: what the scans said of this place, one for each that was new evidence.
        match: of the last scan, if anything coincided.
        tracked: whether it was answered before; then beams through walls alone do not rule it out, but to be
            answered again it must fit as well as any other.
    """

    pose: Pose
    way: Pose
    motion: Pose
    settled: float = 0.0
    latest: float = 0.0
    judged: list[Evidence] = field(default_factory=list)
    match: Match | None = None
    tracked: bool = False

    @property
    def likelihood(self) -> float:
        """Logarithm of how likely this place is, but for a constant."""
        return self.settled + self.latest
