"""Submaps in space: what the sweeps from one node of the graph to the next saw, in the node's frame."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray
from hexmap.base.values import one_line
from hexmap.lattice.lattice import Lattice
from hexmap.maps.counter import HITS, PASSES, CellCounter
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from localisation.matching.global_matcher import spread_points
from localisation.matching.pyramid import OccupancyPyramid
from localisation.matching.score import coincidence
from localisation.matching.surfaces import SurfaceMap

__all__ = ["LevelSubmap", "LidarSubmap", "Rays", "SubmapShelf"]

# Points that are searched with: of a LiDAR's thousands some hundred, spread evenly, tell as much.
SEARCHED = 400
# Levels of a pyramid that a submap's windows need.
_LEVELS = 4


@dataclass(frozen=True, eq=False)
class Rays:
    """Some beams of a sweep: where they began and ended, in the node's frame.

    Attributes:
        origin: (3,) metres.
        ends: (K, 3) float32 metres.
    """

    origin: FloatArray
    ends: NDArray[np.float32]

    __repr__ = one_line


@dataclass(frozen=True, eq=False)
class LidarSubmap:
    """What was seen from a node on.

    Attributes:
        number: of its node.
        first: number of the first sweep, the node's own.
        last: number of the sweep after the last one.
        points: (P, 3) float32 in the node's frame, metres, thinned.
        rays: beams that say what is free.
        reach: how far from the node most of its points are, metres.
    """

    number: int
    first: int
    last: int
    points: NDArray[np.float32]
    rays: tuple[Rays, ...]
    reach: float

    __repr__ = one_line

    @classmethod
    def of(
        cls, number: int, first: int, last: int, points: FloatArray, rays: tuple[Rays, ...]
    ) -> LidarSubmap:
        """Make one of its points (P, 3) in the node's frame."""
        ranges = np.sqrt((points**2).sum(axis=1))
        reach = float(np.quantile(ranges, 0.9)) if len(points) else 0.0
        return cls(number, first, last, points.astype(np.float32), rays, reach)


class LevelSubmap:
    """A submap in axes parallel to the map's, as far as the graph knows them: so that what is left to find is yaw.

    Attributes:
        T_level_node: the node's attitude, about its own place.
    """

    def __init__(self, submap: LidarSubmap, attitude: Pose, lattice: Lattice) -> None:
        """Turn a submap; ``lattice`` is that of its surfaces."""
        self.T_level_node = Pose(attitude.rotation, np.zeros(3))
        self._submap, self._lattice = submap, lattice
        self.points = self.T_level_node.apply(submap.points.astype(np.float64))

    @cached_property
    def searched(self) -> FloatArray:
        """(K, 3) the points it is searched with, metres."""
        return spread_points(self.points, self._lattice, SEARCHED)

    @cached_property
    def occupied(self) -> VoxelList:
        """Its occupied cells, of a surface's size."""
        return coincidence(VoxelList.from_points(self.points, self._lattice))

    @cached_property
    def pyramid(self) -> OccupancyPyramid:
        """Their pyramid."""
        return OccupancyPyramid(self.occupied, levels=_LEVELS)

    @cached_property
    def surfaces(self) -> SurfaceMap:
        """Its surfaces."""
        surfaces = SurfaceMap(self._lattice)
        surfaces.add(self.points)
        return surfaces

    @cached_property
    def free(self) -> VoxelList:
        """The cells that its beams went through and none ended in or beside."""
        counter = CellCounter(self._lattice)
        for rays in self._submap.rays:
            ends = self.T_level_node.apply(rays.ends.astype(np.float64))
            counter.fuse(self.T_level_node.apply(rays.origin[None])[0], ends, len(ends))
        passes = counter.to_list(PASSES)
        clear = passes.select(counter.find(passes.index, HITS) == 0)
        index = self.occupied.index.astype(np.int64)
        near = np.concatenate([index, *[index + o for o in self._lattice.neighbours]])
        return clear.select(~VoxelList.from_cells(near, self._lattice).contains(clear.index))

    def meets(self, points: FloatArray) -> tuple[int, int]:
        """Return how many points (P, 3) lie on its occupied cells or beside them, and how many where it is free."""
        index = self._lattice.quantise(points)
        on = self._wide.contains(index)
        return int(on.sum()), int((~on & self.free.contains(index)).sum())

    @cached_property
    def _wide(self) -> VoxelList:
        index = self.occupied.index.astype(np.int64)
        near = np.concatenate([index, *[index + o for o in self._lattice.neighbours]])
        return VoxelList.from_cells(near, self._lattice)


class SubmapShelf:
    """Keeps the level submaps that were asked for last."""

    def __init__(self, lattice: Lattice, kept: int = 8) -> None:
        """Begin with none; ``lattice`` is that of the surfaces."""
        self.lattice, self._kept = lattice, kept
        self._shelf: OrderedDict[int, tuple[bytes, LevelSubmap]] = OrderedDict()

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the submaps: they are made again when they are asked for."""
        return {**self.__dict__, "_shelf": OrderedDict()}

    def of(self, submap: LidarSubmap, pose: Pose) -> LevelSubmap:
        """Return a submap in axes parallel to the map's by its node's pose T_map_node."""
        known = self._shelf.get(submap.number)
        attitude = pose.rotation.tobytes()
        if known is not None and known[0] == attitude:
            self._shelf.move_to_end(submap.number)
            return known[1]
        level = LevelSubmap(submap, pose, self.lattice)
        self._shelf[submap.number] = (attitude, level)
        self._shelf.move_to_end(submap.number)
        if len(self._shelf) > self._kept:
            self._shelf.popitem(last=False)
        return level


def farthest(points: FloatArray) -> float:
    """Return how far the farthest of points (P, 3) is, metres."""
    return math.sqrt(float((points**2).sum(axis=1).max())) if len(points) else 0.0
