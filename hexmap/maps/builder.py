"""Fuse scans at known poses into a map."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeAlias

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError
from hexmap.base.text import reason
from hexmap.lattice.convert import LatticeLike, as_lattice
from hexmap.lattice.lattice import Lattice
from hexmap.maps.counter import HITS, PASSES, CellCounter, Rows
from hexmap.maps.map import Level, Map
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan

LevelRows: TypeAlias = Iterator[tuple[int, Rows]]
"""Rows of a map, each with the level that they are of: levels ascend, and in each the keys."""


class MapBuilder:
    """Fuses scans at known poses into a map; the result does not depend on their order.

    Examples:
        >>> import numpy as np
        >>> from hexmap import MapBuilder, Pose, Scan
        >>> builder = MapBuilder("A2", levels=2, resolution=0.1)
        >>> builder.fuse(Scan(stamp=0.0, points=np.array([[2.0, 0.0]])), Pose.planar(0.0, 0.0, 0.0))
        >>> len(builder.build().levels[0].hits)
        1
    """

    def __init__(
        self,
        lattice: LatticeLike,
        levels: int = 3,
        *,
        resolution: float | None = None,
        min_range: float = 0.0,
        max_range: float = float("inf"),
        clear_no_return: float = 0.0,
        spare_hits: bool = False,
    ) -> None:
        """Make an empty builder.

        Args:
            lattice: that of the finest level: a lattice, the name of one, or a basis.
            levels: how many levels, each of twice the resolution of the one before.
            resolution: of the finest level, metres; see :func:`~hexmap.lattice.as_lattice`.
            min_range: points nearer to the sensor than this, metres, are left out (the robot itself).
            max_range: points farther than this, metres, are left out; their beams still clear the
                cells up to this range.
            clear_no_return: metres that a beam without return clears; 0, nothing, because such a
                beam often met a black or slanted surface close by.
            spare_hits: whether no beam of a scan clears a cell that another beam of it hit: see
                :meth:`~hexmap.maps.counter.CellCounter.fuse`.

        Raises:
            ArgumentError: a number is out of its range.
        """
        if not isinstance(levels, (int, np.integer)) or isinstance(levels, bool) or not 1 <= levels <= 16:
            raise ArgumentError(f"a map has 1 to 16 levels, not {levels!r}")
        if not 0.0 <= min_range < max_range:
            raise ArgumentError(f"the ranges must be 0 <= minimum < maximum, not {min_range:g} and {max_range:g}")
        if not 0.0 <= clear_no_return < float("inf"):
            raise ArgumentError(f"beams without return clear 0 metres or more, not {clear_no_return:g}")
        lattice = as_lattice(lattice, resolution)
        self._counters = [CellCounter(lattice.scaled(2.0**k)) for k in range(levels)]
        self._min_range = min_range
        self._max_range = max_range
        self._clear_no_return = clear_no_return
        self._spare_hits = spare_hits
        self._budget = 0
        self._spill: Callable[[LevelRows], None] | None = None
        self.scans = 0

    @property
    def lattice(self) -> Lattice:
        """The lattice of the finest level."""
        return self._counters[0].lattice

    def __repr__(self) -> str:
        """Say how many scans there are, and on what."""
        return f"<MapBuilder of {self.scans} scans, {len(self._counters)} levels on {self.lattice!r}>"

    def counter(self, level: int = 0) -> CellCounter:
        """Return the counts of a level as they are now, for reading."""
        return self._counters[level]

    def fuse(self, scan: Scan, T_map_scan: Pose) -> None:
        """Add a scan: its points as hits, the cells its beams went through as passes.

        Raises:
            ArgumentError: scan, pose and lattice are not all of the same dimension.
            BoundsError: a point falls outside the range of indices; nothing of the scan is added.
        """
        ranges = self._ranges(scan, T_map_scan)
        hit = (ranges >= self._min_range) & (ranges <= self._max_range)
        beyond = ranges > self._max_range
        cleared = scan.points[beyond] * (self._max_range / ranges[beyond])[:, None] if beyond.any() else scan.points[:0]
        if self._clear_no_return > 0.0 and len(scan.no_return):
            reach = min(self._clear_no_return, self._max_range)
            cleared = np.concatenate([cleared, scan.no_return * reach])
        points = scan.points[hit]
        ends = T_map_scan.apply(np.concatenate([points, cleared]) if len(cleared) else points)
        # The finest level first: what is in range there and not too much is so on all levels, and if it is not, nothing
        # has been counted yet.
        for counter in self._counters:
            counter.fuse(T_map_scan.translation, ends, len(points), spare_hits=self._spare_hits)
        self._count_scan()

    def add_hits(self, scan: Scan, T_map_scan: Pose) -> None:
        """Add a scan's points as hits, and say nothing of the cells that its beams went through.

        Raises:
            ArgumentError: scan, pose and lattice are not all of the same dimension.
            BoundsError: a point falls outside the range of indices; nothing of the scan is added.
        """
        ranges = self._ranges(scan, T_map_scan)
        points = T_map_scan.apply(scan.points[(ranges >= self._min_range) & (ranges <= self._max_range)])
        index = [counter.lattice.quantise(points) for counter in self._counters]
        for counter, cells in zip(self._counters, index, strict=True):
            counter.add(cells)
        self._count_scan()

    def _count_scan(self) -> None:
        self.scans += 1
        if self._spill is not None and self.nbytes > self._budget:
            self._spill(self.take_rows())

    def spill(self, spill: Callable[[LevelRows], None], budget: int) -> None:
        """Hand the counts on whenever they take more than a budget, and go on from nothing: counts add.

        What :meth:`counter` and :meth:`build` give is then of the scans since.

        Args:
            spill: is called with all rows, which it must take to the end.
            budget: bytes.
        """
        self._spill, self._budget = spill, budget

    @property
    def nbytes(self) -> int:
        """Bytes of all counts."""
        return sum(counter.nbytes for counter in self._counters)

    def take_rows(self) -> LevelRows:
        """Yield the rows of all levels, and give the memory of each level back when its rows are taken.

        Who followed a counter is told nothing more.
        """
        for counter in self._counters:
            counter.forget_followers()
        for k, counter in enumerate(self._counters):
            for rows in counter.rows():
                yield k, rows
            self._counters[k] = CellCounter(counter.lattice)
            del counter

    def _ranges(self, scan: Scan, T_map_scan: Pose) -> FloatArray:
        """Return how far the points (N,) of a scan are from the sensor, metres, if it can go into the map at all."""
        n = self.lattice.dim
        if scan.dim != n or T_map_scan.dim != n:
            raise ArgumentError(
                f"a scan of dimension {scan.dim} at a pose of {T_map_scan.dim} cannot go into a map of dimension {n}"
            )
        if not np.isfinite(scan.points).all():
            self.lattice.quantise(scan.points)  # raises, naming the row
        return np.asarray(np.sqrt((scan.points**2).sum(axis=1)))

    def empty_map(self, frame: str = "map", source: Mapping[str, Any] | None = None) -> Map:
        """Return the map without a cell: arguments and errors as of :meth:`build`."""
        if not isinstance(frame, str):
            raise ArgumentError(f"the name of a frame is a text, not {frame!r}")
        try:
            provenance = [json.dumps(source, sort_keys=True)] if source is not None else []
        except (TypeError, ValueError) as error:
            raise ArgumentError(f"where the scans came from cannot be written as JSON: {reason(error)}") from error
        nothing = [VoxelList.empty(counter.lattice) for counter in self._counters]
        return Map([Level(cells, cells) for cells in nothing], frame, provenance)

    def build(self, frame: str = "map", source: Mapping[str, Any] | None = None, *, finish: bool = False) -> Map:
        """Return the map of all scans fused so far.

        Args:
            frame: name of the frame of the coordinates.
            source: where the scans came from.
            finish: whether that was all: then the builder is empty afterwards, and its memory is given back level by
                level, so that a large map is not in it twice.

        Raises:
            ArgumentError: the frame is no text, or JSON cannot say where the scans came from.
        """
        empty = self.empty_map(frame, source)
        levels = []
        for k, counter in enumerate(self._counters):
            levels.append(Level(counter.to_list(HITS), counter.to_list(PASSES)))
            if finish:
                self._counters[k] = CellCounter(counter.lattice)
                del counter
        if finish:
            self.scans = 0
        return Map(levels, frame, empty.provenance)
