"""Submaps: what the scans around one node of the graph saw, in the node's frame.

A node is a scan; a stretch is what comes from one node to the next; a submap is the stretch before its node and the one
after it. So neighbouring submaps overlap by half, and every scan is in two of them. Only the points of a submap are
kept, one a cell of the finest level; cells of other sizes and free space are made from the scans when they are asked
for, and forgotten again.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.base.values import one_line
from hexmap.lattice.lattice import Lattice
from hexmap.maps.counter import HITS, PASSES, CellCounter
from hexmap.maps.state_rule import StateRule
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from localisation.matching.global_matcher import thin
from localisation.matching.occupancy import Occupancy
from localisation.matching.pyramid import OccupancyPyramid
from localisation.matching.score import coincidence
from localisation.matching.search_space import Scratch
from localisation.slam import planar

__all__ = ["Cells", "CompactScan", "Stretch", "Submap", "SubmapCells", "compact", "in_view", "make_stretch"]

# Scans whose beams say what is free in a submap: more say little more.
_FREE_SCANS = 8
# The share of a submap's points, the nearest ones, that is matched.
_NEAR = 0.98
# Levels of a pyramid that windows of so many cells need: its tables are most of a submap's memory.
SMALL_LEVELS = 3
# So many submaps, those that were asked for last, are kept as cells: out of doors each takes 10 MB at 0.05 m. Half as
# many again would save a quarter of what is made again. The last ones keep their sheets, too, which are as large: half
# of the sheets that are asked for again are younger.
_KEPT, _WITH_SHEETS = 8, 5
SMALL_WINDOW = 64


@dataclass(frozen=True, eq=False)
class CompactScan:
    """A scan as it is kept until the end.

    Attributes:
        stamp: seconds.
        points: (P, n) float32 in the sensor's frame, metres.
        no_return: (M, n) float32 directions of beams without return, where they clear anything.
        line: of the log.
    """

    stamp: float
    points: NDArray[np.float32]
    no_return: NDArray[np.float32]
    line: int | None = None

    __repr__ = one_line

    def scan(self) -> Scan:
        """Return the scan again."""
        return Scan(self.stamp, self.points.astype(np.float64), self.no_return.astype(np.float64), line=self.line)

    def usable(self, min_range: float, max_range: float) -> FloatArray:
        """Return the points (P, n) between two ranges, metres, in the sensor's frame."""
        points = self.points.astype(np.float64)
        ranges = np.sqrt((points**2).sum(axis=1))
        return points[(ranges >= min_range) & (ranges <= max_range)]


def compact(scan: Scan, *, no_return: bool) -> CompactScan:
    """Return what is kept of a scan; ``no_return``: whether its beams without return matter."""
    directions = scan.no_return if no_return else scan.no_return[:0]
    return CompactScan(scan.stamp, scan.points.astype(np.float32), directions.astype(np.float32), scan.line)


@dataclass(frozen=True, eq=False)
class Stretch:
    """What the scans from one node to the next saw.

    Attributes:
        first: number of the first scan, the node's own.
        last: number of the scan after the last one: the next node's.
        motion: (3,) T_node_next.
        points: (P, n) float32, one a cell of the finest level, in the frame of the node, metres.
        weights: (P,) int32 how many points each stands for.
    """

    first: int
    last: int
    motion: FloatArray
    points: NDArray[np.float32]
    weights: NDArray[np.int32]

    __repr__ = one_line


@dataclass(frozen=True, eq=False)
class Submap:
    """What was seen around a node.

    Attributes:
        number: of its node, whose pose T_map_submap the graph knows.
        before: the stretch that ends at the node; None at the first node.
        after: the stretch that begins there.
        middle: (n,) mean of its points in its own frame.
        reach: how far its points are from there at most, metres.
        coarse: (K, n) middles of the squares of a metre that hold points of it, in its own frame.
        view: which squares hold points or lie beside such, as a picture.
        corner: (n,) the square in which that begins.
    """

    number: int
    before: Stretch | None
    after: Stretch
    middle: FloatArray
    reach: float
    coarse: FloatArray
    view: NDArray[np.bool_]
    corner: IntArray

    __repr__ = one_line

    @classmethod
    def of(cls, number: int, before: Stretch | None, after: Stretch) -> Submap:
        """Make the submap of a node."""
        points, _ = _points(before, after)
        middle = points.mean(axis=0) if len(points) else np.zeros(2)
        reach = math.sqrt(float(((points - middle) ** 2).sum(axis=1).max())) if len(points) else 0.0
        squares = np.unique(np.floor(points).astype(np.int64), axis=0).reshape(-1, 2)
        corner = squares.min(axis=0, initial=0) - 1
        view = np.zeros(tuple(squares.max(axis=0, initial=0) - corner + 2), np.bool_)
        for i in (-1, 0, 1):
            for j in (-1, 0, 1):
                view[tuple((squares - corner + [i, j]).T)] = True
        return cls(number, before, after, middle, reach, (squares + 0.5).astype(np.float64), view, corner)

    def seen(self, points: FloatArray) -> NDArray[np.bool_]:
        """Tell which of some points (P, n) in its frame lie on its squares of a metre or beside them, (P,)."""
        at = np.floor(points).astype(np.int64) - self.corner
        inside = ((at >= 0) & (at < self.view.shape)).all(axis=1)
        at[~inside] = 0
        return self.view[at[:, 0], at[:, 1]] & inside

    def points(self) -> tuple[FloatArray, IntArray]:
        """Return its points (P, n) in its own frame, metres, and how many each stands for."""
        return _points(self.before, self.after)

    def scans(self) -> list[tuple[int, int]]:
        """Return the numbers of its scans as ranges, first and one after the last."""
        before = [] if self.before is None else [(self.before.first, self.before.last)]
        return [*before, (self.after.first, self.after.last)]


def _points(before: Stretch | None, after: Stretch) -> tuple[FloatArray, IntArray]:
    points, weights = after.points.astype(np.float64), after.weights.astype(np.int64)
    if before is None:
        return points, weights
    earlier = planar.to_pose(before.motion).inverse().apply(before.points)
    return np.concatenate([earlier, points]), np.concatenate([before.weights.astype(np.int64), weights])


def in_view(submaps: Sequence[Submap], poses: FloatArray, chosen: IntArray, j: int) -> FloatArray:
    """Return how much each of some submaps and submap ``j`` have in view of one another, 0 to 1, (M,).

    It is the share of the squares of a metre of the one that lie on those of the other or beside them, both ways round.

    Args:
        submaps: all of them.
        poses: (N, 3) T_map_submap of all.
        chosen: (M,) which are asked for.
        j: the one that they are compared with.
    """
    if not len(chosen):
        return np.zeros(0)
    b, some = submaps[j], [submaps[i] for i in chosen.tolist()]
    T_a_b = planar.between(poses[chosen], np.broadcast_to(poses[j], (len(chosen), 3)))
    counts = np.array([len(a.coarse) for a in some])
    of_a = np.repeat(np.arange(len(some)), counts)
    in_b = _moved(planar.invert(T_a_b)[of_a], np.concatenate([a.coarse for a in some]))
    by_a = np.bincount(of_a, b.seen(in_b), len(some)) / np.maximum(1, counts)
    by_b = np.empty(len(some))
    in_a = _moved(T_a_b[:, None], b.coarse[None])
    for k, a in enumerate(some):
        by_b[k] = a.seen(in_a[k]).sum() / max(1, len(b.coarse))
    return np.asarray(np.sqrt(by_a * by_b))


def _moved(rows: FloatArray, points: FloatArray) -> FloatArray:
    """Return points (..., 2) moved by poses (..., 3)."""
    c, s = np.cos(rows[..., 2]), np.sin(rows[..., 2])
    x, y = points[..., 0], points[..., 1]
    return np.stack([rows[..., 0] + c * x - s * y, rows[..., 1] + s * x + c * y], axis=-1)


class Cells:
    """A submap on cells, made when they are first asked for: what it is searched in, and what it is searched with."""

    def __init__(self, submap: Submap, maker: SubmapCells) -> None:
        """Take the submap, and who knows the lattices and the scans."""
        self._maker = maker
        self._submap = submap
        points, _ = submap.points()
        ranges = np.sqrt((points**2).sum(axis=1))
        # The few farthest points say little, and the tables reach as far as they do.
        self.raw_points = points[ranges <= np.quantile(ranges, _NEAR)] if len(points) else points

    @cached_property
    def points(self) -> FloatArray:
        """(P, n) one point a cell of the searched lattice, metres, in the submap's frame."""
        return thin(self.raw_points, self._maker.lattice)[0]

    @cached_property
    def occupied(self) -> VoxelList:
        """Its occupied cells."""
        return coincidence(VoxelList.from_points(self.raw_points, self._maker.lattice))

    @cached_property
    def pyramid(self) -> OccupancyPyramid:
        """The pyramid of its occupied cells, for windows of up to 128 of them."""
        return OccupancyPyramid(self.occupied, levels=SMALL_LEVELS)

    @cached_property
    def wide_pyramid(self) -> OccupancyPyramid:
        """The pyramid of its occupied cells of twice the size, for larger windows."""
        return OccupancyPyramid(coincidence(VoxelList.from_points(self.raw_points, self._maker.wide)))

    @cached_property
    def fine(self) -> Occupancy:
        """Its occupied cells on the finest level."""
        return Occupancy.of_list(VoxelList.from_points(self.raw_points, self._maker.fine))

    @cached_property
    def fine_points(self) -> FloatArray:
        """(Q, n) one point a cell of the finest level, or two, metres."""
        return self.raw_points

    @cached_property
    def walls(self) -> VoxelList:
        """Its occupied cells of twice the size and those beside them, where a wall of another may lie."""
        lattice = self._maker.wide
        index = VoxelList.from_points(self.raw_points, lattice).index.astype(np.int64)
        return VoxelList.from_cells(np.concatenate([index, *[index + o for o in lattice.neighbours]]), lattice)

    @cached_property
    def free(self) -> VoxelList:
        """Its free cells of twice the size."""
        passed = self._maker.passed(self._submap)
        return passed.select(~self.walls.contains(passed.index))


    def forget_sheets(self) -> None:
        """Give back the memory of the tables that searches have asked for, which are made again when they are."""
        for name in ("pyramid", "wide_pyramid"):
            if name in self.__dict__:
                self.__dict__[name].forget_sheets()


class SubmapCells:
    """Makes the cells of submaps, and keeps those that were asked for last."""

    def __init__(
        self,
        fine: Lattice,
        searched: Lattice,
        rule: StateRule,
        scan_of: Callable[[int], tuple[Scan, Pose]],
        kept: int = _KEPT,
    ) -> None:
        """Take the lattices, and what gives a scan by its number with its pose T_node_sensor seen from its node."""
        self.lattice, self.wide = searched, searched.scaled(2.0)
        self.fine, self._rule, self.scan_of, self._kept = fine, rule, scan_of, kept
        self._cells: OrderedDict[int, Cells] = OrderedDict()
        self.scratch = Scratch(sparse=True)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the cells, which are made again when they are asked for, and who gives the scans."""
        return {**self.__dict__, "_cells": OrderedDict(), "scan_of": None}

    def of(self, submap: Submap) -> Cells:
        """Return the cells of a submap."""
        if submap.number in self._cells:
            self._cells.move_to_end(submap.number)
        else:
            self._cells[submap.number] = Cells(submap, self)
        if len(self._cells) > self._kept:
            self._cells.popitem(last=False)
        for cells in list(self._cells.values())[:-_WITH_SHEETS]:
            cells.forget_sheets()
        return self._cells[submap.number]

    def forget(self) -> None:
        """Give back the memory of all cells and of what searched in them; both are made again when they are needed."""
        self._cells.clear()
        self.scratch.give_back()

    def passed(self, submap: Submap) -> VoxelList:
        """Return the cells without a wall that beams of some of a submap's scans went through."""
        numbers = [n for first, last in submap.scans() for n in range(first, last)]
        chosen = sorted({numbers[k] for k in np.linspace(0, len(numbers) - 1, _FREE_SCANS).astype(int).tolist()})
        T_node_before = None if submap.before is None else planar.to_pose(submap.before.motion).inverse()
        counter = CellCounter(self.wide)
        for number in chosen:
            scan, pose = self.scan_of(number)
            if number < submap.after.first and T_node_before is not None:
                pose = T_node_before @ pose
            counter.fuse(pose.translation, pose.apply(scan.points), len(scan.points))
        passes = counter.to_list(PASSES)
        return passes.select(~self._rule.occupied(counter.find(passes.index, HITS), passes.counts))


def make_stretch(first: int, last: int, motion: FloatArray, points: FloatArray, lattice: Lattice) -> Stretch:
    """Make a stretch of all points (P, n) of its scans in the frame of its node."""
    kept, weights = thin(points, lattice) if len(points) else (points, np.zeros(0, np.int64))
    return Stretch(first, last, motion, kept.astype(np.float32), weights.astype(np.int32))
