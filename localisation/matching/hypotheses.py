"""All good poses of a scan in a map, not only the best: what a localiser carries on until the robot has seen more.

The best pose is searched for; then the region is searched again outside its neighbourhood, and where that too has
been done it is cut in two between the poses found, each part with one pose of its own to stay away from (Murty's
partition of a set of solutions). So the poses come in the order of their scores, and when none is left the list is
complete.
"""

from __future__ import annotations

import heapq
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError
from hexmap.base.values import one_line
from hexmap.poses.pose import Pose, wrap_angle
from localisation.matching.branch_and_bound import BranchAndBound
from localisation.matching.global_matcher import GlobalMatcher, thin
from localisation.matching.search_region import SearchRegion

__all__ = ["Candidate", "Hypotheses", "find_hypotheses", "is_same_place"]

# A neighbourhood that is cut by the border of two parts can be found again in the other one.
_TRIES = 3
# After so many refused poses, and none that was accepted, the scan is taken to belong elsewhere.
_REFUSED = 2


@dataclass(frozen=True)
class Candidate:
    """A pose T_map_scan and its score."""

    pose: Pose
    score: int


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """The poses of a region that score best.

    Attributes:
        candidates: the best one first, all outside each other's neighbourhood.
        complete: whether no further pose reaches the score that was asked for.
        total: the score if every point met the largest weight.
    """

    candidates: list[Candidate]
    complete: bool
    total: int

    __repr__ = one_line


def is_same_place(a: Pose, b: Pose, apart: tuple[float, float]) -> bool:
    """Tell whether two poses lie within ``apart``: metres between them, and radians."""
    return math.dist(a.translation, b.translation) <= apart[0] and (a.inverse() @ b).angle <= apart[1]


def find_hypotheses(
    matcher: GlobalMatcher,
    points: ArrayLike,
    count: int = 8,
    *,
    least: float = 0.0,
    part: float = 0.9,
    apart: tuple[float, float] = (0.5, math.radians(10.0)),
    accept: Callable[[Pose], bool] | None = None,
    time_limit: float | None = None,
    node_limit: int | None = None,
) -> Hypotheses:
    """Return the best poses of a scan over the whole map and all yaws.

    Args:
        matcher: of the map.
        points: (P, n) the scan in the sensor's frame, metres.
        count: how many poses at the most.
        least: share of the largest score, 0 to 1, below which no pose is looked for.
        part: share of the best score below which no other pose is looked for.
        apart: metres and radians within which two poses are the same.
        accept: tells of a pose whether it is one to return; where the first two are refused nothing is returned.
        time_limit: seconds after which the search stops; what it found until then is not complete.
        node_limit: nodes after which one search stops, at the same node on every run.

    Raises:
        ArgumentError: points are not of the map's dimension.
        BoundsError: a point is not finite or out of range.
    """
    n = matcher.lattice.dim
    p = np.ascontiguousarray(points, dtype=np.float64)
    if p.ndim != 2 or p.shape[1] != n:
        raise ArgumentError(f"the map is of dimension {n}, the scan {p.shape}")
    if len(p) == 0 or matcher.pyramid.most == 0:
        return Hypotheses([], False, 0)
    end = math.inf if time_limit is None else time.monotonic() + time_limit
    kept, weights = thin(p, matcher.lattice)
    total = int(weights.sum()) * matcher.pyramid.most
    floor = max(0, math.ceil(least * total) - 1)
    complete = True
    queue: list[tuple[int, int, Pose, SearchRegion, Pose | None]] = []

    def look(region: SearchRegion, without: Pose | None) -> None:
        nonlocal complete
        away = None if without is None else (without, apart)
        found = BranchAndBound(matcher.space, kept, weights, region, node_limit=node_limit).run(floor, end, away)
        complete = complete and found.finished
        if found.pose is not None:
            heapq.heappush(queue, (-found.score, tries * 2 + len(queue), found.pose, region, without))

    tries = 0
    look(_everywhere(matcher), None)
    chosen: list[Candidate] = []
    while queue and len(chosen) < count and tries < _TRIES * count:
        tries += 1
        score, _, pose, region, without = heapq.heappop(queue)
        if tries == 1:
            floor = max(floor, math.ceil(-score * part) - 1)
        if not any(is_same_place(pose, other.pose, apart) for other in chosen):
            if accept is None or accept(pose):
                chosen.append(Candidate(pose, -score))
            elif not chosen and tries >= _REFUSED:
                return Hypotheses([], False, total)
        if without is None:
            look(region, pose)
        else:
            mine, other = _cut(region, pose, without, apart)
            look(mine, pose)
            look(other, without)
    return Hypotheses(chosen, complete and not queue, total)


def _everywhere(matcher: GlobalMatcher) -> SearchRegion:
    """Return the box in which the sensor may be, as a region with corners."""
    low, high = matcher.space.low, matcher.space.high
    corners = np.array(np.meshgrid(*np.stack([low, high]).T, indexing="ij")).reshape(len(low), -1).T
    centres = matcher.lattice.centres(corners)
    room = matcher.lattice.covering_radius
    return SearchRegion(centres.min(axis=0) - room, centres.max(axis=0) + room)


def _cut(region: SearchRegion, a: Pose, b: Pose, apart: tuple[float, float]) -> tuple[SearchRegion, SearchRegion]:
    """Cut a region in two, with ``a`` in the first and ``b`` in the second part, along what tells them apart best."""
    between: FloatArray = np.asarray(b.translation - a.translation)
    axis = int(np.abs(between).argmax())
    turn = float(wrap_angle(b.theta - a.theta))
    if abs(turn) / max(apart[1], 1e-9) > abs(float(between[axis])) / max(apart[0], 1e-9):
        if region.yaw_range >= math.pi:
            middle = a.theta + 0.5 * turn
            side = math.copysign(0.5 * math.pi, turn)
            return (
                replace(region, yaw=middle - side, yaw_range=0.5 * math.pi),
                replace(region, yaw=middle + side, yaw_range=0.5 * math.pi),
            )
        first, last = region.yaw - region.yaw_range, region.yaw + region.yaw_range
        at_a, at_b = (region.yaw + float(wrap_angle(p.theta - region.yaw)) for p in (a, b))
        middle = 0.5 * (at_a + at_b)
        below = replace(region, yaw=0.5 * (first + middle), yaw_range=max(0.0, 0.5 * (middle - first)))
        above = replace(region, yaw=0.5 * (middle + last), yaw_range=max(0.0, 0.5 * (last - middle)))
        return (below, above) if at_a <= at_b else (above, below)
    middle = float(0.5 * (a.translation[axis] + b.translation[axis]))
    low, high = np.array(region.low, dtype=np.float64), np.array(region.high, dtype=np.float64)
    until, since = high.copy(), low.copy()
    until[axis] = since[axis] = middle
    lower, upper = replace(region, high=until), replace(region, low=since)
    return (lower, upper) if a.translation[axis] <= b.translation[axis] else (upper, lower)
