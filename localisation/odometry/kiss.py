"""KISS-ICP (Vizzo et al. 2023) by its array interface, with a state that can be kept and gone on with.

Its maps and its threshold live in compiled code that cannot be pickled. What they are made of can: points go back into
a map in the order in which each voxel has them, and the threshold is the sum of the deviations that it was told.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import MissingDependencyError
from hexmap.poses.pose import Pose

__all__ = ["KissOdometry", "import_kiss_icp"]

# Its own range, metres, where there is no limit.
_RANGE = 100.0


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


class _Threshold:
    """Its adaptive threshold, which remembers what it was told."""

    def __init__(self, estimator: Any) -> None:
        self._estimator = estimator
        self.told: list[FloatArray] = []

    def get_threshold(self) -> float:
        return float(self._estimator.get_threshold())

    def update_model_deviation(self, model_deviation: FloatArray) -> None:
        self.told.append(np.array(model_deviation))
        self._estimator.update_model_deviation(model_deviation)


class KissOdometry:
    """Follows a sensor whose scans come deskewed and within their ranges."""

    def __init__(self, voxel: float, limit: float, pose: Pose) -> None:
        """Begin with an empty map.

        Args:
            voxel: of its map, metres.
            limit: the farthest range, metres; infinite for none.
            pose: T_map_sensor of the scan before the first one.

        Raises:
            MissingDependencyError: it cannot be loaded.
        """
        self._voxel, self._limit = voxel, limit
        KissICP, KISSConfig = import_kiss_icp()
        config = KISSConfig()
        # One thread, so that a log gives the same bits on any machine.
        config.data.deskew = False
        # It counts turns by how far they move what is at its range, and ends the process where that is infinite.
        config.data.min_range, config.data.max_range = 0.0, limit if math.isfinite(limit) else _RANGE
        config.mapping.voxel_size = voxel
        config.registration.max_num_threads = 1
        self._kiss = KissICP(config)
        self._kiss.last_pose = pose.matrix()
        self._kiss.adaptive_threshold = _Threshold(self._kiss.adaptive_threshold)

    def add(self, points: FloatArray, pose: Pose) -> None:
        """Add a scan (N, 3), in the sensor's frame, whose pose is known."""
        self._kiss.local_map.update(points, pose.matrix())

    def register(self, points: FloatArray) -> Pose:
        """Return T_map_sensor of the next scan (N, 3)."""
        self._kiss.register_frame(points, np.empty(0))
        return Pose.from_matrix(self._kiss.last_pose)

    def __getstate__(self) -> dict[str, Any]:
        """Return what it is made of."""
        kiss = self._kiss
        return {
            "voxel": self._voxel, "limit": self._limit, "pose": np.array(kiss.last_pose),
            "delta": np.array(kiss.last_delta), "points": np.array(kiss.local_map.point_cloud()).reshape(-1, 3),
            "told": np.array(kiss.adaptive_threshold.told).reshape(-1, 4, 4),
        }  # fmt: skip

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Make it again."""
        self.__init__(state["voxel"], state["limit"], Pose.identity(3))  # type: ignore[misc]
        kiss = self._kiss
        kiss.last_pose, kiss.last_delta = state["pose"], state["delta"]
        if len(state["points"]):
            kiss.local_map.add_points(state["points"])
        for deviation in state["told"]:
            kiss.adaptive_threshold.update_model_deviation(deviation)
