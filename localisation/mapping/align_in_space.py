"""Find one map of space in another, or say why it cannot be found beyond doubt.

A map is looked for as a LiDAR's scan is (:mod:`localisation.localiser.lidar_localiser`): searched for by the certified
matcher over all yaws, drawn onto the other's surfaces, and asked on the finest cells how it agrees with what is
occupied there and what is free. Floors and ceilings are most of what maps of space have in common, and meet at wrong
places as well as at the right one: a place is searched and judged by what stands upright. As a whole first; where a map
reaches too far beyond the other for that, in parts, of which most that are found must agree on where the map lies.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import AlignmentError, ArgumentError
from hexmap.maps.map import Map
from hexmap.maps.state_rule import StateRule, States
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from localisation.lidar_settings import LidarSettings
from localisation.localiser.lidar_localiser import LidarLocaliser, Place
from localisation.mapping.align import AlignSettings, check_agreement, pose_words
from localisation.matching.surfaces import SurfaceMap

__all__ = ["SpaceAlignment", "align_maps_in_space"]

# Parts of a map that are looked for: each takes seconds where it is not in the other.
_PARTS = 8
# Parts agree to this, metres and radians: a map bends by as much from one end to the other.
_AGREE = (1.0, math.radians(5.0))
# By so much more of its upright cells a map must agree with the other where it lies than anywhere else.
_MARGIN = 0.05
# Parts reach so far, as a share of how far the map's farthest cells are from its middle, and metres: some rooms.
_PART_REACH, _LEAST_REACH, _MOST_REACH = 0.5, 3.0, 12.0
# In cells of the map, those in which planes are looked for; and how far a floor's normal leans at most, radians.
_PLANES, _FLAT = 5.0, math.radians(30.0)
# A map has no ranges: all of its cells count.
_ALL = LidarSettings(min_range=0.0, max_range=None)


@dataclass(frozen=True, eq=False)
class SpaceAlignment:
    """Where a map b of space lies in a map a, and what speaks for it.

    Attributes:
        pose: T_a_b.
        parts: how many parts of b were found there; 0 where b was found as a whole.
        looked_for: how many searches of a there were.
        met: how many upright cells of b lie on occupied cells of a or beside them.
        overlap: the same as a share of the smaller map's.
        contradicted: of the upright cells of one map that the other knows, the share that is free there; that of
            the map which is contradicted more.
        reverse_metres: by how much drawing a onto b puts b elsewhere, at the farthest corner of what meets.
        reverse_radians: by how much it turns b differently.
    """

    pose: Pose
    parts: int
    looked_for: int
    met: int
    overlap: float
    contradicted: float
    reverse_metres: float
    reverse_radians: float


def align_maps_in_space(
    a: Map,
    b: Map,
    settings: AlignSettings | None = None,
    *,
    rules: tuple[StateRule | None, StateRule | None] = (None, None),
) -> SpaceAlignment:
    """Find map b in map a, both of space with level floors, on any lattices.

    Args:
        a: the map whose frame counts.
        b: the map that is looked for; it may reach beyond a on any side.
        settings: what to accept; of the search its own constants say how.
        rules: what an occupied cell of each map is.

    Raises:
        AlignmentError: there is no alignment beyond doubt; the text says which test failed, with its numbers.
        ArgumentError: a map of the plane.
    """
    settings = settings or AlignSettings()
    for map in (a, b):
        if map.lattice.dim != 3:
            raise ArgumentError(f"maps of space are aligned here, and {map.lattice.name} is a lattice of the plane")
    first, second = a.state(rules[0]), b.state(rules[1])
    for name, states in (("first", first), ("second", second)):
        if len(states.occupied) == 0:
            raise AlignmentError(f"the {name} map has no occupied cell")
    what, where = _Upright.of(second), _Upright.of(first)
    there, back = LidarLocaliser(first, _ALL), LidarLocaliser(second, _ALL)
    found, parts, looked_for = _find(there, what, second)
    b_in_a = there.draw(what.points, found, what.judged)
    a_in_b = back.draw(where.points, b_in_a.pose.inverse(), where.judged)
    met, overlap, contradicted = _agreement(b_in_a, a_in_b)
    check_agreement(met, overlap, contradicted, settings)
    on = what.points[there.meets(b_in_a.pose.apply(what.points))]
    corners = np.array([on.min(axis=0), on.max(axis=0)])
    delta = a_in_b.pose @ b_in_a.pose
    metres, radians = float(np.linalg.norm(delta.apply(corners) - corners, axis=1).max()), delta.angle
    limit = settings.reverse_cells * a.lattice.resolution
    drawn = b_in_a.drawn.converged and a_in_b.drawn.converged
    if not drawn or metres > limit or radians > settings.reverse_radians:
        raise AlignmentError(
            f"drawing the first map onto the second gives another answer than the reverse, {metres:.2f} m and "
            f"{math.degrees(radians):.2f} degrees off; {limit:.2f} m and {math.degrees(settings.reverse_radians):.2f} "
            "degrees are allowed"
        )
    return SpaceAlignment(b_in_a.pose, parts, looked_for, met, overlap, contradicted, metres, radians)


@dataclass(frozen=True, eq=False)
class _Upright:
    """The occupied cells of a map or of a part of it.

    Attributes:
        points: (N, 3) their centres, metres.
        judged: (K, 3) those that are no part of a floor or a ceiling.
    """

    points: FloatArray
    judged: FloatArray

    @classmethod
    def of(cls, states: States) -> _Upright:
        points = states.occupied.centres()
        lattice = states.occupied.lattice.scaled(_PLANES)
        surfaces = SurfaceMap(lattice)
        surfaces.add(points)
        means, normals, _ = surfaces.planes()
        flat = VoxelList.from_points(means[np.abs(normals[:, 2]) > math.cos(_FLAT)], lattice)
        return cls(points, points[~flat.contains(lattice.quantise(points))])

    def near(self, origin: FloatArray, reach: float) -> _Upright:
        """Return those within some metres of a place."""

        def near(points: FloatArray) -> FloatArray:
            return points[((points - origin) ** 2).sum(axis=1) <= reach**2]

        return _Upright(near(self.points), near(self.judged))

    def about(self, origin: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return both in coordinates about a place."""
        return self.points - origin, self.judged - origin


def _agreement(b_in_a: Place, a_in_b: Place) -> tuple[int, float, float]:
    """Return how many upright cells of b meet, which share of the smaller map's do, and which of those known are free.

    The last is that of the map that is contradicted more.
    """
    smaller = b_in_a if b_in_a.total <= a_in_b.total else a_in_b
    free = max(place.contradicted / max(place.met + place.contradicted, 1e-9) for place in (b_in_a, a_in_b))
    return round(b_in_a.met * b_in_a.total), smaller.met, free


def _find(there: LidarLocaliser, what: _Upright, states: States) -> tuple[Pose, int, int]:
    """Look for a map as a whole, then for parts of it; returns T_there_map, parts that hold, and searches.

    Raises:
        AlignmentError: it is not found, or at two places that cannot be told apart.
    """
    origin = _origin(what.points.mean(axis=0), states)
    places = there.look_for(*what.about(origin))
    if len(places) == 2:
        raise AlignmentError(f"ambiguous: {_rivals(places, origin)}")
    if places:
        return places[0].pose @ _from(origin), 0, 1
    parts = _parts(what, states)
    found: list[list[Pose]] = []
    for origin, part in parts:
        places = there.look_for(*part.about(origin))
        if len(places) == 1:
            T = places[0].pose @ _from(origin)
            group = next((group for group in found if group[0].is_close(T, *_AGREE)), None)
            if group is None:
                found.append([T])
            else:
                group.append(T)
    found.sort(key=lambda group: -len(group))
    if not found or sum(_holds(there, *part, found[0][0]) for part in parts) < 2:
        raise AlignmentError(
            f"neither the whole second map nor two of {len(parts)} parts of it lie in the first map beyond doubt"
        )
    judged = [there.draw(what.points, group[0], what.judged) for group in found]
    values = [place.met - place.contradicted for place in judged]
    for n in range(1, len(found)):
        if len(found[n]) == len(found[0]) or values[n] > values[0] - _MARGIN:
            rivals = " and ".join(
                f"{len(found[k])} of {len(parts)} parts lie at {pose_words(found[k][0])}, where {values[k]:.1%} agree"
                for k in (0, n)
            )
            raise AlignmentError(f"ambiguous: {rivals}")
    return found[0][0], len(found[0]), len(parts) + 1


def _holds(there: LidarLocaliser, origin: FloatArray, part: _Upright, T_there_map: Pose) -> bool:
    points, judged = part.about(origin)
    return there.draw(points, T_there_map @ _from(-origin), judged).holds


def _from(origin: FloatArray) -> Pose:
    """Return the pose that takes coordinates of a map into those about an origin."""
    return Pose(np.eye(3), -origin)


def _rivals(places: list[Place], origin: FloatArray) -> str:
    return " and ".join(f"{p.met:.1%} of its cells meet at {pose_words(p.pose @ _from(origin))}" for p in places)


def _origin(middle: FloatArray, states: States) -> FloatArray:
    """Return the free place (3,) nearest to the middle of some cells: where a sensor may have been."""
    if len(states.free) == 0:
        return middle
    centres = states.free.centres()
    return np.asarray(centres[int(np.argmin(((centres - middle) ** 2).sum(axis=1)))])


def _parts(what: _Upright, states: States) -> list[tuple[FloatArray, _Upright]]:
    """Return the origins (3,) of parts that lie far from one another, the most central one first, and the parts."""
    points = what.points
    squared = ((points - points.mean(axis=0)) ** 2).sum(axis=1)
    reach = float(np.clip(_PART_REACH * math.sqrt(float(squared.max())), _LEAST_REACH, _MOST_REACH))
    chosen, nearest = int(np.argmin(squared)), np.full(len(points), np.inf)
    parts: list[tuple[FloatArray, _Upright]] = []
    while len(parts) < _PARTS:
        origin = _origin(points[chosen], states)
        parts.append((origin, what.near(origin, reach)))
        nearest = np.minimum(nearest, ((points - points[chosen]) ** 2).sum(axis=1))
        chosen = int(np.argmax(nearest))
        if nearest[chosen] < (0.5 * reach) ** 2:
            break
    return parts
