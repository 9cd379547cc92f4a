"""Correlative scan matching on any lattice: find the pose at which a scan coincides best with a map.

The score of a pose is the number of distinct lattice points of the rotated, quantised scan that
coincide with occupied lattice points of the map (Ryde and Bruenig, section III). For each angle
the scan is quantised once and then shifted by lattice vectors. All angles and shifts of a window
around the prediction are searched by branch and bound (after Olson, "Real-time correlative scan
matching", 2009), so that the best pose of the window is never lost; then the pose is refined
below a cell.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.errors import ArgumentError, TooLargeError
from hexmap.lattice import Lattice
from hexmap.maps import Map, StateRule
from hexmap.pose import Pose
from hexmap.tiles import HITS, MAX_WINDOW, PASSES, CellCounter
from hexmap.voxels import VoxelList

__all__ = ["CounterOccupancy", "ListOccupancy", "Match", "Occupancy", "ScanMatcher", "SearchWindow"]

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]


class Occupancy(Protocol):
    """What the matcher asks of a map: which cells of a box are occupied."""

    @property
    def lattice(self) -> Lattice:
        """The lattice of the cells."""
        ...

    def occupied(self, low: IntArray, shape: IntArray) -> NDArray[np.bool_]:
        """Return whether each cell is occupied in the box of ``shape`` (n,) cells from the index ``low`` (n,) on."""
        ...


@dataclass(frozen=True, eq=False)
class CounterOccupancy:
    """The occupied cells of a map that is being built, by the rule that finished maps use."""

    counter: CellCounter
    rule: StateRule = field(default_factory=StateRule)

    @property
    def lattice(self) -> Lattice:
        """The lattice of the cells."""
        return self.counter.lattice

    def occupied(self, low: IntArray, shape: IntArray) -> NDArray[np.bool_]:
        """Return whether each cell of the box is occupied."""
        return self.rule.occupied(self.counter.window(low, shape, HITS), self.counter.window(low, shape, PASSES))


@dataclass(frozen=True, eq=False)
class ListOccupancy:
    """The cells of a list."""

    cells: VoxelList

    @classmethod
    def of_map(cls, world: Map, rule: StateRule | None = None, level: int = 0) -> ListOccupancy:
        """Return the occupied cells of a finished map."""
        return cls(world.state(rule, level).occupied)

    @property
    def lattice(self) -> Lattice:
        """The lattice of the cells."""
        return self.cells.lattice

    @cached_property
    def _by_first(self) -> IntArray:
        return self.cells.index[:, 0].astype(np.int64)

    def occupied(self, low: IntArray, shape: IntArray) -> NDArray[np.bool_]:
        """Return whether each cell of the box is in the list."""
        out = np.zeros(tuple(int(s) for s in shape), dtype=bool)
        # The list is sorted by its first index: only the rows of the box are looked at.
        begin, end = np.searchsorted(self._by_first, [low[0], low[0] + shape[0]])
        at = self.cells.index[begin:end].astype(np.int64) - low
        at = at[((at >= 0) & (at < shape)).all(axis=1)]
        out[tuple(at.T)] = True
        return out


@dataclass(frozen=True)
class SearchWindow:
    """Where to look: all poses within ``metres`` and ``radians`` of the prediction."""

    metres: float = 0.5
    radians: float = math.radians(20.0)

    def __post_init__(self) -> None:
        """Check the limits."""
        if not (0.0 <= self.metres < math.inf and 0.0 <= self.radians <= math.pi):
            raise ArgumentError(f"not a search window: {self.metres} m, {self.radians} rad")


@dataclass(frozen=True, eq=False)
class Match:
    """The best pose of a window and what was measured on the way.

    Attributes:
        pose: T_map_scan, refined below a cell.
        score: coincident lattice points of the best pose of the search (before the refinement).
        cells: distinct lattice points of the scan at that angle; ``score / cells`` is the part matched.
        searched: T_map_scan of the best candidate, before the refinement.
        candidates: poses in the window.
        scored: blocks and poses that were scored to find the best.
    """

    pose: Pose
    score: int
    cells: int
    searched: Pose
    candidates: int
    scored: int

    @property
    def part(self) -> float:
        """Part of the scan's cells that coincide with the map, 0 to 1."""
        return self.score / self.cells if self.cells else 0.0


class ScanMatcher:
    """Matches scans against a map on any lattice.

    Examples:
        >>> lattice = Lattice.named("A2", resolution=0.1)
        >>> wall = np.stack([np.linspace(-2, 2, 60), np.full(60, 1.5)], axis=1)
        >>> corner = np.concatenate([wall, wall[:, ::-1]])
        >>> world = ListOccupancy(VoxelList.from_points(corner, lattice))
        >>> true = Pose.planar(0.21, -0.13, 0.1)
        >>> match = ScanMatcher().match(true.inverse().apply(corner), Pose.identity(2), world)
        >>> match.pose.is_close(true, metres=0.05, radians=0.03)
        True
    """

    def __init__(self, window: SearchWindow | None = None, *, refine: bool = True) -> None:
        """Make a matcher that searches ``window`` around each prediction and then refines, unless told not to."""
        self.window = window or SearchWindow()
        self.refine = refine

    def angular_step(self, points: FloatArray, lattice: Lattice) -> float:
        """Return the turn, radians, that moves the farthest point by one resolution (Olson 2009, Eq. 7)."""
        farthest = _farthest(points)
        if farthest <= lattice.resolution:
            return math.pi / 3.0
        return 2.0 * math.asin(0.5 * lattice.resolution / farthest)

    def rotations(self, points: FloatArray, lattice: Lattice, radians: float) -> FloatArray:
        """Return the turns (R, n, n) of the window about the prediction, the identity among them.

        In the plane they are multiples of the angular step; in space rotation vectors on a cubic
        grid of that step, in the ball of ``radians``.
        """
        step = self.angular_step(points, lattice)
        count = math.floor(radians / step + 1e-9)
        turns = (2 * count + 1) ** (1 if lattice.dim == 2 else 3)
        if turns * max(len(points), 1) > MAX_WINDOW:
            raise TooLargeError(
                f"points {_farthest(points):g} m away at resolution {lattice.resolution:g} m need {turns:,} turns "
                f"of {len(points):,} points; take a coarser resolution, a shorter maximum range or a smaller search"
            )
        if lattice.dim == 2:
            angles = np.arange(-count, count + 1) * step
            c, s = np.cos(angles), np.sin(angles)
            return np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1)
        grid = np.array(list(itertools.product(range(-count, count + 1), repeat=3)), dtype=np.float64) * step
        grid = grid[np.sqrt((grid**2).sum(axis=1)) <= radians + 1e-9]
        return np.array([_exponential(v) for v in grid])

    def match(
        self,
        points: ArrayLike,
        predicted: Pose,
        world: Occupancy,
        *,
        fine: Occupancy | None = None,
        window: SearchWindow | None = None,
    ) -> Match | None:
        """Return the best pose of the window around ``predicted`` (T_map_scan), or None if nothing coincides.

        Args:
            points: (P, n) the scan, in the scan's frame, metres.
            predicted: T_map_scan as odometry or the last motion has it.
            world: the occupied cells to search in.
            fine: the occupied cells to refine on, a finer level of the same map; ``world`` if not given.
            window: another window than the matcher's own.

        Equal scores go to the pose nearest to the prediction: the least squared shift plus the
        squared way that the turn moves the farthest point; then to the lower rotation and shift.

        Raises:
            ArgumentError: points, pose and lattice are not of the same dimension.
            BoundsError: a point falls outside the range of indices.
            TooLargeError: scan or window span too many cells or turns.
        """
        lattice = world.lattice
        n = lattice.dim
        p = np.ascontiguousarray(points, dtype=np.float64)
        if p.ndim != 2 or p.shape[1] != n or predicted.dim != n:
            raise ArgumentError(f"the map is of dimension {n}, the scan {p.shape}, the pose of {predicted.dim}")
        if len(p) == 0:
            return None
        if not np.isfinite(p).all():
            lattice.quantise(p)  # raises, naming the row
        window = window or self.window
        turns = self.rotations(p, lattice, window.radians)
        rotations = _product(turns, predicted.rotation)
        found = self._search(p, rotations, turns, predicted, world, window)
        if found is None:
            return None
        searched, score, cells, scored = found
        pose = self._refine(p, searched, lattice, fine or world) if self.refine else searched
        return Match(pose, score, cells, searched, len(turns) * len(shifts_in_ball(lattice, window.metres)), scored)

    def _search(
        self,
        p: FloatArray,
        rotations: FloatArray,
        turns: FloatArray,
        predicted: Pose,
        world: Occupancy,
        window: SearchWindow,
    ) -> tuple[Pose, int, int, int] | None:
        """Score every rotation and shift of the window; return the best pose, its score and cells, and the work."""
        from localisation import _matcher_kernels as kernels

        lattice = world.lattice
        n = lattice.dim
        index = lattice.quantise(_turned(p, rotations, predicted.translation))
        # The index box of a ball of radius m is m times the lengths of the rows of the inverse basis.
        reach = np.ceil(window.metres * np.linalg.norm(np.linalg.inv(lattice.basis), axis=1) - 1e-9).astype(np.int64)
        width = 2 * reach + 1
        # Top blocks of about a quarter of the window: fewer would bound too loosely, more cost more to order.
        top = max(0, min(6, math.ceil(math.log2(float(width.max()))) - 2))
        blocks = -(-width // (1 << top))
        low = index.min(axis=0).astype(np.int64) - reach
        shape = index.max(axis=0).astype(np.int64) - reach + (blocks << top) - low + 1
        strides = _strides(shape)
        size = math.prod(int(s) for s in shape)
        if size > MAX_WINDOW:
            raise TooLargeError(
                f"a scan that spans {size:,} cells at resolution {lattice.resolution:g} m is more than {MAX_WINDOW:,}; "
                "take a coarser resolution, a shorter maximum range or a smaller search"
            )
        cells = world.occupied(low, shape).ravel()
        if not cells.any():
            return None
        grids = np.empty((top + 1, cells.size), np.uint8)
        grids[0] = cells
        for level in range(top):
            kernels.sliding_maximum(grids[level], strides, shape, 1 << level, grids[level + 1])
        stamp = np.full(cells.size, -1, np.int32)
        flat = np.empty(len(index), np.int64)
        ends = np.empty(len(turns), np.int64)
        kernels.distinct_cells(index, len(p), low, strides, stamp, flat, ends)
        best = np.zeros(5, np.int64)
        bounds = np.empty(len(turns) * int(np.prod(blocks)), np.int64)
        scored = kernels.search(
            grids, flat, ends, strides, -reach, blocks, top, lattice.basis, (window.metres * (1.0 + 1e-12)) ** 2,
            (_angles(turns) * _farthest(p)) ** 2, bounds, best,
        )  # fmt: skip
        if best[4] == 0:
            return None
        r = int(best[0])
        shift = lattice.centres(best[None, 1 : 1 + n])[0]
        pose = Pose._trusted(rotations[r].copy(), predicted.translation + shift)
        return pose, int(best[4]), int(ends[r] - (ends[r - 1] if r else 0)), int(scored)

    def _refine(self, p: FloatArray, start: Pose, lattice: Lattice, world: Occupancy) -> Pose:
        """Pull the scan onto the occupied cells around it: expectation maximisation on a sum of Gaussians.

        Each point is drawn to the mean of the occupied cells near it, weighted by a Gaussian of
        their distance. Its width is half a resolution, what quantising leaves unknown: first that
        of the lattice searched on, then that of the finer one.
        """
        from localisation import _matcher_kernels as kernels

        fine = world.lattice
        n = fine.dim
        size = 3 if n == 2 else 6
        last = 0.5 * fine.resolution
        widths = [last] if lattice == fine else [0.5 * lattice.resolution, last]
        margin = math.ceil((2.5 * widths[0] + 2.0 * lattice.resolution) / fine.inradius / 2.0) + 1
        index = fine.quantise(start.apply(p)).astype(np.int64)
        low = index.min(axis=0) - margin
        shape = index.max(axis=0) + margin + 1 - low
        cells = world.occupied(low, shape).ravel()
        strides = _strides(shape)
        hessian, gradient = np.empty((size, size)), np.empty(size)
        pose = start
        for sigma in widths:
            offsets = shifts_in_ball(fine, 2.5 * sigma)
            centres = fine.centres(offsets)
            for _ in range(REFINE_STEPS):
                at = pose.apply(p)
                kernels.refine_terms(
                    at, pose.translation, fine.quantise(at), cells, low, strides, shape, offsets, centres,
                    fine.basis, sigma * sigma, hessian, gradient,
                )  # fmt: skip
                trace = float(np.trace(hessian))
                if trace <= 0.0:
                    return start
                # A little damping keeps directions that the scan says nothing about where they are.
                step = np.linalg.solve(hessian + np.eye(size) * (1e-6 * trace), gradient)
                R = _exponential(np.array(step[n:])) if n == 3 else Pose.planar(0.0, 0.0, float(step[2])).rotation
                pose = Pose._trusted(_product(R, pose.rotation), pose.translation + step[:n])
                if np.abs(step).max() < 0.002 * fine.resolution:
                    break
        # Farther than the search's own resolution there is a better candidate, and the search would have found it.
        moved = float(np.sqrt(((pose.translation - start.translation) ** 2).sum()))
        return pose if moved <= 2.0 * lattice.resolution else start


REFINE_STEPS = 12


def _farthest(points: FloatArray) -> float:
    return math.sqrt(float((points**2).sum(axis=1).max())) if len(points) else 0.0


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the products (..., n, n) of rotations ``a`` (..., n, n) with ``b`` (n, n), entry by entry.

    Written out for the same reason as in :func:`hexmap.arrays.multiply`.
    """
    out = np.zeros(a.shape)
    for i, j, k in itertools.product(range(len(b)), repeat=3):
        out[..., i, j] += a[..., i, k] * b[k, j]
    return out


def _turned(p: FloatArray, rotations: FloatArray, translation: FloatArray) -> FloatArray:
    """Return the points (R * P, n) under each of the rotations (R, n, n), then the translation."""
    n = p.shape[1]
    out = np.empty((len(rotations), len(p), n))
    for i in range(n):
        x = rotations[:, i, 0, None] * p[:, 0]
        for k in range(1, n):
            x += rotations[:, i, k, None] * p[:, k]
        x += translation[i]
        out[:, :, i] = x
    return out.reshape(-1, n)


def _strides(shape: IntArray) -> IntArray:
    """Return the strides, in cells, of a row-major window."""
    strides = np.ones(len(shape), np.int64)
    for k in range(len(shape) - 2, -1, -1):
        strides[k] = strides[k + 1] * shape[k + 1]
    return strides


def _exponential(v: FloatArray) -> FloatArray:
    """Return the rotation matrix of the rotation vector ``v`` (3,) (Rodrigues)."""
    angle = float(np.sqrt((v**2).sum()))
    K = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    if angle < 1e-12:
        return np.asarray(np.eye(3) + K)
    return np.asarray(np.eye(3) + math.sin(angle) / angle * K + (1.0 - math.cos(angle)) / angle**2 * (K @ K))


def _angles(turns: FloatArray) -> FloatArray:
    """Return the angle (R,) of each rotation matrix."""
    trace = np.trace(turns, axis1=1, axis2=2)
    cosine = trace / 2.0 if turns.shape[1] == 2 else (trace - 1.0) / 2.0
    return np.arccos(np.clip(cosine, -1.0, 1.0))


@lru_cache(maxsize=64)
def shifts_in_ball(lattice: Lattice, metres: float) -> IntArray:
    """Return the lattice vectors (K, n) no longer than ``metres``, lexicographically: the shifts of a window."""
    reach = np.ceil(metres * np.linalg.norm(np.linalg.inv(lattice.basis), axis=1)).astype(np.int64)
    grids = np.meshgrid(*[np.arange(-r, r + 1) for r in reach], indexing="ij")
    offsets = np.stack([g.ravel() for g in grids], axis=1)
    offsets = offsets[(lattice.centres(offsets) ** 2).sum(axis=1) <= (metres * (1.0 + 1e-12)) ** 2]
    offsets.setflags(write=False)
    return offsets
