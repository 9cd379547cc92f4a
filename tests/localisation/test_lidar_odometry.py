"""Odometry of a LiDAR: it is not drawn back by rings that move with the sensor, and finds itself again."""

from __future__ import annotations

import itertools
import sys

import numpy as np
import pytest

from hexmap.base.errors import MissingDependencyError
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from hexmap.simulator.space import Drive3D, RingLidar
from localisation.lidar_settings import LidarSettings
from localisation.odometry.kiss import import_kiss_icp
from localisation.odometry.lidar_odometry import LidarOdometry, RegisteredSweep
from tests.localisation.slam.lidar_drives import SimulatedLidarLog, hall, off, plain


def register(log: SimulatedLidarLog) -> tuple[LidarOdometry, list[RegisteredSweep]]:
    odometry, sweeps = LidarOdometry(LidarSettings()), []
    for scan in log:
        sweep = odometry.register(scan)
        if not sweep.missed:
            assert odometry.surfaces is not None
            odometry.surfaces.add(sweep.pose.apply(sweep.points))
        sweeps.append(sweep)
    return odometry, sweeps


def kiss_icp(log: SimulatedLidarLog) -> list[Pose]:
    """KISS-ICP alone, as it is by itself."""
    KissICP, KISSConfig = import_kiss_icp()
    config = KISSConfig()
    config.data.max_range = 100.0
    config.mapping.voxel_size = 1.0
    config.registration.max_num_threads = 1
    kiss, out = KissICP(config), []
    for scan in log:
        assert scan.times is not None
        kiss.register_frame(np.array(scan.points), (scan.times - scan.times.min()) / np.ptp(scan.times))
        out.append(Pose.from_matrix(kiss.last_pose))
    return out


def steps(poses: list[Pose]) -> np.ndarray:
    """How far each pose lies ahead of the one before, metres."""
    return np.array([(a.inverse() @ b).translation[0] for a, b in itertools.pairwise(poses)])


@pytest.mark.parametrize("every", [6.0, 8.0])
def test_rings_that_move_with_the_sensor_do_not_draw_it_back(every: float) -> None:
    building = plain(every)
    lidar = RingLidar(rings=32, azimuths=360, rate=5.0, max_range=40.0)
    log = SimulatedLidarLog(building, Drive3D(building.waypoints, sway=0.0), lidar, scans=30)
    true = log.from_first()
    theirs = float((steps(kiss_icp(log)) - steps(true)).mean())
    ours = [sweep.pose for sweep in register(log)[1]]
    mine = float((steps(ours) - steps(true)).mean())
    assert theirs < -0.05, "points drawn to points are held back"
    # Of the first sweep alone the surfaces are few: what is lost there is not lost again.
    assert abs(mine) < 0.007 and abs(mine) < 0.1 * abs(theirs)
    late = steps(ours[8:]) - steps(true[8:])
    assert abs(float(late.mean())) < 0.0025 and off(ours, true)[0].max() < 0.25


def test_a_scan_of_nothing_known_is_missed_and_the_next_ones_are_found_again() -> None:
    def garbage(k: int, scan: Scan) -> Scan:
        points = np.random.default_rng(k).uniform(-8.0, 8.0, (4000, 3))
        return Scan(scan.stamp, points, times=np.zeros(4000)) if k in (12, 13) else scan

    log = SimulatedLidarLog(hall(), scans=24, change=garbage)
    _, sweeps = register(log)
    assert [k for k, sweep in enumerate(sweeps) if sweep.missed] == [12, 13]
    metres, radians = off([sweep.pose for sweep in sweeps], log.from_first())
    assert metres[:12].max() < 0.05 and metres[14:].max() < 0.5
    assert metres[-4:].max() < 0.05 and radians[-4:].max() < 0.02
    assert sweeps[12].pose == sweeps[11].pose, "it stays where the last one was"


def test_without_kiss_icp_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "kiss_icp.kiss_icp", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'hexmap\[lidar\]', or give --poses"):
        LidarOdometry(LidarSettings())


def test_empty_scans_do_not_stop_it() -> None:
    def nothing(k: int, scan: Scan) -> Scan:
        return Scan(scan.stamp, np.zeros((0, 3)), times=np.zeros(0)) if k == 3 else scan

    log = SimulatedLidarLog(hall(), scans=8, change=nothing)
    _, sweeps = register(log)
    assert [sweep.missed for sweep in sweeps] == [False] * 3 + [True] + [False] * 4
    metres, _ = off([s.pose for s in sweeps[4:]], log.from_first()[4:])
    assert metres.max() < 0.05
