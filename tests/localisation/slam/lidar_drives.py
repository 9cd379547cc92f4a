"""Short simulated drives of a ring LiDAR, as logs; quick because rings and azimuths are few."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from hexmap.io.lidar.lidar_log import LidarLog, LidarLogSettings
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from hexmap.simulator.space import Building3D, Drive3D, RingLidar, SolidList, simulate_lidar

QUICK = RingLidar(rings=16, azimuths=360, rate=5.0)


class SimulatedLidarLog(LidarLog):
    """A simulated drive as a log; ``change`` makes something else of the scan of a number.

    ``mounted`` says whether the log knows how the LiDAR is mounted on its robot.

    Attributes:
        truth: T_map_lidar of every scan that was read last.
    """

    format = "simulated"

    def __init__(
        self,
        building: Building3D,
        drive: Drive3D | None = None,
        lidar: RingLidar = QUICK,
        *,
        scans: int | None = None,
        change: Callable[[int, Scan], Scan] | None = None,
        mounted: bool = False,
    ) -> None:
        super().__init__(Path(building.name), LidarLogSettings(), 1)
        if mounted:
            self.mount, self.robot = lidar.mount, "base_link"
        drive = drive or Drive3D(building.waypoints)
        self._run = list(simulate_lidar(building, drive, lidar, 1, scans=scans))
        self._scans_read = [s.scan if change is None else change(k, s.scan) for k, s in enumerate(self._run)]
        self.truth = [s.T_map_lidar for s in self._run]

    def _read(self) -> Iterator[Scan]:
        yield from self._scans_read

    def _no_scan(self) -> str:
        return f"{self.path}: no scan"

    def from_first(self) -> list[Pose]:
        """The true poses as seen from the first one."""
        back = self.truth[0].inverse()
        return [back @ pose for pose in self.truth]


def off(found: list[Pose], true: list[Pose]) -> tuple[np.ndarray, np.ndarray]:
    """How far poses are off, metres and radians."""
    between = [a.inverse() @ b for a, b in zip(true, found, strict=True)]
    return np.array([np.linalg.norm(d.translation) for d in between]), np.array([d.angle for d in between])


def hall() -> Building3D:
    """A hall with pillars, boxes and a ceiling, and a drive through it."""
    solids = SolidList()
    solids.box((-1, -1, -0.3), (15, 11, 0))
    solids.box((-1, -1, 4.0), (15, 11, 4.3))
    solids.wall((-1, -1), (15, -1), (0, 4), 0.2)
    solids.wall((-1, 11), (15, 11), (0, 4), 0.2)
    solids.wall((-1, -1), (-1, 11), (0, 4), 0.2)
    solids.wall((15, -1), (15, 11), (0, 4), 0.2)
    solids.cylinder(4.0, 7.5, 0.4, 0.0, 4.0)
    solids.turned_box((10.0, 6.5, 0.0), (1.5, 1.0, 2.0), 0.4, 0.5)
    solids.turned_box((5.5, 0.2, 0.0), (1.0, 1.0, 1.2), -0.3, 0.5)
    return solids.building("hall", [(1.0, 2.0, 0.0), (12.5, 2.5, 0.0), (12.5, 9.0, 0.0)])


def block() -> Building3D:
    """A corridor around a block, driven around more than once: what closes a loop."""
    solids = SolidList()
    solids.box((-2, -2, -0.3), (18, 14, 0))
    solids.box((-2, -2, 3.0), (18, 14, 3.3))
    for low, high in (((-2.0, -2.0), (18.0, -2.0)), ((-2.0, 14.0), (18.0, 14.0))):
        solids.wall(low, high, (0, 3), 0.2)
    for x in (-2.0, 18.0):
        solids.wall((x, -2.0), (x, 14.0), (0, 3), 0.2)
    solids.box((2.0, 2.0, 0.0), (14.0, 10.0, 3.0))
    # What tells one place from another.
    rng = np.random.default_rng(3)
    for x, y, turn in ((5, 1.6, 0.1), (11, -1.6, 0.5), (17.5, 4, 0.3), (14.3, 8, 0.2), (9, 13.5, 0.6), (4, 10.4, 0.2),
                       (-1.6, 7, 0.4), (1.6, 4, 0.1)):  # fmt: skip
        edges = (float(rng.uniform(0.5, 1.0)), float(rng.uniform(0.5, 1.0)), float(rng.uniform(0.6, 2.0)))
        solids.turned_box((float(x), float(y), 0.0), edges, turn, 0.5)
    corners = [(0.0, 0.0, 0.0), (16.0, 0.0, 0.0), (16.0, 12.0, 0.0), (0.0, 12.0, 0.0)]
    return solids.building("block", [(3.0, 0.0, 0.0), *corners[1:], *corners[:2], (16.0, 6.0, 0.0)])


def plain(every: float) -> Building3D:
    """A wide floor with a wall across now and then: most of what a ring LiDAR sees moves along with it."""
    solids = SolidList()
    solids.box((-40, -40, -0.3), (70, 40, 0))
    for k in range(-2, 8):
        for x, y in ((every * k, 4.0), (every * (k + 0.5), -8.0)):
            solids.box((x, y, 0.0), (x + 0.4, y + 4.0, 3.0))
    return solids.building("plain", [(0.0, 0.0, 0.0), (30.0, 0.0, 0.0)])
