"""How a LiDAR's scan is found in the experiment: anywhere in a map, and near a start.

As everywhere in this project: levelled by the floors that it sees and searched for on a coarse level with some hundred
points over all yaws, then refined on the finest; near a start drawn onto the map's surfaces, because all poses around
one are too many to be looked at in space.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.poses.pose import Pose
from localisation.experiments.baselines.angle_set import angular_step
from localisation.experiments.maps import Prepared
from localisation.matching.global_matcher import SPREAD_IN_SPACE, GlobalMatcher, refined_finely, spread_points
from localisation.matching.gravity import levelling_of
from localisation.matching.match import Match
from localisation.matching.search_region import SearchRegion
from localisation.matching.surfaces import first_of_each_cell
from localisation.slam.lidar_loops import drawn_covariance

__all__ = ["TILT", "drawn_in_space", "found_in_space"]

TILT = math.radians(2.0)
"""By how much floors may mislead about what is up, radians."""
# Points that are drawn: one in so wide a cell, in a surface's.
_DRAWN = 1.0 / 3.0
# In cells of the surfaces: a scan that moves farther has met something else.
_FARTHEST = 2.0


def found_in_space(
    points: FloatArray, prepared: Prepared, matcher: GlobalMatcher, method: str, node_limit: int
) -> Match | None:
    """Find a scan anywhere in a map, over all yaws or over a set of them; its pose is that of the scan as it is.

    Raises:
        TooLargeError: too many angles for a search.
    """
    if not len(points):
        return None
    searched = matcher.lattice
    level = levelling_of(points, searched)
    some = spread_points(level.apply(points), searched, SPREAD_IN_SPACE)
    match = matcher.match(
        some, SearchRegion(tilt=TILT), angles="continuous" if method == "all angles" else angular_step(some, searched),
        refine=False, beams=False, node_limit=node_limit,
    )  # fmt: skip
    if match is None:
        return None
    fine = refined_finely(match, level.apply(points), prepared.occupancy, searched)
    return _turned(fine, level)


def _turned(match: Match, level: Pose) -> Match:
    """Return the match of a scan that was levelled as one of the scan itself: the sensor is where it was."""
    return replace(match, pose=match.pose @ level, searched=match.searched @ level)


def drawn_in_space(points: FloatArray, start: Pose, prepared: Prepared) -> tuple[Pose | None, FloatArray | None, float]:
    """Draw a scan onto the map's surfaces from a start near its pose.

    Returns:
        The pose, None where it was drawn to nothing; its covariance (6, 6) in the map's axes about the sensor; and the
        share of the points on surfaces.
    """
    surfaces = prepared.surfaces
    drawn = surfaces.draw(
        first_of_each_cell(points, surfaces.lattice.scaled(_DRAWN)), start, farthest=_FARTHEST
    )
    if not drawn.converged:
        return None, None, drawn.share
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = drawn.pose.rotation
    return drawn.pose, turn @ drawn_covariance(drawn) @ turn.T, drawn.share
