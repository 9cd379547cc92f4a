"""What a matcher found."""

from __future__ import annotations

from dataclasses import dataclass

from hexmap.poses.pose import Pose


@dataclass(frozen=True, eq=False)
class Match:
    """The best pose of a window and what was measured on the way.

    Attributes:
        pose: T_map_scan, refined below a cell.
        score: coincident lattice points of the best pose of the search (before the refinement).
        cells: distinct lattice points of the scan at that angle; ``score / cells`` is the part matched.
        searched: T_map_scan of the best candidate, before the refinement.
        candidates: poses in the window.
        scored: blocks and poses that were scored to find the best.
    """

    pose: Pose
    score: int
    cells: int
    searched: Pose
    candidates: int
    scored: int

    @property
    def part(self) -> float:
        """Part of the scan's cells that coincide with the map, 0 to 1."""
        return self.score / self.cells if self.cells else 0.0
