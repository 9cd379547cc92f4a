"""What a matcher found, how good it is, and what else would have fitted."""

from __future__ import annotations

from dataclasses import dataclass

from hexmap.base.arrays import FloatArray
from hexmap.poses.pose import Pose

__all__ = ["Match", "RunnerUp"]


@dataclass(frozen=True, eq=False)
class RunnerUp:
    """The best pose outside the neighbourhood of the best one.

    Attributes:
        pose: T_map_scan, not refined.
        score: its score.
    """

    pose: Pose
    score: int


@dataclass(frozen=True, eq=False)
class Match:
    """The best pose of a region and what is known of it.

    Attributes:
        pose: T_map_scan, refined below a cell.
        searched: T_map_scan of the best candidate, before the refinement.
        score: its score: weights of the map's cells that the scan's points meet, added up.
        total: the score if every point met the largest weight.
        bound: no pose that was asked for scores more than this.
        certified: whether the whole region was searched; if not, ``bound`` still holds.
        refined: whether ``pose`` was refined; if not (it would have left the neighbourhood that was searched), it is
            ``searched``.
        nodes: blocks and poses whose bound or score was taken.
        candidates: poses of a stated set, 0 where the angles were searched as a continuum.
        runner_up: the best pose outside the neighbourhood of the best, where one scores more than ``runner_up_bound``
            or was asked for; None: none does.
        runner_up_bound: no pose outside the neighbourhood scores more than this; None where it was not searched.
        apart: metres and radians that make the neighbourhood.
        overlap: share of the points, 0 to 1, that meet an occupied cell at ``searched``.
        contradicted: share of the beams, 0 to 1, that end beyond a wall at ``pose``; None where it was not asked for.
        information: (3, 3) or (6, 6) inverse covariance of ``pose``: translation in metres in the map's frame, then
            the rotation vector in radians, both about the sensor; None where it was not asked for.
    """

    pose: Pose
    searched: Pose
    score: int
    total: int
    bound: int
    certified: bool = True
    refined: bool = True
    nodes: int = 0
    candidates: int = 0
    runner_up: RunnerUp | None = None
    runner_up_bound: int | None = None
    apart: tuple[float, float] | None = None
    overlap: float = 0.0
    contradicted: float | None = None
    information: FloatArray | None = None

    @property
    def gap(self) -> int:
        """By how much a better pose could score more, at most; 0: there is none."""
        return self.bound - self.score

    @property
    def fraction(self) -> float:
        """Score over the most it could be, 0 to 1."""
        return self.score / self.total if self.total else 0.0

    @property
    def margin(self) -> float:
        """By how much the best pose outscores all others outside its neighbourhood, 0 to 1 of its score."""
        if self.runner_up_bound is None or self.score == 0:
            return 0.0
        return 1.0 - min(self.runner_up_bound, self.score) / self.score

    def __repr__(self) -> str:
        """Show pose, score and certificate on one line."""
        proof = "certified" if self.certified and self.gap == 0 else f"at most {self.gap} from the best"
        return f"<Match {self.pose!r}, score {self.score} of {self.total}, {proof}>"
