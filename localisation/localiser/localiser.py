"""From scans to poses in a known map, without a start pose.

Lost: the whole map is searched for the scan. Ambiguous: all poses that fit are carried on by the robot's motion, each
is matched against every new scan, and what they score adds up until one stands out. Tracking: the scan is matched
around the prediction, and both are fused by their information. When the scans of some time disagree with the map, the
robot is lost.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError
from hexmap.maps.map import Map
from hexmap.maps.state_rule import StateRule, States
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Event, Odometry, Scan
from localisation.localiser.estimate import Estimate, Hypothesis, TrackState
from localisation.localiser.evidence import Evidence, fits, meets
from localisation.localiser.fusion import carry_on, fuse, move_point
from localisation.localiser.place import LOUDEST, Place
from localisation.localiser.settings import LocaliserSettings
from localisation.matching.beams import contradicted_share
from localisation.matching.global_matcher import GlobalMatcher, thin
from localisation.matching.hypotheses import find_hypotheses, is_same_place
from localisation.matching.information import TEMPERATURE, score_covariance
from localisation.matching.match import Match
from localisation.matching.pyramid import OccupancyPyramid
from localisation.matching.score import coincidence
from localisation.matching.search_region import SearchRegion

__all__ = ["Localiser"]

# Metres that no robot drives between two scans: a damaged number or a reset of the odometry.
_FARTHEST_JUMP = 100.0
# Standard deviations from the prediction within which a scan is looked for at a place: 1 in 400 is outside by chance.
_GATE = 3.0
# How many times as wide the window is where the scan does not fit within it.
_WIDENED = 4.0
# One in e^10 as likely as the best: what is dropped cannot win any more.
_HOPELESS = 10.0
# A search that found too many places is repeated after up to 2^3 steps.
_MOST_DOUBLINGS = 3
# The same while nothing is found at all: a robot outside the map is looked for every 8 m.
_MOST_DOUBLINGS_LOST = 5
# Scans that see mostly the same show the same people and the same open door: together they are one view. Half of a
# scan's points lie within their median range; two such discs share 39 % where their centres are one such range apart.
_VIEW = 1.0


class Localiser:
    """Finds a robot in a map and follows it; fed with the events of a log in their order.

    The same events give the same answers, bit for bit, unless a time limit is set.

    Args:
        world: a map, or which cells of a map of others are occupied and free.
        settings: all settings.
        mount: T_robot_sensor; None: the sensor is where the robot is.
        start: T_map_robot where the first pose is known, within the search window.
        rule: what an occupied cell of ``world`` is.
        level: of ``world``.

    Attributes:
        state: lost, ambiguous or tracking.
        times_lost: how often a pose that was tracked was given up.

    Examples:
        >>> from hexmap import Lattice, MapBuilder
        >>> from hexmap.poses.scan import Scan
        >>> from hexmap.simulator import OdometryNoise, make_building, simulate
        >>> from localisation import Localiser
        >>> drive = list(simulate(make_building("room"), duration=8.0))
        >>> scans = [e for e in drive if isinstance(e.event, Scan)]
        >>> builder = MapBuilder(Lattice.named("A2", resolution=0.05))
        >>> for e in scans:
        ...     _ = builder.fuse(e.event, e.T_map_robot)
        >>> localiser = Localiser(builder.build())
        >>> for e in scans[20:]:
        ...     estimate = localiser.add(e.event)
        >>> estimate.state.value, estimate.pose.is_close(scans[-1].T_map_robot, metres=0.05, radians=0.02)
        ('tracking', True)
    """

    def __init__(
        self,
        world: Map | States,
        settings: LocaliserSettings | None = None,
        *,
        mount: Pose | None = None,
        start: Pose | None = None,
        rule: StateRule | None = None,
        level: int = 0,
    ) -> None:
        """Prepare the matcher."""
        states = world.state(rule, level) if isinstance(world, Map) else world
        self.settings = settings or LocaliserSettings()
        self.matcher = GlobalMatcher(
            OccupancyPyramid(coincidence(states.occupied)), states.free if len(states.free) else None
        )
        self.dim = states.occupied.lattice.dim
        self.mount = mount or Pose.identity(self.dim)
        if self.mount.dim != self.dim or (start is not None and start.dim != self.dim):
            raise ArgumentError(f"the map is of dimension {self.dim}; mount and start must be too")
        self.state = TrackState.lost
        self.times_lost = 0
        self._places: list[Place] = []
        self._complete = True
        self._covariance: FloatArray = np.eye(0)
        self._recent: deque[tuple[Evidence, bool]] = deque(maxlen=self.settings.patience)
        self._T_odom_sensor: Pose | None = None
        self._reading: Pose | None = None
        # What the robot moved since the last search that found nothing: from one place it would find nothing again.
        self._waited = self._turned = math.inf
        # Searches in a row that found more places than are carried on.
        self._fruitless = 0
        if start is not None:
            sensor = start @ self.mount
            self._places = [Place.at(sensor, self._start_covariance(), tracked=True)]
            self._track_from(self._start_covariance())

    def add(self, event: Event) -> Estimate | None:
        """Take the next event of the log; return what is known after a scan, None after an odometry reading.

        Raises:
            ArgumentError: the scan is not of the map's dimension.
            BoundsError: a point is not finite or out of the range of indices.
        """
        if isinstance(event, Odometry):
            self._reading = event.pose
            return None
        if event.dim != self.dim:
            raise ArgumentError(f"the map is of dimension {self.dim}, the scan of {event.dim}")
        ranges = np.sqrt((event.points**2).sum(axis=1))
        points = event.points[(ranges >= self.settings.min_range) & (ranges <= self.settings.max_range)]
        self.matcher.lattice.quantise(points)  # raises, naming the row, before anything is changed
        motion = self._motion(event)
        if motion is None:
            self._waited = math.inf
        else:
            self._waited += float(np.linalg.norm(motion.translation))
            self._turned += motion.angle
        before = self.state
        if before is TrackState.tracking:
            self._track(points, motion)
        elif before is TrackState.ambiguous:
            self._compare(points, motion)
        if self.state is TrackState.lost and before is not TrackState.tracking:
            self._search(points)
        return self._estimate(event)

    # ------------------------------------------------------------------ motion

    def __repr__(self) -> str:
        """Say what it knows of the robot."""
        return f"<Localiser, {self.state.value}, {self.times_lost} times lost>"

    def _motion(self, scan: Scan) -> Pose | None:
        """Return the sensor's motion since the last scan by odometry; None where there is none to believe."""
        reading = scan.odometry if scan.odometry is not None else self._reading
        if reading is None or not self.settings.use_odometry or reading.dim != self.dim:
            return None
        before, self._T_odom_sensor = self._T_odom_sensor, reading @ self.mount
        if before is None:
            return None
        motion = before.inverse() @ self._T_odom_sensor
        return motion if float(np.linalg.norm(motion.translation)) <= _FARTHEST_JUMP else None

    def _carry_on(
        self, at: tuple[Pose, FloatArray], motion: Pose, driven: tuple[float, float], *, measured: bool
    ) -> tuple[Pose, FloatArray]:
        """Return pose and covariance after a motion, ``measured`` by odometry, along a path of metres and radians."""
        s = self.settings
        way, turn = driven
        metres, radians = s.drift_metres + s.drift * way, s.drift_radians + s.drift * (turn + 0.2 * way)
        if not measured:
            metres, radians = max(metres, 0.25 * s.search_metres), max(radians, 0.25 * s.search_radians)
        return carry_on(*at, motion, metres, radians)

    # ------------------------------------------------------------------ matching

    def _match_near(self, points: FloatArray, predicted: Pose, widened: float = 1.0) -> Match | None:
        """Return the best pose of the window around ``predicted`` (T_map_sensor), or of one so many times as wide."""
        s = self.settings
        metres, radians = s.search_metres * widened, min(s.search_radians * widened, math.pi)
        region = SearchRegion(predicted.translation - metres, predicted.translation + metres, predicted.theta, radians)
        return self.matcher.match(points, region, runner_up=None, information=False, time_limit=s.time_limit)

    def _match_within(self, points: FloatArray, predicted: Pose, P: FloatArray) -> Match | None:
        """Return the best pose within what a prediction leaves open, at the most within the window.

        A place is a place of the robot's path. In a window that is wider than the odometry errs, a pose slides along a
        corridor from scan to scan to wherever the map is met best: the true one away from the truth, and a wrong one
        to where it is not told from the truth.
        """
        s = self.settings
        n, cell = self.dim, self.matcher.lattice.resolution
        sigmas = np.sqrt(np.diag(P))
        metres = np.clip(_GATE * sigmas[:n], cell, max(cell, s.search_metres))
        radians = min(_GATE * float(sigmas[n:].max()), s.search_radians)
        region = SearchRegion(predicted.translation - metres, predicted.translation + metres, predicted.theta, radians)
        return self.matcher.match(points, region, runner_up=None, information=False, time_limit=s.time_limit)

    def _match_covariance(self, points: FloatArray, match: Match) -> FloatArray:
        """Return the covariance of a match; of a few points each counts as independent."""
        kept, weights = thin(points, self.matcher.lattice)
        temperature = max(TEMPERATURE, 1.0 / len(points))
        return score_covariance(self.matcher.pyramid, kept, weights, match.searched, temperature=temperature)

    # ------------------------------------------------------------------ lost

    def _search(self, points: FloatArray) -> None:
        """Look for a scan in the whole map; without points nothing is known afterwards either."""
        self._places = []
        # Where scan after scan is not in the map the next is hardly: each wait after the second is twice the last.
        waits = 2.0 ** max(0, self._fruitless - 1)
        s = self.settings
        if len(points) == 0 or (self._waited < waits * s.step_metres and self._turned < waits * s.step_radians):
            return
        self._waited = self._turned = 0.0
        self._places = self._newcomers(points, 0.0)
        self._fruitless = 0 if self._places else min(self._fruitless + 1, _MOST_DOUBLINGS_LOST)
        self._settle_on(points)

    def _doubt(self, place: Place, points: FloatArray) -> None:
        """Give up a pose that was tracked: it becomes one of the places that compete, if its points meet the map.

        Doors open and walls move, and the true place, thrown away for that, would leave a wrong one without a rival.
        """
        place.judged = [evidence for evidence, _ in self._recent]
        self._places = self._newcomers(points, 0.0)
        if meets(self._last_of(place), self.settings):
            apart = self.settings.apart
            place.settled = place.latest = 0.0
            place.view = (0.0, 0.0)
            place.covariance = self._covariance
            place.begin_anew()
            self._places = [p for p in self._places if not is_same_place(p.pose, place.pose, apart)] + [place]
        self._waited = self._turned = 0.0
        self._settle_on(points)

    # ------------------------------------------------------------------ ambiguous

    def _compare(self, points: FloatArray, motion: Pose | None) -> None:
        """Carry all places on and match the scan at each; drop those that fall behind."""
        if len(points) == 0:
            for place in self._places:
                step = motion or place.motion
                place.move(step)
                place.pose = place.pose @ step
            return
        s = self.settings
        view_metres = _VIEW * float(np.median(np.sqrt((points**2).sum(axis=1))))
        kept: list[Place] = []
        moved = False
        for place in self._places:
            place.move(motion or place.motion)
            fresh = float(np.linalg.norm(place.way.translation)) > s.step_metres or place.way.angle > s.step_radians
            if fresh:
                place.settle(view_metres)
                moved = True
            before = place.pose
            place.pose, place.covariance = self._carry_on(
                place.anchor, place.way, place.driven, measured=motion is not None
            )
            match = self._match_within(points, place.pose, place.covariance)
            if match is not None:
                M = self._match_covariance(points, match)
                place.pose, place.covariance = fuse(place.pose, place.covariance, match.pose, M)
            self._judge(place, points, match, fresh)
            if fresh:
                place.begin_anew()
            place.fits = self._agrees(place, loosely=True) or (place.tracked and meets(self._last_of(place), s))
            place.motion = before.inverse() @ place.pose
            kept.append(place)
        if not any(place.fits for place in kept):
            kept = []
        waiting = self.settings.step_metres * 2.0**self._fruitless
        if kept and moved and self._waited >= waiting and not (self._complete and any(map(self._agrees, kept))):
            # There were more places than are carried on, or none agrees: those that fit this scan get their chance.
            # A long corridor looks alike for many metres and is the longest to search, so each wait is twice the last.
            self._waited = 0.0
            found = self._newcomers(points, max(place.settled + place.view[0] for place in kept))
            self._fruitless = 0 if self._complete else min(self._fruitless + 1, _MOST_DOUBLINGS)
            kept += [new for new in found if not any(is_same_place(new.pose, old.pose, s.apart) for old in kept)]
        self._places = kept
        self._settle_on(points)

    def _newcomers(self, points: FloatArray, settled: float) -> list[Place]:
        """Search the whole map, and return the places found; nothing yet speaks against them."""
        s = self.settings
        beams = Evidence.of(len(points), 0.0, 0.0).beams

        def accept(pose: Pose) -> bool:
            share = contradicted_share(self.matcher.pyramid, points, pose)
            return fits([Evidence(beams, 1.0, share)], s)

        # Scans below the usual share are not worth the search, which is long where nothing fits: the next will do.
        found = find_hypotheses(
            self.matcher, points, s.hypotheses, least=s.explained, part=s.part, apart=s.apart,
            accept=accept, time_limit=s.time_limit, node_limit=s.node_limit,
        )  # fmt: skip
        # Where all that score best contradict the map, none is a rival of what is carried on.
        self._complete = found.complete or not found.candidates
        places = []
        for candidate in found.candidates:
            match = self._match_near(points, candidate.pose)
            if match is None:
                continue
            place = Place.at(match.pose, self._match_covariance(points, match), settled=settled)
            self._judge(place, points, match, True)
            if self._agrees(place):
                places.append(place)
        return places

    def _judge(self, place: Place, points: FloatArray, match: Match | None, fresh: bool) -> None:
        """Take a match into account at a place.

        Scans from one spot are all alike: one that is not ``fresh`` replaces the one before it.
        """
        place.match = match
        if not fresh and place.judged:
            place.judged.pop()
        place.judged.append(_evidence(points, match))

    def _last_of(self, place: Place) -> list[Evidence]:
        return place.judged[-self.settings.patience :]

    def _agrees(self, place: Place, *, loosely: bool = False) -> bool:
        """Tell whether the last scans agree with the map at a place, or agree well enough not to drop it."""
        return fits(self._last_of(place), self.settings, tracked=loosely)

    def _weigh(self, points: FloatArray) -> None:
        """Compare the places by the last scan.

        The share of points that meet the map scatters by chance and with the cells they happen to fall into: what is
        within one standard deviation of the best tells nothing, or such chances would add up to certainty. Beams beyond
        walls rule places out, and do not weigh: at the true place too they are as many as doors have been opened.
        """
        shares = [0.0 if place.match is None else place.match.fraction for place in self._places]
        best = max(shares, default=0.0)
        share_of_beam = max(TEMPERATURE, 1.0 / len(points))
        chance = math.sqrt(max(best * (1.0 - best), share_of_beam) * share_of_beam)
        for place, share in zip(self._places, shares, strict=True):
            said = min(0.0, share - best + chance) / share_of_beam if place.fits else -LOUDEST
            place.latest = max(-LOUDEST, said)

    def _settle_on(self, points: FloatArray) -> None:
        """Drop places that are hopeless or the same as a better one, and track the best one if it stands out."""
        s = self.settings
        self._weigh(points)
        order = sorted(range(len(self._places)), key=lambda k: (-self._places[k].likelihood, k))
        kept: list[Place] = []
        for place in (self._places[k] for k in order):
            if kept and kept[0].likelihood - place.likelihood > _HOPELESS:
                break
            same = next((other for other in kept if is_same_place(place.pose, other.pose, s.apart)), None)
            if same is None:
                kept.append(place)
            else:
                same.tracked |= place.tracked
        # The oldest history is what speaks for a place: newcomers do not crowd it out.
        self._places = kept[: 2 * s.hypotheses]
        if not kept:
            self.state = TrackState.lost
            return
        self.state = TrackState.ambiguous
        best = kept[0]
        alone = len(kept) == 1 or best.likelihood - kept[1].likelihood >= math.log(s.odds)
        known = best.tracked or len(best.judged) >= s.scans
        if alone and known and self._complete and best.match is not None and self._agrees(best):
            best.tracked = True
            self._places = [best]
            self._track_from(best.covariance)

    # ------------------------------------------------------------------ tracking

    def _track_from(self, covariance: FloatArray) -> None:
        self.state = TrackState.tracking
        self._covariance = covariance
        self._recent.clear()

    def _start_covariance(self) -> FloatArray:
        """Return the covariance of a pose that may be anywhere in the window."""
        n, size = self.dim, 3 if self.dim == 2 else 6
        sigmas = np.full(size, 0.5 * self.settings.search_radians)
        sigmas[:n] = 0.5 * self.settings.search_metres
        return np.diag(sigmas**2)

    def _track(self, points: FloatArray, motion: Pose | None) -> None:
        """Predict, match, fuse; where the scans of some time do not fit, the robot is lost."""
        s = self.settings
        (place,) = self._places
        before = place.pose
        step = motion or place.motion
        driven = float(np.linalg.norm(step.translation)), step.angle
        predicted, P = self._carry_on((place.pose, self._covariance), step, driven, measured=motion is not None)
        place.pose, self._covariance, place.match = predicted, P, None
        if len(points) == 0:
            return
        match = self._match_near(points, predicted)
        evidence = _evidence(points, match)
        agrees = fits([evidence], s, tracked=True)
        if not agrees:
            # Wheels that slip put the true pose outside any window that is fast for every scan; what is found in a
            # wide one must fit as well as a place that is searched for in the whole map.
            wide = self._match_near(points, predicted, _WIDENED)
            if wide is not None and wide.fraction >= s.explained and fits([_evidence(points, wide)], s):
                match, evidence, agrees = wide, _evidence(points, wide), True
                P = P + self._start_covariance() * _WIDENED**2
        self._recent.append((evidence, agrees))
        place.match = match
        # One scan that disagrees is left out, and says little beside those before it; many that half agree add up.
        if len(self._recent) > 1 and not fits([e for e, _ in self._recent], s, tracked=True):
            self.times_lost += 1
            self.state = TrackState.lost
            self._doubt(place, points)
            return
        if match is not None and agrees:
            place.pose, self._covariance = fuse(predicted, P, match.pose, self._match_covariance(points, match))
        place.motion = before.inverse() @ place.pose

    # ------------------------------------------------------------------ answers

    def _estimate(self, scan: Scan) -> Estimate:
        if not self._places:
            return Estimate(scan.stamp, scan.line, self.state, complete=self._complete)
        best = self._places[0]
        sensor_to_robot = self.mount.inverse()
        heat = np.exp([place.likelihood - best.likelihood for place in self._places])
        hypotheses = [
            Hypothesis(place.pose @ sensor_to_robot, place.match.score if place.match else 0, float(w))
            for place, w in zip(self._places, heat / heat.sum(), strict=True)
        ]
        tracking = self.state is TrackState.tracking
        match = best.match
        return Estimate(
            stamp=scan.stamp,
            line=scan.line,
            state=self.state,
            pose=hypotheses[0].pose if tracking else None,
            covariance=move_point(self._covariance, best.pose, sensor_to_robot) if tracking else None,
            hypotheses=hypotheses,
            score=match.score if match else 0,
            total=match.total if match else 0,
            overlap=match.overlap if match else 0.0,
            contradicted=(match.contradicted or 0.0) if match else 0.0,
            complete=self._complete,
        )


def _evidence(points: FloatArray, match: Match | None) -> Evidence:
    if match is None:
        return Evidence.of(len(points), 0.0, 0.0)
    return Evidence.of(len(points), match.overlap, match.contradicted or 0.0)
