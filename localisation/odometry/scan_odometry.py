"""Poses of scans by matching each against the map of those before."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.maps.builder import MapBuilder
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Odometry, Scan
from localisation.matching.information import TEMPERATURE
from localisation.matching.local_matcher import LocalMatcher
from localisation.matching.match import Match
from localisation.matching.occupancy import Occupancy
from localisation.matching.refinement import refine_on
from localisation.matching.search_region import SearchWindow
from localisation.odometry.motion import MotionPredictor
from localisation.odometry.odometry import Reading, RegisteredScan
from localisation.settings import MappingSettings, limit_of, make_mount

__all__ = ["ScanOdometry"]

# A scan agrees with the map when at least half of its cells do; if not, the window is doubled twice.
ENOUGH = 0.5
WIDENING = (1.0, 2.0, 4.0)
# Where it is learnt how good predictions are: standard deviations that make the first window, which begins at a third
# of the settings' one, as if so many scans had shown it; after so many scans the older ones are forgotten by a half.
_SIGMAS = 3.0
_BEGIN = 5.0
_FORGET = 0.5 ** (1.0 / 100.0)
_STEPS = 10
# A match so far out in the first window, in parts of it, may have its better half outside.
_BORDER = 0.75
# Half of a squared distance in standard deviations from which on it is asked whether a nearer pose is likelier.
_FAR = 1.0
# The number of coincident cells of a scan that half agrees scatters by about a tenth (the square
# root of some hundred cells): two and a half times that is no chance.
CLEARLY = 1.25


class ScanOdometry:
    """Odometry by scan matching alone: no loop closure, no back end.

    It matches against what is in a builder and never fuses into it: the caller fuses the registered scans that the next
    ones are to be matched against. The first scan is taken at its prediction.

    Examples:
        >>> import numpy as np
        >>> from hexmap.poses.pose import Pose
        >>> from hexmap.poses.scan import Scan
        >>> from localisation.odometry import ScanOdometry
        >>> from localisation.settings import MappingSettings, make_builder
        >>> settings = MappingSettings()
        >>> builder = make_builder(settings)
        >>> odometry = ScanOdometry(settings, builder)
        >>> along = np.linspace(-2.0, 2.0, 200)
        >>> walls = np.concatenate([np.stack([along, np.full(200, 1.5)], 1), np.stack([np.full(200, 2.0), along], 1)])
        >>> for truth in (Pose.identity(2), Pose.planar(0.2, 0.1, 0.05)):
        ...     registered = odometry.register(Scan(0.0, truth.inverse().apply(walls)))
        ...     builder.fuse(registered.scan, registered.T_map_scan)
        >>> registered.T_map_robot.is_close(truth, metres=0.02, radians=0.01)
        True
    """

    def __init__(
        self, settings: MappingSettings, builder: MapBuilder, mount: Pose | None = None, *, learn: bool = False
    ) -> None:
        """Make an odometry on the map in ``builder``.

        Args:
            settings: of the map.
            builder: what is matched against.
            mount: T_robot_laser where the settings do not say.
            learn: whether it is learnt how good the predictions are: where they are good a narrow window comes first,
                and what is farther away must fit better by more than it is unlikely. Along a bare corridor more of a
                scan lies on known walls the less the robot has moved, so that the best of a wide window falls behind.
        """
        self.settings = settings
        self.mount = make_mount(settings, mount)
        self._motion = MotionPredictor(use_odometry=settings.use_odometry, mount=self.mount)
        self._matcher = LocalMatcher(SearchWindow(settings.search_metres, settings.search_radians))
        self._searcher = LocalMatcher(refine=False)
        self._learn = learn
        self._weight = _BEGIN
        self._squares = [
            _BEGIN * (v / _SIGMAS**2) ** 2 for v in (settings.search_metres, settings.search_radians)
        ]  # fmt: skip
        self.match_against(builder)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the occupied cells: the builder's counters have them."""
        return {k: v for k, v in self.__dict__.items() if k not in ("_coarse", "_fine")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Follow the builder's counters again."""
        self.__dict__.update(state)
        self.match_against(self._builder)

    def match_against(self, builder: MapBuilder) -> None:
        """Match the next scans against what is in ``builder``."""
        settings = self.settings
        self._builder = builder
        self._coarse = Occupancy.of_counter(builder.counter(settings.search_level), settings.rule)
        self._fine = self._coarse
        if settings.search_level != 0:
            self._fine = Occupancy.of_counter(builder.counter(0), settings.rule)

    @property
    def occupied(self) -> Occupancy:
        """The occupied cells of the finest level, as they are now."""
        return self._fine

    def move_to(self, T_map_robot: Pose) -> None:
        """Go on from another pose of the robot at the last scan: the map's frame has moved under it."""
        self._motion.move_to(T_map_robot)

    @property
    def jumps(self) -> int:
        """Odometry readings that could not be true; the last motion was used there."""
        return self._motion.jumps

    def observe(self, reading: Odometry) -> tuple[Reading, ...]:
        """Take an odometry reading; return those that need not wait for a scan any longer: as a rule none."""
        return self._motion.observe(reading)

    def register(self, scan: Scan) -> RegisteredScan:
        """Predict where the robot is at a scan and match the scan there.

        Raises:
            BoundsError: a point is out of range; the scan is as if it had not been.
            TooLargeError: it sees so far that the search has too many angles; the same.
        """
        settings = self.settings
        predicted = T_map_robot = self._motion.predict(scan)
        ranges = np.sqrt((scan.points**2).sum(axis=1))
        usable = scan.points[(ranges >= settings.min_range) & (ranges <= limit_of(settings.max_range))]
        found = None
        matched = self._builder.scans > 0 and len(usable) > 0
        if matched:
            found = self._search(self.mount.apply(usable), predicted)
            if found is not None:
                T_map_robot = found.pose
        readings = self._motion.arrive(scan, predicted, T_map_robot)
        return RegisteredScan(scan, T_map_robot, T_map_robot @ self.mount, readings, matched, found, predicted)

    def finish(self) -> tuple[Reading, ...]:
        """Return the readings after the last scan, at their predicted poses."""
        return self._motion.finish()

    def _search(self, points: FloatArray, predicted: Pose) -> Match | None:
        """Match in the window; where most of the scan then disagrees with the map, look farther.

        Wheels that slip or a laser that skips a turn put the true pose outside any window that is
        fast for every scan. A scan that enters a new room disagrees as well, and there a wide
        window finds chance agreements: a wider search must beat the narrower one clearly.
        """
        best: Match | None = None
        if self._learn:
            window = self.likely_window()
            best = self._likeliest(points, predicted, window)
            if best is not None and best.fraction >= ENOUGH and not _at_border(predicted, best.pose, window):
                self._note(predicted, best.pose)
                return best
        for factor in WIDENING:
            window = SearchWindow(
                self.settings.search_metres * factor, min(self.settings.search_radians * factor, math.pi)
            )
            above = 0 if best is None else math.floor(CLEARLY * best.score)
            found = self._matcher.match(points, predicted, self._coarse, fine=self._fine, window=window, above=above)
            best = found or best
            if best is not None and best.fraction >= ENOUGH:
                break
        if best is not None:
            self._note(predicted, best.pose)
        return best

    def _likeliest(self, points: FloatArray, predicted: Pose, window: SearchWindow) -> Match | None:
        """Match in a window, and in narrower ones where what is found is far out; the likeliest of these."""
        best: Match | None = None
        likeliest = -math.inf
        while True:
            found = self._searcher.match(points, predicted, self._coarse, window=window)
            if found is None:
                break
            delta = predicted.inverse() @ found.searched
            squares = float((delta.translation**2).sum()), delta.angle**2
            unlikely = 0.5 * sum(q * self._weight / s for q, s in zip(squares, self._squares, strict=True))
            # The score as a likelihood, as the information of a match has it.
            likelihood = found.score / (TEMPERATURE * found.total) - unlikely
            if likelihood > likeliest:
                best, likeliest = found, likelihood
            if unlikely <= _FAR or window.metres < 0.5 * self._coarse.lattice.resolution:
                break
            window = SearchWindow(0.5 * window.metres, 0.5 * window.radians)
        if best is None:
            return None
        refined = refine_on(self._fine, points, best.searched, searched=self._coarse.lattice)
        return replace(best, pose=refined.pose, refined=refined.converged)

    def likely_window(self) -> SearchWindow:
        """Return the window in which the scan should lie by what predictions have been off so far."""
        metres, radians = (_SIGMAS * math.sqrt(square / self._weight) for square in self._squares)
        # By steps of a half more, so that the shifts of a window are made once and not for every scan.
        steps = math.floor(math.log(self.settings.search_metres / max(metres, 1e-9), 1.5))
        metres = self.settings.search_metres * 1.5 ** -max(0, min(steps, _STEPS))
        return SearchWindow(metres, min(radians, self.settings.search_radians))

    def _note(self, predicted: Pose, pose: Pose) -> None:
        """Remember by how much a prediction was off."""
        delta = predicted.inverse() @ pose
        self._weight = _FORGET * self._weight + 1.0
        for k, square in enumerate((float((delta.translation**2).sum()), delta.angle**2)):
            self._squares[k] = _FORGET * self._squares[k] + square


def _at_border(predicted: Pose, pose: Pose, window: SearchWindow) -> bool:
    """Tell whether a match lies so far out that what is outside the window may fit better."""
    delta = predicted.inverse() @ pose
    metres = math.hypot(delta.x, delta.y)
    return metres > _BORDER * window.metres or delta.angle > _BORDER * window.radians
