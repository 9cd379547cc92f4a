"""The shortest path of a point through a map of square cells: the baseline that any-angle planners are compared with.

The free space is the union of the closed free cells; blocked cells, and all outside the map, are
open obstacles. A path may therefore

* touch the corners of blocked cells, and run along a wall (an edge between a free and a blocked cell),
* not run along an edge between two blocked cells, and
* not cross a double corner, the point where two free cells meet diagonally between two blocked ones:
  it may reach that point from one of the free cells, but must leave into the same one.

This is the closure of the interior of the free space, so two cells are connected just when steps over
edges connect them, as for planners that cut no corners. A start or goal that is itself a double
corner belongs to both its free cells.

Such a path is a polyline that turns only at convex corners of obstacles, towards the obstacle: the
graph of these corners with the legs that are taut at both ends holds it (Oh and Leong 2017, "Edge
N-Level Sparse Visibility Graphs"). It is made once for a map, by an exact scan of each corner's field
of view, row by row; A* runs over it with the straight-line distance, turning only where taut.

Decisions are signs of cross products without a rounding error for corners, cell centres and all
coordinates of at most 14 binary digits behind the point (up to 4096 cells); for other starts and goals they are
right to about 1e-12 cells, and so is the length.
"""

from __future__ import annotations

import math
import os
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError, BoundsError
from planners.path import NoPath, not_connected

if TYPE_CHECKING:
    from planners.any_angle._optimum_kernels import PlaneMap, View

__all__ = ["AnyAngleOptimum", "OptimalPath"]

_MOST_CELLS = 2**30
_SHIFT = 1.5  # a blocked ring round the map, and the half cell from a centre to a corner
_CHUNK = 4096  # corners linked by a thread at a time


@dataclass(frozen=True, eq=False)
class OptimalPath:
    """A shortest path of a point.

    Attributes:
        length: in cells.
        points: (M, 2) float64 start, turning points (corners of cells) and goal, in cells; one
            point where start and goal are the same.
        expansions: corners whose legs were tried, the start included.
        pushes: entries made in the queue.
        seconds: time of the search, without preparing the map.
    """

    length: float
    points: NDArray[np.float64]
    expansions: int = 0
    pushes: int = 0
    seconds: float = 0.0

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.points)

    def __repr__(self) -> str:
        """Say how long it is."""
        return f"OptimalPath({len(self)} points, {self.length:.6g} cells)"


class AnyAngleOptimum:
    """Shortest paths of a point through a map of square cells, after preparing the map once.

    Attributes:
        free: (nx, ny) bool, the map.
        corners: number of convex corners of obstacles.
        legs: number of directed taut legs between them.
        nbytes: memory of the prepared map.

    Examples:
        >>> import numpy as np
        >>> from planners import AnyAngleOptimum
        >>> free = np.ones((3, 3), bool)
        >>> free[1, 0:2] = False
        >>> AnyAngleOptimum(free).path([0, 0], [2, 0]).points.tolist()
        [[0.0, 0.0], [0.5, 1.5], [1.5, 1.5], [2.0, 0.0]]
    """

    def __init__(self, free: ArrayLike) -> None:
        """Prepare a map.

        Args:
            free: (nx, ny) bool; cell (i, j) spans i - 0.5..i + 0.5 and j - 0.5..j + 0.5.

        Raises:
            ArgumentError: not a map of truth values with at least one cell, or too large.
        """
        array = np.asarray(free)
        if array.ndim != 2 or array.dtype != np.bool_ or array.size == 0:
            raise ArgumentError(f"a map must be bool (nx, ny), not {array.dtype} {array.shape}")
        if array.size > _MOST_CELLS:
            raise ArgumentError(f"a map may have {_MOST_CELLS:,} cells, not {array.size:,}")
        from scipy.ndimage import label

        from planners.any_angle import _optimum_kernels as kernels

        self.free = array.copy()
        self.free.flags.writeable = False
        padded = np.zeros((array.shape[1] + 2, array.shape[0] + 2), np.uint8)
        padded[1:-1, 1:-1] = array.T
        self._labels: NDArray[np.int32] = label(padded)[0].astype(np.int32)
        self._map: PlaneMap = kernels.tables(padded)
        corners = self._map.corners
        # The parts of the view that wait to be looked at lie in different pairs of touching runs.
        low = self._map.low
        self._waiting = 2 * int((padded & (low == np.arange(low.shape[1]))).sum()) + 8

        def link(begin: int) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
            return kernels.link(self._map, begin, min(begin + _CHUNK, len(corners)), self._view())

        with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:
            chunks = list(pool.map(link, range(0, len(corners), _CHUNK)))
        base = np.cumsum([0] + [len(near) for _, near in chunks])
        ends = np.concatenate([np.empty((0, 2), np.int64)] + [e + b for (e, _), b in zip(chunks, base, strict=False)])
        near = np.concatenate([np.empty(0, np.int32)] + [near for _, near in chunks])
        self._legs = kernels.Legs(ends, near, kernels.find_endless(corners, ends, near))

    @property
    def corners(self) -> int:
        """Number of convex corners of obstacles."""
        return len(self._map.corners)

    @property
    def legs(self) -> int:
        """Number of directed taut legs between corners."""
        return len(self._legs.near)

    @property
    def nbytes(self) -> int:
        """Memory of the prepared map in bytes."""
        return sum(a.nbytes for a in (*self._map, self._labels, *self._legs, self.free))

    def __repr__(self) -> str:
        """Say how large it is."""
        return f"AnyAngleOptimum({self.free.shape[0]} x {self.free.shape[1]} cells, {self.corners} corners)"

    def _view(self) -> View:
        """Return scratch for a look around: each thread and each search has its own."""
        from planners.any_angle import _optimum_kernels as kernels

        return kernels.View(
            np.empty((self._waiting, 4)), np.empty((self._waiting, 2), np.int32), np.empty(self.corners, np.int32)
        )

    def _point(self, point: ArrayLike, role: str) -> tuple[NDArray[np.float64], tuple[float, float], set[int]]:
        """Return a point (2,), it in the kernels' coordinates, and the components that it touches."""
        p = np.asarray(point, dtype=np.float64)
        if p.shape != (2,):
            raise ArgumentError(f"a {role} must be a point (2,), not {p.shape}")
        if not np.isfinite(p).all():
            raise BoundsError(f"a {role} must be finite, not {tuple(p.tolist())}")
        if (p < -0.5).any() or (p > np.array(self.free.shape) - 0.5).any():
            raise NoPath(f"{role} outside the map", f"point {tuple(p.tolist())}")
        x, y = inner = _inner(p)
        columns = {math.floor(x), math.ceil(x) - 1}
        rows = {math.floor(y), math.ceil(y) - 1}
        touched = {int(self._labels[j, i]) for j in rows for i in columns} - {0}
        if not touched:
            raise NoPath(f"{role} blocked", f"point {tuple(p.tolist())}")
        return p, inner, touched

    def path(self, start: ArrayLike, goal: ArrayLike) -> OptimalPath:
        """Return a shortest path between two points (2,), in cells; cell centres are integers.

        Raises:
            NoPath: an end lies in no closed free cell or outside the map, or nothing connects them.
            ArgumentError: not one point.
            BoundsError: a coordinate is not finite.
        """
        from planners.any_angle import _optimum_kernels as kernels

        s, inner_s, at_start = self._point(start, "start")
        t, inner_t, at_goal = self._point(goal, "goal")
        same = bool((s == t).all())
        if not at_start & at_goal and not same:
            raise not_connected(s, t)
        begin = time.perf_counter()
        if same:
            return OptimalPath(0.0, s[None].copy(), seconds=time.perf_counter() - begin)
        n = self.corners
        view = self._view()
        labels = kernels.Labels(
            np.full(n, np.inf), np.full(n, np.inf), np.full(n, -1, np.int32),
            np.zeros((n, 2), np.uint8), np.empty(2 * n, np.int32),
        )  # fmt: skip
        count, expansions, pushes = kernels.search(self._map, self._legs, *inner_s, *inner_t, view, labels)
        if count < 0:  # pragma: no cover - the components say otherwise
            raise not_connected(s, t)
        points = np.vstack([s, self._map.corners[view.seen[:count][::-1], :2] - _SHIFT, t])
        # A start or goal at a corner may be named twice.
        points = points[np.append(True, (np.diff(points, axis=0) != 0.0).any(axis=1))]
        length = math.fsum(np.hypot(*np.diff(points, axis=0).T).tolist())
        return OptimalPath(length, points, int(expansions), int(pushes), time.perf_counter() - begin)

    def lengths(self, starts: ArrayLike, goals: ArrayLike, workers: int = 1) -> NDArray[np.float64]:
        """Return the lengths (Q,) of shortest paths between ``starts`` (Q, 2) and ``goals`` (Q, 2), nan where is none.

        The result is the same for any number of ``workers`` (threads).

        Raises:
            ArgumentError: shapes that do not fit, or no worker.
            BoundsError: a coordinate is not finite.
        """
        a, b = np.asarray(starts, dtype=np.float64), np.asarray(goals, dtype=np.float64)
        if a.shape != b.shape or a.ndim != 2 or a.shape[1] != 2:
            raise ArgumentError(f"queries need starts and goals of the same shape (Q, 2), not {a.shape} and {b.shape}")
        if workers < 1:
            raise ArgumentError(f"queries need at least one worker, not {workers}")

        def one(query: int) -> float:
            try:
                return self.path(a[query], b[query]).length
            except NoPath:
                return math.nan

        if workers == 1 or len(a) < 2:
            return np.array([one(q) for q in range(len(a))], dtype=np.float64)
        first = one(0)
        with ThreadPoolExecutor(max_workers=workers) as pool:
            return np.array([first, *pool.map(one, range(1, len(a)))], dtype=np.float64)


def _inner(point: NDArray[np.float64]) -> tuple[float, float]:
    """Return a point in the kernels' coordinates, on the same side of every edge in spite of rounding."""
    moved = point + _SHIFT
    back = moved - _SHIFT
    off = (moved == np.floor(moved)) & (back != point)
    x, y = np.where(off, np.nextafter(moved, np.where(point > back, np.inf, -np.inf)), moved).tolist()
    return x, y
