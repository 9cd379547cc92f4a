"""A log split into scans of the map and scans that are looked for, with their poses, as plain arrays."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.base.values import one_line
from hexmap.io.logs.log import Log, LogSettings
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Event, Scan
from localisation.experiments.geometry import Geometry, geometry_of
from localisation.mapping.build_map import build_map
from localisation.mapping.result import MappingResult
from localisation.settings import MappingSettings

__all__ = ["NEAR", "ScansLog", "World", "built_poses"]

# Points that a scan must have to be looked for: fewer fit anywhere.
_LEAST_POINTS = 20
NEAR = 3.0
"""Metres: a scan is looked for where a scan of the map was taken no farther away, about a room's width."""

_ARRAYS = ("points", "offsets", "poses", "odometry", "run", "held_out", "mounts")


@dataclass(frozen=True, eq=False)
class World:
    """The scans of one place, in the order of the log, those of another run after them.

    Attributes:
        points: (N, n) of all scans one after the other, in the sensor's frame, metres; n is 2 or 3.
        offsets: (K + 1,) where each scan's points begin.
        poses: (K, R) T_map_sensor as the rows of :class:`~localisation.experiments.geometry.Geometry`; NaN where it is
            not known.
        odometry: (K, R) T_odom_robot, NaN where there is none.
        run: (K,) number of the log of each scan.
        held_out: (K,) whether a scan is looked for; then it is in no map.
        mounts: (L, R) T_robot_sensor of each log.
        source: what the logs are.
        reference: where the poses are from, a sentence.
        given: whether they were given, rather than built.
    """

    points: FloatArray
    offsets: IntArray
    poses: FloatArray
    odometry: FloatArray
    run: IntArray
    held_out: NDArray[np.bool_]
    mounts: FloatArray
    source: str
    reference: str
    given: bool

    __repr__ = one_line

    def __len__(self) -> int:
        """Return the number of scans."""
        return len(self.poses)

    @property
    def geometry(self) -> Geometry:
        """The plane or space."""
        return geometry_of(self.points.shape[1])

    @property
    def positions(self) -> FloatArray:
        """(K, n) where the sensor was at each scan, metres; NaN where that is not known."""
        return self.geometry.positions(self.poses)

    def shared(self) -> dict[str, Any]:
        """Return the arrays for the cases."""
        return {**{name: getattr(self, name) for name in _ARRAYS}, "given": self.given}

    @classmethod
    def of_shared(cls, shared: Mapping[str, Any]) -> World:
        """Return the world that a case was given."""
        return cls(**{name: shared[name] for name in _ARRAYS}, source="", reference="", given=bool(shared["given"]))

    def scan(self, k: int) -> FloatArray:
        """Return the points (P, n) of scan ``k``."""
        return self.points[self.offsets[k] : self.offsets[k + 1]]

    def pose(self, k: int) -> Pose:
        """Return T_map_sensor of scan ``k``, which is known."""
        return self.geometry.to_pose(self.poses[k])

    def odometry_pose(self, k: int) -> Pose | None:
        """Return T_odom_robot of scan ``k``, None where there is none."""
        row = self.odometry[k]
        return None if np.isnan(row).any() else self.geometry.to_pose(row)

    def mount(self, k: int) -> Pose:
        """Return T_robot_sensor of scan ``k``."""
        return self.geometry.to_pose(self.mounts[self.run[k]])

    @property
    def known(self) -> NDArray[np.bool_]:
        """(K,) whether the pose of each scan is known."""
        return np.asarray(~np.isnan(self.poses).any(axis=1))

    def map_scans(self) -> IntArray:
        """Return the numbers of the scans that go into maps."""
        return np.flatnonzero(self.known & ~self.held_out)

    def test_scans(self) -> IntArray:
        """Return the numbers of the scans that are looked for: held out, with a pose and enough points, in the map."""
        numbers = np.flatnonzero(self.known & self.held_out & (np.diff(self.offsets) >= _LEAST_POINTS))
        mapped = self.positions[self.map_scans()]
        if len(mapped) == 0 or len(numbers) == 0:
            return numbers[:0]
        distance = cKDTree(mapped).query(self.positions[numbers])[0]
        return np.asarray(numbers[distance <= NEAR])


class ScansLog(Log):
    """Some scans of a world of the plane as a log; the stamp of each is its number, so that its pose can be told."""

    format = "scans"

    def __init__(self, world: World, numbers: IntArray) -> None:
        super().__init__(Path("scans"), LogSettings(), len(numbers))
        self._world, self._numbers = world, numbers
        self.mount = world.mount(int(numbers[0])) if len(numbers) else None

    def _events(self) -> Iterator[Event]:
        for k in self._numbers.tolist():
            self.scans += 1
            yield Scan(float(k), self._world.scan(k), odometry=self._world.odometry_pose(k))

    def _no_laser(self) -> str:
        return "there is no scan"


def built_poses(
    world: World, numbers: IntArray, settings: MappingSettings | None = None
) -> tuple[MappingResult, FloatArray]:
    """Map some scans of the plane; return the result and T_map_laser (K, 3) of each scan, NaN of those left out."""
    poses = np.full((len(world), 3), math.nan)

    def on_pose(stamp: float, pose: Pose, is_scan: bool) -> None:
        if is_scan:
            at = pose @ world.mount(int(stamp))
            poses[int(stamp)] = at.x, at.y, at.theta

    return build_map(ScansLog(world, numbers), settings, on_pose=on_pose), poses
