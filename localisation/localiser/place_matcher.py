"""Scans matched around a place: within the window, or within what odometry leaves open, and how sure that is."""

from __future__ import annotations

import math

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.poses.pose import Pose
from localisation.localiser.fusion import carry_on
from localisation.localiser.settings import LocaliserSettings
from localisation.matching.global_matcher import GlobalMatcher, thin
from localisation.matching.information import TEMPERATURE, score_covariance
from localisation.matching.match import Match
from localisation.matching.search_region import SearchRegion

__all__ = ["PlaceMatcher"]

# Standard deviations from the prediction within which a scan is looked for at a place: 1 in 400 is outside by chance.
_GATE = 3.0


class PlaceMatcher:
    """Predicts and matches at one place of a map; poses are T_map_sensor.

    Args:
        matcher: of the map.
        settings: of the localiser.
    """

    def __init__(self, matcher: GlobalMatcher, settings: LocaliserSettings) -> None:
        self._matcher = matcher
        self._settings = settings
        self._dim = matcher.lattice.dim

    def carry_on(
        self, at: tuple[Pose, FloatArray], motion: Pose, driven: tuple[float, float], *, measured: bool
    ) -> tuple[Pose, FloatArray]:
        """Return pose and covariance after a motion, ``measured`` by odometry, along a path of metres and radians."""
        s = self._settings
        way, turn = driven
        metres, radians = s.drift_metres + s.drift * way, s.drift_radians + s.drift * (turn + 0.2 * way)
        if not measured:
            metres, radians = max(metres, 0.25 * s.search_metres), max(radians, 0.25 * s.search_radians)
        return carry_on(*at, motion, metres, radians)

    def match_near(self, points: FloatArray, predicted: Pose, widened: float = 1.0) -> Match | None:
        """Return the best pose of the window around a predicted one, or of one so many times as wide."""
        s = self._settings
        metres, radians = s.search_metres * widened, min(s.search_radians * widened, math.pi)
        return self._match(points, predicted, np.full(self._dim, metres), radians)

    def match_within(self, points: FloatArray, predicted: Pose, P: FloatArray) -> Match | None:
        """Return the best pose within what a prediction leaves open, at the most within the window.

        A place is a place of the robot's path. In a window that is wider than the odometry errs, a pose slides along a
        corridor from scan to scan to wherever the map is met best: the true one away from the truth, and a wrong one
        to where it is not told from the truth.
        """
        s = self._settings
        n, cell = self._dim, self._matcher.lattice.resolution
        sigmas = np.sqrt(np.diag(P))
        metres = np.clip(_GATE * sigmas[:n], cell, max(cell, s.search_metres))
        return self._match(points, predicted, metres, min(_GATE * float(sigmas[n:].max()), s.search_radians))

    def _match(self, points: FloatArray, around: Pose, metres: FloatArray, radians: float) -> Match | None:
        region = SearchRegion(around.translation - metres, around.translation + metres, around.theta, radians)
        limit = self._settings.time_limit
        return self._matcher.match(points, region, runner_up=None, information=False, time_limit=limit)

    def covariance(self, points: FloatArray, match: Match) -> FloatArray:
        """Return the covariance of a match; of a few points each counts as independent."""
        kept, weights = thin(points, self._matcher.lattice)
        temperature = max(TEMPERATURE, 1.0 / len(points))
        return score_covariance(self._matcher.pyramid, kept, weights, match.searched, temperature=temperature)

    def window_covariance(self) -> FloatArray:
        """Return the covariance of a pose that may be anywhere in the window."""
        n, size = self._dim, 3 if self._dim == 2 else 6
        sigmas = np.full(size, 0.5 * self._settings.search_radians)
        sigmas[:n] = 0.5 * self._settings.search_metres
        return np.diag(sigmas**2)
