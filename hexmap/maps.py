"""Maps: what was hit and what the beams went through, at several resolutions, on one lattice.

No hexagon and no dodecahedron is a union of smaller ones, so every level is quantised from the
points. A map holds counts only; whether a cell is occupied, free or unknown is asked of one rule
(:class:`StateRule`) that pictures, exports, planners and matchers share.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.errors import ArgumentError, LatticeError
from hexmap.lattice import Lattice
from hexmap.pose import Pose
from hexmap.scan import Scan
from hexmap.tiles import HITS, PASSES, CellCounter
from hexmap.voxels import VoxelList

__all__ = ["FREE", "OCCUPIED", "UNKNOWN", "Level", "Map", "MapBuilder", "MapDiff", "StateRule", "States"]

UNKNOWN, FREE, OCCUPIED = 0, 1, 2


@dataclass(frozen=True)
class StateRule:
    """What a cell is, from its hits and passes.

    Occupied: at least ``min_hits`` hits, and hits make up at least ``min_ratio`` of hits and
    passes. Free: not occupied, and at least ``min_passes`` beams went through. Else unknown. A
    wall seen at a grazing angle is passed by many beams that end in the next cell of the same
    wall, so the ratio that still means a wall is well below a half (Karto's default is a tenth, too).

    Attributes:
        min_hits: hits it takes, at least 1.
        min_ratio: hits / (hits + passes) it takes, 0 to 1.
        min_passes: beams it takes for free, at least 1.
    """

    min_hits: int = 1
    min_ratio: float = 0.1
    min_passes: int = 1

    def __post_init__(self) -> None:
        """Check the limits."""
        if self.min_hits < 1 or self.min_passes < 1 or not 0.0 <= self.min_ratio <= 1.0:
            raise ArgumentError(f"not a rule for the state of a cell: {self}")

    def occupied(self, hits: NDArray[np.int64], passes: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Tell where cells with these counts are occupied."""
        # The quotient, correctly rounded, meets a ratio written as a decimal; the product misses 7 of 25 at 0.28.
        return np.asarray((hits >= self.min_hits) & (hits / np.maximum(hits + passes, 1) >= self.min_ratio))


@dataclass(frozen=True, eq=False)
class States:
    """Which cells are occupied and which are free; all others are unknown.

    Attributes:
        occupied: the occupied cells, with their hits as counts.
        free: the free cells, with their passes as counts.
    """

    occupied: VoxelList
    free: VoxelList

    def of(self, index: ArrayLike) -> NDArray[np.uint8]:
        """Return UNKNOWN (0), FREE (1) or OCCUPIED (2) for each of the indices (K, n)."""
        occupied = self.occupied.contains(index)
        free = self.free.contains(index)
        return np.where(occupied, OCCUPIED, np.where(free, FREE, UNKNOWN)).astype(np.uint8)


@dataclass(frozen=True)
class Level:
    """One resolution of a map: hits and passes on the same lattice."""

    hits: VoxelList
    passes: VoxelList

    @property
    def lattice(self) -> Lattice:
        """The lattice of this level."""
        return self.hits.lattice

    def columns(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Return the keys (M,) of all cells that were hit or passed, and their hits and passes (M,)."""
        keys = np.union1d(self.hits.keys, self.passes.keys)
        hits = np.zeros(len(keys), np.int64)
        passes = np.zeros(len(keys), np.int64)
        hits[np.searchsorted(keys, self.hits.keys)] = self.hits.counts
        passes[np.searchsorted(keys, self.passes.keys)] = self.passes.counts
        return keys, hits, passes


@dataclass(frozen=True)
class MapDiff:
    """What changed between two maps, as lists of cells on the finest level.

    Attributes:
        appeared: occupied in the second map and free or unknown in the first.
        vanished: occupied in the first map and free in the second.
        kept: occupied in both.
    """

    appeared: VoxelList
    vanished: VoxelList
    kept: VoxelList


class Map:
    """A map: levels from fine to coarse, the frame, and where it came from; immutable.

    Attributes:
        levels: the finest first; each level's lattice has twice the resolution of the one before.
        frame: name of the frame the coordinates are in.
        provenance: sorted JSON texts, one for each log that was fused (with command and settings).
    """

    def __init__(self, levels: Iterable[Level], frame: str = "map", provenance: Iterable[str] = ()) -> None:
        """Make a map of its levels.

        Raises:
            ArgumentError: there is no level.
            LatticeError: the levels are not the same lattice at doubling resolutions.
        """
        self.levels = tuple(levels)
        if not self.levels:
            raise ArgumentError("a map needs at least one level")
        for k, level in enumerate(self.levels):
            if level.passes.lattice != level.lattice:
                raise LatticeError(f"hits and passes of level {k} are on different lattices")
            if not np.allclose(level.lattice.basis, self.levels[0].lattice.basis * 2.0**k, rtol=1e-9, atol=0.0):
                raise LatticeError(f"level {k} is not the lattice of level 0 at {2**k} times its resolution")
        self.frame = frame
        self.provenance = tuple(sorted(set(provenance)))

    @property
    def lattice(self) -> Lattice:
        """The lattice of the finest level."""
        return self.levels[0].lattice

    def level(self, k: int) -> Level:
        """Return level ``k``, 0 is the finest.

        Raises:
            ArgumentError: there is no such level.
        """
        if not 0 <= k < len(self.levels):
            raise ArgumentError(f"the map has levels 0 to {len(self.levels) - 1}, not {k}")
        return self.levels[k]

    def sources(self) -> list[dict[str, Any]]:
        """Return where the map came from: one entry for each log, with its settings and versions."""
        found = []
        for text in self.provenance:
            try:
                value = json.loads(text)
            except ValueError:
                value = text
            found.append(value if isinstance(value, dict) else {"note": value})
        return found

    def state(self, rule: StateRule | None = None, level: int = 0) -> States:
        """Return which cells of a level are occupied and which are free, by one rule for all users."""
        rule = rule or StateRule()
        at = self.level(level)
        keys, hits, passes = at.columns()
        occupied = rule.occupied(hits, passes)
        free = ~occupied & (passes >= rule.min_passes)
        return States(
            VoxelList(at.lattice, keys[occupied], hits[occupied]), VoxelList(at.lattice, keys[free], passes[free])
        )

    def merge(self, other: Map) -> Map:
        """Return the map of both logs: counts added cell by cell; associative and commutative.

        Raises:
            LatticeError: the lattices or the numbers of levels differ.
            ArgumentError: the frames differ.
        """
        if self.frame != other.frame:
            raise ArgumentError(f"the maps are in different frames: {self.frame!r} and {other.frame!r}")
        if len(self.levels) != len(other.levels):
            raise LatticeError(f"the maps have {len(self.levels)} and {len(other.levels)} levels")
        levels = [
            Level(a.hits.merge(b.hits), a.passes.merge(b.passes))
            for a, b in zip(self.levels, other.levels, strict=True)
        ]
        return Map(levels, self.frame, (*self.provenance, *other.provenance))

    def crop(self, low: ArrayLike, high: ArrayLike) -> Map:
        """Return the cells whose centre lies in the box from ``low`` to ``high`` (n,), metres, both included."""
        lo, hi = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
        n = self.lattice.dim
        if lo.shape != (n,) or hi.shape != (n,) or not (lo <= hi).all():
            raise ArgumentError(f"a box in dimension {n} takes two corners of {n} numbers, the low one first")

        def cut(cells: VoxelList) -> VoxelList:
            centres = cells.centres()
            return cells.select(np.all((centres >= lo) & (centres <= hi), axis=1))

        return Map([Level(cut(v.hits), cut(v.passes)) for v in self.levels], self.frame, self.provenance)

    def transform(self, pose: Pose, frame: str | None = None) -> Map:
        """Return the map carried by ``pose``: each cell's counts move to the cell nearest to its moved centre.

        All counts are kept; positions move by up to the covering radius, as the points behind the
        cells are no longer known. Fuse the log again where that matters.
        """

        def move(cells: VoxelList) -> VoxelList:
            moved = cells.lattice.quantise(pose.apply(cells.centres()))
            return VoxelList.from_cells(moved, cells.lattice, cells.counts)

        return Map([Level(move(v.hits), move(v.passes)) for v in self.levels], frame or self.frame, self.provenance)

    def diff(self, other: Map, rule: StateRule | None = None) -> MapDiff:
        """Return what changed from this map to ``other`` on the finest level.

        Raises:
            LatticeError: the lattices differ.
        """
        if self.lattice != other.lattice:
            raise LatticeError(f"the maps are on different lattices: {self.lattice!r} and {other.lattice!r}")
        before, after = self.state(rule), other.state(rule)
        was = before.of(after.occupied.index)
        now = after.of(before.occupied.index)
        return MapDiff(
            appeared=after.occupied.select(was != OCCUPIED),
            vanished=before.occupied.select(now == FREE),
            kept=after.occupied.select(was == OCCUPIED),
        )

    def bounds(self, level: int = 0) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Return the corners (n,), metres, of the box of all cell centres; None for an empty map."""
        keys, _, _ = self.level(level).columns()
        if len(keys) == 0:
            return None
        centres = VoxelList(self.level(level).lattice, keys, np.ones_like(keys)).centres()
        return centres.min(axis=0), centres.max(axis=0)

    def __eq__(self, other: object) -> bool:
        """Tell whether two maps are the same, cell by cell, and came from the same logs."""
        if not isinstance(other, Map):
            return NotImplemented
        return self.levels == other.levels and self.frame == other.frame and self.provenance == other.provenance

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        """Show size and lattice."""
        return f"<Map of {len(self.levels[0].hits)} hit cells, {len(self.levels)} levels on {self.lattice!r}>"


class MapBuilder:
    """Fuses scans at known poses into a map; the result does not depend on their order.

    Examples:
        >>> builder = MapBuilder(Lattice.named("A2", resolution=0.1), levels=2)
        >>> builder.fuse(Scan(stamp=0.0, points=np.array([[2.0, 0.0]])), Pose.planar(0.0, 0.0, 0.0))
        >>> len(builder.build().levels[0].hits)
        1
    """

    def __init__(
        self,
        lattice: Lattice,
        levels: int = 3,
        *,
        min_range: float = 0.0,
        max_range: float = float("inf"),
        clear_no_return: float = 0.0,
    ) -> None:
        """Make an empty builder.

        Args:
            lattice: the lattice of the finest level.
            levels: how many levels, each of twice the resolution of the one before.
            min_range: points nearer to the sensor than this, metres, are left out (the robot itself).
            max_range: points farther than this, metres, are left out; their beams still clear the
                cells up to this range.
            clear_no_return: metres that a beam without return clears; 0, nothing, because such a
                beam often met a black or slanted surface close by.

        Raises:
            ArgumentError: a number is out of its range.
        """
        if levels < 1 or levels > 16:
            raise ArgumentError(f"a map has 1 to 16 levels, not {levels}")
        if not 0.0 <= min_range < max_range:
            raise ArgumentError(f"the ranges must be 0 <= minimum < maximum, not {min_range:g} and {max_range:g}")
        if not 0.0 <= clear_no_return < float("inf"):
            raise ArgumentError(f"beams without return clear 0 metres or more, not {clear_no_return:g}")
        self._counters = [CellCounter(lattice.scaled(2.0**k)) for k in range(levels)]
        self._min_range = min_range
        self._max_range = max_range
        self._clear_no_return = clear_no_return
        self.scans = 0

    @property
    def lattice(self) -> Lattice:
        """The lattice of the finest level."""
        return self._counters[0].lattice

    def counter(self, level: int = 0) -> CellCounter:
        """Return the counts of a level as they are now, for reading."""
        return self._counters[level]

    def fuse(self, scan: Scan, T_map_scan: Pose) -> None:
        """Add a scan: its points as hits, the cells its beams went through as passes.

        Raises:
            ArgumentError: scan, pose and lattice are not all of the same dimension.
            BoundsError: a point falls outside the range of indices; nothing of the scan is added.
        """
        n = self.lattice.dim
        if scan.dim != n or T_map_scan.dim != n:
            raise ArgumentError(
                f"a scan of dimension {scan.dim} at a pose of {T_map_scan.dim} cannot go into a map of dimension {n}"
            )
        from hexmap.rays import traverse

        if not np.isfinite(scan.points).all():
            self.lattice.quantise(scan.points)  # raises, naming the row
        ranges = np.sqrt((scan.points**2).sum(axis=1))
        hit = (ranges >= self._min_range) & (ranges <= self._max_range)
        beyond = ranges > self._max_range
        cleared = scan.points[beyond] * (self._max_range / ranges[beyond])[:, None] if beyond.any() else scan.points[:0]
        if self._clear_no_return > 0.0 and len(scan.no_return):
            reach = min(self._clear_no_return, self._max_range)
            cleared = np.concatenate([cleared, scan.no_return * reach])
        ends = T_map_scan.apply(scan.points[hit])
        open_ends = T_map_scan.apply(cleared)
        origin = T_map_scan.translation
        additions = []
        for counter in self._counters:
            lattice = counter.lattice
            through = traverse(lattice, np.broadcast_to(origin, ends.shape), ends).without_ends()
            opened = traverse(lattice, np.broadcast_to(origin, open_ends.shape), open_ends).index
            additions.append((counter, lattice.quantise(ends), through, opened))
        for counter, hits, through, opened in additions:
            counter.add(hits, HITS)
            counter.add(through, PASSES)
            counter.add(opened, PASSES)
        self.scans += 1

    def build(self, frame: str = "map", source: Mapping[str, Any] | None = None) -> Map:
        """Return the map of all scans fused so far; ``source`` says where they came from."""
        levels = [Level(c.to_list(HITS), c.to_list(PASSES)) for c in self._counters]
        provenance = [json.dumps(source, sort_keys=True)] if source is not None else []
        return Map(levels, frame, provenance)


