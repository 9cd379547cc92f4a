"""What looking for loops is in the plane and in space: candidates one after the other, and which loops are believed.

Which old submaps a new one is looked for in, and what a match must pass, is for those who know the submaps
(:mod:`~localisation.slam.loop_closer`, :mod:`~localisation.slam.lidar_loops`). What is written down, how two loops
confirm each other and what the graph throws out is the same, whatever the geometry of the graph.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.values import one_line
from localisation.slam.pose_graph import Edge, PoseGraph
from localisation.slam.settings import LoopSettings

__all__ = ["Candidate", "LoopRecord", "LoopSearch"]


@dataclass(frozen=True)
class LoopRecord:
    """What was tried, and what came of it; numbers that were not reached are None.

    Attributes:
        i: node of the old submap.
        j: node of the new one, which is looked for.
        accepted: whether the loop is in the graph.
        reason: why not, or "accepted".
        sigma_metres: standard deviation of where j lay in i before, along the worst axis.
        sigma_radians: of its heading.
        score: cells that coincide at best.
        total: cells there were.
        gap: by how much a better pose could score more.
        margin: by how much the best outscores all others in the window, 0 to 1.
        overlap: share of the cells of one that meet a wall of the other.
        contradicted: share of the walls known to the other that are free there.
        reverse_metres: by how much the search of i in j differs.
        reverse_radians: the same for the heading.
        chi2: squared normalised distance from where the graph had it.
        pose: T_i_j as a row, of three numbers or in space of twelve.
        covariance: (3, 3), or in space (6, 6), of a small motion in the frame of j.
    """

    i: int
    j: int
    accepted: bool
    reason: str
    sigma_metres: float
    sigma_radians: float
    score: int | None = None
    total: int | None = None
    gap: int | None = None
    margin: float | None = None
    overlap: float | None = None
    contradicted: float | None = None
    reverse_metres: float | None = None
    reverse_radians: float | None = None
    chi2: float | None = None
    pose: tuple[float, ...] | None = None
    covariance: tuple[tuple[float, ...], ...] | None = None


@dataclass(frozen=True, eq=False)
class Candidate:
    """An old submap, where the new one lies in it, and how sure that is.

    Attributes:
        i: its node.
        pose: T_i_j as a row.
        covariance: (d, d) of a small motion in the frame of j.
    """

    i: int
    pose: FloatArray
    covariance: FloatArray

    __repr__ = one_line

    @property
    def sigma(self) -> tuple[float, float]:
        """Standard deviations along the worst axes: metres, radians."""
        n = 2 if len(self.covariance) == 3 else 3
        metres, radians = self.covariance[:n, :n], self.covariance[n:, n:]
        return math.sqrt(float(np.linalg.eigvalsh(metres)[-1])), math.sqrt(float(np.linalg.eigvalsh(radians)[-1]))


class LoopSearch(ABC):
    """Looks for loops from each new submap to the old ones.

    Attributes:
        settings: how loops are looked for.
        limit: of the squared normalised residual of a true loop.
        records: everything that was tried, in order.
    """

    def __init__(self, graph: PoseGraph, settings: LoopSettings) -> None:
        """Take the graph, which grows."""
        from scipy.special import gammaincinv

        self._graph, self.settings = graph, settings
        # Of chi-squared with as many degrees of freedom as a pose has.
        self.limit = 2.0 * float(gammaincinv(0.5 * graph.geometry.dof, settings.probability))
        self.records: list[LoopRecord] = []
        self._waiting: list[int] = []

    @abstractmethod
    def candidates(self, j: int) -> list[Candidate]:
        """Return the old submaps in which submap ``j`` may lie, the likeliest first."""

    @abstractmethod
    def _try(self, candidate: Candidate, j: int) -> LoopRecord:
        """Search, and put the match through the tests."""

    def look(self, j: int) -> list[int]:
        """Look for loops from submap ``j``; the edges of those that are believed go into the graph.

        Returns:
            The numbers of the new edges.
        """
        new = []
        for candidate in self.candidates(j):
            record = self._try(candidate, j)
            if record.reason == "waiting":
                record, partner = self._confirm(record)
                if partner is not None:
                    new.append(self._accept(partner))
            self.records.append(record)
            if record.accepted:
                new.append(self._add(record))
            elif record.reason == "waiting":
                self._waiting.append(len(self.records) - 1)
        return new

    def finish(self) -> None:
        """Give up what still waits for a second loop."""
        for number in self._waiting:
            self.records[number] = replace(self.records[number], reason="no second loop agrees")
        self._waiting.clear()

    def throw_out(self, edges: Sequence[int]) -> None:
        """Note the loops that the graph has thrown out."""
        pairs = {(self._graph.edges[e].i, self._graph.edges[e].j) for e in edges}
        for k, record in enumerate(self.records):
            if record.accepted and (record.i, record.j) in pairs:
                self.records[k] = replace(record, accepted=False, reason="thrown out by the graph")

    def _accept(self, number: int) -> int:
        self.records[number] = replace(self.records[number], accepted=True, reason="accepted")
        return self._add(self.records[number])

    def _add(self, record: LoopRecord) -> int:
        edge = Edge(record.i, record.j, np.array(record.pose), np.array(record.covariance), loop=True)
        return self._graph.add_edge(edge)

    def _confirm(self, record: LoopRecord) -> tuple[LoopRecord, int | None]:
        """Look for a loop that waits and agrees with this one around their cycle; returns its number."""
        for number in self._waiting:
            other = self.records[number]
            # Of one submap in two old ones, or of two that share half, a chance would be the same.
            if abs(other.j - record.j) < self.settings.confirm_nodes:
                continue
            if self._cycle(other, record) <= self.limit:
                self._waiting.remove(number)
                return replace(record, accepted=True, reason="accepted"), number
        return record, None

    def _cycle(self, a: LoopRecord, b: LoopRecord) -> float:
        """Return the squared normalised error around the cycle of two loops and the chain between their ends."""
        geometry, poses = self._graph.geometry, self._graph.poses
        step_i, step_j = geometry.between(poses[a.i], poses[b.i]), geometry.between(poses[a.j], poses[b.j])
        pose_a, pose_b = np.array(a.pose), np.array(b.pose)
        # From a's old submap to b's new one both ways round.
        by_a, by_b = geometry.compose(pose_a, step_j), geometry.compose(step_i, pose_b)
        to_b = geometry.adjoint(geometry.invert(step_j))
        of_a = to_b @ np.array(a.covariance) @ to_b.T
        of_j = self._graph.relative_covariances(a.j, [b.j])[0]
        along = geometry.adjoint(geometry.invert(pose_b))
        of_i = along @ self._graph.relative_covariances(a.i, [b.i])[0] @ along.T
        off = geometry.small(geometry.between(by_a, by_b))
        return float(off @ np.linalg.solve(of_a + of_j + of_i + np.array(b.covariance), off))
