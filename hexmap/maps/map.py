"""Maps: what was hit and what the beams went through, at several resolutions, on one lattice.

No hexagon and no dodecahedron is a union of smaller ones, so every level is quantised from the
points. A map holds counts only; whether a cell is occupied, free or unknown is asked of one rule
(:class:`StateRule`) that pictures, exports, planners and matchers share.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError, LatticeError
from hexmap.base.pictures import drawing, pages, picture_html
from hexmap.base.text import quoted
from hexmap.base.values import Immutable, lossless
from hexmap.lattice.lattice import Lattice
from hexmap.maps.cell_state import CellState
from hexmap.maps.origin import frames_of, logs_in_words, sources_in_frame
from hexmap.maps.state_rule import StateRule, States
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["Level", "Map", "MapDiff"]


@dataclass(frozen=True)
class Level:
    """One resolution of a map: hits and passes on the same lattice."""

    hits: VoxelList
    passes: VoxelList

    def __repr__(self) -> str:
        """Show the sizes and the resolution."""
        return f"<Level of {len(self.hits)} hit and {len(self.passes)} passed cells at {self.lattice.resolution:g} m>"

    @property
    def lattice(self) -> Lattice:
        """The lattice of this level."""
        return self.hits.lattice

    def columns(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Return the keys (M,) of all cells that were hit or passed, and their hits and passes (M,)."""
        # Two sorted runs, which a stable sort only has to merge; np.unique hashes, which is forty times slower here.
        both = np.sort(np.concatenate([self.hits.keys, self.passes.keys]), kind="stable")
        keys = both[np.diff(both, prepend=both[:1] - 1) != 0]
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


class Map(Immutable):
    """A map: levels from fine to coarse, the frame, and where it came from; immutable.

    Attributes:
        levels: the finest first; each level's lattice has twice the resolution of the one before.
        frame: name of the frame the coordinates are in.
        provenance: sorted JSON texts, one for each log that was fused (with command and settings).
    """

    levels: tuple[Level, ...]
    frame: str
    provenance: tuple[str, ...]

    def __init__(self, levels: Iterable[Level], frame: str = "map", provenance: Iterable[str] = ()) -> None:
        """Make a map of its levels.

        Raises:
            ArgumentError: there is no level, or the frame or the provenance is no text.
            LatticeError: the levels are not the same lattice at doubling resolutions.
        """
        object.__setattr__(self, "levels", tuple(levels))
        if not self.levels:
            raise ArgumentError("a map needs at least one level")
        for k, level in enumerate(self.levels):
            if level.passes.lattice != level.lattice:
                raise LatticeError(f"hits and passes of level {k} are on different lattices")
            if not np.allclose(level.lattice.basis, self.levels[0].lattice.basis * 2.0**k, rtol=1e-9, atol=0.0):
                raise LatticeError(f"level {k} is not the lattice of level 0 at {2**k} times its resolution")
        texts = tuple(sorted(set(provenance)))
        if not isinstance(frame, str) or not all(isinstance(text, str) for text in texts):
            raise ArgumentError(f"a map's frame and its provenance are texts, not {frame!r} and {texts!r}")
        object.__setattr__(self, "frame", frame)
        object.__setattr__(self, "provenance", texts)

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

    @overload
    def state_at(  # type: ignore[overload-overlap]
        self, points: Sequence[float], level: int = 0, rule: StateRule | None = None
    ) -> CellState: ...

    @overload
    def state_at(self, points: ArrayLike, level: int = 0, rule: StateRule | None = None) -> NDArray[np.uint8]: ...

    def state_at(
        self, points: ArrayLike, level: int = 0, rule: StateRule | None = None
    ) -> NDArray[np.uint8] | CellState:
        """Return what is at points: occupied, free or unknown, as :meth:`state` has it of their cells.

        Args:
            points: (N, n) metres, in the map's frame; or one point (n,).
            level: which level, 0 is the finest.
            rule: what a cell is, from its hits and passes; the default rule where none is given.

        Returns:
            (N,) uint8 codes of :class:`~hexmap.maps.CellState`, of one point the state itself; unknown (0) wherever
            the map does not reach.

        Raises:
            ArgumentError: not points (N, n) or (n,), or there is no such level.
            BoundsError: a point is not finite.

        Examples:
            >>> from hexmap import CellState, MapBuilder, Pose, Scan
            >>> builder = MapBuilder("A2", resolution=0.1)
            >>> builder.fuse(Scan(stamp=0.0, points=[[2.0, 0.0]]), Pose.identity(2))
            >>> codes = builder.build().state_at([[2.0, 0.0], [1.0, 0.01], [9.0, 9.0]])
            >>> [CellState(code).name for code in codes]
            ['OCCUPIED', 'FREE', 'UNKNOWN']
            >>> builder.build().state_at([2.0, 0.0])
            <CellState.OCCUPIED: 2>
        """
        lattice = self.level(level).lattice
        given = lossless(points)
        one = given is not None and given.shape == (lattice.dim,)
        if given is None or (given.size and not one and (given.ndim != 2 or given.shape[1] != lattice.dim)):
            raise ArgumentError(f"points in this map are real numbers (N, {lattice.dim}), not {quoted(points)}")
        at = given.astype(np.float64).reshape(-1, lattice.dim)
        if not np.isfinite(at).all():
            lattice.quantise(at)  # raises, naming the row
        states = self._known(level, rule or StateRule())
        out = np.full(len(at), CellState.UNKNOWN, np.uint8)
        # What lies beyond the range of indices, or within a cell of its end, is unknown as well.
        inverse = np.linalg.inv(lattice.basis)
        room = lattice.limit - 1.0 - np.abs(lattice.cell.vertices @ inverse.T).max(axis=0)
        near = (np.abs(at @ inverse.T) < room).all(axis=1)
        out[near] = states.of(lattice.quantise(at[near]))
        return CellState(int(out[0])) if one else out

    def _known(self, level: int, rule: StateRule) -> States:
        """Return the states of a level, the last ones asked for without computing them again."""
        last = self.__dict__.get("_last")
        if last is None or last[0] != (level, rule):
            last = (level, rule), self.state(rule, level)
            self.__dict__["_last"] = last
        states: States = last[1]
        return states

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what can be computed again."""
        return {name: value for name, value in self.__dict__.items() if name != "_last"}

    def merge(self, other: Map, *, same_frame: bool = False) -> Map:
        """Return the map of both logs: counts added cell by cell; associative and commutative.

        Frames of different names are different, and so are those whose sources say that they come from
        different logs (see :mod:`hexmap.maps.origin`).

        Args:
            other: the other map.
            same_frame: take the frames for one whatever they say; the result has this one's name.

        Raises:
            LatticeError: the lattices or the numbers of levels differ.
            ArgumentError: the frames differ.
            BoundsError: a count would be more than 2^63 - 1.
        """
        if not same_frame:
            self._check_frame(other)
        if len(self.levels) != len(other.levels):
            raise LatticeError(f"the maps have {len(self.levels)} and {len(other.levels)} levels")
        levels = [
            Level(a.hits.merge(b.hits), a.passes.merge(b.passes))
            for a, b in zip(self.levels, other.levels, strict=True)
        ]
        return Map(levels, self.frame, (*self.provenance, *other.provenance))

    def _check_frame(self, other: Map) -> None:
        if self.frame != other.frame:
            raise ArgumentError(f"the maps are in different frames: {self.frame!r} and {other.frame!r}")
        mine, theirs = frames_of(self.sources()), frames_of(other.sources())
        if mine and theirs and not mine.keys() & theirs.keys():
            logs = [logs_in_words(frames.values()) for frames in (mine, theirs)]
            how = "of " + " and of ".join(logs) if logs[0] != logs[1] else f"both of {logs[0]}, posed in two ways"
            raise ArgumentError(f"the maps are in different frames, {how}")

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
        cells are no longer known. Fuse the log again where that matters. The sources no longer say which
        frame they are in, unless ``pose`` moves nothing.

        Raises:
            ArgumentError: the pose is of another dimension.
            BoundsError: a cell would leave the range of indices.
        """
        if pose.dim != self.lattice.dim:
            raise ArgumentError(f"a map of dimension {self.lattice.dim} is not carried by a pose of {pose.dim}")

        def move(cells: VoxelList) -> VoxelList:
            moved = cells.lattice.quantise(pose.apply(cells.centres()))
            return VoxelList.from_cells(moved, cells.lattice, cells.counts)

        levels = [Level(move(v.hits), move(v.passes)) for v in self.levels]
        still = pose == Pose.identity(pose.dim)
        return Map(levels, frame or self.frame, self.provenance if still else sources_in_frame(self.sources(), ()))

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
            appeared=after.occupied.select(was != CellState.OCCUPIED),
            vanished=before.occupied.select(now == CellState.FREE),
            kept=after.occupied.select(was == CellState.OCCUPIED),
        )

    def bounds(self, level: int = 0) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Return the corners (n,), metres, of the box of all cell centres; None for an empty map."""
        keys, _, _ = self.level(level).columns()
        if len(keys) == 0:
            return None
        centres = VoxelList(self.level(level).lattice, keys, np.ones_like(keys)).centres()
        return centres.min(axis=0), centres.max(axis=0)

    def plot(
        self, ax: Axes | None = None, *, level: int = 0, rule: StateRule | None = None, height: float | None = None
    ) -> Axes:
        """Draw a level on axes of matplotlib, in metres: occupied cells, darker the more hits, free and unknown ones.

        A map in space is seen from above, the highest occupied cell of each column in the colour of its height; or cut
        through. :func:`hexmap.draw_map` writes a finished picture instead.

        Args:
            ax: axes to draw on; new ones where none are given.
            level: which level, 0 is the finest.
            rule: what a cell is, from its hits and passes.
            height: of a horizontal cut through a map in space, metres.

        Returns:
            The axes.

        Raises:
            ArgumentError: no such level; a height that is not finite, or of a map in the plane.

        Examples:
            >>> from hexmap import MapBuilder, Pose, Scan, Trajectory
            >>> builder = MapBuilder("Z2", resolution=0.1)
            >>> builder.fuse(Scan(stamp=0.0, points=[[2.0, 0.0]]), Pose.identity(2))
            >>> axes = builder.build().plot()
            >>> axes = Trajectory.from_poses([0.0], [Pose.identity(2)]).plot(axes)     # on the same axes
        """
        return drawing().plot_map(self, ax, level=level, rule=rule, height=height)

    def page(self, *, pixels: int = 560, **options: Any) -> Any:
        """Return the map as a page to look and plan in, which a notebook shows in a frame.

        Args:
            pixels: height of the frame.
            **options: those of :func:`hexmap.write_page`, which writes the page into a file.

        Raises:
            ArgumentError: an option does not go with this map.
        """
        return pages().page_frame(self, pixels=pixels, **options)

    def _repr_html_(self) -> str:
        """Show a small picture in a notebook."""
        return picture_html(self)

    def __eq__(self, other: object) -> bool:
        """Tell whether two maps are the same, cell by cell, and came from the same logs."""
        if not isinstance(other, Map):
            return NotImplemented
        return self.levels == other.levels and self.frame == other.frame and self.provenance == other.provenance

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        """Show size and lattice."""
        return f"<Map of {len(self.levels[0].hits)} hit cells, {len(self.levels)} levels on {self.lattice!r}>"
