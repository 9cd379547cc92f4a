"""Correlative scan matching on any lattice: find the pose at which a scan coincides best with a map.

The score of a pose is the number of distinct lattice points of the rotated, quantised scan that
coincide with occupied lattice points of the map (Ryde and Bruenig, section III). For each angle
the scan is quantised once and then shifted by lattice vectors. All angles and shifts of a window
around the prediction are scored (Olson, "Real-time correlative scan matching", 2009), so that the
best pose of the window is never lost; then the pose is refined below a cell.
"""

from __future__ import annotations

import itertools
import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.base.errors import ArgumentError, TooLargeError
from hexmap.lattice.lattice import Lattice
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import exponential, product
from localisation.matching.match import Match
from localisation.matching.occupancy import BOX_SIDE, Occupancy, box_offsets
from localisation.matching.refinement import refine_on
from localisation.matching.search_region import SearchWindow, shifts_in_ball

__all__ = ["LocalMatcher"]

# Points times rotations of one search.
_MOST_POINTS = 1 << 25
_FAR = 1e150  # metres, the square of which is still a number
# Lengths that differ by less than this fraction are the same: on A2 rounding tells equivalent shifts apart by 1e-16.
_SAME_LENGTH = 1e-9


class LocalMatcher:
    """Matches scans against a map on any lattice.

    Examples:
        >>> import numpy as np
        >>> from hexmap import Lattice, Pose, VoxelList
        >>> from localisation.matching import LocalMatcher, Occupancy
        >>> lattice = Lattice.named("A2", resolution=0.1)
        >>> wall = np.stack([np.linspace(-2, 2, 60), np.full(60, 1.5)], axis=1)
        >>> corner = np.concatenate([wall, wall[:, ::-1]])
        >>> world = Occupancy.of_list(VoxelList.from_points(corner, lattice))
        >>> true = Pose.planar(0.21, -0.13, 0.1)
        >>> match = LocalMatcher().match(true.inverse().apply(corner), Pose.identity(2), world)
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
        steps = self._steps(points, lattice, radians)
        if lattice.dim == 3:
            return np.array([exponential(v) for v in steps * step])
        c, s = np.cos(steps[:, 0] * step), np.sin(steps[:, 0] * step)
        return np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1)

    def _steps(self, points: FloatArray, lattice: Lattice, radians: float) -> IntArray:
        """Return the rotations of the window in whole angular steps: (R, 1), or (R, 3) rotation vectors."""
        step = self.angular_step(points, lattice)
        count = math.floor(radians / step + 1e-9)
        turns = (2 * count + 1) ** (1 if lattice.dim == 2 else 3)
        if turns * max(len(points), 1) > _MOST_POINTS:
            raise TooLargeError(
                f"points {_farthest(points):g} m away at resolution {lattice.resolution:g} m need {turns:,} turns "
                f"of {len(points):,} points; take a coarser resolution, a shorter maximum range or a smaller search"
            )
        if lattice.dim == 2:
            return np.arange(-count, count + 1)[:, None]
        grid = np.array(list(itertools.product(range(-count, count + 1), repeat=3)))
        return grid[np.sqrt((grid**2).sum(axis=1)) * step <= radians + 1e-9]

    def match(
        self,
        points: ArrayLike,
        predicted: Pose,
        world: Occupancy,
        *,
        fine: Occupancy | None = None,
        window: SearchWindow | None = None,
        above: int = 0,
    ) -> Match | None:
        """Return the best pose of the window around ``predicted`` (T_map_scan), or None if none scores above.

        Args:
            points: (P, n) the scan, in the scan's frame, metres.
            predicted: T_map_scan as odometry or the last motion has it.
            world: the occupied cells to search in.
            fine: the occupied cells to refine on, a finer level of the same map; ``world`` if not given.
            window: another window than the matcher's own.
            above: only poses that score more than this are of interest; the higher, the faster.

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
        if not np.abs(p).max() < _FAR:
            lattice.quantise(p)  # raises, naming the row
        window = window or self.window
        turns = self.rotations(p, lattice, window.radians)
        found = self._search(p, turns, predicted, world, window, above)
        if found is None:
            return None
        searched, score, cells, blocks = found
        pose, refined = searched, False
        if self.refine:
            refinement = refine_on(fine or world, p, searched, searched=lattice)
            pose, refined = refinement.pose, refinement.converged
        return Match(
            pose=pose, searched=searched, score=score, total=cells, bound=score, refined=refined, nodes=blocks,
            candidates=len(turns) * len(shifts_in_ball(lattice, window.metres)), overlap=score / cells,
        )  # fmt: skip

    def _search(
        self, p: FloatArray, turns: FloatArray, predicted: Pose, world: Occupancy, window: SearchWindow, above: int
    ) -> tuple[Pose, int, int, int] | None:
        """Score every rotation and shift of the window; return the best pose, its score and cells, and the work."""
        from localisation.matching import _kernels as kernels

        lattice = world.lattice
        n = lattice.dim
        rotations = product(turns, predicted.rotation)
        # In whole steps, so that turns to the left and to the right are equally far.
        squared = (self._steps(p, lattice, window.radians) ** 2).sum(axis=1)
        costs = squared * (self.angular_step(p, lattice) * _farthest(p)) ** 2
        order = np.argsort(squared, kind="stable")
        best = np.zeros(6, np.int64)
        taken = kernels.search(
            world.tiles, world.bounds, world.log_step, p, predicted.translation, kernels.Turns(rotations, costs, order),
            _blocks(lattice, window.metres), lattice.quantiser_tables, above, best,
        )  # fmt: skip
        if best[4] < 0:
            for R in rotations:
                lattice.quantise(Pose._trusted(R.copy(), predicted.translation).apply(p))  # raises, naming the row
        r = int(best[0])
        if best[4] <= 0:
            return None
        shift = lattice.centres(best[None, 1 : 1 + n])[0]
        pose = Pose._trusted(rotations[r].copy(), predicted.translation + shift)
        return pose, int(best[4]), int(best[5]), int(taken)


@lru_cache(maxsize=64)
def _blocks(lattice: Lattice, metres: float) -> Any:
    """Return the shifts of a window in blocks of 64, and these in groups of 64."""
    from localisation.matching import _kernels as kernels

    side = BOX_SIDE[lattice.dim]
    shifts = shifts_in_ball(lattice, metres)
    squared = (lattice.centres(shifts) ** 2).sum(axis=1)
    # Lengths that differ by rounding alone become one number, so that the search compares them exactly.
    ascending = np.argsort(squared, kind="stable")
    lengths = squared[ascending]
    new = np.ones(len(lengths), np.bool_)
    new[1:] = np.diff(lengths) > _SAME_LENGTH * lengths[1:]
    squared[ascending] = lengths[np.maximum.accumulate(np.where(new, np.arange(len(lengths)), 0))]
    low = shifts.min(axis=0)
    block = (shifts - low) // side
    bit = np.ravel_multi_index(tuple(((shifts - low) % side).T), (side,) * lattice.dim)
    which, number = np.unique(block, axis=0, return_inverse=True)
    number = number.ravel()
    masks = np.zeros(len(which), np.uint64)
    np.bitwise_or.at(masks, number, np.uint64(1) << bit.astype(np.uint64))
    costs = np.full((len(which), len(box_offsets(lattice.dim))), np.inf)
    costs[number, bit] = squared
    # Groups of blocks that lie in a larger box of as many blocks as a block has shifts.
    groups, group = np.unique(which // side, axis=0, return_inverse=True)
    members = np.full((len(groups), costs.shape[1]), -1)
    members[group.ravel(), np.ravel_multi_index(tuple((which % side).T), (side,) * lattice.dim)] = np.arange(len(which))
    lows, wide_lows = np.ascontiguousarray(low + which * side), np.ascontiguousarray(low + groups * side * side)
    return kernels.ShiftBlocks(lows, wide_lows, members, masks, costs)


def _farthest(points: FloatArray) -> float:
    return math.sqrt(float((points**2).sum(axis=1).max())) if len(points) else 0.0
