"""Localise a robot along a whole log, and write down what was known after each scan."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from hexmap.base.errors import BoundsError, LogError
from hexmap.base.values import one_line
from hexmap.io.logs.log import Log
from hexmap.maps.map import Map
from hexmap.maps.state_rule import StateRule, States
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from localisation.localiser.estimate import Estimate, TrackState
from localisation.localiser.localiser import Localiser
from localisation.localiser.settings import LocaliserSettings

__all__ = ["CSV_HEADER", "Track", "TrackCounter", "csv_line", "localise_log"]

CSV_HEADER = (
    "stamp,line,state,x,y,theta,score,total,overlap,contradicted,cov_xx,cov_xy,cov_yy,cov_tt,"
    "runner_up_score,runner_up_x,runner_up_y,runner_up_theta"
)


@dataclass(frozen=True, eq=False)
class Track:
    """What was counted along a log.

    Attributes:
        scans: laser readings.
        placed: those with a pose.
        scans_until: scans until the first pose, itself included; None: there was none.
        metres_until: metres driven until then by the odometry, 0 where the log has none.
        times_lost: how often a pose was given up.
        metres: length of the path between poses that follow each other.
        warnings: what was wrong with the log, one line each.
    """

    scans: int
    placed: int
    scans_until: int | None
    metres_until: float
    times_lost: int
    metres: float
    warnings: list[str]

    __repr__ = one_line


def localise_log(
    log: Log,
    world: Map | States,
    settings: LocaliserSettings | None = None,
    *,
    mount: Pose | None = None,
    start: Pose | None = None,
    rule: StateRule | None = None,
    level: int = 0,
    on_estimate: Callable[[Estimate], None] | None = None,
    progress: Callable[[int], None] | None = None,
) -> Track:
    """Localise a robot in a map along a log; the arguments are those of :class:`Localiser`.

    Args:
        log: an open log.
        world: the map.
        settings: of the localiser.
        mount: T_robot_laser; None: as the log says, else the laser is where the robot is.
        start: T_map_robot at the first scan, where it is known.
        rule: what an occupied cell is.
        level: of the map.
        on_estimate: called with what is known after each scan, in the log's order.
        progress: called after each scan with the number of scans so far.

    Raises:
        LogError: the log cannot be read, has no laser reading, or none that can be used.
    """
    localiser: Localiser | None = None
    counted = TrackCounter(str(log.path), on_estimate, progress)
    metres = 0.0
    reading: Pose | None = None
    before: Pose | None = None
    for event in log:
        if localiser is None:
            localiser = Localiser(world, settings, mount=mount or log.mount, start=start, rule=rule, level=level)
        if not isinstance(event, Scan):
            reading = event.pose
        else:
            # From scan to scan: a scan's own reading is older than the lines around it, and to and fro is no way.
            at = event.odometry if event.odometry is not None else reading
            if at is not None and before is not None and counted.scans_until is None and counted.scans:
                metres += math.dist(before.translation, at.translation)
            before = at
        try:
            estimate = localiser.add(event)
        except BoundsError as error:
            counted.leave_out(f"line {event.line}: {error}" if event.line is not None else str(error))
            continue
        if estimate is not None:
            counted.add(estimate)
    if localiser is None:
        raise LogError(f"{log.path}: there is no laser reading in it")
    return counted.track(localiser.times_lost, log.warnings, metres)


class TrackCounter:
    """Counts along a log what is known after each scan, and passes it on.

    Attributes:
        scans: so far.
        scans_until: the first pose, itself included; None: there was none yet.
    """

    def __init__(
        self,
        log: str,
        on_estimate: Callable[[Estimate], None] | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> None:
        """Begin; ``log`` is its name in messages."""
        self._log, self._on_estimate, self._progress = log, on_estimate, progress
        self.scans = self._placed = self._unusable = 0
        self.scans_until: int | None = None
        self._first_bad = ""
        self._metres = 0.0
        self._last: Pose | None = None

    def add(self, estimate: Estimate) -> None:
        """Take what is known after the next scan."""
        self.scans += 1
        if estimate.pose is not None:
            self._placed += 1
            self.scans_until = self.scans_until or self.scans
            if self._last is not None:
                self._metres += math.dist(self._last.translation, estimate.pose.translation)
        self._last = estimate.pose
        if self._on_estimate is not None:
            self._on_estimate(estimate)
        if self._progress is not None:
            self._progress(self.scans)

    def leave_out(self, why: str) -> None:
        """Count a scan that cannot be used."""
        self._unusable += 1
        self._first_bad = self._first_bad or why

    def track(self, times_lost: int, warnings: list[str], metres_until: float = 0.0) -> Track:
        """Return what was counted.

        Raises:
            LogError: there were scans, and none of them could be used.
        """
        if self._unusable and not self.scans:
            raise LogError(f"{self._log}: no scan can be used, {self._first_bad}")
        notes = list(warnings)
        if self._unusable:
            notes.append(
                f"{self._log}: {self._unusable} scans cannot be used and are left out, the first at {self._first_bad}"
            )
        return Track(self.scans, self._placed, self.scans_until, metres_until, times_lost, self._metres, notes)


def csv_line(estimate: Estimate) -> str:
    """Return what is known after a scan as a line of the columns of ``CSV_HEADER``, metres and radians.

    x, y and theta are the pose while tracking, the most likely one while ambiguous, empty while lost. The covariance is
    that of the pose, about the robot; the runner-up the next likely place.
    """
    pose = estimate.hypotheses[0].pose if estimate.state is not TrackState.lost and estimate.hypotheses else None
    cells = [f"{estimate.stamp:.6f}", "" if estimate.line is None else str(estimate.line), estimate.state.value]
    cells += _pose_cells(pose)
    cells += [str(estimate.score), str(estimate.total), f"{estimate.overlap:.4f}", f"{estimate.contradicted:.4f}"]
    C = estimate.covariance
    # The heading stands last in the plane; in space it is the turn about z, and so is the last one too.
    cells += [""] * 4 if C is None else [f"{v:.9g}" for v in (C[0, 0], C[0, 1], C[1, 1], C[-1, -1])]
    second = estimate.hypotheses[1] if len(estimate.hypotheses) > 1 else None
    cells += ["" if second is None else str(second.score), *_pose_cells(second.pose if second else None)]
    return ",".join(cells)


def _pose_cells(pose: Pose | None) -> list[str]:
    return [""] * 3 if pose is None else [f"{pose.x:.6f}", f"{pose.y:.6f}", f"{pose.theta:.6f}"]
