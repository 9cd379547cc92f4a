"""Loops in space: a new submap is looked for in old ones by the certified matcher, and put through tests.

The same rules as in the plane (:mod:`localisation.slam.loop_closer`): windows grow with what the graph does not know, a
match must outscore all others, its reverse must find the same, beams must not contradict it, and it must agree with the
graph; where the graph knows little a second loop must agree. Yaw is searched, and of the tilt as much as the graph
leaves open: gravity pulls the same everywhere, and what a sensor's attitude has drifted by is little.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.lattice.lattice import Lattice
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import angles
from localisation.matching.global_matcher import GlobalMatcher
from localisation.matching.match import Match
from localisation.matching.search_region import SearchRegion, box_of_cells
from localisation.matching.surfaces import Drawn
from localisation.slam import spatial
from localisation.slam.lidar_submap import LevelSubmap, LidarSubmap, SubmapShelf
from localisation.slam.loop_search import Candidate, LoopRecord, LoopSearch
from localisation.slam.pose_graph import PoseGraph
from localisation.slam.settings import LoopSettings

__all__ = ["LidarLoopCloser", "drawn_covariance"]

# Nodes that follow one another overlap anyway.
_NEIGHBOURS = 3
# In what most of a submap's points lie within: farther apart two see little of the same surfaces from the same side.
_SIGHT = 0.5
# In cells of the map: what the graph knows so well a loop does not tell better.
_KNOWN = 0.5
# In cells of the surfaces: so near a scan is drawn onto them without a search.
_NEAR = 0.4
# In cells of the surfaces: search and reverse search may put a submap so far apart, after both are drawn.
_REVERSE = 0.2
# Share of a submap's points that must lie on the planes of the other: half of what one saw the other did not, often.
_LEAST = 0.3
# Variance of what surfaces say, in what it were if points were independent: thousands lie on some hundred planes, each
# as bent and as wrong as its wall. Fitted on simulated drives (``python -m tests.benchmarks.lidar simulated``).
_DEPENDENT = 120.0
# What no number of points makes better: metres and radians. A sweep is deskewed by one velocity, and a robot sways.
_FLOOR = (0.005, 0.002)
# The widest tilt that is searched, radians.
_MOST_TILT = math.radians(5.0)
# Blocks and poses that one search may take: in space each is a thousand times the work of one in the plane.
_NODES = 3_000


def drawn_covariance(drawn: Drawn) -> FloatArray:
    """Return the covariance (6, 6) of a scan that was drawn: a small motion in the scan's own frame."""
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = drawn.pose.rotation.T
    floor = np.diag(np.repeat(np.square(_FLOOR), 3))
    values, axes = np.linalg.eigh(drawn.information)
    # A tunnel holds nothing along itself: a metre, and a radian, is what is not known then.
    covariance = (axes / np.maximum(values, 1.0)) @ axes.T
    return np.asarray(_DEPENDENT * (turn @ covariance @ turn.T) + floor)


class LidarLoopCloser(LoopSearch):
    """Looks for loops in space."""

    def __init__(
        self, graph: PoseGraph, submaps: list[LidarSubmap], shelf: SubmapShelf, fine: Lattice, settings: LoopSettings
    ) -> None:
        """Take the graph and the submaps, which grow; ``fine`` is the lattice of the map's finest level."""
        super().__init__(graph, settings)
        self._submaps, self._shelf, self._fine = submaps, shelf, fine

    # ------------------------------------------------------------------ candidates

    def candidates(self, j: int) -> list[Candidate]:
        """Return the old submaps in which submap ``j`` may lie, the nearest first: one of each earlier visit."""
        last = j - _NEIGHBOURS
        if last < 0:
            return []
        poses = self._graph.poses
        settings = self.settings
        spread = self._graph.relative_covariances(j, [0])[0]
        slack = settings.sigmas * math.sqrt(max(float(np.linalg.eigvalsh(spread[:3, :3])[-1]), 0.0))
        apart = np.linalg.norm(poses[: last + 1, 9:] - poses[j, 9:], axis=1)
        reach = np.array([min(s.reach, self._submaps[j].reach) for s in self._submaps[: last + 1]])
        near = np.flatnonzero(apart < np.maximum(_SIGHT * reach, settings.node_metres) + slack)
        visits = np.split(near, np.flatnonzero(np.diff(near) > 1) + 1)
        chosen = [int(v[np.argmin(apart[v])]) for v in visits if len(v)]
        if not chosen:
            return []
        found = []
        for i, covariance in zip(chosen, self._graph.relative_covariances(j, chosen), strict=True):
            pose = spatial.between(poses[i], poses[j])
            # Held at j, it is the covariance of i: as seen from i it is the same motion in the frame of j.
            A = spatial.adjoint(spatial.invert(pose))
            candidate = Candidate(i, pose, A @ covariance @ A.T)
            metres, radians = candidate.sigma
            known = _KNOWN * self._fine.resolution
            if metres > known or radians * self._submaps[j].reach > 2.0 * known:
                found.append((float(apart[i]), candidate))
        found.sort(key=lambda pair: (pair[0], pair[1].i))
        return [candidate for _, candidate in found[: settings.searches]]

    # ------------------------------------------------------------------ one candidate

    def _try(self, candidate: Candidate, j: int) -> LoopRecord:
        """Search, and put the match through the tests, the cheap ones first."""
        T_map_i, T_map_j = (spatial.to_pose(self._graph.pose(k)) for k in (candidate.i, j))
        old = self._shelf.of(self._submaps[candidate.i], T_map_i)
        new = self._shelf.of(self._submaps[j], T_map_j)
        record = LoopRecord(candidate.i, j, False, "", *candidate.sigma)
        # Between axes parallel to the map's.
        expected = old.T_level_node @ spatial.to_pose(candidate.pose) @ new.T_level_node.inverse()
        start = expected
        if not self._is_near(candidate):
            match = self._search(old, new, expected, candidate)
            if match is None:
                return replace(record, reason="no wall meets another")
            record = replace(record, score=match.score, total=match.total, gap=match.gap, margin=match.margin)
            if not match.certified or match.gap:
                return replace(record, reason="the search was not finished")
            if match.runner_up is not None:
                return replace(record, reason="another place fits as well")
            start = match.pose
        there = old.surfaces.draw(new.points, start, farthest=2.0)
        if not there.converged:
            return replace(record, reason="the surfaces do not hold it")
        row = spatial.of_pose(old.T_level_node.inverse() @ there.pose @ new.T_level_node)
        record = replace(record, overlap=there.share, pose=tuple(row.tolist()))
        if there.share < _LEAST:
            return replace(record, reason="too little overlap")
        met, free = map(sum, zip(old.meets(there.pose.apply(new.searched)),
                                 new.meets(there.pose.inverse().apply(old.searched)), strict=True))  # fmt: skip
        record = replace(record, contradicted=free / max(1, met + free))
        if free > self.settings.max_contradicted * (met + free):
            return replace(record, reason="walls where the other is free")
        return self._check_further(record, old, new, candidate, there, row)

    def _is_near(self, candidate: Candidate) -> bool:
        """Tell whether a submap lies so near to where it is expected that it can be drawn without a search."""
        metres, radians = candidate.sigma
        lever = self._submaps[candidate.i].reach
        return self.settings.sigmas * math.hypot(metres, radians * lever) < _NEAR * self._shelf.lattice.resolution

    def _check_further(
        self, record: LoopRecord, old: LevelSubmap, new: LevelSubmap, candidate: Candidate, there: Drawn,
        row: FloatArray,
    ) -> LoopRecord:  # fmt: skip
        """Draw it the other way round, and compare with what the graph knew."""
        settings = self.settings
        back = new.surfaces.draw(old.points, there.pose.inverse(), farthest=2.0)
        if not back.converged:
            return replace(record, reason="the reverse search finds nothing")
        round_trip = back.pose @ there.pose
        off, turned = float(np.linalg.norm(round_trip.translation)), float(angles(round_trip.rotation[None])[0])
        record = replace(record, reverse_metres=off, reverse_radians=turned)
        if off > _REVERSE * self._shelf.lattice.resolution or turned > settings.reverse_radians:
            return replace(record, reason="the reverse search differs")
        turn = np.zeros((6, 6))
        turn[:3, :3] = turn[3:, 3:] = new.T_level_node.rotation.T
        covariance = turn @ drawn_covariance(there) @ turn.T
        found = spatial.small(spatial.between(candidate.pose, row))
        chi2 = float(found @ np.linalg.solve(candidate.covariance + covariance, found))
        record = replace(record, chi2=chi2, covariance=tuple(map(tuple, covariance.tolist())))
        if chi2 > self.limit:
            return replace(record, reason="too far from where the graph has it")
        if record.sigma_metres > settings.confirm_metres:
            return replace(record, reason="waiting")
        return replace(record, accepted=True, reason="accepted")

    def _search(
        self, old: LevelSubmap, new: LevelSubmap, expected: Pose, candidate: Candidate
    ) -> Match | None:
        """Search the new submap in the window of three standard deviations around where it is expected."""
        metres, radians = candidate.sigma
        sigmas, cell = self.settings.sigmas, self._shelf.lattice.resolution
        sides = sigmas * metres + cell
        low, high = expected.translation - sides, expected.translation + sides
        yaw = math.atan2(expected.rotation[1, 0], expected.rotation[0, 0])
        reach = max(self._submaps[candidate.i].reach, cell)
        tilt = min(sigmas * radians, _MOST_TILT)
        # Drawing takes up a tilt that moves points by a cell.
        tilt = tilt if tilt * reach > cell else 0.0
        matcher = GlobalMatcher(old.pyramid, box_of_cells(old.pyramid.lattice, low, high))
        return matcher.match(
            new.searched,
            SearchRegion(low, high, yaw, min(math.pi, sigmas * radians + cell / reach), tilt),
            apart=(2.0 * cell, math.radians(5.0)),
            runner_up=1.0 - self.settings.min_margin,
            least=_LEAST,
            refine=False,
            beams=False,
            information=False,
            node_limit=_NODES,
        )
