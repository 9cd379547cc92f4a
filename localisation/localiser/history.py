"""What the robot has seen since it began to look for itself: places that are found later are judged by it as well.

A scan that fits at ten places tells nothing of which is true; what was seen on the way there does. A place that is
carried on has that behind it, and a place that only the last search has found must not be believed, nor disbelieved,
for having no past: its past is made up for, scan by scan backwards.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.values import one_line
from hexmap.poses.pose import Pose
from localisation.localiser.evidence import LOUDEST, Evidence, fits, log_odds
from localisation.localiser.fusion import fuse
from localisation.localiser.place import UNSEEN, Place, mean_of, see
from localisation.localiser.place_matcher import PlaceMatcher
from localisation.localiser.settings import LocaliserSettings

__all__ = ["History", "Step"]

# Scans that are kept, one for each step: 50 m of steps of half a metre. What was said before is taken as said.
_KEPT = 100
# And those that are put together: 10 m show more than the repeated doors of a corridor.
_GATHERED = 20


@dataclass(frozen=True)
class Step:
    """What the sensor moved between two scans that were new evidence.

    Attributes:
        way: the motion, by odometry where it was ``measured``.
        driven: metres and radians of the path.
        measured: whether odometry says so, and not the place that fitted best.
    """

    way: Pose
    driven: tuple[float, float]
    measured: bool


@dataclass(frozen=True, eq=False)
class _Seen:
    """A scan as places found later are judged by it.

    Attributes:
        points: (P, n) in the sensor's frame, metres.
        since: the step from the scan before.
        best: the share of points that met the map at the place where it fitted best.
        view_metres: how far the robot must drive until it sees something else.
        credit: what the best place had to its account before this scan.
    """

    points: FloatArray
    since: Step
    best: float
    view_metres: float
    credit: float

    __repr__ = one_line


class History:
    """The scans that were new evidence, in their order.

    Args:
        near: matches them.
        settings: of the localiser.
    """

    def __init__(self, near: PlaceMatcher, settings: LocaliserSettings) -> None:
        self._near = near
        self._settings = settings
        self._seen: deque[_Seen] = deque(maxlen=_KEPT)

    def clear(self) -> None:
        """Forget all: the robot was lost, and may have been put elsewhere."""
        self._seen.clear()

    def add(self, points: FloatArray, since: Step, best: float, view_metres: float, credit: float) -> None:
        """Remember a scan; the arguments are those of what is kept of it."""
        self._seen.append(_Seen(points, since, best, view_metres, credit))

    def gather(self, points: FloatArray, track: Sequence[Pose]) -> FloatArray:
        """Return what is seen now and was seen lately, (P, n), in the frame of the sensor now.

        Args:
            points: (P, n) seen now, in the sensor's frame, metres.
            track: T_map_sensor at the scans that were kept, and now, by a place that was carried on: a rival saw the
                same scans from the same path.
        """
        now = track[-1].inverse()
        lately = zip(reversed(self._seen), reversed(track[:-1]), strict=False)
        before = [(now @ pose).apply(seen.points) for seen, pose in itertools.islice(lately, _GATHERED)]
        return np.concatenate([points, *before])

    def judge(self, place: Place, since: Step, hopeless: float) -> bool:
        """Judge a place, found in the scan that is ``since`` the last one kept, by all that were seen before.

        Its settled log-likelihood and its evidence become those it would have, had it been carried on; views are
        counted from the last one backwards.

        Returns:
            Whether its log-likelihood is not below ``hopeless``.
        """
        if not self._seen:
            return True
        at = place.pose, place.covariance
        settled, view = self._seen[0].credit, UNSEEN
        judged, track = list(place.judged), list(place.track)
        for seen in reversed(self._seen):
            pose, P = self._near.carry_on(at, since.way.inverse(), since.driven, measured=since.measured)
            match = self._near.match_within(seen.points, pose, P)
            at = pose, P
            if match is not None:
                at = fuse(pose, P, match.pose, self._near.covariance(seen.points, match))
            track.insert(0, at[0])
            judged.insert(0, Evidence.of_match(len(seen.points), match))
            share = 0.0 if match is None else match.fraction
            agrees = fits(judged[: self._settings.patience], self._settings, tracked=True)
            said = log_odds(share, seen.best, len(seen.points)) if agrees else -LOUDEST
            over, view = see(view, said, since.driven[0], seen.view_metres)
            settled += over
            if settled < hopeless:
                return False
            since = seen.since
        place.settled = settled + mean_of(view)
        place.judged, place.track = judged, track
        return True
