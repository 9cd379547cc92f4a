"""What scans are matched against: the last stretches as they were fused, and old submaps whose places are known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from localisation.settings import MappingSettings, limit_of
from localisation.slam import planar

__all__ = ["LocalMap"]

# Hits of a cell that an old submap hands on: as many hold against the passes of some dozens of scans.
_MOST_HITS = 4


class LocalMap:
    """A builder of the levels that scans are searched on, made anew where its submaps have moved.

    It has a frame of its own, that of the map when it was made: where a loop moves all that is near alike, it stays.

    Attributes:
        builder: what scans are matched against.
        members: the nodes whose stretches are in it, with the poses (3,) at which they were put there.
        T_map_local: (3,) where its frame lies in the map.
    """

    def __init__(self, settings: MappingSettings) -> None:
        """Make an empty one."""
        self._settings = settings
        self.builder = self._new_builder()
        self.members: dict[int, FloatArray] = {}
        self.T_map_local = np.zeros(3)

    def _new_builder(self) -> MapBuilder:
        settings = self._settings
        return MapBuilder(
            settings.make_lattice(), settings.search_level + 1, min_range=settings.min_range,
            max_range=limit_of(settings.max_range), clear_no_return=settings.clear_no_return,
        )  # fmt: skip

    @property
    def finest(self) -> Lattice:
        """The lattice of the finest level."""
        return self.builder.lattice

    def fuse(self, scan: Scan, T_local_scan: Pose) -> None:
        """Add a scan."""
        self.builder.fuse(scan, T_local_scan)

    def in_map(self, pose: FloatArray) -> FloatArray:
        """Return a pose (3,) of the local frame in the map's frame."""
        return planar.compose(self.T_map_local, pose)

    def in_local(self, pose: FloatArray) -> FloatArray:
        """Return a pose (3,) of the map's frame in the local frame."""
        return planar.between(self.T_map_local, pose)

    def add(self, node: int, pose: FloatArray, points: FloatArray, weights: IntArray) -> None:
        """Add what was seen from a node on: points (P, n) in its frame, and how often each counts."""
        repeated = np.repeat(points, np.minimum(weights, _MOST_HITS), axis=0)
        for level in range(self._settings.search_level + 1):
            counter = self.builder.counter(level)
            counter.add(counter.lattice.quantise(repeated))
        self.members[node] = pose

    def renew(self, scans: Sequence[tuple[Scan, Pose]]) -> None:
        """Begin again in the map's frame with some scans at T_map_scan; the caller adds the submaps."""
        self.builder = self._new_builder()
        self.T_map_local = np.zeros(3)
        self.members = {}
        for scan, pose in scans:
            self.builder.fuse(scan, pose)
