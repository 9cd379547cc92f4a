"""Where a LiDAR is in a known map of space: found without a start pose, tracked, and found again when lost.

A scan is levelled by the floors and ceilings that it sees, searched for by the certified matcher over all yaws on
coarse cells, drawn onto the map's surfaces, and then asked how many of its points lie on occupied cells of the finest
level and how many where the map is free. In a foreign building a search finds something, too; that question tells.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError, BoundsError
from hexmap.io.lidar.lidar_log import LidarLog
from hexmap.lattice.lattice import Lattice
from hexmap.maps.state_rule import States
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from localisation.lidar_settings import LidarSettings
from localisation.localiser.estimate import Estimate, Hypothesis, TrackState
from localisation.localiser.localise_log import Track, TrackCounter
from localisation.matching.global_matcher import GlobalMatcher, spread_points
from localisation.matching.gravity import levelling_of
from localisation.matching.match import Match
from localisation.matching.pyramid import OccupancyPyramid
from localisation.matching.score import coincidence
from localisation.matching.search_region import SearchRegion, cells_of_box
from localisation.matching.surfaces import Drawn, SurfaceMap, first_of_each_cell
from localisation.odometry.lidar_odometry import LidarOdometry, surface_lattice
from localisation.slam import spatial
from localisation.slam.lidar_loops import drawn_covariance

__all__ = [
    "LidarLocaliser",
    "Place",
    "localise_lidar_log",
    "map_surface_lattice",
    "space_csv_header",
    "space_csv_line",
]

# Cells of the search hold so many cells of the map at least: glass and fog leave single ones far outside.
_LEAST_CELLS = 3
# Blocks and poses that a search may take: a scan in its own map takes a tenth of it. What a small room's scan meets all
# over a large hall is not searched to its end.
_NODES = 1_000_000
# In cells of the map, what is searched on at least: a plane's cells stand for its points, and there are enough of them.
_COARSE = 5.0
# Points that are searched with, and by how much floors may mislead about what is up, radians.
_POINTS, _TILT = 300, math.radians(2.0)
# Below this share of the points no place is looked for: of a scan in its own map nine in ten coincide, of one in
# another building no more than half do.
_LEAST_SHARE = 0.6
# A scan belongs where so many of its points lie on occupied cells or beside them, and so few where the map is free. A
# third of what is seen may have changed. In foreign buildings a third lay on something, and half of it in free space.
_LEAST_MET, _MOST_CONTRADICTED = 0.65, 0.25
# Share of points that must lie on the map's planes where it may know no more than half of them.
_LEAST_DRAWN = 0.3
# Two places are told apart where one has so much more of the scan's points on occupied cells.
_MARGIN = 0.05
# Places nearer than this are the same, metres and radians.
_APART = (1.0, math.radians(10.0))
# Down to which part of the best score other places are looked for. The cells of two maps lie apart as chance has it:
# turned by half, a hall whose cells happen to lie on each other scores more than where it belongs.
_RIVALS, _RIVALS_OF_MAPS = 0.9, 0.75
# Of a map of many rooms, places that far from one another are told apart once more.
_FAR_APART = (4.0, math.radians(60.0))
# Scans in a row that do not belong where they were tracked to: then the sensor is lost.
_PATIENCE = 3
# Fewer points than this are no scan.
_FEWEST = 10
# Metres and radians around a start pose.
_START = (1.0, math.radians(20.0))


@dataclass(frozen=True, eq=False)
class Place:
    """A pose in a map that was verified.

    Attributes:
        pose: T_map_sensor.
        match: what the search said.
        drawn: what the surfaces said.
        met: share of points on occupied cells.
        contradicted: share of points where the map is free.
        total: how many points there were.
    """

    pose: Pose
    match: Match | None
    drawn: Drawn
    met: float
    contradicted: float
    total: int

    @property
    def belongs(self) -> bool:
        """Whether a scan belongs there, all of which the map should know."""
        return self.drawn.converged and self.met >= _LEAST_MET and self.contradicted <= _MOST_CONTRADICTED

    @property
    def holds(self) -> bool:
        """Whether points belong there of which the map may know no more than a part."""
        known = self.met + self.contradicted
        on_surfaces = self.drawn.converged and self.drawn.share >= _LEAST_DRAWN
        return on_surfaces and self.contradicted <= _MOST_CONTRADICTED * known


class LidarLocaliser:
    """Finds a LiDAR in a map of space and follows it, on any lattice.

    Attributes:
        times_lost: how often a pose was given up.
    """

    def __init__(
        self,
        states: States,
        settings: LidarSettings | None = None,
        *,
        start: tuple[float, float, float] | None = None,
        time_limit: float | None = None,
        mount: Pose | None = None,
    ) -> None:
        """Take a map.

        Args:
            states: its occupied and free cells.
            settings: of the LiDAR: ranges; lattice and resolution are the map's.
            start: x, y (metres) and yaw (radians) of the robot at the first scan, where they are known.
            time_limit: seconds that a search may take; what it has not finished by then is no answer.
            mount: T_robot_sensor: estimates are those of the robot then; None: of the sensor.

        Raises:
            ArgumentError: a map of the plane, or without an occupied cell.
            MissingDependencyError: kiss-icp cannot be loaded.
        """
        lattice = states.occupied.lattice
        if lattice.dim != 3:
            raise ArgumentError(f"a LiDAR is found in a map of space, and {lattice.name} is a lattice of the plane")
        if len(states.occupied) == 0:
            raise ArgumentError("no cell of the map is occupied, nothing can be found in it")
        self._states, self._settings = states, settings or LidarSettings()
        self._start, self._time_limit = start, time_limit
        self._mount = mount or Pose.identity(3)
        self._odometry: LidarOdometry | None = None
        self._surfaces: SurfaceMap | None = None
        self._bad = 0
        self.times_lost = 0

    # ------------------------------------------------------------------ the map

    def _prepare(self, points: FloatArray) -> None:
        """Make the tables of the map for what the sensor sees."""
        fine = self._states.occupied.lattice
        coarse = map_surface_lattice(fine, points)
        centres = fine.centres(self._states.occupied.index)
        self._surfaces = SurfaceMap(coarse)
        self._surfaces.add(centres)
        cells = VoxelList.from_points(centres, coarse)
        cells = cells.select(cells.counts >= _LEAST_CELLS) if (cells.counts >= _LEAST_CELLS).any() else cells
        inside = coarse.centres(cells.index)
        low, high = inside.min(axis=0), inside.max(axis=0)
        known = VoxelList.from_points(fine.centres(self._states.free.index), coarse).merge(cells)
        at = coarse.centres(known.index)
        known = known.select(((at >= low) & (at <= high)).all(axis=1))
        if len(self._states.free) == 0:
            # A map without free space does not say where a sensor may be.
            known = cells_of_box(coarse, low, high)
        self._matcher = GlobalMatcher(OccupancyPyramid(coincidence(cells)), coincidence(known))
        self._low, self._high = low, high
        index = self._states.occupied.index.astype(np.int64)
        near = np.concatenate([index, *[index + o for o in fine.neighbours]])
        self._near = VoxelList.from_cells(near, fine)

    def _verify(
        self, thin: FloatArray, start: Pose, match: Match | None, drawn: Drawn | None = None,
        judged: FloatArray | None = None,
    ) -> Place:  # fmt: skip
        """Draw a scan onto the surfaces and ask how it, or those points that are judged by, agrees with the cells."""
        assert self._surfaces is not None
        drawn = drawn or self._surfaces.draw(thin, start, farthest=2.0)
        placed = drawn.pose.apply(thin if judged is None else judged)
        met = self.meets(placed)
        free = ~met & self._states.free.contains(self._states.occupied.lattice.quantise(placed))
        count = max(1, len(placed))
        return Place(drawn.pose, match, drawn, float(met.sum()) / count, float(free.sum()) / count, len(placed))

    def meets(self, points: FloatArray) -> NDArray[np.bool_]:
        """Tell which points (N, 3) of the map's frame lie on occupied cells or beside; after a search or drawing."""
        return np.asarray(self._near.contains(self._states.occupied.lattice.quantise(points)))

    def draw(self, points: FloatArray, start: Pose, judged: FloatArray | None = None) -> Place:
        """Draw points (N, 3) of any frame onto the map near ``start`` (T_map_frame), and say how they agree with it.

        ``judged`` (K, 3) are those of them, in the same frame, by whose agreement the place is judged; None: all.
        """
        if self._surfaces is None:
            self._prepare(self._settings.in_range(points))
        assert self._surfaces is not None
        thin = first_of_each_cell(points, self._surfaces.lattice.scaled(1.0 / 3.0))
        return self._verify(thin, start, None, self._surfaces.draw(thin, start), judged)

    # ------------------------------------------------------------------ scan by scan

    def add(self, scan: Scan) -> Estimate:
        """Take the next scan and return what is known after it.

        Raises:
            ArgumentError: a scan of the plane.
            BoundsError: a point is out of range.
        """
        if scan.dim != 3:
            raise ArgumentError("a LiDAR's scan has points in space, not in the plane")
        if self._surfaces is None:
            points = self._settings.in_range(scan.points)
            self._prepare(points if len(points) else np.ones((1, 3)))
        if self._odometry is None:
            return self._find(scan)
        return self._follow(scan)

    def __repr__(self) -> str:
        """Say how often a pose was given up."""
        return f"<LidarLocaliser, {self.times_lost} times lost>"

    def forget(self) -> None:
        """Forget where the sensor was: the next scan is looked for in the whole map."""
        self._odometry, self._bad = None, 0

    def _follow(self, scan: Scan) -> Estimate:
        """Track: draw the scan onto the map where the motion puts it."""
        assert self._odometry is not None
        sweep = self._odometry.register(scan)
        place = None
        if not sweep.missed and sweep.drawn is not None and len(sweep.points):
            place = self._verify(sweep.points, sweep.pose, None, sweep.drawn)
        if place is not None and place.belongs:
            self._bad = 0
            return self._answer(scan, place, len(sweep.points))
        self._bad += 1
        if self._bad < _PATIENCE:
            return Estimate(scan.stamp, scan.line, TrackState.lost)
        self.times_lost += 1
        self._odometry = None
        return self._find(scan)

    def _answer(self, scan: Scan, place: Place, total: int) -> Estimate:
        pose = self._of_robot(place.pose)
        A = spatial.adjoint(spatial.of_pose(self._mount))
        turn = np.zeros((6, 6))
        turn[:3, :3] = turn[3:, 3:] = pose.rotation
        turn = turn @ A
        score = round(place.met * total)
        return Estimate(
            scan.stamp, scan.line, TrackState.tracking, pose, turn @ drawn_covariance(place.drawn) @ turn.T,
            [Hypothesis(pose, score, 1.0)], score, total, place.met, place.contradicted,
        )  # fmt: skip

    def _of_robot(self, pose: Pose) -> Pose:
        """Return T_map_robot of a pose T_map_sensor."""
        return pose @ self._mount.inverse()

    def _find(self, scan: Scan) -> Estimate:
        """Look for a scan in the whole map."""
        odometry = LidarOdometry(self._settings)
        places = self.look_for(scan.points)
        if not places:
            return Estimate(scan.stamp, scan.line, TrackState.lost)
        first = places[0]
        if len(places) > 1:
            found = [Hypothesis(self._of_robot(p.pose), round(p.met * p.total), 0.5) for p in places]
            return Estimate(
                scan.stamp, scan.line, TrackState.ambiguous, None, None, found, found[0].score, first.total, first.met,
                first.contradicted,
            )  # fmt: skip
        odometry.begin_at(scan, first.pose, self._surfaces)
        self._odometry, self._start, self._bad = odometry, None, 0
        return self._answer(scan, first, first.total)

    def look_for(self, points: FloatArray, judged: FloatArray | None = None) -> list[Place]:
        """Return where points (N, 3) in the sensor's frame belong in the whole map.

        Args:
            points: that are drawn onto the map's surfaces.
            judged: (K, 3) those of them that are searched for, and by which a place is judged; None: all.

        Returns:
            None, one, or two places that cannot be told apart, the likelier one first.

        Raises:
            BoundsError: a point is out of range.
        """
        points = self._settings.in_range(points)
        if self._surfaces is None:
            self._prepare(points if len(points) else np.ones((1, 3)))
        lattice = self._matcher.lattice
        thin = first_of_each_cell(points, lattice.scaled(1.0 / 3.0))
        if len(thin) < _FEWEST or (judged is not None and len(judged) < _FEWEST):
            return []
        level = self._level(points, lattice)
        told_by = spread_points(level.apply(points if judged is None else judged), lattice, _POINTS)
        rivals = _RIVALS if judged is None else _RIVALS_OF_MAPS
        match = self._search(told_by, _APART, rivals)
        if match is None:
            return []
        places = [self._verify(thin, match.pose @ level, match, judged=judged)]
        if match.runner_up is not None:
            places.append(self._verify(thin, match.runner_up.pose @ level, match, judged=judged))
        if judged is not None and len(places) > 1 and not _is_apart(places[0].pose, places[1].pose):
            # The next best was the best once more. What a map is like in a mirror, or turned, lies farther off.
            match = self._search(told_by, _FAR_APART, rivals)
            if match is not None and match.runner_up is not None:
                places[1] = self._verify(thin, match.runner_up.pose @ level, match, judged=judged)
        places = [p for p in places if p.belongs]

        def value(place: Place) -> float:
            # Of a whole map what stands where the other is free tells more than what is missing.
            return place.met if judged is None else place.met - place.contradicted

        places.sort(key=lambda p: -value(p))
        if len(places) > 1 and (
            value(places[1]) <= value(places[0]) - _MARGIN or not _is_apart(places[0].pose, places[1].pose)
        ):
            places.pop()
        return places

    def _search(self, points: FloatArray, apart: tuple[float, float], rivals: float) -> Match | None:
        """Search the map for points in level axes; None where it holds nothing like them, or it takes too long.

        A runner-up is looked for down to the part ``rivals`` of the best score.
        """
        match = self._matcher.match(
            points, self._region(), apart=apart, runner_up=rivals, least=_LEAST_SHARE, refine=False, beams=False,
            information=False, time_limit=self._time_limit, node_limit=_NODES,
        )  # fmt: skip
        return match if match is not None and match.certified else None

    def _region(self) -> SearchRegion:
        if self._start is None:
            return SearchRegion(tilt=_TILT)
        x, y, yaw = self._start
        # The search turns a scan whose axes are level and the robot's, about the sensor.
        c, s = math.cos(yaw), math.sin(yaw)
        ahead, left = self._mount.translation[:2].tolist()
        x, y = x + c * ahead - s * left, y + s * ahead + c * left
        low = np.array([x - _START[0], y - _START[0], self._low[2]])
        high = np.array([x + _START[0], y + _START[0], self._high[2]])
        return SearchRegion(low, high, yaw, _START[1], _TILT)

    def _level(self, points: FloatArray, lattice: Lattice) -> Pose:
        """Return the attitude of the sensor but for yaw: as it is mounted, and by the floors that it sees."""
        mounted = Pose(self._mount.rotation, np.zeros(3))
        return levelling_of(mounted.apply(points), lattice) @ mounted


def map_surface_lattice(fine: Lattice, points: FloatArray) -> Lattice:
    """Return the lattice of the surfaces that a map's occupied cells make, and on which it is searched.

    Args:
        fine: the lattice of the map.
        points: (N, 3) a scan of the sensor, metres.
    """
    coarse, _ = surface_lattice(fine, points)
    return fine.scaled(max(coarse.resolution / fine.resolution, _COARSE))


def _is_apart(a: Pose, b: Pose) -> bool:
    off = a.inverse() @ b
    yaw = math.atan2(off.rotation[1, 0], off.rotation[0, 0])
    return float(np.linalg.norm(off.translation)) > _APART[0] or abs(yaw) > _APART[1]


def localise_lidar_log(
    log: LidarLog,
    states: States,
    settings: LidarSettings | None = None,
    *,
    start: tuple[float, float, float] | None = None,
    time_limit: float | None = None,
    on_estimate: Callable[[Estimate], None] | None = None,
    progress: Callable[[int], None] | None = None,
) -> Track:
    """Localise a LiDAR in a map along a log; see :class:`LidarLocaliser`.

    Raises:
        LogError: the log cannot be read, has no scan, or none that can be used.
    """
    localiser = LidarLocaliser(states, settings, start=start, time_limit=time_limit, mount=log.mount)
    counted = TrackCounter(str(log.path), on_estimate, progress)
    for scan in log:
        try:
            counted.add(localiser.add(scan))
        except BoundsError as error:
            counted.leave_out(f"scan {scan.line}: {error}")
    return counted.track(localiser.times_lost, log.warnings)


_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_VARIANCES = ("var_x", "var_y", "var_z", "var_rx", "var_ry", "var_rz")


def space_csv_header() -> str:
    """Return the names of the columns of :func:`space_csv_line`."""
    second = tuple(f"runner_up_{name}" for name in ("score", *_POSE))
    names = ("stamp", "line", "state", *_POSE, "score", "total", "overlap", "contradicted", *_VARIANCES, *second)
    return ",".join(names)


def space_csv_line(estimate: Estimate) -> str:
    """Return what is known after a scan as a line: metres, quaternion, variances in the map's axes.

    The pose is the tracked one, or the likeliest of several; the runner-up is the next one.
    """
    found = estimate.hypotheses
    cells: list[Any] = [f"{estimate.stamp:.6f}", "" if estimate.line is None else estimate.line, estimate.state.value]
    cells += _pose_cells(found[0].pose if found else None)
    cells += [estimate.score, estimate.total, f"{estimate.overlap:.4f}", f"{estimate.contradicted:.4f}"]
    C = estimate.covariance
    cells += [""] * 6 if C is None else [f"{v:.9g}" for v in np.diag(C).tolist()]
    second = found[1] if len(found) > 1 else None
    cells += ["" if second is None else second.score, *_pose_cells(second.pose if second else None)]
    return ",".join(map(str, cells))


def _pose_cells(pose: Pose | None) -> list[str]:
    if pose is None:
        return [""] * len(_POSE)
    return [f"{v:.6f}" for v in (*pose.translation.tolist(), *pose.quaternion().tolist())]
