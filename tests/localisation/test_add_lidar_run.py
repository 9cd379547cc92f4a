"""Further runs of a LiDAR: found in a map, bent to it and added, or refused in words."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hexmap.base.errors import AlignmentError, ArgumentError
from hexmap.lattice.lattice import Lattice
from hexmap.poses.pose import Pose
from hexmap.simulator.space import Building3D
from localisation.lidar_settings import LidarSettings
from localisation.mapping.add_lidar_run import add_lidar_run, lidar_settings_of
from localisation.mapping.lidar_map import LidarMappingResult, build_lidar_map
from tests.lattices import JIT, SPATIAL, Case
from tests.localisation.slam.lidar_drives import SimulatedLidarLog, block, hall, off

pytestmark = pytest.mark.skipif(not JIT, reason="takes hours without the compiler")

COARSE = LidarSettings(resolution=0.2, levels=2)


class Part(SimulatedLidarLog):
    """The scans of a drive from one to before another."""

    def __init__(self, building: Building3D, first: int, last: int) -> None:
        super().__init__(building, scans=last)
        self._scans_read, self.truth = self._scans_read[first:], self.truth[first:]
        self.path = Path(f"{building.name}{first}")


@pytest.fixture(scope="module")
def begun() -> tuple[SimulatedLidarLog, LidarMappingResult]:
    log = Part(hall(), 0, 30)
    return log, build_lidar_map(log, COARSE)


def in_first(first: SimulatedLidarLog, built: LidarMappingResult, log: SimulatedLidarLog) -> list[Pose]:
    """The true poses of a further run in the frame of the map of the first."""
    return [built.poses[0] @ first.truth[0].inverse() @ pose for pose in log.truth]


def test_a_second_run_lies_in_the_map_of_the_first(begun: tuple[SimulatedLidarLog, LidarMappingResult]) -> None:
    log, built = begun
    further, seen = Part(hall(), 20, 44), []
    result, found = add_lidar_run(built.map, further, on_pose=lambda stamp, pose, scan: seen.append(pose))
    metres, radians = off(list(result.poses), in_first(log, built, further))
    assert metres.max() < 0.1 and radians.max() < 0.02, "half a cell"
    assert found.held == found.submaps == 2
    assert all(a.is_close(b) for a, b in zip(seen, result.poses, strict=True))
    assert found.pose.is_close(in_first(log, built, further)[0], 0.15, 0.05)
    alone = build_lidar_map(further, COARSE).map.levels[0].hits.total
    assert result.map.levels[0].hits.total == built.map.levels[0].hits.total + alone
    assert result.map.frame == built.map.frame and lidar_settings_of(result.map) == COARSE
    assert result.slam is not None and result.slam.covariances[0].max() > 0.0, "relative to the map"


def test_a_run_of_another_place_is_refused(begun: tuple[SimulatedLidarLog, LidarMappingResult]) -> None:
    with pytest.raises(AlignmentError, match="block0: not found in the map beyond doubt"):
        add_lidar_run(begun[1].map, Part(block(), 0, 30))


def test_a_map_goes_on_with_its_own_settings_only(begun: tuple[SimulatedLidarLog, LidarMappingResult]) -> None:
    with pytest.raises(ArgumentError, match=r"0\.2 m of 2 levels goes on with these, not with D3 at 0\.1 m of 3"):
        add_lidar_run(begun[1].map, begun[0], LidarSettings())


@pytest.mark.long
@pytest.mark.parametrize("case", SPATIAL, ids=str)
def test_every_lattice_of_space_goes_on(case: Case) -> None:
    basis = Lattice(case.lattice.basis).scaled(0.2 / case.lattice.resolution).basis.tolist()
    settings = LidarSettings(lattice=basis, levels=2)
    log, further = Part(hall(), 0, 30), Part(hall(), 20, 44)
    built = build_lidar_map(log, settings)
    result, _ = add_lidar_run(built.map, further)
    assert off(list(result.poses), in_first(log, built, further))[0].max() < 0.15


@pytest.mark.long
def test_a_long_run_is_bent_to_the_map() -> None:
    log, further = Part(block(), 0, 120), Part(block(), 60, 170)
    built = build_lidar_map(log, LidarSettings(resolution=0.2, levels=2))
    result, found = add_lidar_run(built.map, further)
    assert found.held == found.submaps > 3
    assert np.median(off(list(result.poses), in_first(log, built, further))[0]) < 0.06
    again, _ = add_lidar_run(built.map, further)
    assert again.map == result.map
