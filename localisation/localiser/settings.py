"""What a localiser can be told."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hexmap.base.errors import ArgumentError

__all__ = ["LocaliserSettings"]


@dataclass(frozen=True)
class LocaliserSettings:
    """Settings of a localiser; the defaults serve every map and log we know.

    ``explained`` says that more of a scan is in the map than not. ``changed`` follows from it: of the other half of the
    beams as many end beyond a wall as short of one. ``contradicted`` is measured at the reference poses of scans that
    took no part in the map, beams beyond walls: median 4 % in Belgioioso, 6 % in the ACES building, 13 % in Wean Hall,
    whose walls are drawn half a metre thick.

    Attributes:
        min_range: points nearer than this, metres, are left out.
        max_range: points farther than this, metres, are left out.
        use_odometry: whether odometry predicts the motion; if not, the last motion does.
        search_metres: how far from the prediction a tracked pose is looked for, along each axis.
        search_radians: the same for the yaw, to both sides.
        time_limit: seconds that one search over the whole map may take; None: as many as it needs.
        node_limit: nodes that one may take, some seconds: where nothing fits a proof is long; the next scan will do.
        hypotheses: poses that are carried on at the most while it is not clear which is true.
        part: share of the best score down to which a pose is worth carrying on.
        apart: metres and radians within which two poses are the same.
        odds: how many times as likely as the next one a pose must be to be answered.
        scans: scans, each new evidence, that must agree with a pose before it is answered.
        step_metres: what the robot must have moved before a scan is new evidence; from one place all scans are alike.
        step_radians: the same for a turn.
        explained: share of the points that meet the map in a building that has not changed too much.
        contradicted: share of the beams that go through walls of such a map, at the true pose.
        changed: the same for a pose that is tracked, in a map of which much may have changed since.
        sigmas: standard deviations from these shares at which a map is said not to fit (2.33: one scan in a hundred).
        patience: scans over which a tracked pose is judged.
        drift: metres a metre and radians a radian by which odometry errs.
        drift_metres: metres by which it errs in any case.
        drift_radians: radians by which it errs in any case.
    """

    min_range: float = 0.0
    max_range: float = math.inf
    use_odometry: bool = True
    search_metres: float = 0.4
    search_radians: float = math.radians(15.0)
    time_limit: float | None = None
    node_limit: int = 8_000_000
    hypotheses: int = 8
    part: float = 0.9
    apart: tuple[float, float] = (0.5, math.radians(10.0))
    odds: float = 1000.0
    scans: int = 3
    step_metres: float = 0.5
    step_radians: float = math.radians(30.0)
    explained: float = 0.5
    contradicted: float = 0.15
    changed: float = 0.25
    sigmas: float = 2.33
    patience: int = 5
    drift: float = 0.1
    drift_metres: float = 0.02
    drift_radians: float = 0.01

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ArgumentError: one is out of its range.
        """
        for name in ("min_range", "search_metres", "step_metres", "step_radians", "sigmas", "drift"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ArgumentError(f"the setting {name} is zero or more, not {getattr(self, name)}")
        for name in ("hypotheses", "scans", "patience", "odds", "drift_metres", "drift_radians"):
            least = 0.0 if name.startswith("drift") else 1.0
            if not (getattr(self, name) >= least and getattr(self, name) > 0.0):
                raise ArgumentError(f"the setting {name} is too small: {getattr(self, name)}")
        for name in ("part", "explained", "contradicted", "changed"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise ArgumentError(f"the setting {name} is a share between 0 and 1, not {getattr(self, name)}")
        if not 0.0 < self.search_radians <= math.pi:
            raise ArgumentError(f"the setting search_radians is an angle up to pi, not {self.search_radians}")
        if not self.max_range > self.min_range:
            raise ArgumentError(f"no range lies between {self.min_range:g} and {self.max_range:g} m")
        if self.node_limit < 1:
            raise ArgumentError(f"a search takes at least one node, not {self.node_limit}")
        if self.time_limit is not None and not self.time_limit > 0.0:
            raise ArgumentError(f"the time limit must be positive, not {self.time_limit} s")
