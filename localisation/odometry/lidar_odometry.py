"""Odometry of a LiDAR: KISS-ICP predicts where the sensor went, and the surfaces of the map say where it is.

KISS-ICP (Vizzo et al., "KISS-ICP: In defense of point-to-point ICP", 2023) follows a sensor through jerks and turns,
but draws points to points: rings on the floor that move with the sensor hold it back by some millimetres a scan. What
it says of the motion since the scan before is where :class:`~localisation.matching.surfaces.SurfaceMap` begins.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import BoundsError, TooLargeError
from hexmap.base.values import one_line
from hexmap.lattice.lattice import Lattice
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from localisation.lidar_settings import LidarSettings
from localisation.matching.global_matcher import GlobalMatcher, spread_points
from localisation.matching.pyramid import OccupancyPyramid
from localisation.matching.score import coincidence
from localisation.matching.search_region import SearchRegion
from localisation.matching.surfaces import Drawn, SurfaceMap, first_of_each_cell
from localisation.odometry.kiss import KissOdometry, import_kiss_icp
from localisation.odometry.sweep import Velocity, deskewed
from localisation.settings import limit_of

__all__ = ["LidarOdometry", "RegisteredSweep", "surface_lattice"]

# KISS-ICP's voxels are a metre for sensors that see a hundred: indoors as many of them fit into what the first scan
# sees, down to what the thickness of furniture allows.
_VOXELS_A_SCAN = 15.0
_VOXEL = (0.25, 1.0)
# A surface's cell in KISS-ICP's voxels: planes are found in it, and points within half of it find them.
_SURFACE = 0.75
# Points of a scan that are drawn: one in so wide a cell, in a surface's.
_DRAWN = 1.0 / 3.0
# Points on surfaces at least, as a share, or the scan has met something else.
_LEAST_SHARE = 0.06
# A scan of which fewer points lie in cells that hold points, or fewer lie on surfaces than this part of what is usual,
# may have been put where it is not: it is searched for. In a new room half of what is seen is new.
_DOUBTFUL, _UNUSUAL = 0.6, 0.7
# How far around the last pose: sparse scans and steps that no constant velocity foretells, metres, and as much again
# for every scan since that was not found.
_SEARCH_METRES, _SEARCH_MORE = 2.0, 1.0
# Upwards as much less as stairs and ramps are wider than they are high.
_STEEPEST = 0.4
# In cells of the surfaces, the cells that are searched on: twice as wide, a scan is found sooner, and drawn from there.
_SEARCHED = 2.0
_SEARCH_POINTS = 300
_SEARCH_NODES = 3_000
# Of the points of a scan that was searched for, the share in cells that hold points at least; and how many scans that
# lie nowhere are left out before the next one begins anew where it is expected.
_LEAST_MET = 0.35
_MOST_MISSED = 5
# Scans that KISS-ICP's map is made of again where it was lost.
_KEPT = 10


def surface_lattice(lattice: Lattice, points: FloatArray) -> tuple[Lattice, float]:
    """Return the lattice of the surfaces for a sensor, and KISS-ICP's voxels in metres, by what its first scan sees.

    Args:
        lattice: of the map's finest level.
        points: (N, 3) of the first scan, metres.
    """
    ranges = np.sqrt((points**2).sum(axis=1))
    voxel = float(np.clip(np.quantile(ranges, 0.95) / _VOXELS_A_SCAN, *_VOXEL))
    return lattice.scaled(max(_SURFACE * voxel / lattice.resolution, 2.0)), voxel


@dataclass(frozen=True, eq=False)
class RegisteredSweep:
    """A scan with its pose.

    Attributes:
        scan: the scan, its points as seen at its stamp.
        pose: T_map_sensor at the scan's stamp.
        predicted: the same by KISS-ICP's motion alone.
        points: (P, 3) those of its points that were drawn, metres, in the sensor's frame.
        drawn: what the surfaces said; None where there were none yet.
        missed: whether it lies nowhere near the last scan, and its pose is that one's: it says nothing of the map.
    """

    scan: Scan
    pose: Pose
    predicted: Pose
    points: FloatArray
    drawn: Drawn | None
    missed: bool

    __repr__ = one_line

    @property
    def held(self) -> bool:
        """Whether the surfaces hold the scan."""
        return self.drawn is not None and _holds(self.drawn)


def _holds(drawn: Drawn) -> bool:
    return drawn.converged and drawn.share >= _LEAST_SHARE and drawn.met >= _LEAST_MET


class LidarOdometry:
    """Registers scans of a LiDAR one after the other; the caller adds them to the surfaces.

    Attributes:
        surfaces: what scans are drawn onto; None before the first scan. It may be replaced by another one, with
            :meth:`move_to` where its frame is another.
        missed: how many scans there have been since the last one that was found.
        searches: scans that were searched for, and
        found: those of them that lay elsewhere than KISS-ICP had put them.
    """

    def __init__(
        self, settings: LidarSettings, velocity: Velocity | None = None, begin: Pose | None = None
    ) -> None:
        """Begin with no map.

        Args:
            settings: of the map.
            velocity: the sensor's in the first sweep, where it is known.
            begin: T_map_sensor of the first scan; None: the origin.

        Raises:
            MissingDependencyError: kiss-icp cannot be loaded.
        """
        import_kiss_icp()
        self.settings = settings
        self.surfaces: SurfaceMap | None = None
        self._kiss: KissOdometry | None = None
        self._pose = self._kiss_pose = begin or Pose.identity(3)
        self._stamp: float | None = None
        self._velocity = velocity
        self._usual: float | None = None
        self._recent: deque[tuple[FloatArray, Pose]] = deque(maxlen=_KEPT)
        self.searches = self.found = self.missed = 0

    def _begin(self, points: FloatArray) -> None:
        lattice, voxel = surface_lattice(self.settings.make_lattice(), points)
        self.surfaces = SurfaceMap(lattice)
        self._thin = lattice.scaled(_DRAWN)
        self._voxel = voxel
        self._begin_kiss_icp()

    def _begin_kiss_icp(self) -> None:
        """Begin KISS-ICP anew, from the last scans where they are."""
        self._kiss = KissOdometry(self._voxel, limit_of(self.settings.max_range), self._pose)
        self._kiss_pose = self._pose
        for points, pose in self._recent:
            self._kiss.add(points, pose)

    @classmethod
    def first_velocity(cls, settings: LidarSettings, scans: Sequence[Scan]) -> Velocity | None:
        """Return the sensor's velocity at the first of two scans, which would stay skewed without; None if unknown.

        Points with a time each are wanted, and a second scan not long after.
        """
        if len(scans) < 2 or scans[0].times is None:
            return None
        velocity = None
        # The second time the first scan is deskewed already.
        for _ in range(2):
            odometry = cls(settings, velocity)
            for scan in scans[:2]:
                try:
                    sweep = odometry.register(scan)
                except (BoundsError, TooLargeError):
                    return None  # such a scan is counted where the log is mapped
                assert odometry.surfaces is not None
                odometry.surfaces.add(sweep.pose.apply(sweep.points))
            velocity = odometry._velocity
        return velocity

    def register(self, scan: Scan) -> RegisteredSweep:
        """Return the next scan with its pose.

        Raises:
            BoundsError: a point is out of range; the scan is as if it had not been.
        """
        points = self.settings.in_range(deskewed(scan, self._velocity))
        if self.surfaces is None:
            self._begin(points if len(points) else np.ones((1, 3)))
        assert self.surfaces is not None
        thin = first_of_each_cell(points, self._thin)
        assert self._kiss is not None
        kiss_pose = self._kiss.register(thin if len(thin) else np.zeros((1, 3)))
        predicted = self._pose @ (self._kiss_pose.inverse() @ kiss_pose)
        self._kiss_pose = kiss_pose
        before = self._pose
        if scan.times is not None:
            # Now that the motion is known, once more by this one.
            moved = replace(scan, points=deskewed(scan, self._since(scan.stamp, predicted)), times=None)
            thin = first_of_each_cell(self.settings.in_range(moved.points), self._thin)
        else:
            moved = scan
        drawn = self.surfaces.draw(thin, predicted) if len(self.surfaces) else None
        if drawn is not None and self._is_doubtful(drawn):
            drawn = self._search(thin, drawn)
        held = drawn is not None and _holds(drawn)
        pose = drawn.pose if drawn is not None and held else predicted
        self.missed = 0 if held or drawn is None else self.missed + 1
        if self.missed > _MOST_MISSED:
            self.missed = 0
        if drawn is not None and held:
            self._usual = drawn.share if self._usual is None else 0.9 * self._usual + 0.1 * drawn.share
        if scan.times is not None:
            moved = replace(scan, points=deskewed(scan, self._since(scan.stamp, pose)), times=None)
        self._velocity = self._since(scan.stamp, pose) or self._velocity
        self._pose, self._stamp = pose, scan.stamp
        if self.missed:
            # KISS-ICP has put it somewhere: its map is made anew without it.
            self._pose = before
            self._begin_kiss_icp()
            return RegisteredSweep(moved, before, predicted, thin, drawn, self.missed > 0)
        self._recent.append((thin, pose))
        if math.dist((predicted.inverse() @ pose).translation, (0.0, 0.0, 0.0)) > self._voxel:
            self._begin_kiss_icp()
        return RegisteredSweep(moved, pose, predicted, thin, drawn, False)

    def _is_doubtful(self, drawn: Drawn) -> bool:
        """Tell whether a scan may lie somewhere else than where it was drawn."""
        usual = drawn.share if self._usual is None else self._usual
        return not drawn.converged or drawn.met < _DOUBTFUL or drawn.share < _UNUSUAL * usual

    def _search(self, thin: FloatArray, drawn: Drawn) -> Drawn:
        """Search for a scan around the last pose; return what it is drawn to there, where that fits better."""
        assert self.surfaces is not None
        self.searches += 1
        searched = self.surfaces.lattice.scaled(_SEARCHED)
        centres = self.surfaces.lattice.centres(self.surfaces.cells().index)
        matcher = GlobalMatcher(OccupancyPyramid(coincidence(VoxelList.from_points(centres, searched))))
        # With the attitude that it had last, so that what is left to find is yaw.
        level = Pose(self._pose.rotation, np.zeros(3))
        centre = self._pose.translation
        sides = (_SEARCH_METRES + _SEARCH_MORE * self.missed) * np.array([1.0, 1.0, _STEEPEST])
        match = matcher.match(
            level.apply(spread_points(thin, searched, _SEARCH_POINTS)),
            SearchRegion(centre - sides, centre + sides), least=_LEAST_SHARE,
            runner_up=None, refine=False, beams=False, information=False, node_limit=_SEARCH_NODES,
        )  # fmt: skip
        if match is None:
            return drawn
        there = self.surfaces.draw(thin, match.pose @ level, farthest=_SEARCHED)
        if there.converged and (there.share > drawn.share or not drawn.converged):
            self.found += 1
            return there
        return drawn

    def _since(self, stamp: float, pose: Pose) -> Velocity | None:
        """Return the velocity from the scan before to a pose."""
        if self._stamp is None:
            return None
        return Velocity.between(self._pose.inverse() @ pose, stamp - self._stamp)

    def begin_at(self, scan: Scan, pose: Pose, surfaces: SurfaceMap | None) -> None:
        """Begin at a scan whose pose T_map_sensor is known, on the surfaces of a map."""
        points = self.settings.in_range(scan.points)
        self._pose, self._stamp = pose, scan.stamp
        self._recent.clear()
        self._begin(points if len(points) else np.ones((1, 3)))
        self._recent.append((first_of_each_cell(points, self._thin), pose))
        assert self._kiss is not None
        self._kiss.add(self._recent[-1][0], pose)
        if surfaces is not None:
            self.surfaces = surfaces

    def move_to(self, pose: Pose) -> None:
        """Go on from another pose of the sensor at the last scan: the map has moved under it."""
        back = pose @ self._pose.inverse()
        self._recent = deque(((points, back @ there) for points, there in self._recent), maxlen=_KEPT)
        self._pose = pose
