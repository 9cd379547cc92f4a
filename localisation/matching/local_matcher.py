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

import numpy as np
from numpy.typing import ArrayLike

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError, TooLargeError
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.window import strides
from hexmap.maps.counter import MAX_WINDOW
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import angles, exponential, product
from localisation.matching.match import Match
from localisation.matching.occupancy import Occupancy
from localisation.matching.refinement import refine
from localisation.matching.search_region import SearchWindow, shifts_in_ball

__all__ = ["ScanMatcher"]


class ScanMatcher:
    """Matches scans against a map on any lattice.

    Examples:
        >>> import numpy as np
        >>> from hexmap import Lattice, Pose, VoxelList
        >>> from localisation.matching import ListOccupancy, ScanMatcher
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
        return np.array([exponential(v) for v in grid])

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
        rotations = product(turns, predicted.rotation)
        found = self._search(p, rotations, turns, predicted, world, window)
        if found is None:
            return None
        searched, score, cells, scored = found
        pose = refine(p, searched, lattice, fine or world) if self.refine else searched
        return Match(
            pose=pose, searched=searched, score=score, total=cells, bound=score, nodes=scored,
            candidates=len(turns) * len(shifts_in_ball(lattice, window.metres)), overlap=score / cells,
        )  # fmt: skip

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
        from localisation.matching import _kernels as kernels

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
        steps = strides(shape)
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
            kernels.sliding_maximum(grids[level], steps, shape, 1 << level, grids[level + 1])
        stamp = np.full(cells.size, -1, np.int32)
        flat = np.empty(len(index), np.int64)
        ends = np.empty(len(turns), np.int64)
        kernels.distinct_cells(index, len(p), low, steps, stamp, flat, ends)
        best = np.zeros(5, np.int64)
        bounds = np.empty(len(turns) * int(np.prod(blocks)), np.int64)
        scored = kernels.search(
            grids, flat, ends, steps, -reach, blocks, top, lattice.basis, (window.metres * (1.0 + 1e-12)) ** 2,
            (angles(turns) * _farthest(p)) ** 2, bounds, best,
        )  # fmt: skip
        if best[4] == 0:
            return None
        r = int(best[0])
        shift = lattice.centres(best[None, 1 : 1 + n])[0]
        pose = Pose._trusted(rotations[r].copy(), predicted.translation + shift)
        return pose, int(best[4]), int(ends[r] - (ends[r - 1] if r else 0)), int(scored)


def _farthest(points: FloatArray) -> float:
    return math.sqrt(float((points**2).sum(axis=1).max())) if len(points) else 0.0


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


