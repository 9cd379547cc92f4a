"""Find loops: old submaps in which a new one lies, beyond doubt.

Where a new submap may lie in an old one the graph says itself, with how sure it is; that window, up to the whole of it,
is searched with a certificate. A match is believed only after a row of tests, each of which some false match fails that
passes the others; what was tried is recorded with its numbers and the reason.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.poses.pose import Pose, wrap_angle
from localisation.matching.global_matcher import GlobalMatcher
from localisation.matching.information import score_covariance
from localisation.matching.match import Match
from localisation.matching.pyramid import OccupancyPyramid
from localisation.matching.refinement import refine_on
from localisation.matching.search_region import SearchRegion, box_of_cells
from localisation.slam import planar
from localisation.slam.loop_search import Candidate, LoopRecord, LoopSearch
from localisation.slam.pose_graph import PoseGraph
from localisation.slam.settings import LoopSettings
from localisation.slam.submap import SMALL_WINDOW, Cells, Submap, SubmapCells, in_view

__all__ = ["LoopCloser", "local_covariance", "some_points"]

# Nodes between two submaps that have a scan in common or one beside the other's.
_NEIGHBOURS = 3
# Variance of a loop in what the surface of scores says: both submaps are bent by what drifts inside them. Fitted on
# simulated drives, where ellipses of 95 % held 90 % of the loops with 1.
_BENT = 1.5
# Points of a submap that are matched at most: more take longer and say no more.
_MOST_POINTS = 400
# Share of them that must meet walls, cell by cell, before a match is worth a look: a third of what the overlap asks,
# for which walls of twice the width count.
_LEAST = 0.1
# In cells of the finest level: two submaps whose relative pose is known so well gain nothing by another loop.
_KNOWN = 1.0
# Share of the squares of a metre that must lie on those of the other where the graph knows where they are.
_LEAST_IN_VIEW = 0.5


def local_covariance(covariance: FloatArray, pose: Pose) -> FloatArray:
    """Return a covariance of translation and heading in the outer frame as one of small motions in the inner frame."""
    turn = np.eye(3)
    turn[:2, :2] = pose.rotation.T
    return np.asarray(turn @ covariance @ turn.T)


class LoopCloser(LoopSearch):
    """Looks for loops in the plane."""

    def __init__(self, graph: PoseGraph, submaps: list[Submap], cells: SubmapCells, settings: LoopSettings) -> None:
        """Take the graph and the submaps, which grow, and what makes their cells."""
        super().__init__(graph, settings)
        self._submaps, self._cells = submaps, cells
        self._tried: dict[tuple[int, int], float] = {}
        self._middles: list[tuple[float, ...]] = []

    # ------------------------------------------------------------------ candidates

    def candidates(self, j: int) -> list[Candidate]:
        """Return the old submaps in which submap ``j`` may lie, the likeliest first: one of each earlier visit."""
        new = self._submaps[j]
        last = j - _NEIGHBOURS
        if last < 0:
            return []
        poses = self._graph.poses
        spread = self._graph.relative_covariances(j, [0])[0]
        slack = self.settings.sigmas * math.sqrt(max(float(np.linalg.eigvalsh(spread[:2, :2])[-1]), 0.0))
        near = self.near(j, slack)
        near = near[near <= last]
        views = in_view(self._submaps, self._graph.poses, near, j)
        visits = np.flatnonzero(np.diff(near) > 1) + 1
        chosen = [self._best_of(*visit) for visit in zip(np.split(near, visits), np.split(views, visits), strict=True)]
        asked = [i for visit in chosen for _, i in visit]
        covariances = dict(zip(asked, self._graph.relative_covariances(j, asked), strict=True))
        found = []
        for visit in chosen:
            for rank, (view, i) in enumerate(visit):
                pose = planar.between(poses[i], poses[j])
                # Held at j, it is the covariance of i: as seen from i it is the same motion in the frame of j.
                A = planar.adjoint(planar.invert(pose))
                candidate = Candidate(i, pose, A @ covariances[i] @ A.T)
                metres, radians = candidate.sigma
                if self._is_known(metres, radians, new) or self._was_tried(i, j, metres):
                    continue
                # Where the graph knows what lies where, the one with most in view is the best, or nothing is in view.
                if self.settings.sigmas * metres < 1.0 and (rank > 0 or view < _LEAST_IN_VIEW):
                    continue
                found.append((-view, candidate))
        found.sort(key=lambda pair: (pair[0], pair[1].i))
        return [candidate for _, candidate in found[: self.settings.searches]]

    def _best_of(self, run: IntArray, views: FloatArray) -> list[tuple[float, int]]:
        """Return those of a visit's submaps ``run`` that have most in view, with how much, and are no neighbours."""
        ranked = sorted(zip(views.tolist(), run.tolist(), strict=True), key=lambda pair: (-pair[0], pair[1]))
        best: list[tuple[float, int]] = []
        for view, i in ranked:
            if len(best) < self.settings.searches and all(abs(i - other) >= _NEIGHBOURS - 1 for _, other in best):
                best.append((view, i))
        return best

    def near(self, j: int, slack: float) -> IntArray:
        """Return the submaps before ``j``, ascending, that may see what it sees, ``slack`` metres off."""
        poses = self._graph.poses[: j + 1]
        turn = np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
        while len(self._middles) <= j:
            submap = self._submaps[len(self._middles)]
            self._middles.append((*submap.middle.tolist(), submap.reach))
        middles = np.array(self._middles[: j + 1])
        x = poses[:, 0] + turn[:, 0] * middles[:, 0] - turn[:, 1] * middles[:, 1]
        y = poses[:, 1] + turn[:, 1] * middles[:, 0] + turn[:, 0] * middles[:, 1]
        apart = np.hypot(x - x[j], y - y[j])
        return np.flatnonzero(apart[:j] < middles[:j, 2] + middles[j, 2] + slack)

    def _is_known(self, metres: float, radians: float, new: Submap) -> bool:
        known = _KNOWN * self._cells.fine.resolution
        return metres < known and radians * new.reach < 2.0 * known

    def _was_tried(self, i: int, j: int, metres: float) -> bool:
        before = self._tried.get((i, j))
        return before is not None and 0.5 * before <= metres <= 2.0 * before

    # ------------------------------------------------------------------ one candidate

    def _try(self, candidate: Candidate, j: int) -> LoopRecord:
        """Search, and put the match through the tests, the cheap ones first."""
        self._tried[candidate.i, j] = candidate.sigma[0]
        settings = self.settings
        old, new = self._cells.of(self._submaps[candidate.i]), self._cells.of(self._submaps[j])
        metres, radians = candidate.sigma
        record = LoopRecord(candidate.i, j, False, "", metres, radians)
        if min(len(old.points), len(new.points)) < settings.min_cells:
            return replace(record, reason="too few walls")
        match = self._search(old, new, candidate.pose, candidate.covariance)
        if match is None:
            return replace(record, reason="no wall meets another")
        record = replace(record, score=match.score, total=match.total, gap=match.gap, margin=match.margin)
        if not match.certified or match.gap:
            return replace(record, reason="the search was not finished")
        if match.runner_up is not None:
            return replace(record, reason="another place fits as well")
        pose = refine_on(old.fine, new.fine_points, match.pose, searched=self._cells.lattice).pose
        met, overlap, contradicted = _agreement(old, new, pose)
        record = replace(record, overlap=overlap, contradicted=contradicted, pose=tuple(planar.of_pose(pose).tolist()))
        if met < settings.min_cells or overlap < settings.min_overlap:
            return replace(record, reason="too little overlap")
        if contradicted > settings.max_contradicted:
            return replace(record, reason="walls where the other is free")
        return self._check_further(record, old, new, candidate, match, pose)

    def _check_further(
        self, record: LoopRecord, old: Cells, new: Cells, candidate: Candidate, match: Match, pose: Pose
    ) -> LoopRecord:
        """Search the other way round, and compare with what the graph knew."""
        settings = self.settings
        back, away = planar.invert(candidate.pose), planar.adjoint(candidate.pose)
        reverse = self._search(new, old, back, away @ candidate.covariance @ away.T, both=False)
        if reverse is None:
            return replace(record, reason="the reverse search finds nothing")
        points = some_points(old.fine_points, _MOST_POINTS)
        reverse_pose = refine_on(new.fine, points, reverse.pose, searched=self._cells.lattice).pose
        # Where the walls of the new submap come to lie by one and by the other.
        middle = self._submaps[record.j].middle[None]
        off = math.dist(reverse_pose.inverse().apply(middle)[0], pose.apply(middle)[0])
        turned = abs(float(wrap_angle(reverse_pose.theta + pose.theta)))
        record = replace(record, reverse_metres=off, reverse_radians=turned)
        if off > settings.reverse_cells * self._cells.lattice.resolution or turned > settings.reverse_radians:
            return replace(record, reason="the reverse search differs")
        points = some_points(new.points, _MOST_POINTS)
        covariance = score_covariance(old.pyramid, points, np.ones(len(points), np.int64), match.searched)
        covariance = _BENT * local_covariance(covariance, pose)
        found = planar.of_pose(pose)
        off_graph = planar.between(candidate.pose, found)
        chi2 = float(off_graph @ np.linalg.solve(candidate.covariance + covariance, off_graph))
        record = replace(record, chi2=chi2, covariance=tuple(map(tuple, covariance.tolist())))
        if chi2 > self.limit:
            return replace(record, reason="too far from where the graph has it")
        if record.sigma_metres > settings.confirm_metres:
            return replace(record, reason="waiting")
        return replace(record, accepted=True, reason="accepted")

    def _search(
        self, old: Cells, new: Cells, pose: FloatArray, covariance: FloatArray, both: bool = True
    ) -> Match | None:
        """Search one submap in another where a pose (3,) and its covariance (3, 3) let it lie."""
        lattice = self._cells.lattice
        turn = planar.to_pose(pose).rotation
        sides = np.sqrt(np.diag(turn @ covariance[:2, :2] @ turn.T)) * self.settings.sigmas + 2.0 * lattice.resolution
        step = lattice.resolution / max(1.0, _reach(new.points))
        # Farther away than both reach nothing can meet.
        sides = np.minimum(sides, _reach(old.points) + _reach(new.points) + float(np.hypot(*pose[:2])))
        yaw = min(self.settings.sigmas * math.sqrt(float(covariance[2, 2])) + step, math.pi)
        if 2.0 * float(sides.max()) <= SMALL_WINDOW * lattice.resolution:
            return self._search_box(old.pyramid, new, pose, (sides, yaw), both)
        # A large window is searched on cells of twice the size, and where something is found the small ones follow.
        found = self._search_box(old.wide_pyramid, new, pose, (sides, yaw), both)
        if found is None or not found.certified or found.gap or found.runner_up is not None:
            return found
        near = 2.0 * self._cells.wide.resolution
        around = np.full(2, near), near / max(1.0, _reach(new.points))
        return self._search_box(old.pyramid, new, planar.of_pose(found.pose), around, both)

    def _search_box(
        self, pyramid: OccupancyPyramid, new: Cells, pose: FloatArray, window: tuple[FloatArray, float], both: bool
    ) -> Match | None:
        """Search a submap in the window of so many metres and radians to both sides of a pose (3,)."""
        sides, yaw = window
        low, high = pose[:2] - sides, pose[:2] + sides
        matcher = GlobalMatcher(pyramid, box_of_cells(pyramid.lattice, low, high), self._cells.scratch)
        return matcher.match(
            some_points(new.points, _MOST_POINTS),
            SearchRegion(low, high, float(pose[2]), yaw),
            runner_up=1.0 - self.settings.min_margin if both else None,
            least=_LEAST,
            refine=False,
            beams=False,
            information=False,
            node_limit=self.settings.node_limit,
        )


def some_points(points: FloatArray, most: int) -> FloatArray:
    """Return so many points (P, n) at most, spread over all."""
    if len(points) <= most:
        return points
    return points[np.linspace(0, len(points) - 1, most).astype(np.int64)]


def _reach(points: FloatArray) -> float:
    return math.sqrt(float((points**2).sum(axis=1).max())) if len(points) else 0.0


def _agreement(old: Cells, new: Cells, pose: Pose) -> tuple[int, float, float]:
    """Return how many cells of the smaller meet a wall, which share, and which share of what both know is free."""
    lattice = old.walls.lattice
    counts = []
    for there, points, T in ((old, new.points, pose), (new, old.points, pose.inverse())):
        index = lattice.quantise(T.apply(points))
        on_wall = there.walls.contains(index)
        counts.append((int(on_wall.sum()), int((~on_wall & there.free.contains(index)).sum()), len(points)))
    met, _, total = min(counts, key=lambda count: count[2])
    free, both = counts[0][1] + counts[1][1], counts[0][0] + counts[1][0]
    return met, met / total, free / max(1, free + both)
