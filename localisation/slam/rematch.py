"""The last pass: each scan once more against the map of all the others.

While a log is mapped a scan sees only what came before it. At the end each is drawn to the map of all other scans: its
own hits are taken off the counts first. It is drawn by every other of its beams, and moves only where the beams in
between, which had no part in it, then meet more walls.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.lattice.keys import pack, unpack
from hexmap.maps.builder import MapBuilder
from hexmap.maps.counter import PASSES, CellCounter
from hexmap.maps.state_rule import StateRule
from hexmap.poses.pose import Pose
from localisation.matching.occupancy import Occupancy
from localisation.matching.refinement import refine_on
from localisation.settings import MappingSettings, limit_of
from localisation.slam import planar
from localisation.slam.slam import SlamResult

__all__ = ["carry_along", "rematch"]

# Fewer points than this are no ground to move a scan.
_LEAST = 20


def rematch(
    result: SlamResult, settings: MappingSettings, mount: Pose, progress: Callable[[int], None] | None = None
) -> SlamResult:
    """Draw each scan to the map of all others, all at once; the readings between them follow.

    Args:
        result: all poses and scans of a log.
        settings: of the map.
        mount: T_robot_laser.
        progress: called with how many scans are done, of twice as many: each is fused and then drawn.
    """
    if not result.scans:
        return result
    progress = progress or (lambda done: None)
    rows = result.poses[result.is_scan]
    limit = limit_of(settings.max_range)
    builder = MapBuilder(settings.make_lattice(), 1, min_range=settings.min_range, max_range=limit,
                         clear_no_return=settings.clear_no_return)  # fmt: skip
    for number, scan in enumerate(result.scans):
        builder.fuse(scan.scan(), planar.to_pose(rows[number]) @ mount)
        progress(number + 1)
    others = _Others(builder.counter(0), settings.rule)
    drawn = np.empty_like(rows)
    for number, scan in enumerate(result.scans):
        points = mount.apply(scan.usable(settings.min_range, limit))
        drawn[number] = others.draw(points, rows[number])
        progress(len(rows) + number + 1)
    return replace(result, poses=_in_first_frame(result, carry_along(result, drawn)))


class _Others:
    """The finest level of the map of all scans, from which one scan's own hits can be taken for a moment."""

    def __init__(self, counter: CellCounter, rule: StateRule) -> None:
        self.counter, self.rule = counter, rule
        self.occupancy = Occupancy.of_counter(counter, rule)

    def draw(self, points: FloatArray, row: FloatArray) -> FloatArray:
        """Return where a scan's points (P, n) fit better, or ``row`` (3,), where they are."""
        pose = planar.to_pose(row)
        if len(points) < _LEAST:
            return row
        own = self._own_cells(pose.apply(points))
        self.occupancy.change(own, np.zeros(len(own), np.bool_))
        by_half = refine_on(self.occupancy, points[::2], pose)
        better = row
        if by_half.converged and self._met(points[1::2], by_half.pose) > self._met(points[1::2], pose):
            whole = refine_on(self.occupancy, points, pose)
            better = planar.of_pose(whole.pose)
        self.occupancy.change(own, np.ones(len(own), np.bool_))
        return better

    def _own_cells(self, points: FloatArray) -> IntArray:
        """Return the cells (M, n) that are occupied by nothing but these points (P, n)."""
        keys, own = np.unique(pack(self.counter.lattice.quantise(points)), return_counts=True)
        index = unpack(keys, self.counter.lattice.dim)
        hits, passes = self.counter.find(index), self.counter.find(index, PASSES)
        alone = self.rule.occupied(hits, passes) & ~self.rule.occupied(hits - own, passes)
        return index[alone].astype(np.int64)

    def _met(self, points: FloatArray, pose: Pose) -> int:
        return int(self.occupancy.contains(self.counter.lattice.quantise(pose.apply(points))).sum())


def carry_along(result: SlamResult, drawn: FloatArray) -> FloatArray:
    """Return the poses (N, 3) of all readings with the scans at ``drawn`` (S, 3), those between moved as both are."""
    at = np.flatnonzero(result.is_scan)
    readings = np.arange(len(result.poses))
    after = np.clip(np.searchsorted(at, readings), 0, len(at) - 1)
    before = np.where(at[after] > readings, np.maximum(after - 1, 0), after)
    rows = result.poses[at]
    by_before = planar.compose(drawn[before], planar.between(rows[before], result.poses))
    by_after = planar.compose(drawn[after], planar.between(rows[after], result.poses))
    share = np.clip((readings - at[before]) / np.maximum(at[after] - at[before], 1), 0.0, 1.0)
    poses = planar.blend(by_before, by_after, share)
    poses[at] = drawn
    return poses


def _in_first_frame(result: SlamResult, poses: FloatArray) -> FloatArray:
    """Return poses (N, 3) in the frame in which the first one is where it was."""
    back = planar.compose(result.poses[0], planar.invert(poses[0]))
    return planar.compose(np.broadcast_to(back, poses.shape), poses)
