"""From scans to poses in a known map, without a start pose.

Lost: the whole map is searched for the scan. Ambiguous: all poses that fit are carried on by the robot's motion, each
is matched against every new scan, and what they score adds up until one stands out. Tracking: the scan is matched
around the prediction, and both are fused by their information. When the scans of some time disagree with the map, the
robot is lost.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError
from hexmap.maps.map import Map
from hexmap.maps.state_rule import StateRule, States
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Event, Odometry, Scan
from localisation.localiser.estimate import Estimate, Hypothesis, TrackState
from localisation.localiser.evidence import LOUDEST, Evidence, fits, log_odds, meets
from localisation.localiser.fusion import difference, fuse, move_point
from localisation.localiser.history import History, Step
from localisation.localiser.place import UNSEEN, Place
from localisation.localiser.place_matcher import PlaceMatcher
from localisation.localiser.settings import LocaliserSettings
from localisation.matching.beams import contradicted_share
from localisation.matching.global_matcher import GlobalMatcher
from localisation.matching.hypotheses import find_hypotheses, is_same_place
from localisation.matching.match import Match
from localisation.matching.pyramid import OccupancyPyramid
from localisation.matching.score import coincidence

__all__ = ["Localiser"]

# Metres that no robot drives between two scans: a damaged number or a reset of the odometry.
_FARTHEST_JUMP = 100.0
# How many times as wide the window is where the scan does not fit within it.
_WIDENED = 4.0
# One in e^10 as likely as the best: what is dropped cannot win any more.
_HOPELESS = 10.0
# A search that found too many places, or none, is repeated, and each wait is twice the last, up to 2^5 steps; a robot
# outside the map is looked for every 8 m.
_MOST_DOUBLINGS = 5
# In a corridor there are always more places than are carried on. So many searches in a row, each in another view, that
# list the best places and no rival among them, are taken for completeness: a truth that is not carried on would have
# been outscored in every one of them by as many other places.
_IN_VAIN = 3
# Standard deviations within which two places close together are one.
_ONE_PLACE = 2.0
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
        self._near = PlaceMatcher(self.matcher, self.settings)
        self._history = History(self._near, self.settings)
        self.state = TrackState.lost
        self.times_lost = 0
        self._places: list[Place] = []
        # Whether the last search found all places; as many as it may; how many in a row did, and none was a rival.
        self._complete, self._full, self._in_vain = True, False, 0
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
            self._places = [Place.at(sensor, self._near.window_covariance(), tracked=True)]
            self._track_from(self._near.window_covariance())

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
        self._places = self._newcomers(points)
        self._remember_first(points)
        self._fruitless = 0 if self._places else min(self._fruitless + 1, _MOST_DOUBLINGS)
        self._settle_on(points)

    def _doubt(self, place: Place, points: FloatArray) -> None:
        """Give up a pose that was tracked: it becomes one of the places that compete, if its points meet the map.

        Doors open and walls move, and the true place, thrown away for that, would leave a wrong one without a rival.
        """
        place.judged = [evidence for evidence, _ in self._recent]
        self._places = self._newcomers(points)
        if meets(self._last_of(place), self.settings):
            apart = self.settings.apart
            place.settled = place.latest = 0.0
            place.view = UNSEEN
            place.covariance = self._covariance
            place.track.clear()
            place.begin_anew()
            self._places = [p for p in self._places if not is_same_place(p.pose, place.pose, apart)] + [place]
        self._remember_first(points)
        self._waited = self._turned = 0.0
        self._settle_on(points)

    def _remember_first(self, points: FloatArray) -> None:
        """Begin the history of a robot that may have been put elsewhere."""
        self._in_vain = 0
        self._history.clear()
        still = Step(Pose.identity(self.dim), (0.0, 0.0), True)
        self._history.add(points, still, _best_share(self._places), _view_metres(points), 0.0)

    # ------------------------------------------------------------------ ambiguous

    def _compare(self, points: FloatArray, motion: Pose | None) -> None:
        """Carry all places on and match the scan at each; drop those that fall behind."""
        s = self.settings
        for place in self._places:
            place.move(motion or place.motion)
        # All places have the same anchors: those of the last scan that was new evidence.
        fresh = any(p.way.angle > s.step_radians or p.metres_on > s.step_metres for p in self._places)
        if len(points) == 0 or (motion is not None and not fresh):
            self._wait(points, measured=motion is not None)
            return
        view_metres = _view_metres(points)
        if fresh:
            for place in self._places:
                place.settle(view_metres)
        best = self._places[0]
        step = Step(best.way, best.driven, motion is not None)
        credit = max(place.so_far for place in self._places)
        kept: list[Place] = []
        for place in self._places:
            before = place.pose
            place.pose, place.covariance = self._near.carry_on(
                place.anchor, place.way, place.driven, measured=motion is not None
            )
            match = self._near.match_within(points, place.pose, place.covariance)
            if match is not None:
                M = self._near.covariance(points, match)
                place.pose, place.covariance = fuse(place.pose, place.covariance, match.pose, M)
            self._judge(place, points, match, fresh)
            if fresh:
                place.begin_anew()
            place.fits = self._agrees(place, loosely=True) or (place.tracked and meets(self._last_of(place), s))
            place.motion = before.inverse() @ place.pose
            kept.append(place)
        if not any(place.fits for place in kept):
            kept = []
        waiting = min(s.step_metres * 2.0**self._fruitless, max(s.step_metres, view_metres))
        if kept and fresh and self._waited >= waiting and not (self._all_known and any(map(self._agrees, kept))):
            kept += self._rivals(points, kept, step, credit)
        if fresh:
            self._history.add(points, step, _best_share(kept), view_metres, credit)
        self._places = kept
        self._settle_on(points)

    def _rivals(self, points: FloatArray, kept: list[Place], step: Step, credit: float) -> list[Place]:
        """Search the map again; return the places that are not ``kept`` yet, judged by what was seen before.

        There were more places than are carried on, or none agrees: those that fit what was seen get their chance. A
        long corridor looks alike for many metres and is the longest to search, so each wait is twice the last, until
        the robot sees something else.
        """
        s = self.settings
        self._waited = 0.0
        found = self._newcomers(points, self._history.gather(points, self._places[0].track))
        self._fruitless = 0 if self._complete else min(self._fruitless + 1, _MOST_DOUBLINGS)
        new = [p for p in found if not any(_is_same(p, old, s.apart) for old in kept)]
        new = [p for p in new if self._history.judge(p, step, credit - _HOPELESS)]
        rival = any(p.settled > credit - math.log(s.odds) for p in new)
        self._in_vain = 0 if rival or not self._full else self._in_vain + 1
        return new

    def _wait(self, points: FloatArray, *, measured: bool) -> None:
        """Carry all places on by odometry alone, and match a scan that is no new evidence at the best one only.

        Matches between two anchors leave no trace in what is known later, at many places cost many times a search, and
        give a wrong place as many more chances to look right for a moment.
        """
        for place in self._places:
            place.pose, place.covariance = self._near.carry_on(place.anchor, place.way, place.driven, measured=measured)
        best = self._places[0]
        best.match = self._near.match_within(points, best.pose, best.covariance) if len(points) else None

    def _newcomers(self, points: FloatArray, gathered: FloatArray | None = None) -> list[Place]:
        """Search the whole map for a scan, or for what was ``gathered`` on the way to it; return the places found."""
        s = self.settings
        beams = Evidence.of(len(points), 0.0, 0.0).beams

        def accept(pose: Pose) -> bool:
            share = contradicted_share(self.matcher.pyramid, points, pose)
            return fits([Evidence(beams, 1.0, share)], s)

        # Scans below the usual share are not worth the search, which is long where nothing fits: the next will do.
        found = find_hypotheses(
            self.matcher, points if gathered is None else gathered, s.hypotheses, least=s.explained, part=s.part,
            apart=s.apart, accept=accept, time_limit=s.time_limit, node_limit=s.node_limit,
        )  # fmt: skip
        # Where all that score best contradict the map, none is a rival of what is carried on.
        self._complete = found.complete or not found.candidates
        self._full = len(found.candidates) >= s.hypotheses
        places = []
        for candidate in found.candidates:
            match = self._near.match_near(points, candidate.pose)
            if match is None:
                continue
            place = Place.at(match.pose, self._near.covariance(points, match))
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
        place.judged.append(Evidence.of_match(len(points), match))

    @property
    def _all_known(self) -> bool:
        """Whether no place is left that could be a rival: all were found, or the best of all are none."""
        return self._complete or self._in_vain >= _IN_VAIN

    def _last_of(self, place: Place) -> list[Evidence]:
        return place.judged[-self.settings.patience :]

    def _agrees(self, place: Place, *, loosely: bool = False) -> bool:
        """Tell whether the last scans agree with the map at a place, or agree well enough not to drop it."""
        return fits(self._last_of(place), self.settings, tracked=loosely)

    def _weigh(self, points: FloatArray) -> None:
        """Compare the places by the last scan.

        Beams beyond walls rule places out, and do not weigh: at the true place too they are as many as doors have been
        opened.
        """
        best = _best_share(self._places)
        for place in self._places:
            place.latest = log_odds(_share(place), best, len(points)) if place.fits else -LOUDEST

    def _settle_on(self, points: FloatArray) -> None:
        """Drop places that are hopeless or the same as a better one, and track the best one if it stands out."""
        s = self.settings
        self._weigh(points)
        order = sorted(range(len(self._places)), key=lambda k: (-self._places[k].likelihood, k))
        kept: list[Place] = []
        for place in (self._places[k] for k in order):
            if kept and kept[0].likelihood - place.likelihood > _HOPELESS:
                break
            same = next((other for other in kept if _is_same(place, other, s.apart)), None)
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
        if alone and known and self._all_known and best.match is not None and self._agrees(best):
            best.tracked = True
            self._places = [best]
            self._track_from(best.covariance)

    # ------------------------------------------------------------------ tracking

    def _track_from(self, covariance: FloatArray) -> None:
        self.state = TrackState.tracking
        self._covariance = covariance
        self._recent.clear()

    def _track(self, points: FloatArray, motion: Pose | None) -> None:
        """Predict, match, fuse; where the scans of some time do not fit, the robot is lost."""
        s = self.settings
        (place,) = self._places
        before = place.pose
        step = motion or place.motion
        driven = float(np.linalg.norm(step.translation)), step.angle
        predicted, P = self._near.carry_on((place.pose, self._covariance), step, driven, measured=motion is not None)
        place.pose, self._covariance, place.match = predicted, P, None
        if len(points) == 0:
            return
        match = self._near.match_near(points, predicted)
        evidence = Evidence.of_match(len(points), match)
        agrees = fits([evidence], s, tracked=True)
        if not agrees:
            # Wheels that slip put the true pose outside any window that is fast for every scan; what is found in a
            # wide one must fit as well as a place that is searched for in the whole map.
            wide = self._near.match_near(points, predicted, _WIDENED)
            if wide is not None and wide.fraction >= s.explained and fits([Evidence.of_match(len(points), wide)], s):
                match, evidence, agrees = wide, Evidence.of_match(len(points), wide), True
                P = P + self._near.window_covariance() * _WIDENED**2
        self._recent.append((evidence, agrees))
        place.match = match
        # One scan that disagrees is left out, and says little beside those before it; many that half agree add up.
        if len(self._recent) > 1 and not fits([e for e, _ in self._recent], s, tracked=True):
            self.times_lost += 1
            self.state = TrackState.lost
            self._doubt(place, points)
            return
        if match is not None and agrees:
            place.pose, self._covariance = fuse(predicted, P, match.pose, self._near.covariance(points, match))
        place.motion = before.inverse() @ place.pose

    # ------------------------------------------------------------------ answers

    def _estimate(self, scan: Scan) -> Estimate:
        if not self._places:
            return Estimate(scan.stamp, scan.line, self.state, complete=self._all_known)
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
            complete=self._all_known,
        )


def _is_same(place: Place, other: Place, apart: tuple[float, float]) -> bool:
    """Tell whether two places are one: close together, or not farther than that beyond what is in doubt of them.

    Along a corridor a place may be carried on twice, half a metre apart, and nothing would ever tell the two apart.
    """
    if is_same_place(place.pose, other.pose, apart):
        return True
    if not is_same_place(place.pose, other.pose, (2.0 * apart[0], 2.0 * apart[1])):
        return False
    between = difference(place.pose, other.pose)
    return float(between @ np.linalg.solve(place.covariance + other.covariance, between)) <= _ONE_PLACE**2


def _view_metres(points: FloatArray) -> float:
    """Return how far the robot drives until it sees something else."""
    return _VIEW * float(np.median(np.sqrt((points**2).sum(axis=1)))) if len(points) else 0.0


def _share(place: Place) -> float:
    """Return the share of the last scan's points that meet the map at a place."""
    return 0.0 if place.match is None else place.match.fraction


def _best_share(places: Sequence[Place]) -> float:
    return max((_share(place) for place in places), default=0.0)
