"""Odometry of a LiDAR: KISS-ICP predicts where the sensor went, and the surfaces of the map say where it is.

KISS-ICP (Vizzo et al., "KISS-ICP: In defense of point-to-point ICP", 2023) follows a sensor through jerks and turns,
but draws points to points: rings on the floor that move with the sensor hold it back by some millimetres a scan. What
it says of the motion since the scan before is where :class:`~localisation.matching.surfaces.SurfaceMap` begins.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import MissingDependencyError
from hexmap.lattice.lattice import Lattice
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from localisation.lidar_settings import LidarSettings
from localisation.matching.surfaces import Drawn, SurfaceMap, first_of_each_cell
from localisation.odometry.sweep import Velocity, deskewed
from localisation.settings import limit_of

__all__ = ["LidarOdometry", "RegisteredSweep", "import_kiss_icp", "surface_lattice"]

# KISS-ICP's voxels are a metre for sensors that see a hundred: indoors as many of them fit into what the first scan
# sees, down to what the thickness of furniture allows.
_VOXELS_A_SCAN = 15.0
_VOXEL = (0.25, 1.0)
# A surface's cell in KISS-ICP's voxels: planes are found in it, and points within half of it find them.
_SURFACE = 0.5
# Points of a scan that are drawn: one in so wide a cell, in a surface's.
_DRAWN = 1.0 / 3.0
# Points on surfaces at least, as a share, or the scan has met something else.
_LEAST_SHARE = 0.1


def import_kiss_icp() -> Any:
    """Return the class KissICP and what makes its configuration.

    Raises:
        MissingDependencyError: it is not installed, or cannot be loaded.
    """
    try:
        from kiss_icp.config import KISSConfig
        from kiss_icp.kiss_icp import KissICP
    except (ImportError, OSError) as error:
        raise MissingDependencyError(
            f"the odometry of a LiDAR needs the package kiss-icp, which cannot be loaded ({error}); "
            "pip install 'hexmap[lidar]', or give --poses"
        ) from error
    return KissICP, KISSConfig


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
    """

    scan: Scan
    pose: Pose
    predicted: Pose
    points: FloatArray
    drawn: Drawn | None

    @property
    def held(self) -> bool:
        """Whether the surfaces hold the scan."""
        return self.drawn is not None and self.drawn.converged and self.drawn.share >= _LEAST_SHARE


class LidarOdometry:
    """Registers scans of a LiDAR one after the other; the caller adds them to the surfaces.

    Attributes:
        surfaces: what scans are drawn onto; None before the first scan. It may be replaced by another one, with
            :meth:`move_to` where its frame is another.
    """

    def __init__(self, settings: LidarSettings) -> None:
        """Begin at the origin of the map.

        Raises:
            MissingDependencyError: kiss-icp cannot be loaded.
        """
        import_kiss_icp()
        self.settings = settings
        self.surfaces: SurfaceMap | None = None
        self._kiss: Any = None
        self._kiss_pose = Pose.identity(3)
        self._pose = Pose.identity(3)
        self._stamp: float | None = None
        self._velocity: Velocity | None = None

    def _begin(self, points: FloatArray) -> None:
        KissICP, KISSConfig = import_kiss_icp()
        lattice, voxel = surface_lattice(self.settings.make_lattice(), points)
        self.surfaces = SurfaceMap(lattice)
        self._thin = lattice.scaled(_DRAWN)
        config = KISSConfig()
        # Scans come deskewed and within their ranges. One thread, so that a log gives the same bits on any machine.
        config.data.deskew = False
        config.data.min_range, config.data.max_range = 0.0, limit_of(self.settings.max_range)
        config.mapping.voxel_size = voxel
        config.registration.max_num_threads = 1
        self._kiss = KissICP(config)

    def in_range(self, points: FloatArray) -> FloatArray:
        """Return the points (N, 3) in the range that is mapped."""
        squared = (points**2).sum(axis=1)
        limit = limit_of(self.settings.max_range)
        return points[(squared >= self.settings.min_range**2) & (squared <= limit**2)]

    def register(self, scan: Scan) -> RegisteredSweep:
        """Return the next scan with its pose.

        Raises:
            BoundsError: a point is out of range; the scan is as if it had not been.
        """
        points = self.in_range(deskewed(scan, self._velocity))
        if self.surfaces is None:
            self._begin(points if len(points) else np.ones((1, 3)))
        assert self.surfaces is not None
        thin = first_of_each_cell(points, self._thin)
        self._kiss.register_frame(thin if len(thin) else np.zeros((1, 3)), np.empty(0))
        kiss_pose = Pose.from_matrix(self._kiss.last_pose)
        predicted = self._pose @ (self._kiss_pose.inverse() @ kiss_pose)
        self._kiss_pose = kiss_pose
        if scan.times is not None:
            # Now that the motion is known, once more by this one.
            moved = replace(scan, points=deskewed(scan, self._since(scan.stamp, predicted)), times=None)
            thin = first_of_each_cell(self.in_range(moved.points), self._thin)
        else:
            moved = scan
        drawn = self.surfaces.draw(thin, predicted) if len(self.surfaces) else None
        held = drawn is not None and drawn.converged and drawn.share >= _LEAST_SHARE
        pose = drawn.pose if drawn is not None and held else predicted
        if scan.times is not None:
            moved = replace(scan, points=deskewed(scan, self._since(scan.stamp, pose)), times=None)
        self._velocity = self._since(scan.stamp, pose) or self._velocity
        self._pose, self._stamp = pose, scan.stamp
        return RegisteredSweep(moved, pose, predicted, thin, drawn)

    def _since(self, stamp: float, pose: Pose) -> Velocity | None:
        """Return the velocity from the scan before to a pose."""
        if self._stamp is None:
            return None
        return Velocity.between(self._pose.inverse() @ pose, stamp - self._stamp)

    def move_to(self, pose: Pose) -> None:
        """Go on from another pose of the sensor at the last scan: the map has moved under it."""
        self._pose = pose
