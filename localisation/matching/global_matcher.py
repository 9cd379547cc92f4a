"""Find a scan anywhere in a map, and prove that nothing better is there.

The score of a pose is the sum of the weights of the map's cells that the scan's points fall into: with weights of one
the number of coincident lattice points (Ryde and Bruenig, section III), counted once a point. Branch and bound over
intervals of angles and boxes of shifts finds the largest, over all real angles or over a stated set of them.

What is proved, and what is not. Shifts are lattice vectors, so that translations are searched at the spacing of the
cells; the refinement goes below it. The yaw is a continuum: the largest score on any open interval between the angles
at which a point lies on the face of a cell (nearer than float64 tells, those angles belong to no cell and are left
out). In space the tilts are a grid on which neighbours move the median point of the scan by no more than a cell.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.base.errors import ArgumentError
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.window import IndexBox
from hexmap.maps.map import Map
from hexmap.maps.state_rule import StateRule
from hexmap.maps.voxel_list import VoxelList
from localisation.matching.beams import contradicted_share
from localisation.matching.branch_and_bound import BranchAndBound, Found
from localisation.matching.information import score_covariance
from localisation.matching.match import Match, RunnerUp
from localisation.matching.occupancy import Occupancy
from localisation.matching.pyramid import OccupancyPyramid
from localisation.matching.refinement import refine_on
from localisation.matching.score import coincidence
from localisation.matching.search_region import SearchRegion
from localisation.matching.search_space import Scratch, SearchSpace

__all__ = ["SPREAD_IN_SPACE", "GlobalMatcher", "match_anywhere", "refined_finely", "spread_points", "thin"]

SPREAD_IN_SPACE = 400
"""Points of a LiDAR's scan that are searched with."""
# And those with which the pose is refined on the finest level.
_REFINED_IN_SPACE = 4000


def thin(points: FloatArray, lattice: Lattice) -> tuple[FloatArray, IntArray]:
    """Return one point for all that fall into one cell in the sensor's frame, their mean, and how many they are.

    Returns:
        Points (P, n) in the order of the cells' indices, and weights (P,).
    """
    index = lattice.quantise(points)
    order = np.lexsort(index.T[::-1])
    ordered = index[order]
    new = np.ones(len(order), bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    starts = np.flatnonzero(new)
    weights = np.diff(np.append(starts, len(order)))
    return np.add.reduceat(points[order], starts, axis=0) / weights[:, None], weights


def spread_points(points: FloatArray, lattice: Lattice, most: int) -> FloatArray:
    """Return at most ``most`` points of a scan, spread evenly over what it sees.

    Of each cell of a coarser lattice, as fine as that allows, it is the thinned point nearest to the mean of all: so it
    lies on the surface that was seen.
    """
    kept = fine = thin(points, lattice)[0]
    size = 1.0
    while len(kept) > most:
        size *= math.sqrt(2.0)
        index = lattice.scaled(size).quantise(fine)
        cells, cell = np.unique(index, axis=0, return_inverse=True)
        cell = cell.ravel()
        if len(cells) > most and len(cells) > 1:
            continue
        count = np.bincount(cell)
        means = np.stack([np.bincount(cell, axis) / count for axis in fine.T], axis=1)
        off = ((fine - means[cell]) ** 2).sum(axis=1)
        order = np.lexsort((np.arange(len(fine)), off, cell))
        kept = fine[order[np.searchsorted(cell[order], np.arange(len(cells)))]]
    return kept


class GlobalMatcher:
    """Finds scans in one map, on any lattice, in the plane and in space; may be shared by threads.

    Args:
        pyramid: the weights of the map's cells.
        known: the cells in which the sensor may be, or the box of all of them; None: anywhere in the box around the
            weights.
        scratch: memory to work in, which matchers of other maps may share.

    Attributes:
        space: both, as the search sees them.

    Examples:
        >>> import numpy as np
        >>> from hexmap import Lattice, Pose, VoxelList
        >>> from localisation.matching import GlobalMatcher, OccupancyPyramid, coincidence
        >>> wall = np.stack([np.linspace(-2, 2, 81), np.full(81, 1.5)], axis=1)
        >>> room = np.concatenate([wall, wall[:50] * [1, -1], wall[:, ::-1], [[0.5, 0.2], [0.55, 0.2], [-1.0, 0.7]]])
        >>> cells = VoxelList.from_points(room, Lattice.named("A2", resolution=0.05))
        >>> matcher = GlobalMatcher(OccupancyPyramid(coincidence(cells)))
        >>> true = Pose.planar(0.21, -0.13, 2.5)
        >>> match = matcher.match(true.inverse().apply(room))
        >>> match.gap, match.certified, match.pose.is_close(true, metres=0.05, radians=0.03)
        (0, True, True)
    """

    def __init__(
        self,
        pyramid: OccupancyPyramid,
        known: VoxelList | IndexBox | None = None,
        scratch: Scratch | None = None,
    ) -> None:
        """Prepare the tables of the lattice and of the cells in which the sensor may be."""
        self.pyramid = pyramid
        self.lattice = pyramid.lattice
        self.space = SearchSpace(pyramid, known, scratch)

    def __repr__(self) -> str:
        """Show what is searched."""
        return f"<GlobalMatcher in {self.pyramid!r}>"

    @classmethod
    def of_map(
        cls, map: Map, rule: StateRule | None = None, level: int = 0, *, anywhere: bool = False
    ) -> GlobalMatcher:
        """Return a matcher on the occupied cells of a level of a map, for a sensor in its known cells.

        Args:
            map: the map.
            rule: what an occupied cell is.
            level: of the map.
            anywhere: whether the sensor may also be where the map knows nothing.
        """
        states = map.state(rule, level)
        known = None if anywhere else states.occupied.merge(states.free)
        return cls(OccupancyPyramid(coincidence(states.occupied)), known)

    def match(
        self,
        points: ArrayLike,
        region: SearchRegion | None = None,
        *,
        angles: str | float = "continuous",
        apart: tuple[float, float] = (0.5, math.radians(10.0)),
        runner_up: float | None = 0.9,
        least: float = 0.0,
        most_points: int | None = None,
        refine: bool = True,
        beams: bool = True,
        information: bool = True,
        time_limit: float | None = None,
        node_limit: int | None = None,
    ) -> Match | None:
        """Return the best pose of a region, or None where nothing coincides.

        Args:
            points: (P, n) the scan in the sensor's frame, metres. Points of one cell are taken as one (see
                :func:`thin`).
            region: where to look; None: the whole map and all yaws.
            angles: "continuous", or a step in radians: then the yaws are its multiples, from ``region.yaw`` on.
            apart: metres and radians within which a pose is the same as the best.
            runner_up: down to which part of the best score other poses are looked for; None: not at all.
            least: share of the largest possible score, 0 to 1, below which no best pose is looked for: what is hopeless
                is found to be so soonest.
            most_points: at most so many points, spread evenly, are searched with, and score and proof are of these;
                None: of all. Of a LiDAR's scan some hundred tell as much as all of its thousands.
            refine: whether the pose is refined below a cell, with all points.
            beams: whether the beams that end beyond a wall are counted.
            information: whether the surface of scores around the best pose is turned into an information matrix.
            time_limit: seconds after which the search stops; what it found until then is not certified.
            node_limit: nodes after which it stops: at the same node on every run and machine.

        Raises:
            ArgumentError: points or region are not of the map's dimension, or a number is out of its range.
            BoundsError: a point is not finite or out of range.
            TooLargeError: the region has too many blocks and angles for a search.
        """
        lattice = self.lattice
        n = lattice.dim
        p = np.ascontiguousarray(points, dtype=np.float64)
        if p.ndim != 2 or p.shape[1] != n:
            raise ArgumentError(f"the map is of dimension {n}, the scan {p.shape}")
        region = region or SearchRegion()
        _check(n, region, angles, apart, runner_up)
        if not 0.0 <= least <= 1.0:
            raise ArgumentError(f"a pose is looked for from a share of 0 to 1 of the largest score on, not {least}")
        if most_points is not None and most_points < 1:
            raise ArgumentError(f"a search takes at least one point, not {most_points}")
        if len(p) == 0 or self.pyramid.most == 0:
            return None
        end = math.inf if time_limit is None else time.monotonic() + time_limit
        kept, weights = thin(p if most_points is None else spread_points(p, lattice, most_points), lattice)
        step = None if angles == "continuous" else float(angles)
        search = BranchAndBound(self.space, kept, weights, region, step, node_limit)
        total = int(weights.sum()) * self.pyramid.most
        begin = max(0, math.ceil(least * total) - 1)
        best = search.run(begin, end)
        if best.pose is None:
            return None
        second: Found | None = None
        floor = 0
        if runner_up is not None and best.finished:
            floor = min(best.score, math.floor(runner_up * best.score))
            second = search.run(floor, end, (best.pose, apart))
        pose, refined = best.pose, False
        if refine:
            result = refine_on(self.pyramid.occupancy, p, best.pose)
            pose, refined = result.pose, result.converged
        index = lattice.quantise(best.pose.apply(kept))
        met = self.pyramid.weights(index) > 0
        covariance = None
        if information:
            covariance = score_covariance(self.pyramid, kept, weights, best.pose, refined=refined)
        return Match(
            pose=pose,
            searched=best.pose,
            score=best.score,
            total=total,
            bound=best.bound,
            certified=best.finished,
            refined=refined,
            nodes=best.nodes + (second.nodes if second else 0),
            candidates=search.candidates,
            runner_up=RunnerUp(second.pose, second.score) if second and second.pose else None,
            runner_up_bound=max(second.bound, floor) if second else None,
            apart=apart if second else None,
            overlap=float(weights[met].sum() / weights.sum()),
            contradicted=contradicted_share(self.pyramid, p, pose) if beams else None,
            information=None if covariance is None else np.asarray(np.linalg.inv(covariance), np.float64),
        )


def _check(
    n: int, region: SearchRegion, angles: str | float, apart: tuple[float, float], runner_up: float | None
) -> None:
    """Check what a match is asked for in a map of dimension ``n``.

    Raises:
        ArgumentError: a value is out of its range.
    """
    if region.tilt > 0.0 and n == 2:
        raise ArgumentError("a scan of the plane cannot be tilted")
    if not (apart[0] >= 0.0 and apart[1] >= 0.0):
        raise ArgumentError(f"a neighbourhood takes metres and radians of 0 or more, not {apart}")
    if runner_up is not None and not 0.0 <= runner_up <= 1.0:
        raise ArgumentError(f"other poses are looked for down to a share of 0 to 1 of the best score, not {runner_up}")
    if angles != "continuous" and not (isinstance(angles, (int, float)) and 0.0 < angles <= math.pi):
        raise ArgumentError(f"angles are 'continuous' or a step in radians, not {angles!r}")


def match_anywhere(map: Map, points: ArrayLike, **how: Any) -> Match | None:
    """Find a scan in a map without knowing anything of where it is.

    For many scans of one map make a :class:`GlobalMatcher` once. In space the coarsest level of the map is searched,
    with some hundred points spread over the scan, and the pose refined on the finest one: all of a LiDAR's thousands of
    points would take minutes to tell the same.

    Args:
        map: the map.
        points: (P, n) the scan in the sensor's frame, metres.
        **how: what :meth:`GlobalMatcher.match` takes.

    Returns:
        The best pose of the sensor, T_map_scan, and what is known of it; None where nothing coincides. In space score,
        bound and shares are of the points and the level that were searched.
    """
    if map.lattice.dim == 2:
        return GlobalMatcher.of_map(map).match(points, **how)
    level = len(map.levels) - 1
    how.setdefault("most_points", SPREAD_IN_SPACE)
    match = GlobalMatcher.of_map(map, level=level).match(points, **how)
    if match is None or level == 0 or not how.get("refine", True):
        return match
    return refined_finely(match, np.ascontiguousarray(points, np.float64), Occupancy.of_map(map),
                          map.levels[level].lattice)  # fmt: skip


def refined_finely(match: Match, points: FloatArray, fine: Occupancy, searched: Lattice) -> Match:
    """Return a match of space with its pose refined on a finer level than the one it was searched on.

    Args:
        match: as it was found.
        points: (P, 3) the scan in the sensor's frame, metres; some thousand of them are taken.
        fine: the occupied cells of the finer level.
        searched: the lattice of the level that was searched.
    """
    p = spread_points(points, fine.lattice, _REFINED_IN_SPACE)
    refined = refine_on(fine, p, match.pose, searched=searched)
    return replace(match, pose=refined.pose, refined=True) if refined.converged else match
