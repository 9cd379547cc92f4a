"""Find one map in another, or say why it cannot be found beyond doubt.

The occupied cells of the second map are matched as one large scan, over all yaws and wherever any part of it meets the
first: the certified search of :class:`~localisation.matching.global_matcher.GlobalMatcher` on coarse cells, then
refined on the finest level. A map that was never there has a best pose, too, so that a pose must pass tests before it
counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import AlignmentError, ArgumentError
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.window import box_coordinates
from hexmap.maps.map import Map
from hexmap.maps.origin import frames_of, sources_in_frame
from hexmap.maps.state_rule import StateRule, States
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from localisation.matching.global_matcher import GlobalMatcher, thin
from localisation.matching.match import Match
from localisation.matching.pyramid import OccupancyPyramid
from localisation.matching.score import coincidence
from localisation.matching.search_region import SearchRegion, shifts_in_ball

__all__ = [
    "AlignSettings", "Alignment", "align_maps", "check_agreement", "merge_aligned", "moved_into", "pose_words",
]  # fmt: skip

_COARSEST = 64.0  # times the cells of the finest level


@dataclass(frozen=True)
class AlignSettings:
    """How maps are aligned, and what an alignment must pass.

    Attributes:
        most_cells: the whole of the maps is searched on the finest cells that leave neither of them more than so many,
            at least twice as large as those of the finest level: maps of one place that were built apart bend.
        apart_cells: poses are the same alignment where the map's middle is nearer than so many searched cells, and the
            parts half as far from it as the farthest are turned by no more than that.
        min_margin: part of its score, 0 to 1, by which the best pose must outscore all others. Where a square room is
            matched with itself in the very same cells, quarter turns score up to 17 % less for their other cells alone;
            halves of real drives outscore all else by 20 to 50 %.
        min_overlap: part of the smaller map's cells, 0 to 1, that must meet a wall of the other.
        min_cells: how many cells must meet a wall at least.
        max_contradicted: of the cells that are walls in one map and known to the other, the part, 0 to 1, that may be
            free there.
        reverse_cells: by how many cells of its finest level the search of the first map in the second may differ, and
        reverse_radians: by what angle.
        time_limit: seconds for each of the two searches; None: as long as they take.
    """

    most_cells: int = 2500
    apart_cells: float = 2.5
    min_margin: float = 0.2
    min_overlap: float = 0.1
    min_cells: int = 40
    max_contradicted: float = 0.25
    reverse_cells: float = 2.0
    reverse_radians: float = math.radians(1.0)
    time_limit: float | None = None

    def __post_init__(self) -> None:
        """Check the limits.

        Raises:
            ArgumentError: a number is out of its range.
        """
        parts = (self.min_margin, self.min_overlap, self.max_contradicted)
        if not (all(0.0 <= part <= 1.0 for part in parts) and self.most_cells >= 1):
            raise ArgumentError(f"not a setting for aligning maps: {self}")


@dataclass(frozen=True, eq=False)
class Alignment:
    """Where a map b lies in a map a, and what speaks for it.

    Attributes:
        pose: T_a_b, refined on the finest level.
        searched: T_a_b as it was found on the coarse cells.
        match: of all of b in a, turned about b's middle, whose pose it has; its numbers count coarse cells.
        reverse: T_b_a of the search of a in b, refined as well.
        reverse_match: the match of that.
        resolution: of the coarse cells, metres.
        met: how many cells of the smaller map meet a wall of the other, in their own cell or in one beside it.
        overlap: the same as a part of all its cells.
        contradicted: of the cells that are walls in one map and known to the other, the part that is free there.
        reverse_metres: by how much the reverse search puts b elsewhere: root mean square over the cells that meet.
        reverse_radians: by how much it turns b differently.
    """

    pose: Pose
    searched: Pose
    match: Match
    reverse: Pose
    reverse_match: Match
    resolution: float
    met: int
    overlap: float
    contradicted: float
    reverse_metres: float
    reverse_radians: float


@dataclass(frozen=True, eq=False)
class _Side:
    """One of the two maps.

    Attributes:
        name: in messages.
        fine: (P, n) centres of the occupied cells of the finest level, metres.
        walls: the coarse cells that they lie in.
        points: (Q, n) their mean in each coarse cell, nearer to the wall than the centre of that cell.
        middle: (n,) about which the map is turned: the mean of ``points``.
        reach: how far the farthest of ``points`` is from it.
        states: of a coarse level of the map, for what is free.
    """

    name: str
    fine: FloatArray
    walls: VoxelList
    points: FloatArray
    middle: FloatArray
    reach: float
    states: States


def align_maps(
    a: Map,
    b: Map,
    settings: AlignSettings | None = None,
    *,
    rules: tuple[StateRule | None, StateRule | None] = (None, None),
) -> Alignment:
    """Find map b in map a, in the plane or in space (turned about z only: both know where down is).

    Args:
        a: the map whose frame counts.
        b: the map that is looked for; it may reach beyond a on any side, and be on another lattice.
        settings: how to search, and what to accept.
        rules: what an occupied cell of each map is.

    Raises:
        AlignmentError: there is no alignment beyond doubt; the text says which test failed, with its numbers.
        ArgumentError: the maps are of different dimensions.
        TooLargeError: the maps have too many cells for a search.
    """
    settings = settings or AlignSettings()
    if a.lattice.dim != b.lattice.dim:
        raise ArgumentError(f"a map of dimension {b.lattice.dim} cannot lie in one of dimension {a.lattice.dim}")
    scale = _coarse_scale(a, b, settings.most_cells, rules)
    first, second = _side(a, rules[0], scale, "first map"), _side(b, rules[1], scale, "second map")
    # The best place alone takes half of the time, and maps of different places fail there.
    match, searched = _search(first, second, settings, rivals=False)
    pose = _refine(a, rules[0], first, second, searched)
    met, overlap, contradicted = _agreement(first, second, pose)
    check_agreement(met, overlap, contradicted, settings)
    match, _ = _search(first, second, settings, known=match.score)
    _check_margin(match, searched, second, first, settings)
    reverse_match, reverse = _search(second, first, settings)
    _check_margin(reverse_match, reverse, first, second, settings)
    reverse = _refine(b, rules[1], second, first, reverse)
    metres, radians = _difference(first, second, pose, reverse)
    if metres > settings.reverse_cells * a.lattice.resolution or radians > settings.reverse_radians:
        allowed = settings.reverse_cells * a.lattice.resolution, math.degrees(settings.reverse_radians)
        raise AlignmentError(
            f"searching the first map in the second gives another answer, {metres:.2f} m and "
            f"{math.degrees(radians):.2f} degrees off; {allowed[0]:.2f} m and {allowed[1]:.2f} degrees are allowed"
        )
    resolution = first.walls.lattice.resolution
    return Alignment(
        pose, searched, match, reverse, reverse_match, resolution, met, overlap, contradicted, metres, radians
    )


def merge_aligned(a: Map, b: Map, alignment: Alignment) -> Map:
    """Return both maps as one in the frame of a; the sources of b say how they were moved.

    Raises:
        LatticeError: the lattices or the numbers of levels differ.
        BoundsError: a count would be more than 2^63 - 1.
    """
    return a.merge(moved_into(a, b, alignment.pose), same_frame=True)


def moved_into(a: Map, b: Map, T_a_b: Pose) -> Map:
    """Return map b in the frame of map a; its sources say how they were moved."""

    def how(source: dict[str, Any]) -> dict[str, list[float]]:
        pose, before = T_a_b, source.get("moved")
        if isinstance(before, dict):
            t, q = before["translation"], before["quaternion"]
            planar = pose.dim == 2
            pose = pose @ (
                Pose.planar(t[0], t[1], 2.0 * math.atan2(q[2], q[3])) if planar else Pose.from_quaternion(t, q)
            )
        return {"translation": pose.translation.tolist(), "quaternion": pose.quaternion().tolist()}

    moved = b.transform(T_a_b, a.frame)
    return Map(moved.levels, moved.frame, sources_in_frame(moved.sources(), frames_of(a.sources()), how))


def pose_words(pose: Pose) -> str:
    """Return a pose about z as it stands in a message: position in metres, then degrees."""
    return f"({', '.join(f'{v:.2f}' for v in pose.translation)}) m, {math.degrees(pose.theta):.1f} degrees"


def _coarse_scale(a: Map, b: Map, most: int, rules: tuple[StateRule | None, StateRule | None]) -> float:
    """Return how many times larger than those of a map's finest level the cells of the search are."""
    scale = _COARSEST / 4.0
    fine = [map.state(rule).occupied for map, rule in zip((a, b), rules, strict=True)]
    for scale in 2.0 ** np.arange(1, round(math.log2(_COARSEST))):
        sizes = [len(VoxelList.from_points(cells.centres(), cells.lattice.scaled(scale))) for cells in fine]
        if max(sizes) <= most:
            break
    return float(scale)


def _side(map: Map, rule: StateRule | None, scale: float, name: str) -> _Side:
    fine = map.state(rule).occupied.centres()
    if len(fine) == 0:
        raise AlignmentError(f"the {name} has no occupied cell")
    lattice = map.lattice.scaled(scale)
    points, _ = thin(fine, lattice)
    middle = points.mean(axis=0)
    reach = math.sqrt(float(((points - middle) ** 2).sum(axis=1).max()))
    states = map.state(rule, min(2, len(map.levels) - 1))
    return _Side(name, fine, coincidence(VoxelList.from_points(fine, lattice)), points, middle, reach, states)


def _search(
    there: _Side, what: _Side, settings: AlignSettings, *, rivals: bool = True, known: int = 0
) -> tuple[Match, Pose]:
    """Search the whole of one map for another; returns the match of the other's middle, and T_there_what.

    ``rivals`` says whether what else would have fitted is searched for too, ``known`` is a score that is reached.
    """
    # The middle may lie wherever the farthest cell can still meet a wall.
    low, high = there.points.min(axis=0) - what.reach, there.points.max(axis=0) + what.reach
    matcher = GlobalMatcher(OccupancyPyramid(there.walls), _box(there.walls.lattice, low, high))
    apart = settings.apart_cells * there.walls.lattice.resolution
    # Poses that score less than the margin below the best need not be known.
    found = matcher.match(
        what.points - what.middle,
        apart=(apart, apart / max(0.5 * what.reach, apart)),
        runner_up=1.0 - settings.min_margin if rivals else None,
        # Half a cell less, so that rounding cannot leave out the pose that is known.
        least=max(0.0, known - 0.5) / len(what.points),
        refine=False,
        time_limit=settings.time_limit,
    )
    if found is None:
        raise AlignmentError(f"no wall of the {what.name} meets one of the {there.name} anywhere")
    if not found.certified or found.gap:
        raise AlignmentError(
            f"searching the {what.name} in the {there.name} was not finished: {found.score} of its {found.total} cells "
            f"meet a wall at best so far, and up to {found.bound} might elsewhere"
        )
    return found, _about_origin(found.pose, what)


def _upright(pose: Pose) -> Pose:
    """Return the pose with its yaw alone: the refinement may lean a map of space by a hair."""
    rotation = np.eye(pose.dim)
    rotation[:2, :2] = Pose.planar(0.0, 0.0, pose.theta).rotation
    return Pose(rotation, pose.translation)


def _about_origin(pose: Pose, what: _Side) -> Pose:
    """Return the pose of a map of which ``pose`` is that of its middle."""
    return pose @ Pose(np.eye(pose.dim), -what.middle)


def _box(lattice: Lattice, low: FloatArray, high: FloatArray) -> VoxelList:
    """Return all cells of a box, whose corners are in metres."""
    u = box_coordinates(lattice.basis, low, high)
    first, last = np.floor(u.min(axis=0)).astype(np.int64), np.ceil(u.max(axis=0)).astype(np.int64)
    grids = np.meshgrid(*[np.arange(i, j + 1) for i, j in zip(first, last, strict=True)], indexing="ij")
    return VoxelList.from_cells(np.stack([g.ravel() for g in grids], axis=1), lattice)


def _refine(a: Map, rule: StateRule | None, first: _Side, second: _Side, searched: Pose) -> Pose:
    """Return T_a_b, found again around ``searched`` from level to level down to the finest, and refined there."""
    middle = searched @ Pose(np.eye(searched.dim), second.middle)
    size = first.walls.lattice.resolution
    for level in range(min(2, len(a.levels) - 1), -1, -1):
        lattice = a.level(level).lattice
        points, _ = thin(second.fine, lattice)
        at = middle.translation
        # Two cells of the step before to each side, and as far as that lets the farthest point turn.
        near = 2.0 * size
        known = VoxelList.from_cells(lattice.quantise(at[None]) + shifts_in_ball(lattice, near), lattice)
        matcher = GlobalMatcher(OccupancyPyramid(coincidence(a.state(rule, level).occupied)), known)
        region = SearchRegion(at - near, at + near, middle.theta, min(math.pi, near / max(second.reach, near)))
        found = matcher.match(points - second.middle, region, runner_up=None, refine=level == 0)
        if found is not None:
            middle = _upright(found.pose)
        size = lattice.resolution
    return _about_origin(middle, second)


def _met_and_free(there: _Side, points: FloatArray) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Tell which points (Q, n) meet a wall in their cell or one beside it, and which lie in the open."""
    states = there.states
    index = states.occupied.lattice.quantise(points).astype(np.int64)
    met = states.occupied.contains(index)
    for offset in states.occupied.lattice.neighbours:
        met |= states.occupied.contains(index + offset)
    return met, ~met & states.free.contains(index)


def _agreement(first: _Side, second: _Side, pose: Pose) -> tuple[int, float, float]:
    """Return how many cells of the smaller map meet a wall, which part, and which part of what both know is free."""
    b_met, b_free = _met_and_free(first, pose.apply(second.points))
    a_met, a_free = _met_and_free(second, pose.inverse().apply(first.points))
    met = b_met if len(b_met) <= len(a_met) else a_met
    free = int(b_free.sum() + a_free.sum())
    known = free + int(b_met.sum() + a_met.sum())
    return int(met.sum()), float(met.mean()), free / max(1, known)


def _difference(first: _Side, second: _Side, pose: Pose, reverse: Pose) -> tuple[float, float]:
    """Return by how many metres and radians T_b_a puts b elsewhere than T_a_b, over the cells that meet."""
    met, _ = _met_and_free(first, pose.apply(second.points))
    points = second.points[met]
    delta = reverse @ pose
    return math.sqrt(float(((delta.apply(points) - points) ** 2).sum(axis=1).mean())), delta.angle


def check_agreement(met: int, overlap: float, contradicted: float, settings: AlignSettings) -> None:
    """Reject a pose at which too little of the maps meets, or too much disagrees.

    Raises:
        AlignmentError: with the numbers.
    """
    if met < settings.min_cells or overlap < settings.min_overlap:
        raise AlignmentError(
            f"too little overlap: at best {met} cells of the smaller map meet a wall of the other, {overlap:.1%} of "
            f"them; it takes {settings.min_cells} and {settings.min_overlap:.1%}"
        )
    if contradicted > settings.max_contradicted:
        raise AlignmentError(
            f"contradicted: at best {contradicted:.1%} of the walls that the other map knows are free there; "
            f"{settings.max_contradicted:.1%} are allowed"
        )


def _check_margin(match: Match, pose: Pose, what: _Side, there: _Side, settings: AlignSettings) -> None:
    """Reject a pose that another one comes too near to.

    Raises:
        AlignmentError: with both.
    """
    other = match.runner_up
    if other is not None and match.margin < settings.min_margin:
        second = _about_origin(other.pose, what)
        raise AlignmentError(
            f"ambiguous: {match.score} of {match.total} cells of the {what.name} meet a wall of the {there.name} at "
            f"{pose_words(pose)}, and {other.score} at {pose_words(second)}; a margin of {settings.min_margin:.0%} is "
            "needed"
        )
