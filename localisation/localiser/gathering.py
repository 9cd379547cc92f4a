"""Scans of some metres, gathered into one cloud by scan matching, and that cloud found in the whole map.

One scan in a corridor fits at many places of it, and so do the next ones, of nearly the same walls: their scores do not
tell as much as they add up to. A cloud of all that was seen on the way is matched as one large scan: the niches and
corners in it must fit all at once. It is scored softly, as its odometry and the map bend against each other.
"""

from __future__ import annotations

import math

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.maps.state_rule import StateRule, States
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from localisation.localiser.settings import LocaliserSettings
from localisation.matching.global_matcher import GlobalMatcher, thin
from localisation.matching.match import Match
from localisation.matching.pyramid import OccupancyPyramid
from localisation.matching.score import likelihood
from localisation.odometry.scan_odometry import ScanOdometry
from localisation.settings import MappingSettings, make_builder

__all__ = ["CloudMatcher", "Gathering", "surface"]

# In cells of the map: the field reaches as far as a wall may be drawn amiss, a cell and what quantising adds on either
# side; it is searched on cells of two, which is fine enough for a field as wide as that.
_SIGMA = 3.0
_COARSER = 2.0
# Metres of the cells that are gathered: about the gap between two beams across a room, as where runs are mapped.
_CELL = 0.1


def surface(states: States) -> VoxelList:
    """Return the occupied cells that a sensor can see: those beside a free one, all where nothing is free.

    Walls are drawn as thick as their maker liked; inside them nothing ends.
    """
    occupied, free = states.occupied, states.free
    seen = np.zeros(len(occupied), np.bool_)
    for offset in occupied.lattice.neighbours:
        seen |= free.contains(occupied.index.astype(np.int64) + offset)
    return occupied.select(seen) if seen.any() else occupied


class CloudMatcher:
    """Finds gathered clouds in a map.

    Args:
        states: the map.
        settings: what counts as explained, and which part of the best score makes a rival.
    """

    def __init__(self, states: States, settings: LocaliserSettings) -> None:
        """Make the field of the map."""
        fine = states.occupied.lattice
        self.settings = settings
        self.lattice = fine.scaled(_COARSER)
        walls = VoxelList.from_points(surface(states).centres(), self.lattice)
        field = likelihood(walls, _SIGMA * fine.resolution)
        known = VoxelList.from_points(states.free.centres(), self.lattice) if len(states.free) else None
        self._matcher = GlobalMatcher(OccupancyPyramid(field), known)

    def find(self, cloud: FloatArray, *, alone: bool) -> Match | None:
        """Return the best place of a cloud (P, 2) in the sensor's frame; None where too little of it is explained.

        Args:
            cloud: what was gathered.
            alone: whether another place that reaches ``settings.part`` of the best score always makes the answer None.
                If not, it does where the map leaves as much of the cloud unexplained as makes a rival: doors, furniture
                and what is not drawn favour a wrong place as well.
        """
        s = self.settings
        points, _ = thin(cloud, self.lattice)
        # Neighbouring cells of the search and what the field blurs are one place.
        apart = max(s.apart[0], 5.0 * self.lattice.resolution), s.apart[1]
        match = self._matcher.match(
            points, least=s.explained, apart=apart, runner_up=s.part, refine=False, beams=False, information=False,
            time_limit=s.time_limit, node_limit=s.node_limit,
        )  # fmt: skip
        if match is None or not match.certified or match.runner_up_bound is None:
            return None
        rival = match.runner_up_bound > math.floor(s.part * match.score)
        return None if rival and (alone or match.fraction < s.part) else match


class Gathering:
    """The scans since the robot was last known to be somewhere, as one cloud.

    Args:
        lattice: of the map; the cloud's cells are of its kind.
        settings: of the localiser.
        mount: T_robot_sensor.

    Attributes:
        way: metres that the sensor has moved since the first of them.
        due: metres from which on the next search is worth its time.
    """

    def __init__(self, lattice: Lattice, settings: LocaliserSettings, mount: Pose) -> None:
        """Begin without a scan."""
        basis = lattice.basis * (0.5 * _CELL / lattice.resolution)
        self._settings = MappingSettings(
            lattice=basis.tolist(), levels=2, min_range=settings.min_range,
            max_range=settings.max_range if math.isfinite(settings.max_range) else None,
            use_odometry=settings.use_odometry,
        )  # fmt: skip
        self._mount = mount
        self._most = settings.gather_metres
        self._every = settings.gather_step
        self._begin()

    def _begin(self) -> None:
        self._builder: MapBuilder = make_builder(self._settings)
        self._odometry = ScanOdometry(self._settings, self._builder, self._mount, learn=True)
        self._at: Pose | None = None
        self.way = 0.0
        self.due = self._every

    def add(self, scan: Scan) -> None:
        """Match a scan against those before, and add it; begin again where the way gets too long."""
        if self.way > self._most:
            self._begin()
        registered = self._odometry.register(scan)
        self._builder.fuse(scan, registered.T_map_scan)
        if self._at is not None:
            self.way += math.dist(self._at.translation, registered.T_map_scan.translation)
        self._at = registered.T_map_scan

    def searched(self) -> None:
        """Note that a search was in vain: the next is due after a quarter more, as so much more is new."""
        self.due = max(self.way + self._every, 1.25 * self.way)

    def cloud(self) -> FloatArray:
        """Return the occupied cells' centres (P, 2) in the frame of the sensor at the last scan, metres."""
        assert self._at is not None
        occupied = self._builder.build().state(StateRule(), 1).occupied
        return self._at.inverse().apply(occupied.centres())
